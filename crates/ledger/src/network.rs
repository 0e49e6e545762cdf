//! The genesis of a network: what all its nodes agree on before the first block.

use crate::rules::Rules;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::IdentityError;
use ledger_identity::msp::Msp;
use ledger_identity::units::Units;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Most bytes of a genesis document.
pub const GENESIS_BYTES_MAX: usize = 1024 * 1024;
/// Blocks between two snapshots at least, unless the network's founder chose otherwise.
pub const SNAPSHOT_EVERY_DEFAULT: u64 = 10_000;

/// The genesis block, height 0. Its hash names the network.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Genesis {
    /// Number of the [`Rules`] by which blocks are executed from height 1 on.
    pub rules: u32,
    /// A name for people; need not be unique.
    pub label: String,
    /// When the network was made, microseconds since the UNIX epoch: block time starts here.
    pub created: u64,
    /// Random, so that two networks made alike still differ.
    pub salt: Hash,
    /// The founding organisations.
    pub organisations: Vec<FoundingOrganisation>,
    /// The founding nodes.
    pub nodes: Vec<FoundingNode>,
    /// Every node makes a snapshot of the world state at heights that this number divides. If so many blocks take less
    /// than 120 s of block time, or than 12 ms for each, it makes one in that time.
    pub snapshot_every: u64,
}

/// A founding organisation and its verifying material.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FoundingOrganisation {
    /// Name, e.g. `Org1`.
    pub name: String,
    /// Root CA certificates, DER in hexadecimal.
    #[serde(with = "hex_list")]
    pub roots: Vec<Bytes>,
    /// Intermediate CA certificates, DER in hexadecimal.
    #[serde(with = "hex_list", default, skip_serializing_if = "Vec::is_empty")]
    pub intermediates: Vec<Bytes>,
    /// The units that name roles in its certificates; none: our own words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub units: Option<Units>,
}

impl FoundingOrganisation {
    /// An organisation with one root and no intermediates.
    pub fn below(name: &str, root: Bytes) -> Self {
        Self { name: name.to_owned(), roots: vec![root], intermediates: Vec::new(), units: None }
    }

    /// Its authorities, as certificates are verified against them.
    ///
    /// # Errors
    /// As [`Msp::new`].
    pub fn msp(&self) -> Result<Msp, IdentityError> {
        Msp::new(&self.name, &self.roots, &self.intermediates)?.with_units(self.units.clone())
    }
}

/// A founding node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FoundingNode {
    /// Its number in the ordering protocol, from 1.
    pub id: u64,
    /// Common name of its certificate.
    pub name: String,
    /// Organisation that runs it.
    pub organisation: String,
    /// `HOST:PORT` of its gateway.
    pub address: String,
    /// Does it order (voter), or only follow (learner)?
    pub voter: bool,
}

impl Genesis {
    /// The document as it is stored and hashed.
    ///
    /// # Errors
    /// [`Code::Internal`] if it cannot be written, which no well-formed genesis causes.
    pub fn to_bytes(&self) -> Result<Bytes, Rejection> {
        serde_json::to_vec_pretty(self)
            .map(Bytes::from)
            .map_err(|error| Rejection::new(Code::Internal, format!("the genesis cannot be encoded: {error}")))
    }

    /// Reads and checks a document; answers with the network's name as well.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Malformed`] with what is wrong.
    pub fn from_bytes(bytes: &[u8]) -> Result<(Self, Hash), Rejection> {
        let wrong = |what: String| {
            Rejection::new(Code::Malformed, format!("the genesis is not usable: {what}"))
                .next("use the genesis.json of another node of the same network")
        };
        if bytes.len() > GENESIS_BYTES_MAX {
            return Err(Rejection::new(Code::TooLarge, "the genesis is too large")
                .found(format!("{} bytes", bytes.len()))
                .wanted(format!("at most {GENESIS_BYTES_MAX} bytes")));
        }
        let genesis: Self = serde_json::from_slice(bytes).map_err(|error| wrong(error.to_string()))?;
        if Rules::find(genesis.rules).is_none() {
            let message = "the genesis is not usable: this release does not support the rules of the network";
            return Err(Rejection::new(Code::UnknownRules, message)
                .found(format!("rules {}", genesis.rules))
                .wanted(Rules::NEWEST.and_older()));
        }
        let names: BTreeSet<_> = genesis.organisations.iter().map(|o| o.name.as_str()).collect();
        if names.is_empty() || names.len() != genesis.organisations.len() {
            return Err(wrong("organisations must have names, and these must differ".into()));
        }
        if genesis.snapshot_every == 0 {
            return Err(wrong("snapshot_every is 0, wanted a number of blocks".into()));
        }
        let mut ids = BTreeSet::new();
        for node in &genesis.nodes {
            if node.id == 0 || !ids.insert(node.id) {
                return Err(wrong(format!("node id {} is zero or used twice", node.id)));
            }
            if !names.contains(node.organisation.as_str()) {
                return Err(wrong(format!("node {:?} is of unknown organisation {:?}", node.name, node.organisation)));
            }
        }
        if !genesis.nodes.iter().any(|node| node.voter) {
            return Err(wrong("no node is a voter".into()));
        }
        Ok((genesis, Hash::of(&[b"ledgerd genesis v1\0", bytes])))
    }

    /// The name of the network that a genesis founds.
    ///
    /// # Errors
    /// As [`Genesis::from_bytes`].
    pub fn network_of(bytes: &[u8]) -> Result<Hash, Rejection> {
        Self::from_bytes(bytes).map(|(_, network)| network)
    }

    /// The node of that organisation and name.
    pub fn node(&self, organisation: &str, name: &str) -> Option<&FoundingNode> {
        self.nodes.iter().find(|node| node.organisation == organisation && node.name == name)
    }
}

/// Lists of bytes as hexadecimal text.
pub(crate) mod hex_list {
    use bytes::Bytes;
    use serde::{Deserialize, Deserializer, Serializer};

    pub(crate) fn serialize<S: Serializer>(list: &[Bytes], serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(list.iter().map(hex::encode))
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Bytes>, D::Error> {
        Vec::<String>::deserialize(deserializer)?
            .iter()
            .map(|text| hex::decode(text).map(Bytes::from).map_err(serde::de::Error::custom))
            .collect()
    }
}
