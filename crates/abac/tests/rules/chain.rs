//! A stored chain: genesis, blocks, and what executing each of them gave.

use bytes::Bytes;
use ledger::{Ledger, Registry, Rules};
use ledger_abac::AccessControl;
use ledger_base::hash::Hash;
use ledger_storage::entry::{Entry, EntryKind};
use ledger_storage::result::EmittedEvent;
use ledger_storage::results::ResultStore;
use ledger_storage::state::{MemoryState, State};
use std::path::PathBuf;
use std::sync::Arc;

/// The first bytes of the file.
const MAGIC: &[u8] = b"ledgerd chain of one rules number\n";

/// The content of the file: `MAGIC`, the genesis, then each block as index, term, kind, data, hash, digest, events.
/// Behind the events is the results root, zero where the block is not certified.
/// Numbers are `u64` BE; genesis and data are preceded by their length.
pub(crate) struct Chain {
    pub(crate) genesis: Bytes,
    pub(crate) blocks: Vec<Block>,
}

/// A block and what executing it gave.
pub(crate) struct Block {
    pub(crate) entry: Entry,
    pub(crate) hash: Hash,
    pub(crate) digest: Hash,
    /// Over everything that it emitted.
    pub(crate) events: Hash,
    /// The results root that its voters sign, if it is certified.
    pub(crate) results: Option<Hash>,
}

/// Where the chain of a rules number is stored.
pub(crate) fn path(rules: u32) -> PathBuf {
    let name = format!("../../../tests/fixtures/rules-{rules}.chain");
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// An empty ledger with the chaincodes of a node, which speaks one number more than any release.
pub(crate) fn open(genesis: &[u8]) -> Ledger {
    let mut registry = Registry::new();
    registry.speak_up_to(Rules::OF_TESTS);
    registry.install(Arc::new(AccessControl::new().unwrap())).unwrap();
    let state = Arc::new(State::open(Box::new(MemoryState::default())).unwrap());
    Ledger::open(genesis, registry, state, Arc::new(ResultStore::in_memory())).unwrap()
}

pub(crate) fn digest_of_events(events: &[EmittedEvent]) -> Hash {
    let mut parts = Vec::new();
    for EmittedEvent { index, event } in events {
        parts.push(index.map_or_else(Vec::new, |index| index.to_be_bytes().to_vec()));
        for part in [event.chaincode.as_bytes(), event.name.as_bytes(), event.subject.as_bytes(), &event.payload] {
            parts.push(part.to_vec());
        }
    }
    let parts: Vec<_> = parts.into_iter().flat_map(|part| [(part.len() as u64).to_be_bytes().to_vec(), part]).collect();
    Hash::of(&parts.iter().map(Vec::as_slice).collect::<Vec<_>>())
}

impl Chain {
    pub(crate) fn load(rules: u32) -> Self {
        let path = path(rules);
        let bytes = std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let mut rest = Rest(&bytes);
        assert_eq!(rest.take(MAGIC.len()), MAGIC);
        let genesis = rest.part();
        let mut blocks = Vec::new();
        while !rest.0.is_empty() {
            let (index, term) = (rest.number(), rest.number());
            let kind = EntryKind::from_code(rest.take(1)[0]).unwrap();
            let entry = Entry { index, term, kind, data: rest.part() };
            let (hash, digest, events) = (rest.hash(), rest.hash(), rest.hash());
            let results = Some(rest.hash()).filter(|root| *root != Hash::ZERO);
            blocks.push(Block { entry, hash, digest, events, results });
        }
        Self { genesis, blocks }
    }

    pub(crate) fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        part(&mut bytes, &self.genesis);
        for Block { entry, hash, digest, events, results } in &self.blocks {
            bytes.extend(entry.index.to_be_bytes());
            bytes.extend(entry.term.to_be_bytes());
            bytes.push(entry.kind.code());
            part(&mut bytes, &entry.data);
            let results = results.unwrap_or(Hash::ZERO);
            [hash, digest, events, &results].into_iter().for_each(|hash| bytes.extend(hash.0));
        }
        bytes
    }
}

fn part(bytes: &mut Vec<u8>, part: &[u8]) {
    bytes.extend((part.len() as u64).to_be_bytes());
    bytes.extend(part);
}

/// The bytes that are not read yet.
struct Rest<'a>(&'a [u8]);

impl<'a> Rest<'a> {
    fn take(&mut self, bytes: usize) -> &'a [u8] {
        let (taken, rest) = self.0.split_at(bytes);
        self.0 = rest;
        taken
    }

    fn number(&mut self) -> u64 {
        u64::from_be_bytes(self.take(8).try_into().unwrap())
    }

    fn part(&mut self) -> Bytes {
        let bytes = self.number();
        Bytes::copy_from_slice(self.take(bytes.try_into().unwrap()))
    }

    fn hash(&mut self) -> Hash {
        Hash::from_slice(self.take(32)).unwrap()
    }
}
