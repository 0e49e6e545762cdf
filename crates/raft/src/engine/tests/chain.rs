//! A leader with two faces: entries are compared by the hash of the chain, not by index and term.

use super::votes::head;
use super::*;
use crate::interface::Contradiction;
use ledger::block::{Header, Payload};
use ledger_storage::entry::Entry;

const GENESIS: Hash = Hash([7; 32]);

/// A block of one transaction.
pub(super) fn entry(index: u64, term: u64, content: &'static [u8]) -> WireEntry {
    let data = Payload { time: index, transactions: vec![Bytes::from_static(content)] }.to_bytes();
    WireEntry { index, term, kind: 1, data }
}

/// The hash of the chain of these entries, from the genesis on.
pub(super) fn hash(entries: &[WireEntry]) -> Hash {
    link(entries).0
}

fn link(entries: &[WireEntry]) -> (Hash, u64) {
    let (mut hash, mut time) = (GENESIS, 0);
    for WireEntry { index, term, data, .. } in entries {
        let entry = Entry { index: *index, term: *term, kind: EntryKind::Normal, data: data.clone() };
        let header = Header::following(hash, time, &entry);
        (hash, time) = (header.hash(), header.time);
    }
    (hash, time)
}

/// Node `from` leads in a term and appends entries after those of its log that it names.
pub(super) fn append(from: u64, term: u64, before: &[WireEntry], entries: &[WireEntry], commit: u64) -> Input {
    message(from, RaftKind::Append, |message| {
        (message.term, message.commit) = (term, commit);
        (message.index, message.log_term) = before.last().map_or((0, 0), |last| (last.index, last.term));
        message.hash = hash(before).0.to_vec().into();
        message.entries = entries.to_vec();
        message.head = head(from, message, link(before));
    })
}

/// Node 2 of three, which follows node 1 in term 1 and holds two entries, of which the first is committed.
pub(super) fn follower() -> Engine {
    let mut node = engine(2, &[1, 2, 3], &[]);
    step(&mut node, append(1, 1, &[], &[entry(1, 1, b"a"), entry(2, 1, b"b")], 1));
    assert_eq!((node.store.last_index(), node.emitted), (2, 1));
    node
}

fn contradictions(out: &[Output]) -> Vec<Contradiction> {
    let found = out.iter().filter_map(|output| match output {
        Output::Contradicted(found) => Some(*found),
        _ => None,
    });
    found.collect()
}

pub(super) fn responses(out: &[Output]) -> Vec<(u64, bool, Bytes)> {
    let sent = out.iter().filter_map(|output| match output {
        Output::Send { message: PeerMessage::Raft(message), .. } if message.kind() == RaftKind::AppendResponse => {
            Some((message.index, message.reject, message.hash.clone()))
        }
        _ => None,
    });
    sent.collect()
}

#[test]
fn a_leader_names_the_block_before_its_entries_and_a_follower_the_last_one_that_it_acknowledges() {
    let mut node = engine(2, &[1, 2, 3], &[]);
    let entries = [entry(1, 1, b"a"), entry(2, 1, b"b")];
    let out = step(&mut node, append(1, 1, &[], &entries, 1));
    assert_eq!(responses(&out), [(2, false, Bytes::copy_from_slice(&hash(&entries).0))]);

    let mut node = leader(2);
    let out = step(&mut node, Input::Submit { lane: Lane::Data, transaction: vec![1].into() });
    let named: Vec<_> = out
        .iter()
        .filter_map(|output| match output {
            Output::Send { to: 2, message: PeerMessage::Raft(message) } if message.kind() == RaftKind::Append => {
                Some((message.index, message.hash.clone()))
            }
            _ => None,
        })
        .collect();
    assert_eq!(named, [(3, Bytes::copy_from_slice(&node.chain.hash(3).unwrap().0))]);
}

#[test]
fn a_node_never_appends_onto_a_fork_although_index_and_term_match() {
    let (own, other) = ([entry(1, 1, b"a"), entry(2, 1, b"b")], [entry(1, 1, b"a"), entry(2, 1, b"B")]);
    let mut node = follower();
    let forked = append(3, 2, &other, &[entry(3, 2, b"c")], 2);
    let out = step(&mut node, forked.clone());
    let (height, own, other) = (2, hash(&own), hash(&other));
    assert_eq!(contradictions(&out), [Contradiction { node: 3, leads: true, term: 2, height, own, other }]);
    assert_eq!((node.store.last_index(), node.emitted, responses(&out)), (2, 1, vec![]));
    let again = step(&mut node, forked);
    assert_eq!((contradictions(&again), node.store.last_index()), (vec![], 2), "reported once");
}

#[test]
fn entries_that_this_node_has_with_another_content_contradict_it() {
    let mut node = follower();
    let other = [entry(1, 1, b"a"), entry(2, 1, b"B")];
    let found = contradictions(&step(&mut node, append(1, 1, &other[..1], &[other[1].clone(), entry(3, 1, b"c")], 3)));
    assert_eq!(found.iter().map(|found| (found.height, found.other)).collect::<Vec<_>>(), [(2, hash(&other))]);
    assert_eq!((node.store.last_index(), node.emitted), (2, 1));
    // The same ones once more do not.
    let same = [entry(1, 1, b"a"), entry(2, 1, b"b")];
    assert_eq!(contradictions(&step(&mut node, append(1, 1, &same[..1], &same[1..], 2))), []);
    assert_eq!(node.emitted, 2);
}

#[test]
fn a_committed_block_is_contradicted_by_an_entry_of_any_term() {
    for (before, entries) in [
        (vec![entry(1, 2, b"a")], vec![entry(2, 2, b"b")]),
        (vec![], vec![entry(1, 2, b"a")]),
        (vec![entry(1, 1, b"A")], vec![]),
    ] {
        let mut node = follower();
        let found = contradictions(&step(&mut node, append(3, 2, &before, &entries, 0)));
        assert_eq!(found.iter().map(|found| found.height).collect::<Vec<_>>(), [1], "{before:?} {entries:?}");
    }
}

#[test]
fn entries_of_another_term_that_nobody_committed_are_superseded_as_ever() {
    let mut node = follower();
    let other = [entry(1, 1, b"a"), entry(2, 2, b"B"), entry(3, 2, b"c")];
    let out = step(&mut node, append(3, 2, &other[..2], &other[2..], 2));
    assert_eq!((contradictions(&out), responses(&out).len()), (vec![], 1));
    assert!(responses(&out).iter().all(|(_, reject, _)| *reject));
    let out = step(&mut node, append(3, 2, &other[..1], &other[1..], 2));
    assert_eq!(responses(&out), [(3, false, Bytes::copy_from_slice(&hash(&other).0))]);
    assert_eq!((node.store.last_index(), node.emitted), (3, 2));
}

#[test]
fn an_append_that_does_not_name_the_block_before_is_not_taken() {
    for named in [Bytes::new(), Bytes::from_static(b"short")] {
        let mut node = follower();
        step(&mut node, message(1, RaftKind::Heartbeat, |_| {}));
        let unnamed = message(1, RaftKind::Append, |message| {
            (message.index, message.log_term, message.hash) = (2, 1, named.clone());
            message.entries = vec![entry(3, 1, b"c")];
        });
        let out = bare_step(&mut node, unnamed);
        assert!(matches!(&out[..], [Output::Ignored { from: 1, .. }]), "{out:?}");
        assert_eq!(node.store.last_index(), 2);
    }
}

#[test]
fn a_leader_counts_acknowledgements_of_its_own_chain_only() {
    for named in [Bytes::new(), Bytes::from(vec![5; 32])] {
        let mut node = leader(1);
        step(&mut node, Input::Submit { lane: Lane::Data, transaction: vec![1].into() });
        let before = (progress(&node, 3), node.raw.raft.raft_log.committed);
        let acknowledges = |named: Bytes| {
            message(3, RaftKind::AppendResponse, move |message| (message.index, message.hash) = (3, named))
        };
        let out = bare_step(&mut node, acknowledges(named.clone()));
        assert_eq!((progress(&node, 3), node.raw.raft.raft_log.committed), before);
        let own = node.chain.hash(3).unwrap();
        let found = Contradiction { node: 3, leads: false, term: 1, height: 3, own, other: Hash([5; 32]) };
        assert_eq!(contradictions(&out), if named.is_empty() { vec![] } else { vec![found] });
        step(&mut node, acknowledges(Bytes::copy_from_slice(&own.0)));
        assert_eq!(node.raw.raft.raft_log.committed, 3);
    }
}

#[test]
fn the_chain_of_a_log_is_the_same_after_a_start() {
    let before = follower();
    let config = EngineConfig::new(2, Membership::new([1, 2, 3], []), 2);
    let again = Engine::new(config, Arc::clone(&before.store), Arc::new(Genesis), Arc::new(Names(2))).unwrap();
    for height in 0..=3 {
        assert_eq!(again.chain.link(height), before.chain.link(height), "{height}");
    }
    assert_eq!((again.chain.last(), again.chain.hash(3)), (2, None));
}

#[test]
fn links_of_executed_blocks_leave_the_memory() {
    let mut node = engine(1, &[1], &[]);
    step(&mut node, Input::Tick);
    for _ in 0..5000 {
        step(&mut node, Input::ProposeEmpty);
    }
    let last = node.store.last_index();
    assert!(last > 5000 && node.chain.hash(last).is_some());
    assert_eq!(node.chain.hash(last - 4500), None, "it is asked for where results are");
}
