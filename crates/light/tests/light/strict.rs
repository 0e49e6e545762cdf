//! How many signatures are enough, and what voters survive: all ways in which up to seven voters belong to hands.

use ledger_light::{CertificateRule, Survives, Voter, Voters, strict_quorum};
use std::collections::{BTreeMap, BTreeSet};

/// The voters of organisations that have so many each.
fn voters(sizes: &[u64], rule: CertificateRule) -> Voters {
    let owners = sizes.iter().zip('A'..).flat_map(|(size, name)| (0..*size).map(move |_| format!("Org{name}")));
    let nodes: BTreeMap<u64, Voter> =
        (1..).zip(owners).map(|(id, organisation)| (id, Voter { organisation, name: format!("node{id}") })).collect();
    let voters = nodes.keys().copied().collect();
    Voters { nodes, voters, outgoing: BTreeSet::new(), rule, recoveries: 0 }
}

fn strict() -> CertificateRule {
    CertificateRule { strict_since: Some(1), ..CertificateRule::default() }
}

/// Strict if any one voter can be lost, as networks are by themselves.
fn as_set(sizes: &[u64]) -> Voters {
    let plain = voters(sizes, CertificateRule::default());
    if plain.can_be_strict() { voters(sizes, strict()) } else { plain }
}

/// All ways to divide up to `most` voters among organisations, the largest first.
fn divisions(most: u64) -> Vec<Vec<u64>> {
    fn divide(left: u64, largest: u64, sizes: &mut Vec<u64>, found: &mut Vec<Vec<u64>>) {
        for size in (1..=left.min(largest)).rev() {
            sizes.push(size);
            found.push(sizes.clone());
            divide(left - size, size, sizes, found);
            sizes.pop();
        }
    }
    let mut found = Vec::new();
    divide(most, most, &mut Vec::new(), &mut found);
    found
}

fn subsets(of: &BTreeSet<u64>) -> impl Iterator<Item = BTreeSet<u64>> {
    let nodes: Vec<u64> = of.iter().copied().collect();
    (0u32..1 << nodes.len()).map(move |bits| {
        let is_in = |(at, _): &(usize, &u64)| bits >> at & 1 == 1;
        nodes.iter().enumerate().filter(is_in).map(|(_, node)| *node).collect()
    })
}

/// By trying: can the voters of one organisation, which sign everything, complete two certificates with others that sign
/// one thing each?
fn can_be_divided(voters: &Voters, organisation: &str) -> bool {
    let (liars, honest): (BTreeSet<u64>, BTreeSet<u64>) =
        voters.voters.iter().partition(|node| voters.nodes[node].organisation == organisation);
    subsets(&honest).any(|some| {
        let rest = honest.difference(&some).copied();
        let one: BTreeSet<u64> = liars.union(&some).copied().collect();
        let other: BTreeSet<u64> = liars.iter().copied().chain(rest).collect();
        voters.enough(&one).is_ok() && voters.enough(&other).is_ok()
    })
}

/// By trying: do the rest order and certify without these?
fn goes_on_without(voters: &Voters, lost: &BTreeSet<u64>) -> bool {
    let rest: BTreeSet<u64> = voters.voters.difference(lost).copied().collect();
    rest.len() * 2 > voters.voters.len() && voters.enough(&rest).is_ok()
}

fn organisations(voters: &Voters) -> BTreeSet<String> {
    voters.nodes.values().map(|voter| voter.organisation.clone()).collect()
}

fn by_trying(voters: &Voters) -> Survives {
    let survives = |crashes: usize| {
        subsets(&voters.voters).filter(|lost| lost.len() == crashes).all(|lost| goes_on_without(voters, &lost))
    };
    let of = |organisation: &String| {
        voters.voters.iter().copied().filter(|node| voters.nodes[node].organisation == *organisation).collect()
    };
    Survives {
        crashes: (0..=voters.voters.len()).take_while(|crashes| survives(*crashes)).last().unwrap(),
        lie: organisations(voters).iter().all(|organisation| !can_be_divided(voters, organisation)),
        silence: organisations(voters).iter().all(|organisation| goes_on_without(voters, &of(organisation))),
    }
}

#[test]
fn what_voters_survive_is_what_trying_it_shows() {
    for sizes in divisions(7) {
        for rule in [CertificateRule::default(), strict()] {
            let voters = voters(&sizes, rule.clone());
            let (found, tried) = (voters.survives(), by_trying(&voters));
            // An organisation that has all voters needs nobody else to certify two things.
            assert_eq!(found, tried, "{sizes:?} {rule:?}");
        }
    }
}

#[test]
fn no_organisation_completes_two_strict_certificates_and_fewer_signatures_would_let_one() {
    for sizes in divisions(7).into_iter().filter(|sizes| sizes.len() > 1) {
        let voters = voters(&sizes, strict());
        for organisation in organisations(&voters) {
            assert!(!can_be_divided(&voters, &organisation), "{organisation} of {sizes:?}");
        }
        let (all, largest) = (voters.voters.len(), sizes[0] as usize);
        let quorum = strict_quorum(all, largest);
        assert!(2 * (quorum - 1) <= all + largest, "{sizes:?} need {quorum}, and fewer would do");
    }
}

#[test]
fn organisations_under_one_hand_count_as_one() {
    let hands = vec![["OrgA", "OrgB"].map(str::to_owned).into()];
    let shared = CertificateRule { hands, ..strict() };
    assert_eq!(voters(&[1, 1, 1, 1], strict()).quorum(), 3);
    let four = voters(&[1, 1, 1, 1], shared.clone());
    assert_eq!((four.quorum(), four.can_be_strict()), (4, false), "four voters, of whom one hand has two");
    assert_eq!(voters(&[1, 1, 1, 1, 1], shared).quorum(), 4);
    // Where they are not strict, one hand is not enough either.
    let three = voters(&[1, 1, 1], CertificateRule { strict_since: None, ..four.rule });
    assert!(three.enough(&[1, 2].into()).is_err() && three.enough(&[2, 3].into()).is_ok());
}

#[test]
fn while_voters_change_both_sets_need_their_strict_quorum() {
    let mut voters = voters(&[1, 1, 1, 1, 1], strict());
    (voters.voters, voters.outgoing) = ([1, 2, 3, 4].into(), [1, 2, 3, 4, 5].into());
    assert_eq!(voters.quorum(), 4);
    assert!(voters.enough(&[1, 2, 3].into()).is_err(), "enough for the new ones only");
    assert!(voters.enough(&[1, 2, 3, 5].into()).is_ok());
}

#[test]
fn the_page_about_clusters_has_the_table() {
    let page = format!("{}/../../../docs/cluster.md", env!("CARGO_MANIFEST_DIR"));
    let page = std::fs::read_to_string(page).unwrap();
    let yes = |survived: bool| if survived { "yes" } else { "no" };
    for sizes in [
        &[1][..],
        &[3],
        &[2, 1],
        &[1, 1, 1],
        &[2, 2],
        &[1, 1, 1, 1],
        &[2, 2, 1],
        &[1, 1, 1, 1, 1],
        &[3, 3],
        &[2, 2, 2],
        &[1, 1, 1, 1, 1, 1, 1],
    ] {
        let voters = as_set(sizes);
        let Survives { crashes, lie, silence } = voters.survives();
        let strict = if voters.rule.strict_since.is_some() { "strict" } else { "majority" };
        let sizes = sizes.iter().map(u64::to_string).collect::<Vec<_>>().join(", ");
        let (quorum, all) = (voters.quorum(), voters.voters.len());
        let row = format!("| {sizes} | {quorum} of {all}, {strict} | {crashes} | {} | {} |", yes(lie), yes(silence));
        assert!(page.lines().any(|line| line == row), "docs/cluster.md lacks this row:\n{row}");
    }
}
