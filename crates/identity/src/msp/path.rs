//! The path from a certificate to a root of one organisation (RFC 5280 section 6), without policies.

use super::{Authority, Msp, Usage};
use crate::certificate::Certificate;
use crate::identity::{IdentityError, check_validity, printable};
use crate::signature::{Fault, WANTED};
use ledger_base::hash::Hash;

/// Most signatures that are checked for one certificate: authorities of one name could make the search long.
const SIGNATURES_MAX: usize = 100;

/// A path that was found.
#[derive(Debug)]
pub(super) struct Path {
    /// SHA-256 of the certificate that has issued the leaf.
    pub(super) issuer: Hash,
    /// SHA-256 of its name, as that certificate writes it.
    pub(super) issuer_name: Hash,
    /// Since when every certificate of it is valid, in microseconds since the UNIX epoch.
    pub(super) not_before: u64,
    /// Until when every certificate of it is valid, in microseconds since the UNIX epoch.
    pub(super) not_after: u64,
}

/// Looks for a path from a certificate, used at a time (microseconds since the UNIX epoch), to any root of the organisation.
pub(super) fn find(
    msp: &Msp,
    presented: &[Authority],
    (certificate, usage, at): (&Certificate, Usage, u64),
) -> Result<Path, IdentityError> {
    let mut search = Search { msp, presented, usage, at: Some(at), below: 0, signatures: 0 };
    if let Some(oid) = certificate.unknown_critical() {
        return Err(search.broken(certificate, format!("the critical extension {oid}, which is not known here")));
    }
    let mut path = Vec::new();
    search.climb(certificate, &mut path)?;
    let Some(issuer) = path.first() else { return Err(search.untrusted(certificate)) };
    let mut found = Path {
        issuer: Hash::of(&[issuer.der.as_ref()]),
        issuer_name: issuer.certificate.subject_name.hash(),
        not_before: certificate.not_before,
        not_after: certificate.not_after,
    };
    for Authority { certificate, .. } in path {
        found.not_before = found.not_before.max(certificate.not_before);
        found.not_after = found.not_after.min(certificate.not_after);
    }
    Ok(found)
}

/// Checks that an intermediate authority leads to a root, at some time, with room for the certificates that it issues.
pub(super) fn check_leads_to_root(msp: &Msp, intermediate: &Authority) -> Result<(), IdentityError> {
    let certificate = &intermediate.certificate;
    let below = usize::from(!certificate.is_self_issued());
    let mut search = Search { msp, presented: &[], usage: Usage::Client, at: None, below, signatures: 0 };
    search.climb(certificate, &mut Vec::new())
}

struct Search<'a> {
    msp: &'a Msp,
    presented: &'a [Authority],
    usage: Usage,
    /// None: the time does not matter.
    at: Option<u64>,
    /// Intermediate authorities below the certificate where the search begins, it included.
    below: usize,
    /// How many were checked.
    signatures: usize,
}

impl<'a> Search<'a> {
    /// Adds to the path the authorities from this certificate's issuer up to a root.
    fn climb(&mut self, leaf: &Certificate, path: &mut Vec<&'a Authority>) -> Result<(), IdentityError> {
        let msp = self.msp;
        let lowest = path.last().map_or(leaf, |authority| &authority.certificate).issuer_name.clone();
        let mut refused = self.untrusted(leaf);
        for root in msp.roots.iter().filter(|root| root.certificate.subject_name == lowest) {
            match self.check_link(leaf, path, root, true) {
                Ok(()) => {
                    path.push(root);
                    return Ok(());
                }
                Err(error) => refused = more_telling(refused, error),
            }
        }
        let presented = self.presented;
        for issuer in msp.intermediates.iter().chain(presented) {
            let Certificate { subject_name, public_key_info, .. } = &issuer.certificate;
            let same = |known: &&Authority| {
                known.certificate.subject_name == *subject_name && known.certificate.public_key_info == *public_key_info
            };
            if *subject_name != lowest || path.iter().any(same) {
                continue;
            }
            if let Err(error) = self.check_link(leaf, path, issuer, false) {
                refused = more_telling(refused, error);
                continue;
            }
            path.push(issuer);
            match self.climb(leaf, path) {
                Ok(()) => return Ok(()),
                Err(error) => refused = more_telling(refused, error),
            }
            path.pop();
        }
        Err(refused)
    }

    /// Checks that an authority may have issued the last certificate of a path that is built so far.
    fn check_link(
        &mut self,
        leaf: &Certificate,
        path: &[&Authority],
        issuer: &Authority,
        is_root: bool,
    ) -> Result<(), IdentityError> {
        let authority = &issuer.certificate;
        let certificate = path.last().map_or(leaf, |lower| &lower.certificate);
        self.signatures += 1;
        if self.signatures > SIGNATURES_MAX {
            return Err(self.broken(leaf, format!("more than {SIGNATURES_MAX} signatures of authorities to check")));
        }
        certificate.signed().verify(&authority.public_key_info).map_err(|fault| match fault {
            Fault::Unsupported(found) => IdentityError::UnsupportedSignature {
                what: format!("the certificate of {}", printable(&certificate.subject)),
                found,
                wanted: WANTED,
            },
            Fault::Mismatch => IdentityError::BadSignature {
                subject: printable(&certificate.subject),
                issuer: printable(&certificate.issuer),
                organisation: self.msp.organisation.clone(),
            },
        })?;
        if let Some(at) = self.at {
            let subject = || match is_root {
                true => authority.subject.clone(),
                false => format!("intermediate authority {}", authority.subject),
            };
            check_validity(subject, authority.not_before, authority.not_after, at)?;
        }
        self.check_rules(leaf, path, authority).map_err(|found| self.broken(leaf, found))?;
        if authority.allows(self.usage) {
            return Ok(());
        }
        Err(IdentityError::WrongUsage {
            subject: printable(&leaf.subject),
            found: format!("an issuer, {}, with an extended key usage without this use", printable(&authority.subject)),
            wanted: match self.usage {
                Usage::Client => "clientAuth, or no extended key usage",
                Usage::Server => "serverAuth, or no extended key usage",
            },
        })
    }

    /// Checks the rules that an authority sets for what stands below it; answers with the one that is broken.
    fn check_rules(&self, leaf: &Certificate, path: &[&Authority], authority: &Certificate) -> Result<(), String> {
        let subject = printable(&authority.subject);
        if let Some(oid) = authority.unknown_critical() {
            return Err(format!("the critical extension {oid} in {subject}, which is not known here"));
        }
        let lower = || path.iter().map(|lower| &lower.certificate).filter(|lower| !lower.is_self_issued());
        let length = self.below + lower().count();
        if authority.path_length_max().and_then(|max| usize::try_from(max).ok()).is_some_and(|max| length > max) {
            return Err(format!("more authorities than the path length of {subject} allows"));
        }
        let checked = lower().chain([leaf]).try_for_each(|certificate| authority.check_names(certificate));
        checked.map_err(|found| format!("{found} of {subject}"))
    }

    fn untrusted(&self, leaf: &Certificate) -> IdentityError {
        IdentityError::Untrusted { issuer: printable(&leaf.issuer), wanted: vec![self.msp.organisation.clone()] }
    }

    fn broken(&self, leaf: &Certificate, found: String) -> IdentityError {
        IdentityError::BadPath { subject: printable(&leaf.subject), organisation: self.msp.organisation.clone(), found }
    }
}

/// Of two refusals, the one from further along the path: a root that verified but has expired says more than
/// another root that did not fit.
pub(super) fn more_telling(first: IdentityError, second: IdentityError) -> IdentityError {
    let rank = |error: &IdentityError| match error {
        IdentityError::Untrusted { .. } => 0,
        IdentityError::BadSignature { .. } => 1,
        IdentityError::Expired { .. } | IdentityError::NotYetValid { .. } => 3,
        _ => 2,
    };
    if rank(&second) > rank(&first) { second } else { first }
}
