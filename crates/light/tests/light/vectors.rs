//! Test vectors for programs in other languages: `tests/fixtures/certified.json`. Hashes and bytes are in hexadecimal.
//!
//! With `STORE_CERTIFIED=1` the file is made if it is not there. It is never made anew: the formats have a version.

use crate::scenes::{Ways, change, members as members_record, node};
use crate::sworn::{faults, lies, votes};
use crate::world::{NETWORK, NOW, World, name, statement};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_identity::msp::{Msp, Msps};
use ledger_light::control::{self, Write};
use ledger_light::fact::Fact;
use ledger_light::merkle::{self, Path};
use ledger_light::{Certificate, CertificateRule, Change, Statement, Voter, Voters};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::sync::OnceLock;

pub(crate) fn file() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../tests/fixtures/certified.json")
}

/// Read once, since they may have to be made.
pub(crate) fn vectors() -> &'static Value {
    static VECTORS: OnceLock<Value> = OnceLock::new();
    VECTORS.get_or_init(|| {
        if std::env::var_os("STORE_CERTIFIED").is_some() && !file().exists() {
            std::fs::write(file(), serde_json::to_string_pretty(&made()).unwrap() + "\n").unwrap();
        }
        serde_json::from_slice(&std::fs::read(file()).unwrap()).unwrap()
    })
}

pub(crate) fn text<'a>(value: &'a Value, field: &str) -> &'a str {
    value[field].as_str().unwrap_or_else(|| panic!("no text {field} in {value}"))
}

pub(crate) fn number(value: &Value, field: &str) -> u64 {
    value[field].as_u64().unwrap_or_else(|| panic!("no number {field} in {value}"))
}

pub(crate) fn hash(value: &Value, field: &str) -> Hash {
    Hash::from_hex(text(value, field)).unwrap()
}

pub(crate) fn bytes(value: &Value, field: &str) -> Vec<u8> {
    hex::decode(text(value, field)).unwrap()
}

/// The fact that one vector describes.
fn fact(value: &Value) -> Fact<'_> {
    let index = |value: &Value| u32::try_from(number(value, "index")).unwrap();
    match text(value, "kind") {
        "ground" => Fact::Ground {
            governing: hash(value, "governing"),
            control: hash(value, "control"),
            digest: hash(value, "digest"),
            previous: hash(value, "previous"),
        },
        "verdict" => Fact::Verdict {
            index: index(value),
            id: hash(value, "id"),
            code: u32::try_from(number(value, "code")).unwrap(),
            response: hash(value, "response_hash"),
        },
        "event" => Fact::Event {
            index: (!value["index"].is_null()).then(|| index(value)),
            chaincode: text(value, "chaincode"),
            name: text(value, "name"),
            subject: text(value, "subject"),
            payload: hash(value, "payload_hash"),
        },
        _ => Fact::Control {
            key: text(value, "key").as_bytes(),
            value: (!value["value_hash"].is_null()).then(|| hash(value, "value_hash")),
        },
    }
}

/// The vector of a fact, without its bytes.
pub(crate) fn fact_json(fact: &Fact<'_>) -> Value {
    match fact {
        Fact::Ground { governing, control, digest, previous } => {
            json!({"kind": "ground", "governing": governing, "control": control, "digest": digest, "previous": previous})
        }
        Fact::Verdict { index, id, code, response } => {
            json!({"kind": "verdict", "index": index, "id": id, "code": code, "response_hash": response})
        }
        Fact::Event { index, chaincode, name, subject, payload } => {
            json!({"kind": "event", "index": index, "chaincode": chaincode, "name": name, "subject": subject,
                   "payload_hash": payload})
        }
        Fact::Control { key, value } => {
            json!({"kind": "control", "key": std::str::from_utf8(key).unwrap(), "value_hash": value})
        }
    }
}

pub(crate) fn given(value: &Value) -> Statement {
    let [network, block, results] = ["network", "block", "results"].map(|field| hash(value, field));
    let [recoveries, height, time] = ["recoveries", "height", "time"].map(|field| number(value, field));
    Statement { network, recoveries, height, time, block, results }
}

#[test]
fn facts_paths_and_roots_are_those_of_the_vectors() {
    let vectors = vectors();
    let facts = vectors["facts"].as_array().unwrap();
    assert!(facts.len() > 6);
    let mut leaves = Vec::new();
    for vector in facts {
        let (fact, wanted) = (fact(vector), bytes(vector, "bytes"));
        assert_eq!(hex::encode(fact.to_bytes()), hex::encode(&wanted), "{vector}");
        assert_eq!(Fact::from_bytes(&wanted).unwrap(), fact);
        let shown = fact_json(&fact);
        assert!(shown.as_object().unwrap().iter().all(|(field, value)| vector[field] == *value), "{vector}");
        assert_eq!(fact.leaf(), hash(vector, "leaf"), "{vector}");
        leaves.push(fact.leaf());
    }
    let root = hash(vectors, "root");
    assert_eq!(merkle::root(leaves.clone()), root);
    for (vector, leaf) in facts.iter().zip(&leaves) {
        assert!(Path::from_bytes(&bytes(vector, "path")).unwrap().leads(*leaf, root), "{vector}");
    }
}

#[test]
fn roots_and_paths_of_trees_are_those_of_the_vectors() {
    let vectors = vectors();
    let trees = vectors["trees"].as_array().unwrap();
    assert!(trees.len() > 6);
    for tree in trees {
        let root = hash(tree, "root");
        let leaves = tree["leaves"].as_array().unwrap().iter();
        let leaves: Vec<Hash> = leaves.map(|leaf| Hash::from_hex(leaf.as_str().unwrap()).unwrap()).collect();
        assert_eq!(merkle::root(leaves.clone()), root);
        for (index, path) in (0..).zip(tree["paths"].as_array().unwrap()) {
            let path = Path::from_bytes(&hex::decode(path.as_str().unwrap()).unwrap()).unwrap();
            assert_eq!(Path::new(&leaves, index).as_ref(), Some(&path));
            for (other, leaf) in (0..).zip(&leaves) {
                assert_eq!(path.leads(*leaf, root), other == index, "{other} as {index}");
            }
        }
        assert_eq!(tree["paths"].as_array().unwrap().len(), leaves.len());
    }
}

#[test]
fn the_governing_chain_is_that_of_the_vectors() {
    let vectors = vectors();
    let mut chain = Hash::ZERO;
    for block in vectors["governing_chain"].as_array().unwrap() {
        let change = Change::from_bytes(number(block, "height"), &bytes(block, "writes")).unwrap();
        assert_eq!(hex::encode(change.to_bytes()), text(block, "writes"));
        chain = change.extend(chain).unwrap();
        assert_eq!(chain, hash(block, "chain"), "{block}");
    }
    assert_ne!(chain, Hash::ZERO);
}

#[test]
fn the_control_chain_is_that_of_the_vectors() {
    let vectors = vectors();
    let mut chain = Hash::ZERO;
    for block in vectors["control_chain"].as_array().unwrap() {
        let writes: Vec<_> = block["writes"].as_array().unwrap().iter().map(fact).collect();
        let writes = writes.iter().map(|fact| match fact {
            Fact::Control { key, value } => Write { key, value: *value },
            other => panic!("{other:?} is no write"),
        });
        chain = control::extend(chain, number(block, "height"), &writes.collect::<Vec<_>>()).unwrap();
        assert_eq!(chain, hash(block, "chain"), "{block}");
    }
    assert_ne!(chain, Hash::ZERO);
}

/// The nodes and the authorities of the vectors that are no ways.
pub(crate) fn members(vectors: &Value) -> (Voters, Msps) {
    let nodes = vectors["nodes"].as_array().unwrap().iter().map(|node| {
        let [organisation, name] = ["organisation", "name"].map(|field| text(node, field).to_owned());
        (number(node, "id"), Voter { organisation, name })
    });
    let mut msps = Msps::new();
    for organisation in vectors["organisations"].as_array().unwrap() {
        let none: [Vec<u8>; 0] = [];
        msps.insert(Msp::new(text(organisation, "name"), &[bytes(organisation, "root")], &none).unwrap()).unwrap();
    }
    (
        Voters {
            nodes: nodes.collect(),
            voters: [1, 2, 3].into(),
            outgoing: [].into(),
            rule: CertificateRule::default(),
            recoveries: 0,
        },
        msps,
    )
}

#[test]
fn statements_and_certificates_are_those_of_the_vectors() {
    let vectors = vectors();
    let statement = given(&vectors["statement"]);
    assert_eq!(hex::encode(statement.to_bytes()), text(&vectors["statement"], "bytes"));

    let (voters, msps) = members(vectors);
    let identify = |der: &[u8], time: u64| msps.verify(der, &[], time).map_err(Rejection::from);
    let certificate = Certificate::from_bytes(&bytes(vectors, "certificate")).unwrap();
    assert_eq!(certificate.statement, statement);
    certificate.verify(&statement.network, &voters, identify).unwrap();
    let few = Certificate::from_bytes(&bytes(vectors, "certificate_of_one_organisation")).unwrap();
    assert!(few.verify(&statement.network, &voters, identify).is_err());
}

/// Changes of who governs, and the chain over them.
fn governing_chain() -> Vec<Value> {
    let gone = ("node/00000000000000000004".to_owned(), None);
    let changes = [
        change(0, vec![members_record(&[1, 2, 3], &[]), node(4, name(4), "learner")]),
        change(3, vec![]),
        change(5, vec![members_record(&[1, 3], &[1, 2, 3])]),
        change(6, vec![gone, members_record(&[1, 3], &[])]),
    ];
    let mut chain = Hash::ZERO;
    let extend = |change: &Change| {
        chain = change.extend(chain).unwrap();
        json!({"height": change.height, "writes": hex::encode(change.to_bytes()), "chain": chain})
    };
    changes.iter().map(extend).collect()
}

/// The content of the file.
fn made() -> Value {
    let world = World::new();
    let said = Statement { network: NETWORK, height: 5, time: NOW, ..statement(5) };
    let inputs = [
        json!({"kind": "ground", "governing": Hash([6; 32]), "control": Hash([1; 32]), "digest": Hash([2; 32]),
               "previous": Hash([3; 32])}),
        json!({"kind": "verdict", "index": 0, "id": Hash([4; 32]), "code": 0, "response_hash": Hash::of(&[b"done"])}),
        json!({"kind": "verdict", "index": 1, "id": Hash([5; 32]), "code": 3001, "response_hash": Hash::of(&[b""])}),
        json!({"kind": "event", "index": null, "chaincode": "abac", "name": "released", "subject": "Turtlebot4/cmd_vel",
               "payload_hash": Hash::of(&[b"{}"])}),
        json!({"kind": "event", "index": 1, "chaincode": "note", "name": "größer", "subject": "",
               "payload_hash": Hash::of(&[b""])}),
        json!({"kind": "control", "key": "abac\0grant/Turtlebot4/cmd_vel\0Org1/Salma", "value_hash": null}),
        json!({"kind": "control", "key": "msp\0members", "value_hash": Hash::of(&[b"{\"voters\":[1]}"])}),
    ];
    let leaves: Vec<Hash> = inputs.iter().map(|input| fact(input).leaf()).collect();
    let facts = (0..).zip(&inputs).map(|(index, input)| {
        let mut vector = input.clone();
        vector["bytes"] = hex::encode(fact(input).to_bytes()).into();
        vector["leaf"] = json!(leaves[index as usize]);
        vector["path"] = hex::encode(Path::new(&leaves, index).unwrap().to_bytes()).into();
        vector
    });
    let writes = |input: &Value| match fact(input) {
        Fact::Control { key, value } => (key.to_vec(), value),
        other => panic!("{other:?} is no write"),
    };
    let mut chain = Hash::ZERO;
    let mut follow = |height: u64, of: &[Value]| {
        let owned: Vec<_> = of.iter().map(writes).collect();
        let writes: Vec<_> = owned.iter().map(|(key, value)| Write { key, value: *value }).collect();
        chain = control::extend(chain, height, &writes).unwrap();
        json!({"height": height, "writes": of, "chain": chain})
    };
    let control_chain = [follow(0, &inputs[6..]), follow(1, &[]), follow(5, &inputs[5..])];
    let nodes: Vec<_> = (1..=4).map(|id| json!({"id": id, "organisation": name(id)[0], "name": name(id)[1]})).collect();
    let roots = world.cas.iter().zip(["Org1", "Org2"]);
    let trees = [0, 1, 2, 3, 5, 6, 7, 13].map(|count: u32| {
        let leaves: Vec<Hash> = (0..count).map(|number| Hash::of(&[&number.to_be_bytes()])).collect();
        let path = |index| hex::encode(Path::new(&leaves, index).unwrap().to_bytes());
        let paths: Vec<_> = (0..count).map(path).collect();
        json!({"root": merkle::root(leaves.clone()), "leaves": leaves, "paths": paths})
    });
    let Ways { beginnings, ways } = crate::made::made();
    json!({
        "about": "docs/format.md, Certified blocks; hashes and bytes in hexadecimal, keys as text",
        "trees": trees,
        "governing_chain": governing_chain(),
        "votes": votes(&world),
        "lies": lies(&world, said),
        "faults": faults(&world, said),
        "beginnings": beginnings,
        "ways": ways,
        "facts": facts.collect::<Vec<_>>(),
        "root": merkle::root(leaves.clone()),
        "control_chain": control_chain,
        "statement": {"network": said.network, "recoveries": said.recoveries, "height": said.height, "time": said.time,
                      "block": said.block, "results": said.results, "bytes": hex::encode(said.to_bytes())},
        "organisations": roots.map(|(ca, name)| json!({"name": name, "root": hex::encode(ca.root())})).collect::<Vec<_>>(),
        "nodes": nodes,
        "voters": [1, 2, 3],
        "time": NOW,
        "certificate": hex::encode(world.certificate(said, &[1, 3]).to_bytes()),
        "certificate_of_one_organisation": hex::encode(world.certificate(said, &[1, 2]).to_bytes()),
    })
}
