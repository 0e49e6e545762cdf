//! Waiting raises who waits, so that nobody starves, however many with a higher priority come again and again.

use crate::fleet::{Fleet, SECOND, TURTLEBOT, bytes, owner};
use crate::tasks::ranked;
use ledger_abac::LineState;
use ledger_identity::Identity;
use proptest::prelude::*;

/// How long a holder keeps the service at most.
const HELD_MAX: u64 = 2 * SECOND;

fn state(fleet: &Fleet) -> LineState {
    serde_json::from_slice(&fleet.simulate(&owner(), "line", &[TURTLEBOT.into()]).unwrap()).unwrap()
}

/// How long somebody with priority 0 waits while others with higher ones want the service all the time; none if it waits longer
/// than `most`.
fn waits(settings: &str, eager: &[Identity], holds: &[u64], most: u64) -> Option<u64> {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "configure", &[TURTLEBOT, &format!(r#"{{"sharing":{settings}}}"#)]);
    // Twice: one that another of them preempts waits in line again.
    for who in eager.iter().chain(eager) {
        fleet.ok(who, "acquire", &[TURTLEBOT]);
    }
    let patient = ranked("Patient", "0", 90);
    fleet.ok(&patient, "acquire", &[TURTLEBOT]);
    let (since, mut holds) = (fleet.time, holds.iter().cycle());
    while fleet.time < since + most {
        fleet.time += holds.next().copied().unwrap_or(HELD_MAX);
        let holder = state(&fleet).holders.first().map(|grant| grant.holder.clone());
        for who in eager.iter().filter(|who| Some(who.id()) == holder) {
            // It may have lost the service at the start of this very block.
            let _lost = fleet.call(who, "release", &bytes(&[TURTLEBOT])).is_err();
        }
        fleet.tick();
        for who in eager.iter().chain(eager) {
            fleet.ok(who, "acquire", &[TURTLEBOT]);
        }
        // Where a higher priority preempts, it may have had its turn and lost it again.
        let mut granted = fleet.events.iter().filter(|event| event.name == "granted");
        if granted.any(|event| String::from_utf8_lossy(&event.payload).contains("Org1/Patient")) {
            return Some(fleet.time - since);
        }
    }
    None
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, ..ProptestConfig::default() })]

    #[test]
    fn nobody_starves_where_waiting_raises_priorities_and_somebody_does_where_it_does_not(
        ranks in prop::collection::vec(1_u64..5, 2..5),
        holds in prop::collection::vec(SECOND / 10..HELD_MAX, 1..8),
        aging in 1_u64..4,
        conflict in prop_oneof![Just("queue"), Just("preempt")],
    ) {
        let eager: Vec<_> =
            (0..).zip(&ranks).map(|(n, rank)| ranked(&format!("Eager{n}"), &rank.to_string(), 91 + n)).collect();
        let (highest, others) = (ranks.iter().max().copied().unwrap_or(0), ranks.len() as u64);
        // After that it precedes everybody who comes, and those who came before have had their turns.
        let most = (highest + 1) * aging * SECOND + (others + 2) * HELD_MAX;
        let settings = |aging: &str| {
            format!(r#"{{"on_conflict":"{conflict}","queue_max":9,"priority":"attribute:rank"{aging}}}"#)
        };
        let raised = waits(&settings(&format!(r#","aging_ms":{}"#, aging * 1000)), &eager, &holds, most);
        prop_assert!(raised.is_some(), "it waits longer than {most} microseconds");
        prop_assert_eq!(waits(&settings(""), &eager, &holds, most), None);
    }
}
