//! Hostile bytes: refused or read as exactly what they say, never with a panic.

use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_light::certificate::{self, SIGNATURES_MAX};
use ledger_light::fact::{FACT_BYTES_MAX, Fact};
use ledger_light::merkle::{PATH_BYTES_MAX, Path};
use ledger_light::proof::Shown;
use ledger_light::statement::SIGNED_BYTES_MAX;
use ledger_light::{
    Branch, BranchLink, Certificate, Change, DoubleHead, DoubleVote, Fault, Lie, Misbehaviour, Proof, Signature,
    Signed, Statement, head, lie,
};
use proptest::prelude::*;

fn hash() -> impl Strategy<Value = Hash> {
    any::<[u8; 32]>().prop_map(Hash)
}

fn statement() -> impl Strategy<Value = Statement> {
    let fields = (hash(), any::<[u64; 3]>(), hash(), hash());
    fields.prop_map(|(network, [recoveries, height, time], block, results)| Statement {
        network,
        recoveries,
        height,
        time,
        block,
        results,
    })
}

fn bytes(max: usize) -> impl Strategy<Value = Bytes> {
    prop::collection::vec(any::<u8>(), 0..=max).prop_map(Bytes::from)
}

fn signature() -> impl Strategy<Value = Signature> {
    (1..=u64::MAX, bytes(100), bytes(72)).prop_map(|(node, certificate, signature)| Signature {
        node,
        certificate,
        signature,
    })
}

fn signed() -> impl Strategy<Value = Signed> {
    (statement(), signature()).prop_map(|(statement, signature)| Signed { statement, signature })
}

fn certificates() -> impl Strategy<Value = Certificate> {
    (statement(), prop::collection::btree_map(1..=u64::MAX, signature(), 0..5)).prop_map(|(statement, signatures)| {
        let signatures = signatures.into_iter().map(|(node, signature)| Signature { node, ..signature }).collect();
        Certificate { statement, signatures }
    })
}

/// The bytes of something of each kind.
fn proofs() -> impl Strategy<Value = Bytes> {
    let path = |siblings| Path { index: 0, count: 100, siblings };
    let shown = (bytes(60), prop::collection::vec(hash(), 0..8));
    let facts =
        prop::collection::vec(shown.prop_map(move |(fact, siblings)| Shown { fact, path: path(siblings) }), 0..3);
    (certificates(), facts).prop_map(|(certificate, facts)| Proof { certificate, facts }.to_bytes())
}

fn written() -> impl Strategy<Value = Bytes> {
    let verdict = (any::<u32>(), hash(), any::<u32>(), hash())
        .prop_map(|(index, id, code, response)| Fact::Verdict { index, id, code, response }.to_bytes().into());
    let event = (any::<Option<u32>>(), ".{0,20}", ".{0,20}", hash()).prop_map(|(index, name, subject, payload)| {
        Fact::Event { index, chaincode: "abac", name: &name, subject: &subject, payload }.to_bytes().into()
    });
    let ground = [hash(), hash(), hash(), hash()].prop_map(|[governing, control, digest, previous]| {
        Fact::Ground { governing, control, digest, previous }.to_bytes().into()
    });
    let control = (bytes(60), prop::option::of(hash()))
        .prop_map(|(key, value)| Fact::Control { key: &key, value }.to_bytes().into());
    let path = (0..100u32, prop::collection::vec(hash(), 0..8))
        .prop_map(|(index, siblings)| Path { index, count: 100, siblings }.to_bytes().into());
    prop_oneof![
        verdict,
        event,
        ground,
        control,
        path,
        statement().prop_map(|statement| statement.to_bytes().into()),
        signed().prop_map(|signed| signed.to_bytes()),
        certificates().prop_map(|certificate| certificate.to_bytes()),
        (signed(), signed()).prop_map(|(first, second)| Misbehaviour::Lie(Lie { first, second }).to_bytes()),
        (signed(), signed()).prop_map(|(first, second)| Misbehaviour::Fault(Fault { first, second }).to_bytes()),
        (signed(), signed(), any::<[u64; 4]>()).prop_map(|(first, second, [term, time, one, other])| {
            let votes = [(one, first.signature), (other, second.signature)];
            let (network, recoveries) = (first.statement.network, first.statement.recoveries);
            DoubleVote { network, recoveries, term, time, votes }.to_bytes()
        }),
        (signed(), signed(), any::<[u64; 5]>(), prop::collection::vec((any::<u64>(), any::<u64>(), hash()), 0..3))
            .prop_map(|(first, second, [recoveries, leader, term, height, time], links)| {
                let links: Vec<_> =
                    links.into_iter().map(|(term, time, root)| BranchLink { term, time, root }).collect();
                let branches = [(first.statement.block, first.signature), (second.statement.block, second.signature)]
                    .map(|(base, signature)| Branch { base, links: links.clone(), signature });
                let network = first.statement.network;
                DoubleHead { network, recoveries, leader, term, height, time, branches }.to_bytes()
            }),
        proofs(),
        prop::collection::vec((bytes(60), prop::option::of(bytes(200))), 0..4).prop_map(|writes| Change {
            height: 1,
            writes
        }
        .to_bytes()),
    ]
}

/// The bytes again, from each kind that they are read as.
fn read(bytes: &[u8]) -> Vec<Bytes> {
    let again: [Result<Bytes, Rejection>; 8] = [
        Fact::from_bytes(bytes).map(|fact| fact.to_bytes().into()),
        Path::from_bytes(bytes).map(|path| path.to_bytes().into()),
        Statement::from_bytes(bytes).map(|statement| statement.to_bytes().into()),
        Signed::from_bytes(bytes).map(|signed| signed.to_bytes()),
        Certificate::from_bytes(bytes).map(|certificate| certificate.to_bytes()),
        Misbehaviour::from_bytes(bytes).map(|proof| proof.to_bytes()),
        Proof::from_bytes(bytes).map(|proof| proof.to_bytes()),
        Change::from_bytes(1, bytes).map(|change| change.to_bytes()),
    ];
    again.into_iter().flatten().collect()
}

proptest! {
    #[test]
    fn what_was_written_is_read_as_one_kind_and_in_one_form(bytes in written()) {
        prop_assert_eq!(read(&bytes), vec![bytes]);
    }

    #[test]
    fn garbage_is_refused_without_a_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        // Only a path begins with nothing of its own.
        for again in read(&bytes) {
            prop_assert_eq!(&again, &bytes);
        }
    }

    #[test]
    fn damaged_bytes_are_refused_or_say_something_else(bytes in written(), at in any::<prop::sample::Index>(), flip in 1..=255u8) {
        let mut damaged = bytes.to_vec();
        let at = at.index(damaged.len());
        damaged[at] ^= flip;
        for again in read(&damaged).into_iter().chain(read(&bytes[..at])) {
            prop_assert!(again == damaged || again == bytes[..at]);
        }
        let longer = [&bytes[..], &[flip]].concat();
        prop_assert!(read(&longer).is_empty(), "something behind the end");
    }
}

#[test]
fn limits_are_exact_and_hold_before_anything_is_allocated() {
    let statement =
        Statement { network: Hash::ZERO, recoveries: 0, height: 1, time: 1, block: Hash::ZERO, results: Hash::ZERO };
    let signature = |node| Signature {
        node,
        certificate: vec![0; ledger_identity::certificate::CERTIFICATE_BYTES_MAX].into(),
        signature: vec![0; 72].into(),
    };
    let many = |count: u64| Certificate { statement, signatures: (1..=count).map(signature).collect() };
    let most = many(SIGNATURES_MAX as u64).to_bytes();
    assert_eq!(most.len(), certificate::CERTIFICATE_BYTES_MAX);
    assert!(Certificate::from_bytes(&most).is_ok());
    assert_eq!(Certificate::from_bytes(&many(SIGNATURES_MAX as u64 + 1).to_bytes()).unwrap_err().code, Code::TooLarge);
    // As many signatures as a number can say, in no bytes at all.
    let mut claims = many(0).to_bytes().to_vec();
    let length = claims.len();
    claims[length - 4..].fill(0xff);
    assert_eq!(Certificate::from_bytes(&claims).unwrap_err().code, Code::Malformed);

    let signed = Signed { statement, signature: signature(1) };
    assert_eq!(signed.to_bytes().len(), SIGNED_BYTES_MAX);
    let lie = Misbehaviour::Lie(Lie { first: signed.clone(), second: signed.clone() });
    assert_eq!(lie.to_bytes().len(), lie::LIE_BYTES_MAX);
    assert!(Misbehaviour::from_bytes(&lie.to_bytes()).is_ok());
    let fault = Misbehaviour::Fault(Fault { first: signed.clone(), second: signed.clone() });
    assert_eq!(fault.to_bytes().len(), lie::FAULT_BYTES_MAX);
    assert!(Misbehaviour::from_bytes(&fault.to_bytes()).is_ok());
    let votes = [(1, signature(1)), (2, signature(1))];
    let votes = DoubleVote { network: Hash::ZERO, recoveries: 0, term: 1, time: 1, votes };
    assert_eq!(votes.to_bytes().len(), lie::DOUBLE_VOTE_BYTES_MAX);
    assert!(DoubleVote::from_bytes(&votes.to_bytes()).is_ok());
    let link = BranchLink { term: 1, time: 1, root: Hash::ZERO };
    let branch = |count| Branch { base: Hash::ZERO, links: vec![link; count], signature: signature(1) };
    let heads = |count| {
        let branches = [branch(count), branch(count)];
        DoubleHead { network: Hash::ZERO, recoveries: 0, leader: 1, term: 1, height: 1, time: 1, branches }
    };
    assert_eq!(heads(head::LINKS_MAX).to_bytes().len(), head::DOUBLE_HEAD_BYTES_MAX);
    assert!(DoubleHead::from_bytes(&heads(head::LINKS_MAX).to_bytes()).is_ok());
    assert!(DoubleHead::from_bytes(&heads(head::LINKS_MAX + 1).to_bytes()).is_err());
    let mut longer = signed.clone();
    longer.signature.signature = vec![0; 73].into();
    assert_eq!(Signed::from_bytes(&longer.to_bytes()).unwrap_err().code, Code::TooLarge);
    let nobody = Signed { signature: signature(0), ..signed };
    assert_eq!(Signed::from_bytes(&nobody.to_bytes()).unwrap_err().code, Code::Malformed, "there is no node 0");
    assert_eq!(Fact::from_bytes(&vec![0; FACT_BYTES_MAX + 1]).unwrap_err().code, Code::TooLarge);
    assert_eq!(Path::from_bytes(&vec![0; PATH_BYTES_MAX + 1]).unwrap_err().code, Code::TooLarge);
}
