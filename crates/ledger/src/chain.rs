//! The ledger of a node: the chain executed so far, and the questions that can be asked of it.

mod admission;
mod certified;
mod deadlines;
mod early;
mod readers;
mod rules;
mod storage;

pub use admission::{Admission, Ground, Refusal, Step};
use certified::newest_roots;

use crate::block::{Header, Payload, leaf};
use crate::chaincode::{Context, Environment, Meter, Registry};
use crate::execution::{Execution, Executor, effects, genesis};
use crate::foretold;
use crate::identities::{Identities, check_organisation, check_revoked};
use crate::large::Large;
use crate::members::Membership;
use crate::msp::{
    self, LIST_KEYS, MspChaincode, ORGANISATION_KEYS, RULES_KEY, STALE_KEYS, certificate_key, revoked_key,
};
use crate::network::Genesis;
use crate::rules::Schedule;
use crate::transaction::{NOT_AFTER_AHEAD_MAX, Transaction};
use crate::verified::Verified;
use crate::window::Window;
use crate::writes::{RecentWrites, Write};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::Certificate;
use ledger_identity::msp::Msps;
use ledger_identity::{Identity, Role};
use ledger_storage::entry::Entry;
use ledger_storage::result::{BlockKind, BlockResult, EmittedEvent, Event, Roots, TransactionResult};
use ledger_storage::results::{Place, ResultStore, StoredResult};
use ledger_storage::state::{Overlay, State, StateRead, Tip};
use std::ops::Bound;
use std::sync::{Arc, Mutex, PoisonError, RwLock};

/// How often a query is repeated when blocks are committed while it runs, before it is answered as it is.
const QUERY_RETRIES: usize = 3;

/// The ledger of a node. Blocks are applied by one caller in order; everything else may be asked beside that.
pub struct Ledger {
    network: Hash,
    registry: Registry,
    state: Arc<State>,
    results: Arc<ResultStore>,
    /// The result of the genesis block, which is in no file.
    genesis: BlockResult,
    /// Number of the rules that the network was founded with.
    founded: u32,
    /// Which rules it has at which height.
    schedule: RwLock<Schedule>,
    /// Blocks between two snapshots.
    snapshot_every: u64,
    /// Those of the newest block that is to be certified; none if its rules have none.
    roots: Mutex<Roots>,
    identities: Identities,
    verified: Verified,
    large: Large,
    /// Ids of executed transactions that block time has not passed.
    window: RwLock<Window>,
    writes: Mutex<RecentWrites>,
    /// One flush at a time.
    flushing: Mutex<()>,
}

/// The outcome of a block, for those who wait for it.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The link of the chain.
    pub header: Header,
    /// Its hash.
    pub hash: Hash,
    /// State digest after the block.
    pub digest: Hash,
    /// Hash over what the block wrote.
    pub writes: Hash,
    /// The kind of the block.
    pub kind: BlockKind,
    /// The transactions as they were signed.
    pub transactions: Vec<Bytes>,
    /// Their ids; zero where the bytes are no transaction.
    pub ids: Vec<Hash>,
    /// One for each transaction.
    pub results: Vec<TransactionResult>,
    /// In the order in which they were emitted.
    pub events: Vec<EmittedEvent>,
    /// The hashes that its voters sign, if it is to be certified: blocks with control writes, and the first block of each window
    /// of block time. None for a change of members that the ledger does not want, and for a block that was executed long ago.
    pub certifiable: Option<Roots>,
    /// Does it change whom others trust: an organisation, a node, a member, a revocation, rules? Not known of a block that was
    /// executed long ago.
    pub governs: bool,
}

/// The link of a block to those before it, and to their effects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockHashes {
    /// Block time, microseconds since the UNIX epoch.
    pub time: u64,
    /// Hash of the header.
    pub hash: Hash,
    /// State digest after the block.
    pub digest: Hash,
    /// Control chain and results root, if it is to be certified.
    pub roots: Option<Roots>,
}

/// Where a transaction is and what became of it.
#[derive(Clone, Debug, PartialEq)]
pub struct TransactionRecord {
    /// Height of its block.
    pub height: u64,
    /// Position in the block.
    pub index: u32,
    /// Block time, microseconds since the UNIX epoch.
    pub time: u64,
    /// Its verdict.
    pub result: TransactionResult,
}

impl Outcome {
    /// The step from the state digest before the block to the one after it (docs/format.md).
    pub fn effects(&self) -> Hash {
        effects(self.writes, &self.results)
    }
}

impl Ledger {
    /// The ledger at the point that the state has reached; blocks after [`Ledger::tip`] are to be applied next. A new
    /// state starts with the genesis. The chaincode `msp` is always installed.
    ///
    /// # Errors
    /// [`Code::Corrupt`] if state or results are of another network, cannot be read or do not belong together: rebuild
    /// both then. [`Code::UnknownRules`] if this release does not speak the rules of the next block.
    pub fn open(
        genesis_bytes: &[u8],
        mut registry: Registry,
        state: Arc<State>,
        results: Arc<ResultStore>,
    ) -> Result<Self, Rejection> {
        let (founding, network) = Genesis::from_bytes(genesis_bytes)?;
        registry.install(Arc::new(MspChaincode))?;
        let (first, writes, genesis) = genesis(&founding, network, &registry)?;
        if state.tip().is_none() {
            state.commit(writes, first.clone(), false);
        }
        let tip = state.tip().filter(|tip| tip.height > 0 || *tip == first).ok_or_else(|| {
            Rejection::new(Code::Corrupt, "the world state belongs to another network")
                .wanted(format!("network {network}"))
                .next("delete the directory state/ while the node is stopped; it is rebuilt from the blocks")
        })?;
        results.align(&tip)?;
        let mut window = Window::default();
        results.since(tip.time.saturating_sub(NOT_AFTER_AHEAD_MAX), tip.height, |height, stored| {
            remember(&mut window, height, stored.taken());
            Ok(())
        })?;
        window.forget_before(tip.time);
        let schedule = Schedule::new(founding.rules, msp::activations(&*state)?);
        let roots = newest_roots(tip.height, &genesis, &results)?;
        let ledger = Self {
            roots: Mutex::new(roots),
            network,
            registry,
            identities: Identities::read(&*state)?,
            state,
            results,
            genesis,
            founded: founding.rules,
            schedule: RwLock::new(schedule),
            snapshot_every: founding.snapshot_every,
            verified: Verified::default(),
            large: Large::default(),
            window: RwLock::new(window),
            writes: Mutex::default(),
            flushing: Mutex::default(),
        };
        ledger.rules_of(tip.height + 1)?;
        Ok(ledger)
    }

    /// Name of the network.
    pub fn network(&self) -> Hash {
        self.network
    }

    /// The installed chaincodes.
    pub fn registry(&self) -> &Registry {
        &self.registry
    }

    /// The organisations whose certificates are accepted.
    pub fn msps(&self) -> Arc<Msps> {
        self.identities.msps()
    }

    /// The creator of transactions, by the hash of the certificate, if it was verified before. It says only whom to count
    /// something for: it may have been revoked since.
    pub fn counted_for(&self, creator: &Hash) -> Option<Arc<Identity>> {
        self.identities.known(creator)
    }

    /// The world state.
    pub fn state(&self) -> &Arc<State> {
        &self.state
    }

    /// Where execution stands.
    pub fn tip(&self) -> Tip {
        self.state.tip().unwrap_or(Tip { height: 0, term: 0, time: 0, hash: self.network, digest: Hash::ZERO })
    }

    /// The voters and learners, as of [`Ledger::tip`].
    ///
    /// # Errors
    /// A fault of the store; [`Code::Corrupt`] if the record cannot be read.
    pub fn members(&self) -> Result<Membership, Rejection> {
        msp::members(&*self.state)
    }

    /// Executes the next block and makes its writes visible.
    ///
    /// # Errors
    /// [`Code::ChainInvalid`] if the entry is not the next one, [`Code::UnknownRules`] if this release does not speak its
    /// rules, or a fault of the store. The node must stop then: it cannot know what the others know.
    pub fn apply(&self, entry: &Entry) -> Result<Outcome, Rejection> {
        let previous = self.tip();
        if entry.index != previous.height + 1 || entry.term < previous.term {
            return Err(Rejection::new(Code::ChainInvalid, "a block does not follow the last one")
                .found(format!("height {} of term {}", entry.index, entry.term))
                .wanted(format!("height {} of term {} or later", previous.height + 1, previous.term)));
        }
        let executor = Executor {
            network: self.network,
            rules: self.rules_of(entry.index)?,
            roots: *self.roots.lock().unwrap_or_else(PoisonError::into_inner),
            registry: &self.registry,
            identities: &self.identities,
            state: Arc::clone(&self.state) as Arc<dyn StateRead>,
            verified: &|leaf| self.verified.take(leaf),
            read: &|encoded| self.large.take(encoded),
            window: &self.window,
        };
        let execution = executor.execute(&previous, entry)?;
        execution.check(&previous);
        let Execution { tip, header, result, foretold, transactions, ids, writes, certifiable, governs, is_unwanted } =
            execution;
        let wrote = |prefix: &'static [u8]| {
            let from = writes.range::<[u8], _>((Bound::Included(prefix), Bound::Unbounded));
            from.take(1).any(|(key, _)| key.starts_with(prefix))
        };
        let changed_organisations = [ORGANISATION_KEYS, LIST_KEYS, STALE_KEYS].into_iter().any(wrote);
        let changed_rules = writes.contains_key(RULES_KEY);
        let (hash, digest, kind) = (tip.hash, tip.digest, result.kind());
        // Who sees the block as executed finds all of it.
        self.results.push(tip.height, &result, &foretold)?;
        {
            let mut window = self.window.write().unwrap_or_else(PoisonError::into_inner);
            remember(&mut window, tip.height, result.taken());
            window.forget_before(tip.time);
        }
        self.writes.lock().unwrap_or_else(PoisonError::into_inner).push(tip.height, &writes);
        let cut = self.is_snapshot_due(&tip);
        if let Some(roots) = certifiable {
            *self.roots.lock().unwrap_or_else(PoisonError::into_inner) = roots;
        }
        self.state.commit(writes, tip, cut);
        if changed_organisations {
            self.identities.reload(&*self.state)?;
        }
        if changed_rules {
            self.reload_rules()?;
        }
        let (writes, results, events) = (result.writes(), result.results, result.events);
        let certifiable = certifiable.filter(|_| !is_unwanted);
        Ok(Outcome { header, hash, digest, writes, kind, transactions, ids, results, events, certifiable, governs })
    }

    /// The same for blocks that are about to be applied one after the other. It changes no verdict: applying them looks
    /// itself for what was not seen to verify.
    pub fn verify_blocks(&self, blocks: &[Entry]) {
        // The signatures of one block are checked together anyway.
        if blocks.len() < 2 {
            return;
        }
        let transactions = blocks.iter().filter_map(|block| Payload::from_bytes(block.data.clone()).ok());
        let decoded = transactions.flat_map(|payload| payload.transactions).filter_map(|encoded| {
            let leaf = leaf(&encoded);
            let new = !self.verified.contains(&leaf);
            new.then(|| Transaction::decode(encoded).ok()).flatten().map(|transaction| (leaf, transaction))
        });
        let decoded: Vec<_> = decoded.collect();
        let unverified = decoded.iter().map(|(leaf, transaction)| (*leaf, transaction));
        let verified = self.identities.verify_together(unverified, self.tip().time);
        verified.into_iter().for_each(|leaf| self.verified.insert(leaf));
    }

    /// Calls a function on the committed state, at the time of [`Ledger::judged_at`], and throws its writes away. Answers with the
    /// height of that state. `now` as in [`Ledger::admit`].
    ///
    /// # Errors
    /// The rejection of the chaincode; [`Code::Revoked`] for a revoked caller.
    pub fn query(
        &self,
        caller: &Identity,
        now: u64,
        chaincode: &str,
        function: &str,
        args: &[Bytes],
    ) -> Result<(Bytes, u64), Rejection> {
        self.check_revoked(caller)?;
        // An admin has to see what is wrong.
        if caller.role != Role::Admin {
            self.identities.check_current(caller, now)?;
        }
        let mut retries = 0;
        loop {
            let tip = self.tip();
            let answer = self.call(caller, self.judged_at(now), Hash::ZERO, chaincode, function, args);
            // Blocks that were committed in between may have been seen by one half of the reads only.
            if self.tip().height == tip.height || retries == QUERY_RETRIES {
                return answer.map(|(response, _)| (response, tip.height));
            }
            retries += 1;
        }
    }

    /// Refuses a caller whose certificate was revoked, or whose organisation or authority was removed.
    ///
    /// # Errors
    /// [`Code::Revoked`], [`Code::Untrusted`].
    pub fn check_revoked(&self, caller: &Identity) -> Result<(), Rejection> {
        check_organisation(caller, &self.msps())?;
        check_revoked(caller, &self.overlay())
    }

    /// Was the certificate with this serial number revoked? The issuer is the SHA-256 of its distinguished name.
    ///
    /// # Errors
    /// A fault of the store.
    pub fn is_revoked(&self, issuer: &Hash, serial: &[u8]) -> Result<bool, Rejection> {
        Ok(self.state.get(&revoked_key(&[&issuer.0, serial].concat()))?.is_some())
    }

    /// Where a transaction is and what became of it. Takes microseconds for those of the last seconds, and may take
    /// milliseconds in a long history.
    ///
    /// # Errors
    /// A fault of the store.
    pub fn transaction(&self, id: &Hash) -> Result<Option<TransactionRecord>, Rejection> {
        let recent = self.window.read().unwrap_or_else(PoisonError::into_inner).find_any(id);
        match recent {
            Some(place) => self.record(place),
            None => self.results.find(id)?.map_or(Ok(None), |place| self.record(place)),
        }
    }

    fn record(&self, place: Place) -> Result<Option<TransactionRecord>, Rejection> {
        let found = foretold::transaction(&self.results, place, &self.registry)?;
        let Place { height, position: index } = place;
        Ok(found.map(|(time, result)| TransactionRecord { height, index, time, result }))
    }

    /// The result of executing the block at a height; none if it was not executed yet, or was dropped.
    ///
    /// # Errors
    /// A fault of the store.
    pub fn result(&self, height: u64) -> Result<Option<BlockResult>, Rejection> {
        if height == 0 {
            Ok(Some(self.genesis.clone()))
        } else {
            foretold::whole(&self.results, height, &self.registry)
        }
    }

    /// The same for who has read the block.
    ///
    /// # Errors
    /// As [`Ledger::result`]; [`Code::Corrupt`] if the two do not belong together.
    pub fn result_of(&self, block: &Entry) -> Result<Option<BlockResult>, Rejection> {
        let stored = self.results.get(block.index)?;
        stored.map(|stored| foretold::complete(stored, block, &self.registry)).transpose()
    }

    /// Time, hash and digest of the block at a height; none as for [`Ledger::result`]. Reads less than that.
    ///
    /// # Errors
    /// A fault of the store.
    pub fn block_hashes(&self, height: u64) -> Result<Option<BlockHashes>, Rejection> {
        if height == 0 {
            let (hash, digest) = (self.genesis.hash(), self.genesis.digest());
            return Ok(Some(BlockHashes { time: self.genesis.time, hash, digest, roots: self.genesis.roots() }));
        }
        let stored = self.results.get(height)?;
        let hashes = |stored: StoredResult| BlockHashes {
            time: stored.time(),
            hash: stored.hash(),
            digest: stored.digest(),
            roots: stored.roots(),
        };
        Ok(stored.map(hashes))
    }

    /// The results of executed blocks.
    pub fn results(&self) -> &Arc<ResultStore> {
        &self.results
    }

    /// The writes of the block at a height to the world state, in order of keys; none if they are not kept any more.
    /// They are kept for some [4096](crate::writes::WRITES_BLOCKS_MAX) blocks, and not over a restart.
    pub fn writes(&self, height: u64) -> Option<Vec<Write>> {
        self.writes.lock().unwrap_or_else(PoisonError::into_inner).get(height)
    }

    /// The certificate of a creator that the ledger knows, in DER.
    ///
    /// # Errors
    /// A fault of the store.
    pub fn certificate(&self, fingerprint: &Hash) -> Result<Option<Bytes>, Rejection> {
        self.state.get(&certificate_key(fingerprint))
    }

    /// The name of a creator that the ledger knows, e.g. `Org1/Salma`, whether or not its certificate is still valid.
    pub fn creator_name(&self, fingerprint: &Hash) -> Option<String> {
        let der = self.certificate(fingerprint).ok()??;
        let certificate = Certificate::parse(&der).ok()?;
        let identity = self.msps().verify(&der, &[], certificate.not_before).ok()?;
        Some(identity.id())
    }

    /// Calls a function on the state as it is, and throws its writes away: the answer, and its events.
    fn call(
        &self,
        caller: &Identity,
        time: u64,
        transaction: Hash,
        chaincode: &str,
        function: &str,
        args: &[Bytes],
    ) -> Result<(Bytes, Vec<Event>), Rejection> {
        let (mut overlay, mut events) = (self.overlay(), Vec::new());
        let mut tip = self.tip();
        let meter = if transaction == Hash::ZERO {
            Meter::of_query()
        } else {
            // The first block that a transaction can be in.
            tip.height += 1;
            Meter::of_block()
        };
        let executed = |id: &Hash, not_after| self.was_executed(id, not_after);
        let environment = self.environment(Some(caller), (&tip, time), &executed, &meter);
        let environment = Environment { transaction, ..environment };
        let answer = Registry::invoke(environment, &mut overlay, &mut events, chaincode, function, args);
        overlay.finish().and(answer).map(|answer| (answer, events))
    }

    fn environment<'a>(
        &'a self,
        submitter: Option<&'a Identity>,
        (tip, time): (&Tip, u64),
        executed: &'a dyn Fn(&Hash, u64) -> bool,
        meter: &'a Meter,
    ) -> Environment<'a> {
        let (registry, network, rules, transaction) = (&self.registry, self.network, self.rules(), Hash::ZERO);
        Environment { registry, submitter, network, rules, height: tip.height, time, transaction, executed, meter }
    }

    /// Was this transaction executed? Known while block time has not passed its `not_after`.
    fn was_executed(&self, id: &Hash, not_after: u64) -> bool {
        self.window.read().unwrap_or_else(PoisonError::into_inner).find(id, not_after).is_some()
    }

    fn overlay(&self) -> Overlay {
        Overlay::new(Arc::clone(&self.state) as Arc<dyn StateRead>)
    }
}

/// Remembers the transactions of a block until block time has passed them.
fn remember(window: &mut Window, height: u64, taken: impl Iterator<Item = (u32, Hash, u64)>) {
    for (position, id, not_after) in taken {
        window.insert(&id, not_after, Place { height, position });
    }
}
