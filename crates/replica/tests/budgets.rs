//! Budgets of identities, organisations and services: at the gateway, by what blocks hold, and at the leader.

use crate::cluster::{BOARD_BYTES, Cluster, PEOPLE, call};
use bytes::Bytes;
use ledger::Ledger;
use ledger::msp::QUOTAS;
use ledger::transaction::Transaction;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::{Input, Lane, PeerMessage, Transactions};
use ledger_replica::{BURST, Budgets};
use std::sync::Arc;

const MIB: u64 = 1 << 20;
const UNLIMITED: u64 = u64::MAX;
/// A segment of the log, bytes: large transactions fit.
const SEGMENT: u64 = 16 * MIB;

/// A node that has verified Salma's certificate, and its ledger.
fn alone() -> (Cluster, Arc<Ledger>) {
    let mut cluster = Cluster::with_segments(40, &[1], &[], SEGMENT);
    let leader = cluster.elect();
    cluster.submit(leader, Lane::Data, "first");
    cluster.until("it is executed", 100, |cluster| cluster.has_executed(leader, "first"));
    let ledger = Arc::clone(cluster.nodes[&leader].up.as_ref().unwrap().ledger());
    (cluster, ledger)
}

/// A transaction of Salma's with so many bytes of content.
fn transaction(ledger: &Ledger, function: &str, bytes: u64) -> Transaction {
    let content = Bytes::from(vec![7; usize::try_from(bytes).unwrap()]);
    call(&PEOPLE.salma, ledger.network(), ledger.tip().time, ("notes", function), content)
}

/// How many of the same are let in at a time, microseconds after the start, and why the next one is not.
fn let_in(budgets: &Budgets, ledger: &Ledger, transaction: &Transaction, elapsed: u64, disk: u64) -> (u64, Rejection) {
    let clock = ledger.tip().time + 3600 * 1_000_000 + elapsed;
    let mut count = 0;
    loop {
        match budgets.admit(ledger, transaction, (elapsed, clock), disk) {
            Ok(()) => count += 1,
            Err(refused) => return (count, refused),
        }
        assert!(count < 1_000_000, "without end");
    }
}

#[test]
fn a_gateway_lets_a_burst_of_an_identity_in_then_its_rate_and_says_when_to_come_again() {
    let (_cluster, ledger) = alone();
    let (budgets, large) = (Budgets::default(), transaction(&ledger, "note", MIB));
    let burst = QUOTAS.identity_bytes_per_s / MIB * BURST / 1_000_000;
    let (passed, refused) = let_in(&budgets, &ledger, &large, 0, UNLIMITED);
    assert_eq!(passed, burst);
    assert_eq!(refused.code, Code::Overloaded);
    assert!(refused.message.contains("Org1/Salma") && refused.wanted.contains("8.0 MiB"), "{refused}");
    let advice = refused.advice();
    assert!(advice.contains("retry after") && advice.contains("identity_bytes_per_s"), "{refused}");
    let (passed, _) = let_in(&budgets, &ledger, &large, 1_000_000, UNLIMITED);
    assert_eq!(passed, QUOTAS.identity_bytes_per_s / MIB, "a second later");

    let (budgets, small) = (Budgets::default(), transaction(&ledger, "note", 0));
    let (passed, _) = let_in(&budgets, &ledger, &small, 0, UNLIMITED);
    assert_eq!(passed, QUOTAS.identity_messages_per_s * BURST / 1_000_000 + 1, "and messages");
}

#[test]
fn the_owners_budget_of_a_service_holds_for_what_is_published_on_it_alone() {
    let (_cluster, ledger) = alone();
    let (budgets, message) = (Budgets::default(), transaction(&ledger, "publish", BOARD_BYTES));
    let (passed, refused) = let_in(&budgets, &ledger, &message, 0, UNLIMITED);
    assert!((1..=BURST / 1_000_000).contains(&passed), "{passed}");
    assert!(refused.message.contains("board") && refused.advice().contains("Org1"), "{refused}");
    budgets.admit(&ledger, &transaction(&ledger, "note", BOARD_BYTES), (0, ledger.tip().time), UNLIMITED).unwrap();
}

#[test]
fn the_fuller_the_disk_the_less_an_organisation_may_send() {
    let (_cluster, ledger) = alone();
    let note = transaction(&ledger, "note", 10_000);
    let share = |disk| let_in(&Budgets::default(), &ledger, &note, 0, disk);
    let ((much, _), (little, refused)) = (share(MIB), share(MIB / 16));
    assert!(little >= 16 && much > 15 * little, "{much} with much space, {little} with little");
    assert!(refused.advice().contains("free space"), "{refused}");
}

#[test]
fn what_other_gateways_have_let_in_counts_as_soon_as_it_is_in_a_block() {
    let (mut cluster, ledger) = alone();
    let budgets = Arc::clone(cluster.nodes[&1].up.as_ref().unwrap().executor.budgets());
    let note = transaction(&ledger, "note", 10);
    let clock = ledger.tip().time;
    budgets.admit(&ledger, &note, (0, clock), UNLIMITED).unwrap();
    flood(&mut cluster, 1, QUOTAS.identity_bytes_per_s * (BURST / 1_000_000) + 16 * MIB);
    let refused = budgets.admit(&ledger, &note, (0, ledger.tip().time), UNLIMITED).unwrap_err();
    assert_eq!(refused.code, Code::Overloaded);
    // It has nothing of it in its own count: after the time that blocks hold, it lets in again.
    budgets.admit(&ledger, &note, (0, ledger.tip().time + BURST), UNLIMITED).unwrap();
}

/// Has so many bytes of Salma's ordered, past every gateway.
fn flood(cluster: &mut Cluster, leader: u64, bytes: u64) {
    // The answer has the same bytes, and may have 512 KiB.
    let part = "x".repeat(400 * 1024);
    for nth in 0..bytes.div_ceil(8 * 400 * 1024) {
        let texts = (0..8).map(|number| format!("{nth} {number} {part}"));
        texts.for_each(|text| cluster.submit(leader, Lane::Data, &text));
        let last = format!("{nth} 7 {part}");
        cluster.until("a part of the flood is executed", 100, |cluster| cluster.has_executed(leader, &last));
    }
}

#[test]
fn a_leader_gives_back_what_a_gateway_forwards_far_beyond_a_budget_and_takes_control() {
    let mut cluster = Cluster::with_segments(41, &[1, 2, 3], &[], SEGMENT);
    let leader = cluster.elect();
    let other = if leader == 1 { 2 } else { 1 };
    let burst = QUOTAS.identity_bytes_per_s * (BURST / 1_000_000);
    flood(&mut cluster, leader, 2 * burst + 32 * MIB);
    let control = vec![cluster.awaited(other, Lane::Control, "stop").unwrap()];
    let data = vec![cluster.awaited(other, Lane::Data, "more").unwrap()];
    let sent = Transactions { control, data, code: 0 };
    cluster.input(leader, Input::Message { from: other, message: PeerMessage::Forward(sent) });
    cluster.until("control is executed", 100, |cluster| cluster.has_executed(leader, "stop"));
    assert_eq!(cluster.nodes[&other].dropped, [("more".to_owned(), Code::Overloaded)]);
    assert!(!cluster.has_executed(leader, "more"));
}

#[test]
fn a_leader_gives_back_all_of_a_node_that_forwards_bytes_without_a_valid_signature() {
    let mut cluster = Cluster::with_segments(42, &[1, 2, 3], &[], SEGMENT);
    let leader = cluster.elect();
    let [liar, honest] = if leader == 1 { [2, 3] } else { [1, 5 - leader] };
    let forward = |cluster: &mut Cluster, from: u64, data: Vec<Bytes>| {
        let sent = Transactions { control: Vec::new(), data, code: 0 };
        cluster.input(leader, Input::Message { from, message: PeerMessage::Forward(sent) });
    };
    // A mebibyte a second is allowed, eight seconds of it at once: three times that much is not.
    for part in 0..24_u8 {
        let garbage = (0..4).map(|number| Bytes::from([vec![part, number], vec![7; 256 * 1024]].concat()));
        forward(&mut cluster, liar, garbage.collect());
        let mark = format!("behind {part}");
        cluster.submit(leader, Lane::Data, &mark);
        cluster.until("a part is executed", 100, |cluster| cluster.has_executed(leader, &mark));
    }
    let of = |cluster: &mut Cluster, node: u64, text: &str| cluster.awaited(node, Lane::Data, text).unwrap();
    let (bad, good) = (of(&mut cluster, liar, "of the liar"), of(&mut cluster, honest, "of the other"));
    forward(&mut cluster, liar, vec![bad]);
    forward(&mut cluster, honest, vec![good]);
    cluster.until("the other node's is executed", 100, |cluster| cluster.has_executed(leader, "of the other"));
    assert_eq!(cluster.nodes[&liar].dropped.last(), Some(&("of the liar".to_owned(), Code::Overloaded)));
    assert!(!cluster.has_executed(leader, "of the liar"));
}
