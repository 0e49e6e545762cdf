//! Would the simulation notice? Deliberate bugs, one at a time: each must break one of the promises named here, in the seed named
//! here or in one of the first [`SEEDS_NEAR`].
//!
//! The named seed is the fast way. A change of the simulation may move it: `./test --long mutations` searches further, and fails with
//! the seed to put here.

#![expect(clippy::expect_used, clippy::panic, clippy::print_stderr, reason = "tests")]

use ledger_base::mutation::{COMPILED_IN, Mutation, turn_on};
use ledgerd_sim::invariant::Violation;
use ledgerd_sim::people::People;
use ledgerd_sim::run::run;
use ledgerd_sim::twins::{self, Cast};
use std::env;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Set in a process that runs one test.
const ALONE: &str = "LEDGERD_TEST_ALONE";
/// Set by `./test --long`: other seeds are searched, too.
const LONG: &str = "LEDGERD_TEST_LONG";
/// Seeds within which a bug must show in a search. The rarest is a snapshot that one organisation attests.
const SEEDS_MAX: u64 = 1500;
/// Seeds that are searched if the named one does not show the bug any more.
const SEEDS_NEAR: u64 = 60;
/// Seeds at a time.
const WORKERS: usize = 2;
/// Seeds in which a bug that others make good for must break nothing; in `./test --long` three times as many.
const SEEDS_BORNE: u64 = 4;

/// Is this a process of one test? The bug is a switch of the whole process, so each test runs itself again in one of its own,
/// and passes its failure on.
fn is_alone() -> bool {
    let this = std::thread::current();
    // With --test-threads=1 the harness has no threads, and runs one after the other.
    let test = this.name().filter(|name| *name != "main");
    let Some(test) = test.filter(|_| env::var_os(ALONE).is_none()) else { return true };
    let program = env::current_exe().expect("the test binary has a path");
    let run = Command::new(program)
        .args(["--exact", test, "--nocapture", "--test-threads=1"])
        .env(ALONE, test)
        .stderr(Stdio::inherit())
        .output()
        .expect("the test binary starts");
    let told = String::from_utf8_lossy(&run.stdout);
    assert!(run.status.success() && told.contains("test result: ok. 1 passed"), "{test}: {}\n{told}", run.status);
    false
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The bug must break one of these promises in this seed, or in another one if that is searched for.
#[track_caller]
fn caught(mutation: Mutation, seed: u64, by: &[&str]) {
    let people = Arc::new(People::new());
    caught_in(mutation, seed, by, SEEDS_NEAR, |seed| run(seed, &people, false).violation);
}

/// The same in networks in which organisations lie. Their seeds take a tenth of the time.
#[track_caller]
pub(crate) fn caught_with_liars(mutation: Mutation, seed: u64, by: &[&str]) {
    let cast = Arc::new(Cast::new());
    caught_in(mutation, seed, by, 10 * SEEDS_NEAR, |seed| twins::run(seed, &cast, false).violation);
}

#[track_caller]
fn caught_in(mutation: Mutation, seed: u64, by: &[&str], near: u64, breaks: impl Fn(u64) -> Option<Violation> + Sync) {
    if !is_alone() {
        return;
    }
    if !COMPILED_IN {
        panic!("no switches in this build: run ./test, or cargo test without --release");
    }
    turn_on(Some(mutation));
    // Another promise may be the first to break in a seed; one of these must.
    let is_wanted = |violation: &Violation| by.contains(&violation.invariant);
    let first = breaks(seed);
    if let Some(violation) = first.as_ref().filter(|violation| is_wanted(violation)) {
        turn_on(None);
        eprintln!("{mutation:?} is caught with seed {seed} by {violation}");
        return;
    }
    let is_long = env::var_os(LONG).is_some();
    let most = if is_long { SEEDS_MAX.max(near) } else { near };
    let (next, found) = (AtomicU64::new(0), Mutex::new(None));
    let worker = || {
        while lock(&found).is_none() {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= most {
                return;
            }
            if let Some(violation) = breaks(seed).filter(is_wanted) {
                *lock(&found) = Some((seed, violation));
            }
        }
    };
    std::thread::scope(|scope| (0..WORKERS).for_each(|_| drop(scope.spawn(worker))));
    turn_on(None);
    let found = lock(&found).take();
    let Some((better, violation)) = found else {
        panic!(
            "{mutation:?} was not noticed by one of {by:?} in seed {seed}, but by {first:?}, nor in the first {most} seeds; \
             ./test --long mutations searches further"
        )
    };
    let news =
        format!("{mutation:?} shows in seed {better} by {violation}, and no longer in seed {seed}: put {better} here");
    assert!(!is_long, "{news}");
    eprintln!("{news}");
}

/// A bug that the other nodes make good for: no promise is broken. But the cluster may stand still, in few seeds, where
/// so many disks were lost that the nodes with this bug are needed.
#[track_caller]
fn borne(mutation: Mutation) {
    if !is_alone() {
        return;
    }
    if !COMPILED_IN {
        panic!("no switches in this build: run ./test, or cargo test without --release");
    }
    let people = Arc::new(People::new());
    let seeds = if env::var_os(LONG).is_some() { 3 * SEEDS_BORNE } else { SEEDS_BORNE };
    turn_on(Some(mutation));
    let broken: Vec<_> = (0..seeds).filter_map(|seed| Some((seed, run(seed, &people, false).violation?))).collect();
    turn_on(None);
    let harm = broken.iter().find(|(_, violation)| violation.invariant != "the cluster serves again");
    if let Some((seed, violation)) = harm {
        panic!("{mutation:?} breaks {violation} with seed {seed}");
    }
    // Where a disk was lost, a cluster may stand still until block time has come (docs/reliability.md).
    assert!(broken.len() as u64 <= (seeds / 10).max(1), "{mutation:?} stops the cluster: {broken:?}");
}

#[test]
fn a_log_that_is_not_synced_is_noticed() {
    caught(Mutation::NoFsync, 2, &["acknowledged is durable"]);
}

#[test]
fn an_answer_before_a_majority_has_it_is_noticed() {
    caught(Mutation::AcknowledgeBeforeMajority, 0, &["acknowledged is durable", "committed is immutable"]);
}

#[test]
fn an_epoch_that_comes_twice_is_noticed() {
    caught(Mutation::ReuseAnEpoch, 0, &["epochs grow"]);
}

#[test]
fn a_preemption_that_gives_no_new_epoch_is_noticed() {
    caught(Mutation::PreemptWithoutANewEpoch, 9, &["epochs grow"]);
}

#[test]
fn a_grant_that_is_passed_on_without_a_new_epoch_is_noticed() {
    caught(Mutation::PassOnWithoutANewEpoch, 15, &["epochs grow"]);
}

#[test]
fn a_requester_that_counts_as_one_who_confirms_is_noticed() {
    caught(Mutation::CountTheRequester, 45, &["the oracle agrees"]);
}

#[test]
fn a_free_place_that_goes_to_somebody_before_the_line_is_noticed() {
    caught(Mutation::SkipTheLine, 9, &["nobody is overtaken", "the oracle agrees"]);
}

#[test]
fn a_task_that_begins_although_somebody_else_holds_the_service_is_noticed() {
    caught(Mutation::RunBesideAHolder, 6, &["grant exclusivity", "the oracle agrees", "nobody is overtaken"]);
}

#[test]
fn a_task_that_waits_again_although_its_submitter_did_not_want_that_is_noticed() {
    caught(Mutation::AlwaysWaitAgain, 6, &["the oracle agrees"]);
}

#[test]
fn one_reader_more_than_the_owner_allows_is_noticed() {
    caught(Mutation::OnePlaceTooMany, 6, &["grant exclusivity", "the oracle agrees"]);
}

#[test]
fn a_reader_without_a_place_is_noticed() {
    caught(Mutation::ReadWithoutAPlace, 0, &["the oracle agrees"]);
}

#[test]
fn a_stop_that_a_node_forgets_when_it_starts_is_noticed() {
    caught(Mutation::ForgetAStop, 3, &["a stop lasts", "state agreement", "the oracle agrees"]);
}

#[test]
fn a_revoked_certificate_that_is_accepted_is_noticed() {
    caught(Mutation::SkipTheRevocationCheck, 1, &["revoked stays revoked"]);
}

#[test]
fn a_forbid_that_errs_and_is_skipped_is_noticed() {
    caught(Mutation::AcceptAnErringForbid, 1, &["the oracle agrees"]);
}

/// The leader does not count it: an acknowledgement names the hash of its block, which this node does not know. So its chain seems to
/// contradict the others.
#[test]
fn a_catch_up_that_is_off_by_one_is_noticed() {
    caught(Mutation::CatchUpOffByOne, 0, &["nobody contradicts the chain of an honest node"]);
}

#[test]
fn a_lease_by_the_wall_clock_is_noticed() {
    caught(Mutation::WallClockLease, 1, &["state agreement", "grant exclusivity", "the oracle agrees"]);
}

#[test]
fn a_digest_in_any_order_is_noticed() {
    caught(Mutation::UnsortedDigest, 0, &["state agreement"]);
}

#[test]
fn damage_that_a_start_does_not_look_for_is_noticed() {
    caught(Mutation::NoRecheckAfterRestart, 7, &["damage is refused", "log matching", "committed is immutable"]);
}

#[test]
fn a_refusal_on_an_old_state_is_noticed() {
    caught(Mutation::RefuseOnAnOldState, 0, &["answered is seen"]);
}

#[test]
fn a_repetition_that_is_refused_for_good_is_noticed() {
    caught(Mutation::RefuseARetry, 3, &["refused is final", "clients see one history"]);
}

#[test]
fn an_answer_with_the_verdict_on_a_forged_copy_is_noticed() {
    caught(Mutation::AnswerWithAForgedCopy, 6, &["clients see one history"]);
}

#[test]
fn a_waiter_that_is_forgotten_is_noticed() {
    caught(Mutation::ForgetAWaiter, 0, &["everybody is answered"]);
}

#[test]
fn a_read_that_no_majority_confirms_is_noticed() {
    caught(Mutation::AnswerAMinorityRead, 0, &["answered is seen", "clients see one history"]);
}

#[test]
fn a_snapshot_that_one_organisation_attests_is_noticed_when_it_is_taken() {
    caught(Mutation::BelieveOneOrganisation, 2, &["snapshots are attested"]);
}

#[test]
fn blocks_that_nobody_confirms_are_noticed_when_they_are_taken() {
    caught(Mutation::TakeUnconfirmedBlocks, 0, &["committed is immutable", "chain agreement", "log matching"]);
}

#[test]
fn a_vote_before_it_is_known_whether_blocks_were_lost_is_noticed() {
    caught(Mutation::VoteBeforeTheAnswers, 0, &["votes are informed"]);
}

#[test]
fn a_removed_member_that_keeps_its_vote_is_noticed() {
    caught(Mutation::KeepARemovedVoter, 3, &["members follow the ledger"]);
}

#[test]
fn a_block_that_is_executed_twice_after_a_snapshot_is_noticed() {
    caught(Mutation::ApplyTwiceAfterASnapshot, 2, &["a node ends only for a reason"]);
}

#[test]
fn messages_that_overtake_control_are_noticed() {
    caught(Mutation::DataOvertakesControl, 3, &["no call overtakes another"]);
}

#[test]
fn a_call_that_overtakes_one_that_is_held_is_noticed() {
    caught(Mutation::OvertakeWhatIsHeld, 0, &["no call overtakes another"]);
}

#[test]
fn an_identity_that_uses_a_gateway_alone_is_noticed() {
    caught(Mutation::IgnoreTheShare, 1, &["nobody is kept out"]);
}

#[test]
fn a_deadline_that_is_forgotten_is_noticed() {
    caught(Mutation::ForgetADeadline, 25, &["everybody is answered"]);
}

#[test]
fn a_learner_whose_signature_counts_is_noticed() {
    caught(Mutation::CountALearner, 1, &["certificates are true"]);
}

#[test]
fn a_voter_that_counts_twice_is_noticed() {
    caught(Mutation::CountAVoterTwice, 1, &["certificates are true"]);
}

#[test]
fn a_statement_about_other_results_that_counts_is_noticed() {
    caught(Mutation::CountOtherResults, 0, &["certificates are true"]);
}

#[test]
fn a_block_that_is_executed_by_older_rules_is_noticed() {
    caught(Mutation::OlderRulesAtTheActivation, 1, &["rules by height"]);
}

#[test]
fn a_voter_that_acknowledges_any_time_is_noticed() {
    caught(Mutation::AcknowledgeAnyTime, 4, &["block time keeps to the clocks"]);
}

#[test]
fn a_leader_that_orders_by_its_own_clock_alone_does_no_harm() {
    borne(Mutation::OrderByOneClock);
}

/// Followers take nothing without the signed head of the leader, which needs the vote in its mandate.
#[test]
fn a_leader_that_nobody_elected_and_that_is_followed_does_no_harm() {
    borne(Mutation::FollowWithoutMandate);
}

#[test]
fn a_robot_that_believes_its_node_about_a_grant_is_noticed() {
    caught(Mutation::BelieveAGrant, 4, &["gate"]);
}

#[test]
fn a_robot_that_compares_no_epochs_is_noticed() {
    caught(Mutation::IgnoreEpochs, 27, &["gate"]);
}

#[test]
fn a_robot_that_goes_on_without_the_voters_is_noticed() {
    caught(Mutation::IgnoreStaleness, 58, &["gate"]);
}

#[test]
fn members_that_may_say_everything_are_noticed() {
    caught(
        Mutation::BelieveAnybody,
        2,
        &[
            "a node ends only for a reason",
            "committed is immutable",
            "log matching",
            "chain agreement",
            "the oracle agrees",
            "only elected leaders are followed",
        ],
    );
}

#[test]
fn a_proposer_of_policies_that_counts_twice_is_noticed() {
    caught(Mutation::CountTheProposerTwice, 0, &["the oracle agrees"]);
}

#[test]
fn a_revocation_list_that_goes_back_is_noticed_when_it_is_taken() {
    caught(Mutation::TakeAnOlderList, 0, &["the oracle agrees"]);
}

#[test]
fn a_content_key_that_is_good_after_a_reader_was_taken_out_is_noticed() {
    caught(Mutation::KeepAnOldContentKey, 4, &["only readers read", "the oracle agrees"]);
}

#[test]
fn a_content_key_that_is_shared_with_others_than_the_readers_is_noticed() {
    caught(Mutation::ShareWithAnybody, 4, &["only readers read", "the oracle agrees"]);
}
