//! Organisations that lie with all their nodes, also as leaders: no two truths, no stop that is voided, no lie that is hidden. And
//! deliberate bugs in the rules that this rests on.

use crate::mutations::caught_with_liars as caught;
use crate::seeds::{hold, hold_again};
use ledger_base::mutation::Mutation;
use ledgerd_sim::seeds::Liars;
use ledgerd_sim::twins::{Cast, run};
use std::sync::Arc;

/// Of the gates, judged by `control`.
const CERTIFIED_STATE: &str = "no gate passes what no certified state of the last second allows";
/// Seeds of one test run; `LEDGER_LIAR_SEEDS` runs more.
const SEEDS: u64 = 40;
/// Seeds of `./test --long`.
const SEEDS_LONG: u64 = 5000;
/// Those that once failed.
const REGRESSIONS: &str = include_str!("../regressions-liars.txt");

#[test]
fn organisations_that_lie_break_no_promise_and_every_kind_of_lie_has_happened() {
    hold(&Liars(Arc::new(Cast::new())), "LEDGER_LIAR_SEEDS", SEEDS, SEEDS_LONG);
}

#[test]
fn what_once_failed_does_not_fail_again() {
    hold_again(&Liars(Arc::new(Cast::new())), REGRESSIONS);
}

#[test]
fn the_same_seed_gives_the_same_lies_byte_for_byte() {
    let cast = Arc::new(Cast::new());
    let (one, other) = (run(3, &cast, true).trace, run(3, &Arc::new(Cast::new()), true).trace);
    assert!(one == other, "two traces");
    assert!(one.is_some_and(|text| text.len() > 10_000));
}

#[test]
fn certificates_that_one_hand_completes_twice_are_noticed() {
    caught(Mutation::ForgetTheHands, 1, &["no two certificates for one height", "certificates are true"]);
}

#[test]
fn a_proof_that_is_believed_unread_is_noticed() {
    caught(Mutation::BelieveAnyProof, 2, &["evidence names only liars"]);
}

#[test]
fn a_proof_that_a_node_keeps_for_itself_is_noticed() {
    caught(Mutation::KeepAProofForItself, 26, &["evidence travels"]);
}

#[test]
fn a_liar_that_is_followed_is_noticed() {
    caught(Mutation::FollowALiar, 26, &["nobody follows a liar of whom it has the proof"]);
}

#[test]
fn a_node_that_stops_for_any_certificate_is_noticed() {
    caught(Mutation::StopForAnyCertificate, 1, &["a node stops only for a strict certificate"]);
}

#[test]
fn a_certified_block_that_a_node_leaves_is_noticed() {
    caught(Mutation::DropACertifiedBlock, 84, &["nothing certified is dropped"]);
}

#[test]
fn a_transfer_that_no_leader_has_signed_is_noticed() {
    caught(Mutation::HonourAnyTransfer, 5, &["nobody deposes an honest leader that others reach"]);
}

#[test]
fn a_leader_that_one_organisation_deposes_is_noticed() {
    caught(Mutation::BelieveOneComplaint, 5, &["nobody deposes an honest leader that others reach"]);
}

#[test]
fn voters_that_never_complain_are_noticed() {
    caught(Mutation::NeverComplain, 6, &["no leader withholds a call for good"]);
}

#[test]
fn a_block_that_follows_another_one_than_its_leader_has_is_noticed() {
    caught(Mutation::AppendToAnyLog, 17, &["an entry follows the one that its leader has before it"]);
}

#[test]
fn an_acknowledgement_of_another_log_that_counts_is_noticed() {
    caught(Mutation::CountAnyLog, 21, &["a leader counts only those who have its log"]);
}

#[test]
fn an_organisation_that_ends_strict_certificates_alone_is_noticed() {
    caught(Mutation::DemoteFreely, 2, &["strict never ends without its proposal"]);
}

#[test]
fn a_vote_that_is_forgotten_is_noticed() {
    caught(Mutation::ForgetTheVote, 104, &["one vote a term"]);
}

#[test]
fn a_gate_that_believes_a_lying_node_about_a_grant_is_noticed() {
    caught(Mutation::BelieveAGrant, 75, &[CERTIFIED_STATE]);
}

#[test]
fn a_gate_that_forgets_a_stop_without_a_verdict_is_noticed() {
    caught(Mutation::ForgetAnOpenStop, 179, &["a gate that was notified of a stop waits for its verdict"]);
}

#[test]
fn a_gate_that_lets_old_answers_count_is_noticed() {
    caught(Mutation::IgnoreStaleness, 102, &[CERTIFIED_STATE]);
}
