//! Ways that begin at a checkpoint.

use crate::scenes::{Scene, Ways, change, members, node, step};
use crate::world::NOW;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_light::proof::Proof;
use ledger_light::{Change, Checkpoint, Governance};
use serde_json::json;
use std::collections::BTreeMap;

/// Where a reader goes on later.
pub(super) fn checkpoints(ways: &mut Ways, scene: &Scene) {
    let moved = change(5, vec![node(4, ["Org2", "node4"], "learner")]);
    let begun = Governance::founded(scene.network, NOW, &scene.genesis).unwrap();
    let proof = scene.proof(&scene.block(8, &[&moved]), &[1, 3]);
    let governance = begun.follow(std::slice::from_ref(&moved), &proof).unwrap();
    let good = Checkpoint { governance, proof };
    let mut add = |name: &str, network: Hash, bytes: &[u8]| {
        let begin = json!({"network": network, "checkpoint": hex::encode(bytes)});
        ways.beginnings.insert(name.to_owned(), begin);
    };
    let bytes = good.to_bytes();
    add("checkpoint", scene.network, &bytes);
    add("a checkpoint of another network", Hash([9; 32]), &bytes);
    add("a byte behind a checkpoint", scene.network, &[&bytes[..], &[0]].concat());
    add("a checkpoint without its last byte", scene.network, &bytes[..bytes.len() - 1]);
    let with = |proof: Proof| Checkpoint { proof, ..good.clone() }.to_bytes();
    add("a checkpoint that one voter has signed", scene.network, &with(scene.proof(&scene.block(8, &[&moved]), &[1])));
    let mut path = good.proof.clone();
    path.facts[0].path.siblings[0] = Hash::ZERO;
    add("a checkpoint whose path leads elsewhere", scene.network, &with(path));
    // The length of the values, then their first bytes, their number, and the values.
    let values =
        begun.follow(std::slice::from_ref(&moved), &good.proof).map(|_| all(&[&scene.genesis, &moved])).unwrap();
    let part = |part: &[u8]| [&(part.len() as u32).to_be_bytes(), part].concat();
    let of_bytes =
        |values: &[u8]| [b"ledgerd checkpoint v1\0".to_vec(), part(values), part(&good.proof.to_bytes())].concat();
    let written = |writes: &[(Bytes, Option<Bytes>)]| Change { height: 8, writes: writes.to_vec() }.to_bytes();
    let of = |writes: &[(Bytes, Option<Bytes>)]| of_bytes(&written(writes));
    assert_eq!(of(&values), bytes);
    let mut backwards = values.clone();
    backwards.reverse();
    add("a checkpoint out of order", scene.network, &of(&backwards));
    let deleted = [&[(Bytes::from_static(b"msp\0gone"), None)], &values[..]].concat();
    add("a checkpoint with a deleted key", scene.network, &of(&deleted));
    let cut = written(&values);
    add("a checkpoint whose last value is too short", scene.network, &of_bytes(&cut[..cut.len() - 1]));

    for (name, code, why) in [
        ("a checkpoint of another network", Code::WrongNetwork, "its block is of another network"),
        ("a byte behind a checkpoint", Code::Malformed, "nothing stands behind the end"),
        ("a checkpoint without its last byte", Code::Malformed, "the proof is too short"),
        ("a checkpoint that one voter has signed", Code::Untrusted, "more than half of its voters must sign"),
        ("a checkpoint whose path leads elsewhere", Code::Untrusted, "its ground is not one of its block"),
        ("a checkpoint out of order", Code::Malformed, "keys stand in ascending order"),
        ("a checkpoint with a deleted key", Code::Malformed, "a checkpoint holds values"),
        ("a checkpoint whose last value is too short", Code::Malformed, "its length is that of another value"),
    ] {
        ways.refused(name, (code, why), name, Vec::new());
    }
    ways.good("a checkpoint", "checkpoint", Vec::new());
    let on = |changes: &[&Change], nodes: &[u64]| {
        let all = [&[&moved], changes].concat();
        vec![step(changes, scene.proof(&scene.block(20, &all), nodes).to_bytes())]
    };
    ways.good("a block after a checkpoint", "checkpoint", on(&[], &[2, 3]));
    let voters = change(12, vec![members(&[1, 3, 4], &[])]);
    ways.good("a change after a checkpoint", "checkpoint", on(&[&voters], &[1, 3]));
    let why = "node 2 does not vote any more, nor does node 4 by the checkpoint";
    ways.refused(
        "too few of both sets after a checkpoint",
        (Code::Untrusted, why),
        "checkpoint",
        on(&[&voters], &[2, 4]),
    );
}

/// All values after these changes, in order of keys.
fn all(changes: &[&Change]) -> Vec<(Bytes, Option<Bytes>)> {
    let mut state = BTreeMap::new();
    changes.iter().for_each(|change| state.extend(change.writes.iter().cloned()));
    state.into_iter().filter(|(_, value)| value.is_some()).collect()
}
