use super::convert::{entry_from_raft, entry_into_raft};
use super::*;
use ledger_storage::entry::Entry;
use proptest::prelude::*;

fn raft(kind: RaftKind) -> RaftMessage {
    RaftMessage { kind: kind.into(), term: u64::from(kind != RaftKind::ReadIndex), ..RaftMessage::default() }
}

fn append(entries: impl IntoIterator<Item = u64>) -> PeerMessage {
    let entries =
        entries.into_iter().map(|index| WireEntry { index, term: 1, kind: 1, data: Bytes::from_static(b"x") });
    PeerMessage::Raft(RaftMessage { entries: entries.collect(), ..raft(RaftKind::Append) })
}

fn bytes() -> impl Strategy<Value = Bytes> {
    prop::collection::vec(any::<u8>(), 0..40).prop_map(Bytes::from)
}

fn message() -> impl Strategy<Value = PeerMessage> {
    let numbers = prop::collection::vec(0..1000u64, 6);
    let raft = (1..=11i32, numbers, any::<bool>(), bytes(), prop::collection::vec((1..=3u32, bytes()), 0..5)).prop_map(
        |(kind, numbers, reject, context, entries)| {
            let [index, log_term, commit, commit_term, reject_hint, more] = numbers[..] else { unreachable!() };
            // These two name a hash, and the engine hands it over as their context.
            let names = [RaftKind::Append, RaftKind::AppendResponse].map(i32::from).contains(&kind);
            let entries = entries.into_iter().enumerate().map(|(nth, (kind, data))| WireEntry {
                index: index + 1 + nth as u64,
                term: log_term + 1,
                kind,
                data,
            });
            PeerMessage::Raft(RaftMessage {
                kind,
                term: if kind == i32::from(RaftKind::ReadIndex) { 0 } else { log_term + 1 + more },
                log_term,
                index,
                commit,
                commit_term,
                reject,
                reject_hint,
                context: if names { Bytes::new() } else { context.clone() },
                entries: if kind == i32::from(RaftKind::Append) { entries.collect() } else { Vec::new() },
                receipt_index: 0,
                receipt: Bytes::new(),
                accepts_until: 0,
                vote: Bytes::new(),
                hash: if names { context.slice(..context.len().min(HASH_BYTES)) } else { Bytes::new() },
                transfer: Bytes::new(),
                head: Bytes::new(),
            })
        },
    );
    let transactions = || {
        let lane = || prop::collection::vec(bytes(), 0..5);
        (lane(), lane(), 0..9999u32).prop_map(|(control, data, code)| Transactions { control, data, code })
    };
    let statement = bytes().prop_map(|signed| PeerMessage::Statement(SignedStatement { signed }));
    let early = bytes().prop_map(|transaction| PeerMessage::Early(EarlyCall { transaction }));
    let evidence = bytes().prop_map(|proof| PeerMessage::Evidence(Evidence { proof }));
    prop_oneof![
        statement,
        early,
        evidence,
        raft,
        transactions().prop_map(PeerMessage::Forward),
        transactions().prop_map(PeerMessage::Returned)
    ]
}

proptest! {
    #[test]
    fn every_message_survives_the_wire(message in message()) {
        prop_assert_eq!(PeerMessage::decode(message.to_bytes()).unwrap(), message);
    }

    #[test]
    fn what_the_engine_is_told_is_what_another_said(message in message()) {
        let PeerMessage::Raft(message) = message else { return Ok(()) };
        let there = message.clone().into_raft(7, 8).unwrap();
        prop_assert_eq!((there.from, there.to), (7, 8));
        let back = RaftMessage::from_raft(there).unwrap();
        prop_assert_eq!(back, message);
    }

    #[test]
    fn garbage_is_refused_without_a_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = PeerMessage::decode(bytes.into());
    }

    #[test]
    fn a_damaged_message_is_refused_or_another_message(message in message(), at in any::<prop::sample::Index>(), flip in 1..=255u8) {
        let mut bytes = message.to_bytes().to_vec();
        let at = at.index(bytes.len());
        bytes[at] ^= flip;
        let _ = PeerMessage::decode(bytes.clone().into());
        let _ = PeerMessage::decode(bytes[..at].to_vec().into());
    }
}

#[test]
fn an_entry_survives_the_engine() {
    for kind in [EntryKind::Normal, EntryKind::ConfChange, EntryKind::ConfChangeV2] {
        let entry = Entry { index: 3, term: 2, kind, data: Bytes::from_static(b"data") };
        assert_eq!(entry_from_raft(entry_into_raft(entry.clone())), entry);
    }
}

#[test]
fn limits_are_exact() {
    let most = append(1..=ENTRIES_MAX as u64);
    assert_eq!(PeerMessage::decode(most.to_bytes()).unwrap(), most);
    let more = append(1..=ENTRIES_MAX as u64 + 1);
    assert!(matches!(PeerMessage::decode(more.to_bytes()), Err(MessageError::TooLarge { unit: "entries", .. })));

    let transactions = |count| Transactions { control: vec![Bytes::new(); count], ..Transactions::default() };
    let most = PeerMessage::Forward(transactions(TRANSACTIONS_MAX));
    assert_eq!(PeerMessage::decode(most.to_bytes()).unwrap(), most);
    let more = PeerMessage::Forward(transactions(TRANSACTIONS_MAX + 1));
    assert!(matches!(PeerMessage::decode(more.to_bytes()), Err(MessageError::TooLarge { .. })));

    let context = |bytes| RaftMessage { context: vec![0; bytes].into(), ..raft(RaftKind::Heartbeat) };
    assert!(PeerMessage::decode(PeerMessage::Raft(context(CONTEXT_BYTES_MAX)).to_bytes()).is_ok());
    assert!(PeerMessage::decode(PeerMessage::Raft(context(CONTEXT_BYTES_MAX + 1)).to_bytes()).is_err());
    let statement = |bytes| PeerMessage::Statement(SignedStatement { signed: vec![7; bytes].into() });
    assert!(PeerMessage::decode(statement(STATEMENT_BYTES_MAX).to_bytes()).is_ok());
    assert!(PeerMessage::decode(statement(STATEMENT_BYTES_MAX + 1).to_bytes()).is_err());
    let early = |bytes| PeerMessage::Early(EarlyCall { transaction: vec![7; bytes].into() });
    assert!(PeerMessage::decode(early(EARLY_BYTES_MAX).to_bytes()).is_ok());
    assert!(PeerMessage::decode(early(EARLY_BYTES_MAX + 1).to_bytes()).is_err());
    let evidence = |bytes| PeerMessage::Evidence(Evidence { proof: vec![7; bytes].into() });
    assert!(PeerMessage::decode(evidence(EVIDENCE_BYTES_MAX).to_bytes()).is_ok());
    assert!(PeerMessage::decode(evidence(EVIDENCE_BYTES_MAX + 1).to_bytes()).is_err());
    assert!(PeerMessage::decode(vec![0; PEER_MESSAGE_BYTES_MAX + 1].into()).is_err());
}

#[test]
fn many_tiny_fields_are_refused_before_anything_is_allocated_for_them() {
    // Two bytes each on the wire, an entry of 56 bytes each in memory.
    let mut inner = Vec::new();
    for _ in 0..=FIELDS_MAX {
        inner.extend_from_slice(&[0x52, 0x00]);
    }
    let mut bytes = vec![0x0a];
    prost::encoding::encode_varint(inner.len() as u64, &mut bytes);
    bytes.extend(inner);
    assert!(matches!(PeerMessage::decode(bytes.into()), Err(MessageError::TooLarge { unit: "fields", .. })));
}

#[test]
fn what_no_peer_may_say_is_refused() {
    let refused = |message: RaftMessage| PeerMessage::decode(PeerMessage::Raft(message).to_bytes()).is_err();
    assert!(refused(RaftMessage { kind: 0, ..raft(RaftKind::Append) }), "no kind");
    assert!(refused(RaftMessage { kind: 12, ..raft(RaftKind::Append) }), "unknown kind");
    assert!(refused(RaftMessage { kind: -1, ..raft(RaftKind::Append) }), "unknown kind");
    assert!(refused(RaftMessage { term: 0, ..raft(RaftKind::Append) }), "a local message");
    assert!(refused(RaftMessage { term: u64::MAX, ..raft(RaftKind::Vote) }), "a term that cannot be exceeded");
    let entry = |index, term, kind| WireEntry { index, term, kind, data: Bytes::new() };
    let with = |kind, entries| RaftMessage { term: 5, entries, ..raft(kind) };
    assert!(!refused(with(RaftKind::Append, vec![entry(1, 2, 1), entry(2, 2, 3)])));
    assert!(refused(with(RaftKind::Heartbeat, vec![entry(1, 2, 1)])), "entries in a heartbeat");
    assert!(refused(with(RaftKind::Append, vec![entry(2, 2, 1)])), "a gap");
    assert!(refused(with(RaftKind::Append, vec![entry(1, 2, 1), entry(2, 1, 1)])), "a falling term");
    assert!(refused(with(RaftKind::Append, vec![entry(1, 6, 1)])), "an entry of a later term");
    assert!(refused(with(RaftKind::Append, vec![entry(1, 2, 9)])), "an unknown kind of entry");
    let end = RaftMessage { index: u64::MAX, log_term: 1, ..with(RaftKind::Append, vec![entry(0, 2, 1)]) };
    assert!(refused(end), "an index that overflows");
}

#[test]
fn two_messages_in_one_are_refused() {
    let one = append([1]).to_bytes();
    let two = [one.clone(), one].concat();
    assert!(PeerMessage::decode(two.into()).is_err());
    assert!(PeerMessage::decode(Bytes::new()).is_err());
}
