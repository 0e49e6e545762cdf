//! How far a start executes the log.

use crate::cluster::{Node, genesis};
use bytes::Bytes;
use ledger::block::{Header, Payload};
use ledger_base::hash::Hash;
use ledger_raft::Membership;
use ledger_storage::entry::{Entry, EntryKind};

const CREATED: u64 = 1_900_000_000_000_000;

#[test]
fn a_certified_block_is_committed_although_the_log_does_not_say_so_and_no_other_one_is() {
    let members = Membership::new([1, 2, 3], []);
    let genesis = genesis(&members, CREATED);
    let entries: Vec<Entry> = (1..=3)
        .map(|index| {
            let data = Payload { time: CREATED + index, transactions: Vec::<Bytes>::new() }.to_bytes();
            Entry { index, term: 1, kind: EntryKind::Normal, data }
        })
        .collect();
    let mut node = Node::new(1, 7, members);
    let mut height = |certified: Option<(u64, Hash)>| {
        node.certified = certified;
        node.open(&genesis, 1 << 20, 7, 0);
        let up = node.up.as_ref().unwrap();
        if up.store.last_index() == 0 {
            up.store.append(&entries, None).unwrap();
            up.store.flush().unwrap();
        }
        let (tip, committed) = (up.ledger().tip(), up.store.hard_state().commit);
        assert_eq!(committed, 0);
        node.end();
        node.lose_state(9);
        (tip.height, tip.hash, tip.time)
    };
    let (_, mut hash, mut time) = height(None);
    let mut hashes = Vec::new();
    for entry in &entries {
        let header = Header::following(hash, time, entry);
        (hash, time) = (header.hash(), header.time);
        hashes.push(hash);
    }
    assert_eq!(height(None).0, 0, "nobody says that anything is committed");
    assert_eq!(height(Some((2, hashes[1]))).0, 2);
    assert_eq!(height(Some((2, hashes[0]))).0, 0, "the certificate of another block");
    assert_eq!(height(Some((4, hashes[2]))).0, 0, "of a block that the log does not have");
}
