//! The proto file and the ledger's own encoding of transactions are the same bytes.
#![expect(clippy::unwrap_used, reason = "tests")]

use bytes::Bytes;
use ledger::transaction::{Body, KnownBlock, Transaction};
use ledger_api::v1;
use ledger_base::hash::Hash;
use ledger_identity::key::{KeyKind, SigningKey};
use prost::Message;
use ring::rand::SystemRandom;

fn body(args: &[&'static [u8]]) -> Body {
    Body {
        network: Bytes::from_static(&[1; 32]),
        creator: Bytes::from_static(&[2; 32]),
        nonce: Bytes::from_static(&[3; 16]),
        not_after: 1_893_456_000_000_000,
        chaincode: "abac".into(),
        function: "acquire".into(),
        args: args.iter().map(|arg| Bytes::from_static(arg)).collect(),
        known_block: Some(KnownBlock { height: 700, hash: Bytes::from_static(&[4; 8]), known_us: 90_000 }),
    }
}

fn key() -> SigningKey {
    SigningKey::generate(KeyKind::Ed25519, &SystemRandom::new()).unwrap()
}

#[test]
fn what_the_ledger_writes_the_proto_reads_and_writes_back() {
    let calls: [&[&'static [u8]]; 3] = [&[], &[b""], &[b"Turtlebot4", b"", &[0; 300]]];
    for args in calls {
        let wanted = body(args);
        let transaction = Transaction::sign(&wanted, &key()).unwrap();
        let transaction = transaction.with_certificate(Bytes::from_static(b"certificate")).unwrap();
        let read = v1::Transaction::decode(transaction.encoded().clone()).unwrap();
        assert_eq!(read.encode_to_vec(), *transaction.encoded());
        assert_eq!(read.certificate, "certificate");
        assert_eq!(Hash::of(&[&read.body]), transaction.id());
        let inner = v1::TransactionBody::decode(read.body.clone()).unwrap();
        assert_eq!(inner.encode_to_vec(), read.body);
        assert_eq!((inner.network, inner.creator, inner.nonce), (wanted.network, wanted.creator, wanted.nonce));
        assert_eq!((inner.not_after, inner.chaincode), (wanted.not_after, wanted.chaincode));
        assert_eq!((inner.function, inner.args), (wanted.function, wanted.args));
        let known = inner.known_block.map(|known| (known.height, known.hash, known.known_us));
        assert_eq!(known, wanted.known_block.map(|known| (known.height, known.hash, known.known_us)));
    }
}

#[test]
fn what_another_client_writes_by_the_proto_the_ledger_reads() {
    let key = key();
    let Body { network, creator, nonce, not_after, chaincode, function, args, known_block } =
        body(&[b"Turtlebot4", b""]);
    let known_block =
        known_block.map(|KnownBlock { height, hash, known_us }| v1::KnownBlock { height, hash, known_us });
    let inner = v1::TransactionBody { network, creator, nonce, not_after, chaincode, function, args, known_block };
    let inner = Bytes::from(inner.encode_to_vec());
    let signature = key.sign(&[b"ledgerd transaction v1\0".as_slice(), &inner].concat());
    let outer = v1::Transaction { body: inner.clone(), signature: signature.into(), certificate: Bytes::new() };
    let encoded = Bytes::from(outer.encode_to_vec());
    let read = Transaction::decode(encoded.clone()).unwrap();
    assert_eq!(*read.body(), body(&[b"Turtlebot4", b""]));
    assert_eq!(*read.encoded(), encoded);
    assert_eq!(read.id(), Hash::of(&[&inner]));
    read.verify(&key.public_key()).unwrap();
}
