//! How far a start executes the log.

use crate::cluster::{Node, genesis};
use bytes::Bytes;
use ledger::block::Payload;
use ledger_base::hash::Hash;
use ledger_raft::Membership;
use ledger_storage::entry::{Entry, EntryKind, HardState};

const SEGMENT: u64 = 1 << 20;
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
    let hashes = {
        let mut node = Node::new(2, 5, members.clone());
        node.open(&genesis, SEGMENT, 7, 0);
        let up = node.up.as_ref().unwrap();
        up.store.append(&entries, Some(&HardState { term: 1, vote: 0, commit: 3 })).unwrap();
        up.store.flush().unwrap();
        node.end();
        node.open(&genesis, SEGMENT, 7, 0);
        let ledger = node.up.as_ref().unwrap().ledger().clone();
        [1, 2, 3].map(|height| ledger.block_hashes(height).unwrap().unwrap().hash)
    };
    let mut node = Node::new(1, 7, members);
    let mut height = |certified: Option<(u64, Hash)>| {
        node.certified = certified;
        node.open(&genesis, SEGMENT, 7, 0);
        let up = node.up.as_ref().unwrap();
        if up.store.last_index() == 0 {
            up.store.append(&entries, None).unwrap();
            up.store.flush().unwrap();
        }
        let (height, committed) = (up.ledger().tip().height, up.store.hard_state().commit);
        assert_eq!(committed, 0);
        node.end();
        node.lose_state(9);
        height
    };
    assert_eq!((height(None), height(None)), (0, 0), "nobody says that anything is committed");
    assert_eq!(height(Some((2, hashes[1]))), 2);
    assert_eq!(height(Some((2, hashes[0]))), 0, "the certificate of another block");
    assert_eq!(height(Some((4, hashes[2]))), 0, "of a block that the log does not have");
}
