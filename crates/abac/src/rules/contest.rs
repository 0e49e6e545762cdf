//! The contest for a number of places: what `deny`, `queue` and `preempt` mean, the same for every rule that has places.

use super::terms::Terms;
use super::{Claim, Decision, Situation};
use ledger_base::mutation::{Mutation, active};
use ledger_contract::{OnConflict, Sharing};
use std::cmp::Reverse;

/// Decides about a contender for one of so many places.
///
/// A free place goes to whoever [precedes](precedence) all others in line. With `preempt`, a contender that precedes them may
/// end the grant of the holder with the lowest priority below its own, once that one has held for `min_hold`.
pub fn contend(places: usize, contender: &Claim, situation: &Situation<'_>) -> Decision {
    let terms = Terms::of(situation.sharing);
    let rank = |claim: &Claim| (Reverse(precedence(claim, situation.sharing, situation.now)), claim.ticket);
    let is_first = situation.line.iter().all(|other| rank(other) > rank(contender));
    let may_come_now = is_first || active(Mutation::SkipTheLine);
    if may_come_now && situation.holders.len() < places {
        return Decision::Grant { ends: Vec::new() };
    }
    let again = match terms.on_conflict {
        OnConflict::Preempt => match victim(contender, situation) {
            Some((index, from)) if is_first && from <= situation.now => return Decision::Grant { ends: vec![index] },
            found => found.map(|(_, from)| from),
        },
        _ => None,
    };
    if terms.queue_max == 0 { Decision::Refuse } else { Decision::Wait { again } }
}

/// The precedence of a claim: its priority, and one more for each `aging` that it has waited, exact to the microsecond. More
/// goes first; among equals, whoever came first.
pub fn precedence(claim: &Claim, sharing: &Sharing, now: u64) -> i128 {
    match aging(sharing) {
        None => i128::from(claim.priority),
        Some(aging) => i128::from(claim.priority) * i128::from(aging) + i128::from(now.saturating_sub(claim.since)),
    }
}

/// The line by precedence.
pub(super) fn order(situation: &Situation<'_>) -> Vec<usize> {
    let rank = |claim: &Claim| (Reverse(precedence(claim, situation.sharing, situation.now)), claim.ticket);
    let mut ranked: Vec<_> = situation.line.iter().map(rank).zip(0..).collect();
    ranked.sort_unstable();
    if active(Mutation::SkipTheLine) {
        ranked.reverse();
    }
    ranked.into_iter().map(|(_, index)| index).collect()
}

/// Microseconds of waiting that raise a priority by one.
fn aging(sharing: &Sharing) -> Option<u64> {
    sharing.aging_ms.map(|ms| ms.saturating_mul(1000).max(1))
}

/// The holder whose place the contender takes, and from when on (microseconds): of those whose priority is below its own the
/// lowest, and of these the newest. If no priority is below its own yet, the one that waiting reaches first.
fn victim(contender: &Claim, situation: &Situation<'_>) -> Option<(usize, u64)> {
    let now = situation.now;
    let from = |holder: &Claim| {
        let held = holder.since.saturating_add(Terms::of(situation.sharing).min_hold_us);
        let missing = u64::try_from((i128::from(holder.priority) - i128::from(contender.priority) + 1).max(0)).ok()?;
        let waited = match (missing, aging(situation.sharing)) {
            (0, _) => 0,
            (_, None) => return None,
            (missing, Some(aging)) => contender.since.saturating_add(missing.saturating_mul(aging)),
        };
        Some(held.max(waited))
    };
    let candidates =
        situation.holders.iter().enumerate().filter_map(|(index, holder)| Some((index, holder, from(holder)?)));
    let candidates: Vec<_> = candidates.collect();
    let ready = candidates.iter().filter(|(.., from)| *from <= now);
    let best = ready.min_by_key(|(index, holder, _)| (holder.priority, Reverse(*index)));
    let later = || candidates.iter().min_by_key(|(index, _, from)| (*from, *index));
    best.or_else(later).map(|(index, _, from)| (*index, *from))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claim(who: &str, priority: i64, since: u64, ticket: u64) -> Claim {
        Claim { who: who.into(), priority, since, ticket, used: 0 }
    }

    fn preempt() -> Sharing {
        Sharing { on_conflict: Some(OnConflict::Preempt), ..Sharing::default() }
    }

    fn queue() -> Sharing {
        Sharing { on_conflict: Some(OnConflict::Queue), ..Sharing::default() }
    }

    fn decide(
        places: usize,
        contender: &Claim,
        sharing: &Sharing,
        holders: &[Claim],
        line: &[Claim],
        now: u64,
    ) -> Decision {
        contend(places, contender, &Situation { sharing, holders, line, now })
    }

    fn ends(indexes: &[usize]) -> Decision {
        Decision::Grant { ends: indexes.to_vec() }
    }

    #[test]
    fn a_free_place_goes_to_whoever_precedes_the_line() {
        let (late, early) = (claim("late", 0, 9, 9), claim("early", 0, 1, 1));
        assert_eq!(decide(1, &late, &queue(), &[], std::slice::from_ref(&early), 10), Decision::Wait { again: None });
        assert_eq!(decide(1, &early, &queue(), &[], std::slice::from_ref(&late), 10), ends(&[]));
        let urgent = claim("urgent", 1, 9, 9);
        assert_eq!(decide(1, &urgent, &queue(), &[], std::slice::from_ref(&early), 10), ends(&[]));
        assert_eq!(decide(2, &late, &queue(), &[claim("holder", 9, 0, 0)], &[], 10), ends(&[]));
        assert_eq!(decide(1, &late, &Sharing::default(), &[claim("holder", 0, 0, 0)], &[], 10), Decision::Refuse);
    }

    #[test]
    fn who_preempts_takes_the_place_of_the_newest_of_the_lowest_priority_below_its_own() {
        let holders = [claim("a", 2, 0, 0), claim("b", 1, 1, 0), claim("c", 1, 2, 0), claim("d", 3, 3, 0)];
        assert_eq!(decide(4, &claim("x", 5, 9, 9), &preempt(), &holders, &[], 9), ends(&[2]));
        assert_eq!(
            decide(4, &claim("x", 1, 9, 9), &preempt(), &holders, &[], 9),
            Decision::Refuse,
            "never an equal one"
        );
    }

    #[test]
    fn nobody_is_preempted_before_min_hold_and_the_contender_that_waits_is_looked_at_then() {
        let sharing = Sharing { min_hold_ms: Some(10), queue_max: Some(8), ..preempt() };
        let holder = [claim("a", 0, 1_000, 0)];
        let urgent = claim("x", 1, 5_000, 9);
        assert_eq!(decide(1, &urgent, &sharing, &holder, &[], 10_999), Decision::Wait { again: Some(11_000) });
        assert_eq!(decide(1, &urgent, &sharing, &holder, &[], 11_000), ends(&[0]));
        let without_line = Sharing { queue_max: None, ..sharing };
        assert_eq!(decide(1, &urgent, &without_line, &holder, &[], 10_999), Decision::Refuse);
    }

    #[test]
    fn waiting_raises_a_priority_in_line_and_against_holders() {
        let sharing = Sharing { aging_ms: Some(1), queue_max: Some(8), ..preempt() };
        let (old, young) = (claim("old", 0, 0, 1), claim("young", 3, 2_000, 2));
        assert_eq!(decide(1, &old, &sharing, &[], std::slice::from_ref(&young), 9_000), Decision::Wait { again: None });
        let younger = claim("younger", 3, 3_001, 2);
        assert_eq!(
            decide(1, &old, &sharing, &[], &[younger], 9_000),
            ends(&[]),
            "it has waited longer than that is worth"
        );
        let holder = [claim("holder", 4, 0, 0)];
        assert_eq!(decide(1, &old, &sharing, &holder, &[], 4_999), Decision::Wait { again: Some(5_000) });
        assert_eq!(decide(1, &old, &sharing, &holder, &[], 5_000), ends(&[0]));
    }
}
