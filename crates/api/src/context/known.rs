//! A network as it was learnt since a context was made: the addresses of its nodes, and their organisations.
//!
//! A context is made from the answer of one node on one day. Nodes join, move and go, organisations join and renew
//! their CA. Every node tells it as the ledger has it, at every use, and `nodes.json` in the context keeps it. The file
//! is a memory and no more: without it, or if it is damaged, the nodes of the enrolment are asked and tell it again.
//!
//! Roots that were learnt decide which *nodes* are talked to. The gate of a robot's bridge does not believe them: it
//! goes by the organisations of the enrolment, so that no node can invent an organisation whose commands would count.

use super::Context;
use super::files;
use super::lock::Lock;
use super::organisations::{self, Stored};
use crate::connect;
use crate::v1;
use ledger_base::rejection::Rejection;
use ledger_identity::msp::Msps;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// Most nodes that are remembered.
pub const KNOWN_NODES_MAX: usize = 256;
/// Longest address that is remembered, in bytes.
pub const ADDRESS_BYTES_MAX: usize = 262;
/// How long a command waits to note what it has learnt. It learns it again next time.
const NOTE_WAITS_MAX: Duration = Duration::from_millis(200);

/// A node of the network.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct KnownNode {
    /// `HOST:PORT`.
    pub address: String,
    /// The organisation that runs it.
    pub organisation: String,
}

/// The content of `nodes.json`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
struct Known {
    /// In the order in which the network told them.
    nodes: Vec<KnownNode>,
    /// Address of the node that served last.
    last: Option<String>,
    /// All organisations, if they are others than at enrolment.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    organisations: Vec<Stored>,
}

/// The knowledge of a context, and its file. Empty in a context that was not stored yet.
#[derive(Clone, Debug, Default)]
pub struct Memory {
    known: Known,
    /// The organisations in it, ready to verify.
    organisations: Option<Arc<Msps>>,
    /// The directory of the context.
    directory: Option<PathBuf>,
}

impl Memory {
    /// Reads what a stored context has learnt. Never fails: what cannot be used is learnt again.
    pub(super) fn read(directory: &Path) -> Self {
        let read = files::read(&directory.join(files::NODES)).ok();
        let known: Known = read.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default();
        let organisations = match known.organisations.as_slice() {
            [] => None,
            stored => organisations::read(stored).ok().map(Arc::new),
        };
        Self { known, organisations, directory: Some(directory.to_owned()) }
    }

    /// The directory of the context, if it was loaded.
    pub(super) fn directory(&self) -> Option<&Path> {
        self.directory.as_deref()
    }

    /// As a file; none if nothing was learnt.
    pub(super) fn to_json(&self) -> Result<Option<String>, Rejection> {
        if self.known == Known::default() {
            return Ok(None);
        }
        organisations::pretty(&self.known, files::NODES).map(Some)
    }
}

impl Context {
    /// The nodes of the network as they were told last; empty if nobody has told yet.
    pub fn known_nodes(&self) -> &[KnownNode] {
        &self.memory.known.nodes
    }

    /// Address of the node that served last.
    pub fn last_node(&self) -> Option<&str> {
        self.memory.known.last.as_deref()
    }

    /// The organisations of the network as its nodes told them last, if they are others than at enrolment.
    pub fn learnt_organisations(&self) -> Option<&Arc<Msps>> {
        self.memory.organisations.as_ref()
    }

    /// The addresses at which a node may answer, in the order to try them. The one that served last is first, then the
    /// one that was given at enrolment, those of the own organisation, and the others. At last come those that the
    /// network does not tell (any more).
    pub fn addresses(&self) -> Vec<String> {
        let known = &self.memory.known;
        let told = |address: &&String| known.nodes.iter().any(|node| node.address == **address);
        let last = known.last.iter().filter(|last| self.nodes.contains(last) || told(last));
        // What somebody typed is perhaps another name of a node that the network tells.
        let typed = self.nodes.first();
        let own = known.nodes.iter().filter(|node| node.organisation == self.organisation).map(|node| &node.address);
        let given = self.nodes.iter().filter(|address| told(address));
        let others = known.nodes.iter().map(|node| &node.address);
        let mut addresses: Vec<String> = Vec::new();
        for address in last.chain(typed).chain(own).chain(given).chain(others).chain(&self.nodes) {
            if !addresses.contains(address) {
                addresses.push(address.clone());
            }
        }
        addresses
    }

    /// Takes what the node at `address`, whose certificate was verified, has told of the network. True if it is news.
    ///
    /// # Errors
    /// If an organisation cannot be read: then nothing of it is taken.
    pub fn learn(&mut self, told: &v1::NetworkResponse, address: &str) -> Result<bool, Rejection> {
        let msps = super::msps_of(&told.organisations)?;
        let stored = organisations::store(&msps);
        let enrolled = organisations::store(&self.msps);
        let nodes = told.organisations.iter().flat_map(|organisation| {
            organisation
                .addresses
                .iter()
                .map(|address| (address, &organisation.name))
                .filter(|(address, _)| usable(address))
        });
        let nodes = nodes.map(|(address, name)| KnownNode { address: address.clone(), organisation: name.clone() });
        let known = Known {
            nodes: nodes.take(KNOWN_NODES_MAX).collect(),
            last: Some(address.to_owned()),
            organisations: if stored == enrolled { Vec::new() } else { stored },
        };
        if known == self.memory.known {
            return Ok(false);
        }
        let learnt = !known.organisations.is_empty();
        self.memory.organisations = learnt.then(|| Arc::new(msps));
        self.memory.known = known;
        Ok(true)
    }

    /// Notes on the disk what was learnt, if the context is stored and holds something else. Nothing else of the
    /// context is touched.
    ///
    /// # Errors
    /// [`Code::BadFile`](ledger_base::rejection::Code::BadFile) if the disk is full, the context read-only or removed
    /// meanwhile. A command goes on all the same.
    pub fn note(&self) -> Result<(), Rejection> {
        let (Some(directory), Some(text)) = (&self.memory.directory, self.memory.to_json()?) else { return Ok(()) };
        let path = directory.join(files::NODES);
        if files::read(&path).is_ok_and(|known| known == text) {
            return Ok(());
        }
        files::check_length(&path, &text)?;
        let home = directory.parent().and_then(Path::parent).unwrap_or(directory);
        let _alone = Lock::exclusive_within(home, NOTE_WAITS_MAX)?;
        files::replace_file_in(directory, files::NODES, &text)
    }
}

fn usable(address: &str) -> bool {
    address.len() <= ADDRESS_BYTES_MAX && connect::origin(address).is_ok()
}
