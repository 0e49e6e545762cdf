//! What the targets share: here the networks of the vectors, as readers know them that have only just begun.

#![expect(clippy::expect_used, clippy::indexing_slicing, reason = "a fuzz target stops at the first surprise")]

pub mod dds;
pub mod files;
pub mod fleet;
pub mod messages;

use ledger_base::hash::Hash;
use ledger_identity::msp::{Msp, Msps};
use ledger_light::{Change, Governance, Misbehaviour, Proof, Statement};
use serde_json::Value;
use std::sync::LazyLock;

/// tests/fixtures/certified.json.
static VECTORS: LazyLock<Value> =
    LazyLock::new(|| serde_json::from_str(include_str!("../../tests/fixtures/certified.json")).expect("JSON"));

/// Names of the places where the ways begin that are fuzzed; the first byte of an input of `follow` is the number of one.
pub const BEGINNINGS: [&str; 4] = ["genesis", "two voters", "one organisation", "four voters"];

/// A reader at each of them.
pub static READERS: LazyLock<Vec<Governance>> = LazyLock::new(|| BEGINNINGS.map(founded).to_vec());

/// All that voters of the vectors have signed.
pub static SIGNED: LazyLock<Vec<Statement>> = LazyLock::new(|| {
    let ways = list("ways").filter(|way| way["refused"] != "BAD_SIGNATURE");
    let steps = ways.flat_map(|way| way["steps"].as_array().expect("steps"));
    let proofs = steps.filter_map(|step| Proof::from_bytes(&bytes(&step["proof"])).ok());
    proofs.map(|proof| proof.certificate.statement).collect()
});

/// The organisations of the nodes that have lied.
pub static MSPS: LazyLock<Msps> = LazyLock::new(|| {
    let mut msps = Msps::new();
    for organisation in list("organisations") {
        let (name, none) = (organisation["name"].as_str().expect("a name"), [] as [Vec<u8>; 0]);
        let msp = Msp::new(name, &[bytes(&organisation["root"])], &none).expect("an organisation");
        msps.insert(msp).expect("an organisation");
    }
    msps
});

/// All that was signed in the proofs of a lie.
pub static TOLD: LazyLock<Vec<Statement>> = LazyLock::new(|| {
    let lies = list("lies").filter(|lie| lie["refused"] != "BAD_SIGNATURE");
    let lies = lies.filter_map(|lie| match Misbehaviour::from_bytes(&bytes(&lie["lie"])) {
        Ok(Misbehaviour::Lie(lie)) => Some(lie),
        _ => None,
    });
    lies.flat_map(|lie| [lie.first.statement, lie.second.statement]).collect()
});

/// A genesis, and the transactions that the evidence of the vectors proves.
pub struct Vouched {
    /// The document.
    pub genesis: Vec<u8>,
    /// Their ids.
    pub proved: Vec<Hash>,
}

/// tests/fixtures/evidence.json.
static FILES: LazyLock<Value> =
    LazyLock::new(|| serde_json::from_str(include_str!("../../tests/fixtures/evidence.json")).expect("JSON"));

/// All that they prove.
pub static EVIDENCE: LazyLock<Vouched> = LazyLock::new(|| {
    let files = FILES["files"].as_array().expect("a list").iter();
    let proved = files.map(|file| Hash::from_hex(file["transaction"].as_str().expect("a text")).expect("a hash"));
    Vouched { genesis: bytes(&FILES["genesis"]), proved: proved.collect() }
});

/// The evidence of the vectors.
///
/// # Panics
/// If there is none.
pub fn evidence() -> impl Iterator<Item = Vec<u8>> {
    FILES["files"].as_array().expect("a list").iter().map(|file| bytes(&file["evidence"]))
}

/// The vectors: tests/fixtures/certified.json.
pub fn vectors() -> &'static Value {
    &VECTORS
}

/// A list of the vectors.
///
/// # Panics
/// If it is none.
pub fn list(field: &str) -> impl Iterator<Item = &'static Value> {
    VECTORS[field].as_array().expect("a list").iter()
}

/// The bytes behind hexadecimal digits.
///
/// # Panics
/// If they are none.
pub fn bytes(digits: &Value) -> Vec<u8> {
    hex::decode(digits.as_str().expect("a text")).expect("hexadecimal")
}

fn founded(name: &str) -> Governance {
    let begin = &VECTORS["beginnings"][name];
    let network = Hash::from_hex(begin["network"].as_str().expect("a text")).expect("a hash");
    let genesis = Change::from_bytes(0, &bytes(&begin["writes"])).expect("writes");
    Governance::founded(network, begin["time"].as_u64().expect("a time"), &genesis).expect("a network")
}

/// The network of the checkpoint of the vectors.
pub fn network() -> Hash {
    READERS[0].network()
}
