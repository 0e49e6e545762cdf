//! Ways past the certificates and keys of signers.

use crate::scenes::{Block, Scene, Ways, step};
use crate::world::NOW;
use bytes::Bytes;
use ledger_base::rejection::Code;
use ledger_identity::key::{KeyKind, SigningKey};
use ledger_light::Signature;
use serde_json::Value;
use testkit::rcgen::{
    BasicConstraints, CertificateParams, CustomExtension, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa,
    Issuer, KeyPair, KeyUsagePurpose, SubjectPublicKeyInfo, date_time_ymd,
};
use testkit::{Ca, User};

/// The proof of a block that node 1 signs with this certificate, and node 3 with one that is valid for long.
fn with(scene: &Scene, time: u64, user: &User) -> Vec<Value> {
    let block = Block { time, ..scene.block(5, &[]) };
    let long = |params: &mut CertificateParams| params.not_after = date_time_ymd(2040, 1, 1);
    let node3 = scene.world.cas[1].user_as(["node3", "node"], KeyKind::P256, long);
    let sign = |(node, user): (u64, &User)| {
        block.statement().sign(node, user.certificate.clone(), &user.key).unwrap().signature
    };
    vec![step(&[], block.proof([(1, user), (3, &node3)].map(sign).to_vec()).to_bytes())]
}

/// The X.509 certificates of signers.
pub(super) fn certificates(ways: &mut Ways, scene: &Scene) {
    let (org1, org2, time) = (&scene.world.cas[0], &scene.world.cas[1], NOW + 1_000_000);
    let user = |unit: &str| org1.user("node1", unit, KeyKind::P256);
    ways.good("a renewed certificate", "genesis", with(scene, time, &user("node")));
    ways.good("a node is a peer in the words of Fabric", "genesis", with(scene, time, &user("peer")));
    let mut refused = |name: &str, code: Code, why: &str, time: u64, user: &User| {
        ways.refused(name, (code, why), "genesis", with(scene, time, user));
    };
    for unit in ["member", "admin", "robot", "a department"] {
        refused(&format!("a certificate of role {unit}"), Code::Untrusted, "only a node votes", time, &user(unit));
    }
    let both = org1.user_as(["node1", "node"], KeyKind::P256, |params| {
        let mut name = DistinguishedName::new();
        name.push(DnType::CommonName, "node1");
        name.push(DnType::OrganizationalUnitName, "node");
        name.push(DnType::CustomDnType(vec![2, 5, 4, 11]), "admin");
        params.distinguished_name = name;
    });
    refused(
        "a certificate of two roles",
        Code::CertificateMalformed,
        "nobody can tell which one was meant",
        time,
        &both,
    );
    let somebody = "the organisation or the name is not that of node 1";
    refused(
        "a certificate of another node",
        Code::Untrusted,
        somebody,
        time,
        &org1.user("node2", "node", KeyKind::P256),
    );
    refused(
        "a node of this name of another organisation",
        Code::Untrusted,
        somebody,
        time,
        &org2.user("node1", "node", KeyKind::P256),
    );
    let why = "its key is not that of the organisation's authority, only its name is";
    let forged = Ca::new("Org1 CA").user("node1", "node", KeyKind::P256);
    refused("an authority of the same name", Code::Untrusted, why, time, &forged);
    let foreign = Ca::new("Org9 CA").user("node1", "node", KeyKind::P256);
    refused("an authority of no organisation", Code::Untrusted, "nobody vouches for it", time, &foreign);
    let why = "the organisation has not declared the authority between";
    let below = org1.below("Org1 other CA").user("node1", "node", KeyKind::P256);
    refused("an intermediate authority that is not declared", Code::Untrusted, why, time, &below);

    // Time: the block's, not the reader's.
    let brief = org1.user_as(["node1", "node"], KeyKind::P256, |params| params.not_after = date_time_ymd(2030, 6, 1));
    let last = 1_906_502_400_999_999;
    let why = "the certificate had expired at the block time";
    refused("an expired certificate", Code::CertificateExpired, why, last + 1, &brief);
    let late = org1.user_as(["node1", "node"], KeyKind::P256, |params| params.not_before = date_time_ymd(2030, 6, 1));
    let why = "the certificate was not valid yet at the block time";
    let early = last - 1_000_000;
    refused("a certificate that is not valid yet", Code::CertificateNotYetValid, why, early, &late);
    let long = org1.user_as(["node1", "node"], KeyKind::P256, |params| params.not_after = date_time_ymd(2040, 1, 1));
    let why = "the certificate of the authority had expired at the block time";
    refused("an expired authority", Code::CertificateExpired, why, 2_000_000_000_000_000, &long);
    let why = "no such time is within any certificate";
    refused("a block time that no clock shows", Code::CertificateExpired, why, u64::MAX, &long);

    // Use.
    type Change = fn(&mut CertificateParams);
    let usages: [(&str, &str, Change); 5] = [
        ("a certificate for servers only", "clientAuth is missing", |params| {
            params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
        }),
        ("a certificate for other uses than signing", "digitalSignature is missing", |params| {
            params.key_usages = vec![KeyUsagePurpose::KeyAgreement];
        }),
        ("the certificate of an authority", "an authority signs certificates, nothing else", |params| {
            params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        }),
        ("an unknown critical extension", "nobody knows what it forbids", |params| {
            let mut extension = CustomExtension::from_oid_content(&[1, 2, 3, 4], vec![5, 0]);
            extension.set_criticality(true);
            params.custom_extensions.push(extension);
        }),
        ("a name with a slash", "names have none", |params| {
            params.distinguished_name.push(DnType::CommonName, "node/1");
        }),
    ];
    for (name, why, change) in usages {
        let user = org1.user_as(["node1", "node"], KeyKind::P256, change);
        let code = if name.contains("slash") { Code::CertificateMalformed } else { Code::Untrusted };
        refused(name, code, why, time, &user);
    }
    let node2 = &scene.world.nodes[1];
    let issued = issued_by_node(node2);
    refused("a certificate that a node has issued", Code::Untrusted, "a node is no authority", time, &issued);
    refused(
        "no certificate",
        Code::CertificateMalformed,
        "there is no key to check with",
        time,
        &User { key: testkit::key(KeyKind::P256), certificate: Bytes::new() },
    );
    let mut longer = user("node");
    longer.certificate = [&longer.certificate[..], &[0]].concat().into();
    refused("a byte behind a certificate", Code::CertificateMalformed, "nothing stands behind its end", time, &longer);
    ways.good("the last microsecond of a certificate", "genesis", with(scene, last, &brief));
    ways.good(
        "any extended key usage that has clientAuth",
        "genesis",
        with(
            scene,
            time,
            &org1.user_as(["node1", "node"], KeyKind::P256, |params| {
                params.extended_key_usages =
                    vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth]
            }),
        ),
    );
}

/// A certificate of node 1 whose issuer is a node: its name as the issuer's, its key below.
fn issued_by_node(node: &User) -> User {
    let mut issuer = CertificateParams::default();
    issuer.distinguished_name = DistinguishedName::new();
    issuer.distinguished_name.push(DnType::CommonName, "node2");
    issuer.distinguished_name.push(DnType::OrganizationalUnitName, "node");
    let issuer = Issuer::new(issuer, KeyPair::try_from(node.key.to_pkcs8_der()).unwrap());
    let mut params = CertificateParams::default();
    params.distinguished_name = DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, "node1");
    params.distinguished_name.push(DnType::OrganizationalUnitName, "node");
    (params.not_before, params.not_after) = (date_time_ymd(2029, 1, 1), date_time_ymd(2031, 1, 1));
    let key = testkit::key(KeyKind::P256);
    let public = SubjectPublicKeyInfo::from_der(&key.public_key().to_spki()).unwrap();
    let certificate = params.signed_by(&public, &issuer).unwrap();
    User { key, certificate: Bytes::copy_from_slice(certificate.der()) }
}

/// The keys of signers, and the one form of a signature.
pub(super) fn keys(ways: &mut Ways, scene: &Scene) {
    let block = scene.block(5, &[]);
    let good = scene.proof(&block, &[1, 3]);
    let signed = |signature: Vec<u8>| {
        let mut proof = good.clone();
        proof.certificate.signatures[0].signature = signature.into();
        vec![step(&[], proof.to_bytes())]
    };
    let signature = &good.certificate.signatures[0].signature;
    let (r, s) = numbers(signature);
    ways.good("the signature in its one form", "genesis", signed(sequence(&[integer(&r), integer(&s)].concat())));
    let why = "of the two values of s that verify, the lower one counts";
    let high = sequence(&[integer(&r), integer(&less(&ORDER, &s))].concat());
    ways.refused("a signature with high s", (Code::BadSignature, why), "genesis", signed(high));
    let padded = sequence(&[integer(&[&[0, 0], &r[..]].concat()), integer(&s)].concat());
    let forms = [
        ("a signature with a long form of its length", [&[0x30, 0x81], &signature[1..]].concat()),
        ("a signature with a number that is padded", padded),
        ("a signature with a byte behind it", [&signature[..], &[0]].concat()),
        ("a signature without bytes", Vec::new()),
    ];
    for (name, form) in forms {
        ways.refused(name, (Code::BadSignature, "a signature has one form in DER"), "genesis", signed(form));
    }
    // y = 1 is the point that adds nothing: R = y, s = 0 verifies for every message.
    let identity = [&[1][..], &[0; 31]].concat();
    let public = [&hex::decode("302a300506032b6570032100").unwrap()[..], &identity].concat();
    let certificate = scene.world.cas[0].certify_key(["node1", "node"], &public);
    let mut weak = good.clone();
    weak.certificate.signatures[0] =
        Signature { node: 1, certificate, signature: [identity, vec![0; 32]].concat().into() };
    let why = "under a key of small order one signature fits every message";
    let weak = vec![step(&[], weak.to_bytes())];
    ways.refused("an Ed25519 key of small order", (Code::CertificateMalformed, why), "genesis", weak);
    let key = SigningKey::from_seed(&[5; 32]).unwrap();
    let certificate = scene.world.cas[0].certify_key(["node1", "node"], &key.public_key().to_spki());
    let mut cut = good.clone();
    let signature = key.sign(&block.statement().to_bytes())[..63].to_vec();
    cut.certificate.signatures[0] = Signature { node: 1, certificate, signature: signature.into() };
    let why = "a signature of Ed25519 has 64 bytes";
    ways.refused(
        "an Ed25519 signature of 63 bytes",
        (Code::BadSignature, why),
        "genesis",
        vec![step(&[], cut.to_bytes())],
    );
}

/// The order of P-256.
const ORDER: [u8; 32] = [
    0xff, 0xff, 0xff, 0xff, 0x00, 0x00, 0x00, 0x00, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xbc, 0xe6, 0xfa,
    0xad, 0xa7, 0x17, 0x9e, 0x84, 0xf3, 0xb9, 0xca, 0xc2, 0xfc, 0x63, 0x25, 0x51,
];

/// The two numbers of a signature, without padding.
fn numbers(signature: &[u8]) -> (Vec<u8>, Vec<u8>) {
    let (r, rest) = signature[4..].split_at(usize::from(signature[3]));
    let digits = |number: &[u8]| number[usize::from(number[0] == 0)..].to_vec();
    (digits(r), digits(&rest[2..]))
}

fn less(from: &[u8; 32], number: &[u8]) -> Vec<u8> {
    let (mut result, mut borrow) = (from.to_vec(), 0i16);
    let number = [vec![0; 32 - number.len()], number.to_vec()].concat();
    for at in (0..32).rev() {
        let difference = i16::from(result[at]) - i16::from(number[at]) - borrow;
        borrow = i16::from(difference < 0);
        result[at] = difference.rem_euclid(256) as u8;
    }
    result
}

fn integer(digits: &[u8]) -> Vec<u8> {
    let padding: &[u8] = if digits[0] >= 0x80 { &[0] } else { &[] };
    [&[2, (padding.len() + digits.len()) as u8], padding, digits].concat()
}

fn sequence(content: &[u8]) -> Vec<u8> {
    [&[0x30, content.len() as u8], content].concat()
}
