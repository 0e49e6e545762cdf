//! Every invariant notices what breaks it, and nothing else.

#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use bytes::Bytes;
use ledger::Outcome;
use ledger::block::Header;
use ledger::members::Membership;
use ledger::msp::{NodeRecord, NodeRole};
use ledger::transaction::Transaction;
use ledger_base::hash::Hash;
use ledger_gate::gate::Refused;
use ledger_storage::block_store::{BlockStore, Options};
use ledger_storage::disk::SimDisk;
use ledger_storage::entry::{Entry, EntryKind, HardState};
use ledger_storage::result::{BlockKind, EmittedEvent, Event, TransactionResult};
use ledgerd_sim::client::{Call, Terms, sign};
use ledgerd_sim::invariant::{
    AcknowledgedIsDurable, BlockTimeKeepsToTheClocks, ChainAgreement, CommittedIsImmutable, DeniedByDefault,
    ElectionSafety, EpochsGrow, ExactlyOnce, Executed, GateKeepsTheRules, GrantExclusivity, LeaderCompleteness,
    LogMatching, MembersFollowTheLedger, NobodyIsOvertaken, Passed, RevokedStaysRevoked, SnapshotsAreAttested,
    StateAgreement, StopsLast, VotesAreInformed,
};
use ledgerd_sim::people::People;
use std::sync::Arc;

fn entry(index: u64, term: u64, data: &'static str) -> Entry {
    Entry { index, term, kind: EntryKind::Normal, data: Bytes::from(data) }
}

fn store(entries: &[Entry]) -> BlockStore {
    let (store, _) = BlockStore::open(Arc::new(SimDisk::new(1)), Options::new([0; 32], || 7)).unwrap();
    store.append(entries, None).unwrap();
    store.flush().unwrap();
    store
}

/// A block without content at a height.
fn block(height: u64, previous: Hash) -> Outcome {
    let header = Header { height, term: 1, time: height, previous, root: Hash::ZERO };
    Outcome {
        hash: header.hash(),
        header,
        digest: Hash::of(&[&height.to_be_bytes()]),
        writes: Hash::ZERO,
        kind: BlockKind::Transactions,
        transactions: Vec::new(),
        ids: Vec::new(),
        results: Vec::new(),
        events: Vec::new(),
        certifiable: None,
        governs: false,
    }
}

/// A block with one transaction that succeeded.
fn with(call: &Call, who: usize, people: &People, height: u64) -> (Outcome, Vec<Option<Transaction>>) {
    let mut outcome = block(height, Hash::ZERO);
    let transaction = sign(&people.all[who], Hash::ZERO, height, height, call.transaction(), true);
    outcome.ids.push(transaction.id());
    outcome.results.push(TransactionResult::default());
    (outcome, vec![Some(transaction)])
}

fn event(mut outcome: Outcome, name: &str, payload: &str) -> Outcome {
    let (chaincode, name, subject) = ("abac".to_owned(), name.to_owned(), "R/cmd_vel".to_owned());
    let event = Event { chaincode, name, subject, payload: Bytes::from(payload.to_owned()) };
    outcome.events.push(EmittedEvent { index: Some(0), event });
    outcome
}

fn grant(holder: &str, epoch: u64) -> String {
    format!(r#"{{"service":"R/cmd_vel","holder":"{holder}","epoch":{epoch},"mode":"exclusive"}}"#)
}

/// As one node has executed it.
fn at(node: u64, outcome: &Outcome) -> Executed<'_> {
    Executed { node, outcome, transactions: &[] }
}

#[test]
fn a_second_leader_or_a_second_vote_in_a_term_is_noticed() {
    let mut safety = ElectionSafety::default();
    safety.leads(1, 5).unwrap();
    safety.leads(1, 5).unwrap();
    safety.leads(2, 6).unwrap();
    safety.leads(2, 5).unwrap_err();
    safety.votes(3, 7, 1).unwrap();
    safety.votes(3, 8, 2).unwrap();
    safety.votes(3, 7, 2).unwrap_err();
}

#[test]
fn a_leader_that_was_not_elected_and_is_followed_is_noticed() {
    let mut safety = ElectionSafety::default();
    safety.leads(1, 5).unwrap();
    safety.follows(2, 5, 1).unwrap();
    safety.follows(2, 5, 3).unwrap_err();
    safety.follows(2, 6, 1).unwrap_err();
}

#[test]
fn logs_that_differ_before_a_place_where_they_agree_are_noticed() {
    let mut matching = LogMatching::default();
    matching.look(1, &store(&[entry(1, 1, "a"), entry(2, 3, "b")])).unwrap();
    matching.look(2, &store(&[entry(1, 2, "x")])).unwrap();
    matching.look(3, &store(&[entry(1, 2, "x"), entry(2, 3, "b")])).unwrap_err();
    matching.look(4, &store(&[entry(1, 1, "other")])).unwrap_err();
}

#[test]
fn a_leader_without_a_committed_entry_is_noticed() {
    let mut completeness = LeaderCompleteness::default();
    completeness.committed(1, 1, 2);
    completeness.elected(1, 3, &store(&[entry(1, 1, "a")])).unwrap();
    completeness.elected(2, 2, &store(&[entry(1, 2, "b")])).unwrap();
    completeness.elected(2, 3, &store(&[entry(1, 2, "b")])).unwrap_err();
    completeness.elected(3, 3, &store(&[])).unwrap_err();
}

#[test]
fn another_block_or_another_state_at_a_height_is_noticed() {
    let (mut chain, mut state) = (ChainAgreement::default(), StateAgreement::default());
    let first = block(1, Hash::ZERO);
    chain.executed(&at(1, &first)).unwrap();
    chain.executed(&at(2, &first)).unwrap();
    chain.executed(&at(2, &block(2, first.hash))).unwrap();
    chain.executed(&at(3, &block(2, Hash::ZERO))).unwrap_err();
    chain.executed(&at(3, &block(1, first.hash))).unwrap_err();
    state.executed(&at(1, &first)).unwrap();
    let other = Outcome { digest: Hash::ZERO, ..first.clone() };
    state.executed(&at(2, &other)).unwrap_err();
    state.snapshot(1, 10, Hash::ZERO).unwrap();
    state.snapshot(2, 10, Hash::ZERO).unwrap();
    state.snapshot(3, 10, Hash::of(&[])).unwrap_err();
    state.same(2, &first, &event(first.clone(), "message", "{}")).unwrap_err();
    let (one, two) = (vec![("k".into(), "1".into())], vec![("k".into(), "2".into())]);
    state.compare((1, &one), (2, &one.clone())).unwrap();
    assert!(state.compare((1, &one), (2, &two)).unwrap_err().what.contains("\"k\""));
    state.compare((1, &one), (2, &vec![])).unwrap_err();
}

#[test]
fn a_transaction_that_succeeds_twice_is_noticed() {
    let people = People::new();
    let call = Call::Release { service: "R/cmd_vel".into() };
    let (outcome, _) = with(&call, 3, &people, 1);
    let mut once = ExactlyOnce::default();
    once.executed(&at(1, &outcome)).unwrap();
    let mut again = block(2, Hash::ZERO);
    again.ids.clone_from(&outcome.ids);
    again.results.push(TransactionResult { code: 1008, ..TransactionResult::default() });
    once.executed(&at(1, &again)).unwrap();
    again.results = vec![TransactionResult::default()];
    once.executed(&at(1, &again)).unwrap_err();
}

#[test]
fn an_answer_without_a_majority_and_a_disk_that_forgot_are_noticed() {
    let mut durable = AcknowledgedIsDurable::default();
    let members = Membership::new([1, 2, 3], []);
    let full = store(&[entry(1, 1, "a")]);
    durable.flushed(1, &full);
    durable.acknowledged(1, 1, &[&members]).unwrap_err();
    durable.flushed(2, &full);
    durable.acknowledged(1, 1, &[&members]).unwrap();
    durable.acknowledged(1, 2, &[&members]).unwrap_err();
    durable.restarted(1, &full).unwrap();
    durable.restarted(1, &store(&[])).unwrap_err();
}

#[test]
fn a_second_holder_and_an_end_of_nothing_are_noticed() {
    let mut grants = GrantExclusivity::default();
    let told = |name: &str, grant: String| event(block(1, Hash::ZERO), name, &grant);
    grants.executed(&at(1, &told("granted", grant("A", 1)))).unwrap();
    grants.executed(&at(1, &told("released", grant("A", 1)))).unwrap();
    grants.executed(&at(1, &told("granted", grant("B", 2)))).unwrap();
    grants.executed(&at(1, &told("granted", grant("C", 3)))).unwrap_err();
    grants.executed(&at(1, &told("released", grant("D", 9)))).unwrap_err();
}

#[test]
fn an_epoch_that_comes_again_and_the_use_of_an_old_one_are_noticed() {
    let mut epochs = EpochsGrow::default();
    let told = |name: &str, payload: &str| event(block(1, Hash::ZERO), name, payload);
    epochs.executed(&at(1, &told("granted", &grant("A", 1)))).unwrap();
    epochs.executed(&at(1, &told("message", r#"{"epoch":1}"#))).unwrap();
    epochs.executed(&at(1, &told("granted", &grant("B", 2)))).unwrap();
    epochs.executed(&at(1, &told("message", r#"{"epoch":1}"#))).unwrap_err();
    epochs.executed(&at(1, &told("granted", &grant("A", 2)))).unwrap_err();
}

/// A place in the line of `R/cmd_vel`.
fn place(contender: &str, priority: i64) -> String {
    format!(r#"{{"service":"R/cmd_vel","contender":"{contender}","priority":{priority}}}"#)
}

#[test]
fn a_grant_past_a_line_is_noticed() {
    let people = Arc::new(People::new());
    let granted = |contender: &str| {
        let mut overtaken = NobodyIsOvertaken::new(Arc::clone(&people));
        for (height, (contender, priority)) in (1..).zip([("A", 0), ("B", 1), ("C", 1)]) {
            let call = Call::Release { service: "R/cmd_vel".into() };
            let (outcome, transactions) = with(&call, 0, &people, height);
            let outcome = event(outcome, "queued", &place(contender, priority));
            overtaken.executed(&Executed { node: 1, outcome: &outcome, transactions: &transactions }).unwrap();
        }
        let mut outcome = event(block(4, Hash::ZERO), "granted", &grant(contender, 1));
        outcome.events[0].index = None;
        overtaken.executed(&at(1, &outcome))
    };
    granted("B").unwrap();
    granted("A").unwrap_err();
    granted("C").unwrap_err();
    granted("D").unwrap_err();
}

#[test]
fn a_task_past_a_line_is_noticed_and_whoever_holds_the_service_is_passed_over() {
    let people = Arc::new(People::new());
    let turn = |holder: &str, who: &str, task: Option<u64>| {
        let mut overtaken = NobodyIsOvertaken::new(Arc::clone(&people));
        let mut told = event(block(1, Hash::ZERO), "granted", &grant(holder, 1));
        told.events[0].index = None;
        overtaken.executed(&at(1, &told)).unwrap();
        // Two that wait, each with a task; the first one was interrupted, and joins the line with the next block.
        for (height, (id, who, reason)) in (2..).zip([(1, "A", "preempted"), (2, "B", "")]) {
            let submit = Call::Submit { service: "R/cmd_vel".into(), task: "{}".into() };
            let (outcome, transactions) = with(&submit, 0, &people, height);
            let told = format!(r#"{{"id":{id},"submitter":"{who}","state":"waiting","reason":"{reason}"}}"#);
            let outcome = event(outcome, "task", &told);
            overtaken.executed(&Executed { node: 1, outcome: &outcome, transactions: &transactions }).unwrap();
        }
        let task = task.map(|id| format!(r#","task":{id}"#)).unwrap_or_default();
        let granted = format!(r#"{{"holder":"{who}","epoch":2,"mode":"exclusive"{task}}}"#);
        let mut outcome = event(block(4, Hash::ZERO), "granted", &granted);
        outcome.events[0].index = None;
        overtaken.executed(&at(1, &outcome))
    };
    turn("C", "A", Some(1)).unwrap();
    turn("C", "B", Some(2)).unwrap_err();
    turn("C", "A", None).unwrap_err();
    turn("A", "B", Some(2)).unwrap();
}

#[test]
fn an_interrupted_task_keeps_its_priority() {
    let people = Arc::new(People::new());
    let terms =
        Terms { mode: "exclusive", sharing: r#"{"on_conflict":"preempt","priority":"attribute:rank","queue_max":3}"# };
    let submit = Call::Submit { service: "R/cmd_vel".into(), task: "{}".into() };
    let task = |id: u64, who: &str, state: &str, reason: &str| {
        format!(r#"{{"id":{id},"submitter":"{who}","state":"{state}","reason":"{reason}"}}"#)
    };
    let turn = |who: &str, id: Option<u64>| {
        let mut overtaken = NobodyIsOvertaken::new(Arc::clone(&people));
        let mut height = 0;
        let mut execute = |who: &str, call: &Call, events: &[(&str, String)]| {
            height += 1;
            let (outcome, transactions) = with(call, people.index(who, 0).unwrap(), &people, height);
            let outcome = events.iter().fold(outcome, |outcome, (name, payload)| event(outcome, name, payload));
            overtaken.executed(&Executed { node: 1, outcome: &outcome, transactions: &transactions }).unwrap();
        };
        execute("Org2/admin", &Call::Configure { service: "R/cmd_vel".into(), terms }, &[]);
        execute("Org1/admin", &submit, &[("task", task(1, "Org1/admin", "running", ""))]);
        // Priority 1 takes the place of priority 0.
        let interrupted = ("task", task(1, "Org1/admin", "waiting", "preempted"));
        execute("Org1/Farhad", &submit, &[interrupted, ("task", task(2, "Org1/Farhad", "running", ""))]);
        execute(
            "Org1/Farhad",
            &Call::Acquire { service: "R/cmd_vel".into(), lease_ms: None },
            &[("queued", place("Org1/Farhad", 1))],
        );
        let id = id.map(|id| format!(r#","task":{id}"#)).unwrap_or_default();
        let granted = format!(r#"{{"holder":"{who}","epoch":3,"mode":"exclusive"{id}}}"#);
        let mut outcome = event(block(5, Hash::ZERO), "granted", &granted);
        outcome.events[0].index = None;
        overtaken.executed(&at(1, &outcome))
    };
    turn("Org1/Farhad", None).unwrap();
    turn("Org1/admin", Some(1)).unwrap_err();
}

#[test]
fn one_reader_more_than_the_owner_allows_is_noticed() {
    let people = People::new();
    let terms = Terms { mode: "limited", sharing: r#"{"subscribers":1}"# };
    let configured = Call::Configure { service: "R/cmd_vel".into(), terms };
    let (outcome, transactions) = with(&configured, 0, &people, 1);
    let place = |holder: &str, epoch: u64, id: &str| {
        format!(r#"{{"service":"R/cmd_vel{id}","holder":"{holder}","epoch":{epoch},"mode":"limited"}}"#)
    };
    let (mut exclusivity, mut epoch) = (GrantExclusivity::default(), 0);
    exclusivity.executed(&Executed { node: 1, outcome: &outcome, transactions: &transactions }).unwrap();
    let mut granted = |holder: &str, id: &str| {
        epoch += 1;
        exclusivity.executed(&at(1, &event(block(1 + epoch, Hash::ZERO), "granted", &place(holder, epoch, id))))
    };
    granted("Org1/Salma", ":subscribe").unwrap();
    granted("Org1/Salma", "").unwrap();
    granted("Org1/Farhad", "").unwrap();
    granted("Org1/Farhad", ":subscribe").unwrap_err();
}

#[test]
fn a_stop_that_does_not_last_is_noticed() {
    let told = |height: u64, name: &str, payload: &str| event(block(height, Hash::ZERO), name, payload);
    let mut stops = StopsLast::default();
    let mut tell = |height, name: &str| stops.executed(&at(1, &told(height, name, &grant("A", 1))));
    tell(1, "granted").unwrap();
    tell(2, "stopped").unwrap_err();
    tell(3, "released").unwrap();
    tell(4, "stopped").unwrap();
    tell(5, "message").unwrap_err();
    tell(6, "granted").unwrap_err();
    stops.opened(1, 6, &["R".to_owned()].into()).unwrap();
    stops.opened(1, 6, &[].into()).unwrap_err();
    stops.executed(&at(1, &told(7, "resumed", "{}"))).unwrap();
    stops.executed(&at(1, &told(8, "granted", &grant("A", 2)))).unwrap();
    stops.opened(1, 8, &["R".to_owned()].into()).unwrap_err();
}

#[test]
fn success_of_somebody_without_rights_is_noticed() {
    let people = Arc::new(People::new());
    let mut denied = DeniedByDefault::new(Arc::clone(&people));
    let mut succeed = |who: &str, call: Call| {
        let (outcome, transactions) = with(&call, people.index(who, 0).unwrap(), &people, 1);
        denied.executed(&Executed { node: 1, outcome: &outcome, transactions: &transactions })
    };
    let acquire = || Call::Acquire { service: "R/cmd_vel".into(), lease_ms: None };
    succeed("Org1/Salma", acquire()).unwrap();
    succeed("Org3/Trudy", acquire()).unwrap_err();
    succeed("Org2/admin", Call::Setup { open: true }).unwrap();
    succeed("Org1/Salma", Call::Setup { open: true }).unwrap_err();
}

#[test]
fn success_of_a_revoked_certificate_is_noticed() {
    let people = Arc::new(People::new());
    let mut revoked = RevokedStaysRevoked::new(Arc::clone(&people));
    let mut succeed = |who: &str, nth: usize, call: Call| {
        let (outcome, transactions) = with(&call, people.index(who, nth).unwrap(), &people, 1);
        revoked.executed(&Executed { node: 1, outcome: &outcome, transactions: &transactions })
    };
    let release = || Call::Release { service: "R/cmd_vel".into() };
    let salma = &people.all[people.index("Org1/Salma", 0).unwrap()].identity;
    let (issuer, serial) = (hex::encode(salma.issuer), hex::encode(&salma.serial));
    succeed("Org1/Salma", 0, release()).unwrap();
    succeed("Org1/admin", 0, Call::Revoke { issuer, serial }).unwrap();
    succeed("Org1/Salma", 1, release()).unwrap();
    succeed("Org1/Salma", 0, release()).unwrap_err();
}

#[test]
fn a_committed_entry_that_changes_is_noticed() {
    let mut committed = CommittedIsImmutable::default();
    committed.committed(1, &entry(1, 1, "a")).unwrap();
    committed.committed(2, &entry(1, 1, "a")).unwrap();
    committed.committed(2, &entry(1, 2, "a")).unwrap_err();
    committed.committed(2, &entry(3, 2, "c")).unwrap_err();
    let log = store(&[entry(1, 2, "x")]);
    committed.reopened(1, &log).unwrap();
    log.append(&[], Some(&HardState { term: 2, vote: 0, commit: 1 })).unwrap();
    committed.reopened(1, &log).unwrap_err();
}

#[test]
fn a_snapshot_that_too_few_attest_is_noticed() {
    let mut attested = SnapshotsAreAttested::default();
    let content = Hash::of(&[b"snapshot"]);
    let mut says = |node: &str, content: Hash| {
        let zero = Hash::ZERO;
        let said = format!(
            r#"{{"height":10,"hash":"{zero}","digest":"{zero}","content":"{content}","time":1,"transaction":"{zero}"}}"#
        );
        let mut outcome = event(block(1, Hash::ZERO), "attested", &said);
        for emitted in &mut outcome.events {
            emitted.event.chaincode = "msp".into();
            emitted.event.subject = node.into();
        }
        attested.executed(&at(1, &outcome));
        attested.installed(2, 10, Hash::of(&[b"snapshot"])).is_ok()
    };
    assert!(!says("Org1/node1", content));
    assert!(!says("Org1/node3", content), "of the same organisation");
    assert!(!says("Org2/node2", Hash::ZERO), "of another content");
    assert!(says("Org2/node2", content));
}

#[test]
fn a_vote_before_everybody_has_answered_is_noticed() {
    let mut votes = VotesAreInformed::default();
    votes.votes(1).unwrap();
    votes.asks(1, 1);
    votes.votes(1).unwrap_err();
    votes.answered(1);
    votes.votes(1).unwrap();
    votes.asks(1, 1);
    votes.closed(1);
    votes.votes(1).unwrap();
}

#[test]
fn members_that_no_transaction_wanted_are_noticed() {
    let record = |id, role| NodeRecord::new(id, ["Org1", &format!("node{id}")], &format!("h:{id}"), role);
    let mut members = MembersFollowTheLedger::default();
    let records = [record(1, NodeRole::Voter), record(2, NodeRole::Learner)];
    let one = Membership::new([1], []);
    members.executed(&one, &Membership::new([1], [2]), &records).unwrap();
    members.executed(&one, &Membership::new([1], [3]), &records).unwrap_err();
    members.executed(&one, &Membership::new([1, 2], []), &records).unwrap_err();
    members.at_rest(&Membership::new([1], [2]), &records).unwrap();
    let removed = [record(1, NodeRole::Voter), record(2, NodeRole::Removed)];
    members.at_rest(&Membership::new([1, 2], []), &removed).unwrap_err();
}

#[test]
fn block_time_that_no_majority_can_have_acknowledged_is_noticed() {
    let voters = [1, 2, 3].into();
    let clock = |voter: u64| [0, 9_000_000, 5_000_000, 1_000_000][voter as usize];
    let mut keeps_time = BlockTimeKeepsToTheClocks::default();
    let mut at = |now: u64, time: u64| keeps_time.executed(now, (1, time), &[&voters], clock);
    at(0, 7_000_000).unwrap();
    at(0, 7_000_001).unwrap_err();
    at(500, 7_000_501).unwrap();
    at(1_000_000, 8_000_001).unwrap();
    at(1_000_000, 8_000_002).unwrap_err();
}

#[test]
fn a_message_that_passes_a_gate_without_a_right_twice_out_of_order_or_late_is_noticed() {
    const SECOND: u64 = 1_000_000;
    let people = Arc::new(People::new());
    let (salma, farhad) = (people.index("Org1/Salma", 0).unwrap(), people.index("Org1/Farhad", 0).unwrap());
    let set = |who: usize, epoch, seq| {
        let call = Call::Set { service: "R/cmd_vel".into(), epoch, seq };
        sign(&people.all[who], Hash::ZERO, seq, 4 * SECOND, call.transaction(), true)
    };
    let mut gate = GateKeepsTheRules::new(Arc::clone(&people), SECOND);
    gate.executed(&at(1, &event(block(1, Hash::ZERO), "granted", &grant("Org1/Salma", 3))), SECOND);
    let pass = |gate: &mut GateKeepsTheRules, transaction: &Transaction, now| {
        gate.passed(&Passed { opening: 1, service: "R/cmd_vel", transaction, now, wall: now, by_block: false })
    };
    pass(&mut gate, &set(salma, 3, 7), 2 * SECOND).unwrap();
    pass(&mut gate, &set(salma, 3, 7), 2 * SECOND).unwrap_err();
    pass(&mut gate, &set(salma, 3, 6), 2 * SECOND).unwrap_err();
    pass(&mut gate, &set(salma, 2, 8), 2 * SECOND).unwrap_err();
    pass(&mut gate, &set(farhad, 3, 8), 2 * SECOND).unwrap_err();
    pass(&mut gate, &set(salma, 3, 9), 4 * SECOND).unwrap_err();
    gate.executed(&at(1, &event(block(2, Hash::ZERO), "released", &grant("Org1/Salma", 3))), SECOND + SECOND / 2);
    pass(&mut gate, &set(salma, 3, 10), 2 * SECOND).unwrap();
    gate.moves("R/cmd_vel", 2 * SECOND).unwrap();
    gate.moves("R/cmd_vel", 3 * SECOND).unwrap_err();
    pass(&mut gate, &set(salma, 3, 11), 2 * SECOND + SECOND / 2 + 3000).unwrap_err();
}

#[test]
fn a_message_that_names_a_block_and_passes_too_late_or_is_rejected_though_it_is_new_is_noticed() {
    const SECOND: u64 = 1_000_000;
    let people = Arc::new(People::new());
    let salma = people.index("Org1/Salma", 0).unwrap();
    let mut gate = GateKeepsTheRules::new(Arc::clone(&people), SECOND);
    gate.executed(&at(1, &event(block(1, Hash::ZERO), "granted", &grant("Org1/Salma", 3))), SECOND);
    let signed = |gate: &mut GateKeepsTheRules, seq| {
        let call = Call::Set { service: "R/cmd_vel".into(), epoch: 3, seq };
        // The clock of the signer is an hour ahead: that makes nothing younger.
        let transaction = sign(&people.all[salma], Hash::ZERO, seq, 3600 * SECOND, call.transaction(), true);
        gate.signed(transaction.id(), 2 * SECOND);
        transaction
    };
    let pass = |gate: &mut GateKeepsTheRules, transaction: &Transaction, now| {
        gate.passed(&Passed { opening: 1, service: "R/cmd_vel", transaction, now, wall: 0, by_block: true })
    };
    let on_time = signed(&mut gate, 7);
    pass(&mut gate, &on_time, 3 * SECOND).unwrap();
    let late = signed(&mut gate, 8);
    pass(&mut gate, &late, 5 * SECOND + SECOND / 2).unwrap_err();
    let refused = |gate: &GateKeepsTheRules, refused, now| gate.refused("R/cmd_vel", &late, refused, now);
    refused(&gate, Refused::TooOld, 2 * SECOND + SECOND / 4).unwrap_err();
    refused(&gate, Refused::UnknownBlock, 2 * SECOND).unwrap_err();
    refused(&gate, Refused::TooOld, 3 * SECOND).unwrap();
    refused(&gate, Refused::StaleEpoch, 2 * SECOND).unwrap();
}
