//! Ways over changes of who governs.

use crate::scenes::{Block, Scene, Ways, change, members, node, organisation, step};
use crate::world::NOW;
use bytes::Bytes;
use ledger_base::rejection::Code;
use ledger_identity::key::KeyKind;
use ledger_light::Change;
use serde_json::{Value, json};
use testkit::Ca;

/// The changes of who governs.
pub(super) fn chains(ways: &mut Ways, scene: &Scene) {
    let moved = change(5, vec![node(4, ["Org2", "node4"], "learner"), ("revoked/x".into(), Some("{}".into()))]);
    let again = change(7, vec![("revoked/x".into(), None), ("rules".into(), Some("[]".into()))]);
    let proof = scene.proof(&scene.block(8, &[&moved, &again]), &[1, 3]).to_bytes();
    let shown = |changes: &[&Change]| vec![step(changes, &proof)];
    ways.good("two changes, and a block after them", "genesis", shown(&[&moved, &again]));
    let beyond = change(9, vec![("node/4".into(), None)]);
    ways.good("changes after the block wait", "genesis", shown(&[&moved, &again, &beyond]));
    let at_once = scene.proof(&scene.block(7, &[&moved, &again]), &[1, 3]).to_bytes();
    ways.good("the block of the last change", "genesis", vec![step(&[&moved, &again], &at_once)]);
    ways.good("the same block twice", "genesis", [shown(&[&moved, &again]), shown(&[])].concat());
    let unchanged = scene.proof(&scene.block(4, &[]), &[1, 3]).to_bytes();
    ways.good("a block before the changes", "genesis", vec![step(&[&moved, &again], &unchanged)]);

    let forced = change(5, vec![("recovery/00000000000000000005".into(), Some("{}".into()))]);
    for (name, recoveries, height, why) in [
        ("the block of a forced recovery", 0, 5, None),
        ("a block after a forced recovery", 1, 8, None),
        (
            "a block after a forced recovery, signed as if there had been none",
            0,
            8,
            Some("the records count one forced recovery"),
        ),
        (
            "a block after a forced recovery, signed as if there had been two",
            2,
            8,
            Some("the records count one forced recovery"),
        ),
    ] {
        let block = Block { recoveries, ..scene.block(height, &[&forced]) };
        let at_recovery = step(&[&forced], scene.proof(&scene.block(5, &[&forced]), &[1, 3]).to_bytes());
        let proof = scene.proof(&block, &[1, 3]).to_bytes();
        let steps = if height > 5 { vec![at_recovery, step(&[], proof)] } else { vec![step(&[&forced], proof)] };
        match why {
            None => ways.good(name, "genesis", steps),
            Some(why) => ways.refused(name, (Code::Untrusted, why), "genesis", steps),
        }
    }

    let at = |height: u64, of: &Change| Change { height, ..of.clone() };
    let without_value = change(5, vec![node(4, ["Org2", "node4"], "learner"), ("revoked/x".into(), None)]);
    let other_value = change(5, vec![node(4, ["Org2", "node4"], "voter"), ("revoked/x".into(), Some("{}".into()))]);
    let left_out = change(5, vec![node(4, ["Org2", "node4"], "learner")]);
    for (name, changes) in [
        ("all changes are left out", &[][..]),
        ("the first change is left out", &[&again]),
        ("the last change is left out", &[&moved]),
        ("a change at another height", &[&at(6, &moved), &again]),
        ("a change is shown twice", &[&moved, &at(6, &moved), &again]),
        ("a change is made up", &[&moved, &at(6, &beyond), &again]),
        ("a write of a change is left out", &[&left_out, &again]),
        ("a value of a change is another one", &[&other_value, &again]),
        ("a value of a change is left out", &[&without_value, &again]),
    ] {
        let why = "the governing chain in the ground is another one";
        ways.refused(name, (Code::Untrusted, why), "genesis", shown(changes));
    }
    let older = vec![shown(&[&moved, &again]).remove(0), step(&[], &unchanged)];
    let why = "the proof is older than what the reader knows";
    ways.refused("an older block", (Code::Untrusted, why), "genesis", older);
    let at = |height| step(&[], scene.proof(&scene.block(height, &[]), &[1, 3]).to_bytes());
    ways.refused("an older block with the same voters", (Code::Untrusted, why), "genesis", vec![at(8), at(7)]);

    let written = |bytes: &[u8]| {
        let mut first = shown(&[&moved, &again]);
        first[0]["changes"][0]["writes"] = hex::encode(bytes).into();
        first
    };
    let bytes = moved.to_bytes();
    let mut backwards = moved.clone();
    backwards.writes.reverse();
    let twice = Change { height: 5, writes: [&moved.writes[..1], &moved.writes[..]].concat() };
    let mut mark = bytes.to_vec();
    mark[28 + 4 + 4 + moved.writes[0].0.len()] = 2;
    for (name, why, bytes) in [
        ("writes out of order", "keys stand in ascending order", &backwards.to_bytes()[..]),
        ("one key twice", "each key stands once", &twice.to_bytes()),
        ("a byte behind the writes", "nothing stands behind the end", &[&bytes[..], &[0]].concat()),
        ("writes without their last byte", "the last value is too short", &bytes[..bytes.len() - 1]),
        ("a mark that is neither 0 nor 1", "0 is a deleted key, 1 a value", &mark),
    ] {
        ways.refused(name, (Code::Malformed, why), "genesis", written(bytes));
    }
    let lost = change(5, vec![("members".into(), None)]);
    let proof = scene.proof(&scene.block(8, &[&lost]), &[1, 2, 3]).to_bytes();
    let why = "nobody votes any more";
    ways.refused("a change deletes the members", (Code::Malformed, why), "genesis", vec![step(&[&lost], proof)]);
}

/// Organisations, and certificates that they revoke.
pub(super) fn organisations(ways: &mut Ways, scene: &Scene) {
    let root = scene.world.cas[1].root();
    let shared = change(5, vec![organisation("Org3", &root)]);
    let proof = scene.proof(&scene.block(8, &[&shared]), &[1, 2, 3]).to_bytes();
    let why = "nobody can tell for which of two organisations one authority speaks";
    ways.refused(
        "two organisations share an authority",
        (Code::CertificateMalformed, why),
        "genesis",
        vec![step(&[&shared], proof)],
    );

    // Revoked.
    let revoke = |node: usize| {
        let identity = scene.world.identify(&scene.world.nodes[node - 1].certificate, NOW).unwrap();
        let key = [&b"msp\0revoked/"[..], &identity.revocation_key()].concat().into();
        Change { height: 3, writes: vec![(key, Some(Bytes::from_static(b"{}")))] }
    };
    let revoked = revoke(1);
    let by = |nodes: &[u64]| vec![step(&[&revoked], scene.proof(&scene.block(8, &[&revoked]), nodes).to_bytes())];
    ways.good("a revoked certificate beside enough others", "genesis", by(&[1, 2, 3]));
    ways.refused(
        "a revoked certificate",
        (Code::Revoked, "node 1 signs with a revoked certificate"),
        "genesis",
        by(&[1, 3]),
    );
    let at_its_block = |nodes| vec![step(&[&revoked], scene.proof(&scene.block(3, &[&revoked]), nodes).to_bytes())];
    ways.good("the block that revokes is signed by those before it", "genesis", at_its_block(&[1, 3]));

    for (name, root) in [
        ("an organisation comes, and its voter signs below an intermediate authority", Ca::new("Org3 root")),
        ("as many authorities as a root allows", Ca::above("Org3 root", 1)),
    ] {
        ways.good(name, "genesis", arrival(scene, &root));
    }
    let why = "the root allows no authority between it and a signer";
    let steps = arrival(scene, &Ca::above("Org3 root", 0));
    ways.refused("more authorities than a root allows", (Code::Untrusted, why), "genesis", steps);
}

/// Org3 comes with an authority below this root, and with a node that votes. Then this node and one other sign a block.
fn arrival(scene: &Scene, root: &Ca) -> Vec<Value> {
    let below = root.below("Org3 CA");
    let record =
        json!({"name": "Org3", "roots": [hex::encode(root.root())], "intermediates": [hex::encode(below.root())]});
    let record = ("organisation/Org3".to_owned(), Some(record.to_string().into()));
    let comes = change(5, vec![record, node(5, ["Org3", "node5"], "voter"), members(&[1, 3, 5], &[])]);
    let later = scene.block(9, &[&comes]);
    let user = below.user("node5", "node", KeyKind::P256);
    let mut signatures = scene.sign(&later.statement(), &[1]);
    signatures.push(later.statement().sign(5, user.certificate, &user.key).unwrap().signature);
    let first = step(&[&comes], scene.proof(&scene.block(5, &[&comes]), &[1, 3]).to_bytes());
    vec![first, step(&[], later.proof(signatures).to_bytes())]
}

/// Voters hand over to others.
pub(super) fn hand_over(ways: &mut Ways, scene: &Scene) {
    let joint = change(4, vec![members(&[2, 4], &[1, 3])]);
    let left = change(6, vec![members(&[2, 4], &[])]);
    let both = [&joint, &left];
    let proof = |height: u64, changes: &[&Change], nodes: &[u64]| {
        step(&both, scene.proof(&scene.block(height, changes), nodes).to_bytes())
    };
    let (first, second) = (proof(4, &both[..1], &[1, 3]), proof(6, &both, &[1, 2, 3, 4]));
    let alone = proof(9, &both, &[2, 4]);
    ways.good("voters hand over step by step", "two voters", vec![first.clone(), second, alone.clone()]);
    ways.good("voters hand over in one step", "two voters", vec![proof(9, &both, &[1, 2, 3, 4])]);
    let why = "none of the voters that the reader believes has signed";
    ways.refused("new voters alone", (Code::Untrusted, why), "two voters", vec![alone.clone()]);
    let why = "the new voters have not signed";
    ways.refused("earlier voters alone", (Code::Untrusted, why), "two voters", vec![proof(9, &both, &[1, 3])]);
    let why = "while voters change, more than half of the outgoing ones must sign, too";
    ways.refused(
        "new voters alone while they change",
        (Code::Untrusted, why),
        "two voters",
        vec![first.clone(), alone],
    );
    let why = "while voters change, more than half of the new ones must sign, too";
    let outgoing = proof(5, &both[..1], &[1, 3]);
    ways.refused(
        "outgoing voters alone while they change",
        (Code::Untrusted, why),
        "two voters",
        vec![first, outgoing],
    );
}
