//! One holder at a time; the contender that used the service least in the last hour is next.

use ledger_abac::{Capabilities, Claim, Decision, Fencing, Mode, Publishing, Rule, Sequence, Sharing, Situation};

/// The most that wait, unless the owner says otherwise.
const LINE_MAX: u64 = 64;

/// The rule behind `mode=fair-share`.
pub(crate) struct FairShare;

/// Less use goes first; among equals, whoever came first.
fn rank(claim: &Claim) -> (u64, u64) {
    (claim.used, claim.ticket)
}

impl Rule for FairShare {
    fn mode(&self) -> Mode {
        Mode::named("fair-share")
    }

    fn capabilities(&self, _sharing: &Sharing) -> Capabilities {
        Capabilities { publishing: Publishing::Grant, fencing: Fencing::Newest, sequence: Sequence::PerEpoch }
    }

    fn keys(&self) -> &'static [&'static str] {
        &["queue_max", "queue_wait_max_ms", "idle_release_ms"]
    }

    fn line_max(&self, sharing: &Sharing) -> u64 {
        sharing.queue_max.unwrap_or(LINE_MAX)
    }

    fn remembers_use(&self) -> bool {
        true
    }

    fn decide(&self, contender: &Claim, situation: &Situation<'_>) -> Decision {
        let is_first = situation.line.iter().all(|other| rank(contender) < rank(other));
        if is_first && situation.holders.is_empty() {
            Decision::Grant { ends: Vec::new() }
        } else {
            Decision::Wait { again: None }
        }
    }

    fn order(&self, situation: &Situation<'_>) -> Vec<usize> {
        let mut order: Vec<usize> = (0..situation.line.len()).collect();
        order.sort_by_key(|index| situation.line.get(*index).map(rank));
        order
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claim(used: u64, ticket: u64) -> Claim {
        Claim { who: format!("Org1/{ticket}"), priority: 0, since: 0, ticket, used }
    }

    #[test]
    fn whoever_used_it_least_goes_first() {
        let (sharing, line) = (Sharing::default(), [claim(9, 1), claim(0, 2), claim(0, 3)]);
        let situation = Situation { sharing: &sharing, holders: &[], line: &line, now: 10 };
        assert_eq!(FairShare.order(&situation), [1, 2, 0]);
        assert_eq!(
            FairShare.decide(&claim(9, 1), &Situation { line: &line[1..], ..situation }),
            Decision::Wait { again: None }
        );
        let alone = Situation { line: &line[..1], ..situation };
        assert_eq!(FairShare.decide(&claim(0, 2), &alone), Decision::Grant { ends: vec![] });
    }
}
