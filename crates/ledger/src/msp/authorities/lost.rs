//! The authorities that an organisation loses by a change.

use crate::network::FoundingOrganisation;
use ledger_base::rejection::Rejection;
use ledger_identity::certificate::Certificate;
use std::collections::BTreeSet;

/// SHA-256 of a distinguished name: as a certificate, a grant or an approval names its issuer.
type Name = [u8; 32];

/// The names of the authorities that vouch no longer for all for whom they did: each that leaves, or loses a key. A CA that is
/// founded anew has the name of the one before and another key, so everything of that name is lost, and what stands below it.
pub(super) fn lost(before: &FoundingOrganisation, after: &FoundingOrganisation) -> Result<BTreeSet<Name>, Rejection> {
    let stay = standing(after)?;
    let mut lost: BTreeSet<Name> = standing(before)?.difference(&stay).map(|(name, _)| *name).collect();
    let names: BTreeSet<Name> = stay.into_iter().map(|(name, _)| name).collect();
    let (mut below, msp) = (Vec::new(), after.msp()?);
    for der in &after.intermediates {
        let Certificate { issuer_name, subject_name, .. } = Certificate::parse(der)?;
        let issuer = msp.issuer(&issuer_name).unwrap_or_else(|| issuer_name.hash());
        below.push((issuer.0, subject_name.hash().0));
    }
    loop {
        // The issuer still stands by its name, but perhaps not with the key that has signed this one.
        let ends = |issuer: &Name, name: &Name| lost.contains(issuer) && names.contains(issuer) && !lost.contains(name);
        let more: Vec<Name> = below.iter().filter(|(issuer, name)| ends(issuer, name)).map(|(_, name)| *name).collect();
        if more.is_empty() {
            return Ok(lost);
        }
        lost.extend(more);
    }
}

/// The authorities that lead to a root, each by its name and its public key.
fn standing(organisation: &FoundingOrganisation) -> Result<BTreeSet<(Name, Vec<u8>)>, Rejection> {
    let msp = organisation.msp()?;
    let mut standing = BTreeSet::new();
    for der in organisation.roots.iter().chain(&organisation.intermediates) {
        let Certificate { subject_name, public_key_info, .. } = Certificate::parse(der)?;
        let name = subject_name.hash().0;
        if msp.standing().contains(&name) {
            standing.insert((name, public_key_info));
        }
    }
    Ok(standing)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use testkit::Ca;

    fn organisation(roots: &[&Ca], intermediates: &[&Ca]) -> FoundingOrganisation {
        let ders = |cas: &[&Ca]| cas.iter().map(|ca| ca.root()).collect::<Vec<_>>();
        let (roots, intermediates) = (ders(roots), ders(intermediates));
        FoundingOrganisation { name: "Org1".into(), roots, intermediates, units: None }
    }

    #[test]
    fn an_authority_is_lost_with_its_key_whoever_else_has_its_name() {
        let (old, anew, other) = (Ca::new("org1-ca"), Ca::new("org1-ca"), Ca::new("other-ca"));
        let (below, beside) = (old.below("below-ca"), other.below("beside-ca"));
        let lowest = below.below("lowest-ca");
        let all = [&below, &lowest, &beside];
        let before = organisation(&[&old, &other], &all);
        let name = |ca: &&Ca| Certificate::parse(&ca.root()).unwrap().subject_name.hash().0;
        let cases: [(FoundingOrganisation, &[&Ca]); 5] = [
            (organisation(&[&old, &other, &anew], &all), &[]),
            (organisation(&[&other, &anew], &all), &[&old, &below, &lowest]),
            (organisation(&[&other], &all), &[&old, &below, &lowest]),
            (organisation(&[&old, &other], &[&lowest, &beside]), &[&below, &lowest]),
            (organisation(&[&old, &anew], &all), &[&other, &beside]),
        ];
        for (number, (after, wanted)) in (1..).zip(cases) {
            let wanted: BTreeSet<Name> = wanted.iter().map(name).collect();
            assert_eq!(lost(&before, &after).unwrap(), wanted, "case {number}");
        }
    }
}
