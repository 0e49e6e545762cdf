//! The ways of the vectors. Each that is refused differs in one thing from one that is not.

mod changes;
mod checkpoints;
mod x509;

use crate::scenes::{Block, Scene, Ways, step};
use crate::world::World;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_light::fact::Fact;
use ledger_light::merkle::{self, Path};
use ledger_light::proof::{Proof, Shown};
use ledger_light::{Signature, Statement, Vote};
use serde_json::Value;
use testkit::User;

/// The ways, with the places where they begin.
pub(crate) fn made() -> Ways {
    let mut ways = Ways::default();
    let scene = Scene::new(World::new(), &[1, 2, 3]);
    let alone = Scene::new(World::new(), &[1, 2]);
    let handing = Scene::new(World::new(), &[1, 3]);
    for (name, scene) in [("genesis", &scene), ("one organisation", &alone), ("two voters", &handing)] {
        ways.beginnings.insert(name.to_owned(), scene.begin.clone());
    }
    let four = Scene::new(World::new(), &[1, 2, 3, 4]);
    ways.beginnings.insert("four voters".to_owned(), four.begin.clone());
    let by = |scene: &Scene, nodes: &[u64]| vec![step(&[], scene.proof(&scene.block(5, &[]), nodes).to_bytes())];
    ways.good("voters of one organisation", "one organisation", by(&alone, &[1, 2]));
    ways.good("three voters of four", "four voters", by(&four, &[1, 2, 3]));
    let why = "half of the voters are not more than half";
    ways.refused("one voter of two", (Code::Untrusted, why), "one organisation", by(&alone, &[1]));
    ways.refused("two voters of four", (Code::Untrusted, why), "four voters", by(&four, &[1, 3]));
    signers(&mut ways, &scene);
    forms(&mut ways, &scene);
    paths(&mut ways, &scene);
    changes::chains(&mut ways, &scene);
    changes::organisations(&mut ways, &scene);
    changes::hand_over(&mut ways, &handing);
    x509::certificates(&mut ways, &scene);
    x509::keys(&mut ways, &scene);
    checkpoints::checkpoints(&mut ways, &scene);
    ways
}

/// Signers: those that count, and how many are enough.
fn signers(ways: &mut Ways, scene: &Scene) {
    let block = scene.block(5, &[]);
    let by = |nodes: &[u64]| vec![step(&[], scene.proof(&block, nodes).to_bytes())];
    ways.good("two voters of three, of two organisations", "genesis", by(&[1, 3]));
    ways.good("all voters, one of them with Ed25519", "genesis", by(&[1, 2, 3]));
    ways.good("a node signs that does not vote: it counts for nothing", "genesis", by(&[1, 3, 4]));
    for (name, why, nodes) in [
        ("one voter of three", "more than half of the voters must sign", &[1][..]),
        ("no signature", "more than half of the voters must sign", &[]),
        ("two voters of one organisation", "the voters are of two organisations, so signers must be, too", &[1, 2]),
        ("one voter and one that only follows", "node 4 does not vote", &[3, 4]),
    ] {
        ways.refused(name, (Code::Untrusted, why), "genesis", by(nodes));
    }
    let spoilt = |at: usize| {
        let mut proof = scene.proof(&block, &[1, 2, 3]);
        let mut signature = proof.certificate.signatures[at].signature.to_vec();
        signature[40] ^= 1;
        proof.certificate.signatures[at].signature = signature.into();
        vec![step(&[], proof.to_bytes())]
    };
    ways.good("one signature of three is not good: it counts for nothing", "genesis", spoilt(1));
    let why = "the signature of node 3 is not good, and the others are of one organisation";
    ways.refused("the signature that is needed is not good", (Code::BadSignature, why), "genesis", spoilt(2));
    let mut stranger = scene.proof(&block, &[1, 3]);
    stranger.certificate.signatures.push(Signature { node: u64::MAX, ..stranger.certificate.signatures[1].clone() });
    ways.good("a node signs that nobody knows: it counts for nothing", "genesis", vec![step(&[], stranger.to_bytes())]);

    // What was signed is this statement of this network, and nothing else.
    let mut elsewhere = block;
    elsewhere.network = Hash([9; 32]);
    let why = "the statement is about a block of another network";
    let proof = scene.proof(&elsewhere, &[1, 3]).to_bytes();
    ways.refused("another network", (Code::WrongNetwork, why), "genesis", vec![step(&[], proof)]);
    type Change = fn(&mut Statement);
    let others: [(&str, Change); 5] = [
        ("a signature of another network", |said| said.network = Hash([9; 32])),
        ("a signature after another number of forced recoveries", |said| said.recoveries += 1),
        ("a signature of another height", |said| said.height += 1),
        ("a signature of another block time", |said| said.time += 1),
        ("a signature of another block", |said| said.block = Hash([9; 32])),
    ];
    for (name, change) in others {
        let mut said = block.statement();
        change(&mut said);
        let proof = block.proof(scene.sign(&said, &[1, 3])).to_bytes();
        let why = "the statement below which it stands is not the one that was signed";
        ways.refused(name, (Code::BadSignature, why), "genesis", vec![step(&[], proof)]);
    }
    let vote = |voter: u64| {
        let User { key, certificate } = &scene.world.nodes[voter as usize - 1];
        Vote { network: scene.network, recoveries: 0, term: 5, candidate: 1, voter }
            .sign(certificate.clone(), key)
            .unwrap()
    };
    let proof = block.proof(vec![vote(1), vote(3)]).to_bytes();
    let why = "votes are signed with other first bytes than statements";
    ways.refused("signatures of votes", (Code::BadSignature, why), "genesis", vec![step(&[], proof)]);
}

/// The form of the bytes.
fn forms(ways: &mut Ways, scene: &Scene) {
    let block = scene.block(5, &[]);
    let good = scene.proof(&block, &[1, 2, 3]);
    let mut malformed = |name: &str, why: &str, bytes: &[u8]| {
        ways.refused(name, (Code::Malformed, why), "genesis", vec![step(&[], bytes)]);
    };
    let signed = |order: &[usize]| {
        let mut proof = good.clone();
        proof.certificate.signatures = order.iter().map(|at| good.certificate.signatures[*at].clone()).collect();
        proof.to_bytes()
    };
    malformed("one voter twice", "each node signs once", &signed(&[0, 0, 2]));
    malformed("signatures out of order", "nodes stand in ascending order", &signed(&[2, 0]));
    let mut nobody = good.clone();
    nobody.certificate.signatures.insert(0, Signature { node: 0, ..good.certificate.signatures[0].clone() });
    malformed("a signature of node 0", "nodes are counted from 1", &nobody.to_bytes());
    let mut many = good.clone();
    let empty = |node| Signature { node, certificate: Bytes::new(), signature: Bytes::new() };
    many.certificate.signatures.extend((4..=129).map(empty));
    malformed("129 signatures", "at most 128 are read", &many.to_bytes());
    let mut many = good.clone();
    many.facts.extend(std::iter::repeat_n(good.facts[0].clone(), 64));
    malformed("65 facts", "at most 64 are read", &many.to_bytes());

    let bytes = good.to_bytes();
    malformed("a byte behind the proof", "nothing stands behind the end", &[&bytes[..], &[0]].concat());
    malformed("a proof without its last byte", "the last path is too short", &bytes[..bytes.len() - 1]);
    malformed("nothing", "there is no proof", &[]);
    // The certificate begins behind 17 first bytes and its length.
    let inner = |certificate: &[u8]| {
        let rest = &bytes[21 + good.certificate.to_bytes().len()..];
        [&bytes[..17], &(certificate.len() as u32).to_be_bytes(), certificate, rest].concat()
    };
    let certificate = good.certificate.to_bytes();
    malformed(
        "a byte behind the certificate",
        "nothing stands behind the end",
        &inner(&[&certificate[..], &[0]].concat()),
    );
    let other = |at: usize, byte: u8| {
        let mut changed = certificate.to_vec();
        changed[at] = byte;
        inner(&changed)
    };
    malformed("a certificate of version 2", "only version 1 is known", &other(21, b'2'));
    malformed("a statement of version 2", "only version 1 is known", &other(23 + 19, b'2'));
    let mut statement = block.statement().to_bytes();
    statement[19] = b'2';
    let mut signed = good.certificate.clone();
    for signature in &mut signed.signatures {
        let signed = [&statement[..], &signature.node.to_be_bytes()].concat();
        signature.signature = scene.world.nodes[signature.node as usize - 1].key.sign(&signed).into();
    }
    let signed = signed.to_bytes();
    let signed = [&signed[..23], &statement, &signed[23 + statement.len()..]].concat();
    malformed("a signed statement of version 2", "only version 1 is known", &inner(&signed));
    malformed(
        "a length beyond the end",
        "the certificate of the first node is not so long",
        &other(23 + 133 + 4 + 8, 0xff),
    );
    malformed("a proof of version 2", "only version 1 is known", &{
        let mut changed = bytes.to_vec();
        changed[15] = b'2';
        changed
    });
}

/// The way from a fact to the results root.
fn paths(ways: &mut Ways, scene: &Scene) {
    for (leaves, shown) in
        [(1, &[0][..]), (2, &[0, 1]), (3, &[0, 1, 2]), (5, &[0, 4, 3]), (6, &[0, 2, 5]), (7, &[0, 6])]
    {
        let block = Block { leaves, ..scene.block(5, &[]) };
        let proof = Proof { facts: block.shown(shown), ..scene.proof(&block, &[1, 3]) };
        ways.good(&format!("facts of a block of {leaves} leaves"), "genesis", vec![step(&[], proof.to_bytes())]);
    }
    let block = Block { leaves: 7, ..scene.block(5, &[]) };
    let good = Proof { facts: block.shown(&[0, 2]), ..scene.proof(&block, &[1, 3]) };
    let with = |change: &dyn Fn(&mut Vec<Shown>)| {
        let mut changed = good.clone();
        change(&mut changed.facts);
        vec![step(&[], changed.to_bytes())]
    };
    type Change = fn(&mut Path);
    let wrong: [(&str, Code, &str, Change); 8] = [
        ("another hash in a path", Code::Untrusted, "it leads to another root", |path| path.siblings[1] = Hash::ZERO),
        ("a path of the leaf beside", Code::Untrusted, "it leads to another root", |path| path.index = 3),
        ("a path in a smaller tree", Code::Untrusted, "it has more hashes than the tree is high", |path| {
            path.count = 4
        }),
        ("a path in a higher tree", Code::Untrusted, "it has fewer hashes than the tree is high", |path| {
            path.count = 9
        }),
        ("a path that is too short", Code::Untrusted, "it ends below the root", |path| path.siblings.truncate(1)),
        ("a path that is too long", Code::Untrusted, "a hash is left", |path| path.siblings.push(Hash::ZERO)),
        ("a leaf beyond the tree", Code::Malformed, "leaves are counted from 0", |path| path.index = path.count),
        ("a tree without leaves", Code::Malformed, "it has no leaf", |path| (path.index, path.count) = (0, 0)),
    ];
    for (name, code, why, change) in wrong {
        ways.refused(name, (code, why), "genesis", with(&|facts| change(&mut facts[1].path)));
        // The ground that is not the first leaf is another vector.
        if code == Code::Untrusted && name != "a path of the leaf beside" {
            let name = format!("{name}, of the ground");
            ways.refused(&name, (code, why), "genesis", with(&|facts| change(&mut facts[0].path)));
        }
    }
    let other = Fact::Verdict { index: 1, id: Hash::ZERO, code: 0, response: Hash::ZERO };
    let why = "voters have signed no such fact";
    let made_up = with(&|facts| facts[1].fact = other.to_bytes().into());
    ways.refused("a fact that is made up", (Code::Untrusted, why), "genesis", made_up);
    let later = Block { governing: Hash::ZERO, ..block };
    let elsewhere = with(&|facts| facts[0] = later.shown(&[0])[0].clone());
    let why = "voters have signed another ground";
    ways.refused("the ground of another block", (Code::Untrusted, why), "genesis", elsewhere);
    let why = "the ground is the first fact";
    ways.refused(
        "a verdict instead of the ground",
        (Code::Malformed, why),
        "genesis",
        with(&|facts| drop(facts.remove(0))),
    );
    ways.refused("the ground behind another fact", (Code::Malformed, why), "genesis", with(&|facts| facts.reverse()));
    ways.refused("no fact", (Code::Malformed, why), "genesis", with(&Vec::clear));
    let beside = |first: &[u8], second: &[u8]| {
        let leaves = [first, second].map(|fact| Hash::of(&[&[0], fact]));
        let shown =
            |at: u32, fact: &[u8]| Shown { fact: Bytes::copy_from_slice(fact), path: Path::new(&leaves, at).unwrap() };
        let said = Statement { results: merkle::root(leaves.to_vec()), ..block.statement() };
        let mut proof = block.proof(scene.sign(&said, &[1, 3]));
        proof.certificate.statement = said;
        proof.facts = vec![shown(0, first), shown(1, second)];
        vec![step(&[], proof.to_bytes())]
    };
    let ground = block.fact(0).to_bytes();
    // Its bytes are the governing chain where the ground has it.
    let (head, tail) = block.governing.0.split_at(4);
    let id = Hash([tail, &[0; 4]].concat().try_into().unwrap());
    let index = u32::from_be_bytes(head.try_into().unwrap());
    let posing = Fact::Verdict { index, id, code: 0, response: Hash::ZERO }.to_bytes();
    let second = |mut steps: Vec<Value>| {
        let mut proof = Proof::from_bytes(&hex::decode(steps[0]["proof"].as_str().unwrap()).unwrap()).unwrap();
        proof.facts.remove(0);
        steps[0]["proof"] = hex::encode(proof.to_bytes()).into();
        steps
    };
    let posing = second(beside(&ground, &posing));
    ways.refused("a verdict whose bytes pose as the ground", (Code::Malformed, why), "genesis", posing);
    let unknown = [b"ledgerd fact v1\0".as_slice(), &[5]].concat();
    let why = "kinds are 1 to 4";
    ways.refused("a fact of an unknown kind", (Code::Malformed, why), "genesis", beside(&ground, &unknown));
    let why = "the ground is the first leaf of its block";
    let misplaced = second(beside(&other.to_bytes(), &ground));
    ways.refused("a ground that is the second leaf", (Code::Malformed, why), "genesis", misplaced);
}
