//! The ledger of a node: the chain executed so far, and the questions that can be asked of it.

use crate::Hash;
use crate::block::{Header, leaf};
use crate::certificate::Certificate;
use crate::chaincode::{Context, Environment, Event, Overlay, Registry, StateRead};
use crate::code::Code;
use crate::entry::Entry;
use crate::execution::{Execution, Executor, check_network, genesis};
use crate::governance::{Governance, ORGANISATION_KEYS, certificate_key, read, revoked_key};
use crate::identities::{Identities, check_organisation, check_revoked};
use crate::identity::Identity;
use crate::members::Membership;
use crate::msp::Msps;
use crate::network::Genesis;
use crate::rejection::Rejection;
use crate::result::{BlockKind, BlockResult, EmittedEvent, TransactionResult};
use crate::state::{State, Tip, result_key, transaction_key};
use crate::transaction::Transaction;
use bytes::Bytes;
use std::collections::HashSet;
use std::ops::Bound;
use std::sync::{Arc, Mutex, PoisonError};

/// Verified signatures remembered between admission and execution; twice as many at most.
const VERIFIED_MAX: usize = 32_768;
/// How often a query is repeated when blocks are committed while it runs, before it is answered as it is.
const QUERY_RETRIES: usize = 3;

/// The ledger of a node. Blocks are applied by one caller in order; everything else may be asked beside that.
pub struct Ledger {
    network: Hash,
    registry: Registry,
    state: Arc<State>,
    identities: Identities,
    verified: Mutex<Verified>,
}

/// What a block came to, for those who wait for it.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The link of the chain.
    pub header: Header,
    /// Its hash.
    pub hash: Hash,
    /// State digest after the block.
    pub digest: Hash,
    /// What kind of block it is.
    pub kind: BlockKind,
    /// The transactions as they were signed.
    pub transactions: Vec<Bytes>,
    /// Their ids; zero where the bytes are no transaction.
    pub ids: Vec<Hash>,
    /// One for each transaction.
    pub results: Vec<TransactionResult>,
    /// In the order in which they were emitted.
    pub events: Vec<EmittedEvent>,
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
    /// What became of it.
    pub result: TransactionResult,
}

/// What [`Ledger::admit`] answers.
#[derive(Clone, Debug, PartialEq)]
pub enum Admission {
    /// Worth ordering.
    New(Transaction),
    /// Executed before under this id: this is its verdict.
    Known(Hash, TransactionRecord),
}

impl Ledger {
    /// The ledger at the point that the state has reached; blocks after [`Ledger::tip`] are to be applied next. A new
    /// state starts with the genesis. The chaincode `msp` is always installed.
    ///
    /// # Errors
    /// [`Code::Corrupt`] if the state is of another network or cannot be read: rebuild it then.
    pub fn open(genesis_bytes: &[u8], mut registry: Registry, state: Arc<State>) -> Result<Self, Rejection> {
        let (founding, network) = Genesis::from_bytes(genesis_bytes)?;
        registry.install(Arc::new(Governance))?;
        if state.tip().is_none() {
            let (tip, writes) = genesis(&founding, network)?;
            state.commit(writes, tip);
        }
        let first = state.get(&result_key(0))?.map(BlockResult::from_bytes).transpose()?;
        if first.is_none_or(|first| first.root != network.0[..]) {
            return Err(Rejection::new(Code::Corrupt, "the world state is of another network")
                .wanted(format!("network {network}"))
                .next("delete the state directory; the node rebuilds it from the blocks"));
        }
        let identities = Identities::read(&*state)?;
        Ok(Self { network, registry, state, identities, verified: Mutex::default() })
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

    /// The world state.
    pub fn state(&self) -> &Arc<State> {
        &self.state
    }

    /// Where execution stands.
    pub fn tip(&self) -> Tip {
        self.state.tip().unwrap_or(Tip { height: 0, term: 0, time: 0, hash: self.network, digest: Hash::ZERO })
    }

    /// Who votes and who follows, as of [`Ledger::tip`].
    ///
    /// # Errors
    /// A fault of the store; [`Code::Corrupt`] if the record cannot be read.
    pub fn members(&self) -> Result<Membership, Rejection> {
        read::members(&*self.state)
    }

    /// Executes the next block and makes its writes visible.
    ///
    /// # Errors
    /// [`Code::ChainInvalid`] if the entry is not the next one, or a fault of the store. The node must stop then:
    /// it cannot know what the others know.
    pub fn apply(&self, entry: &Entry) -> Result<Outcome, Rejection> {
        let previous = self.tip();
        if entry.index != previous.height + 1 || entry.term < previous.term {
            return Err(Rejection::new(Code::ChainInvalid, "a block does not follow the last one")
                .found(format!("height {} of term {}", entry.index, entry.term))
                .wanted(format!("height {} of term {} or later", previous.height + 1, previous.term)));
        }
        let executor = Executor {
            network: self.network,
            registry: &self.registry,
            identities: &self.identities,
            state: Arc::clone(&self.state) as Arc<dyn StateRead>,
            verified: &|leaf| self.verified.lock().unwrap_or_else(PoisonError::into_inner).take(leaf),
        };
        let Execution { tip, header, result, transactions, ids, writes } = executor.execute(&previous, entry)?;
        let changed_organisations = writes
            .range::<[u8], _>((Bound::Included(ORGANISATION_KEYS), Bound::Unbounded))
            .next()
            .is_some_and(|(key, _)| key.starts_with(ORGANISATION_KEYS));
        let (hash, digest, kind) = (tip.hash, tip.digest, result.kind());
        self.state.commit(writes, tip);
        if changed_organisations {
            self.identities.reload(&*self.state)?;
        }
        Ok(Outcome { header, hash, digest, kind, transactions, ids, results: result.results, events: result.events })
    }

    /// Is this transaction worth ordering? Checks all that execution will check, on the committed state, so that what
    /// would be refused costs the others nothing. `now` is the node's clock in microseconds; block time may be behind
    /// it on a quiet network.
    ///
    /// # Errors
    /// The refusal, with the creator's name if it is known (see [`Refusal`]).
    pub fn admit(&self, encoded: Bytes, now: u64) -> Result<Admission, Box<Refusal>> {
        let transaction = Transaction::decode(encoded).map_err(Refusal::anonymous)?;
        let refuse = |who: Option<&Identity>, rejection| {
            Box::new(Refusal { who: who.map(Identity::id), transaction: Some(transaction.clone()), rejection })
        };
        check_network(&transaction, &self.network).map_err(|rejection| refuse(None, rejection))?;
        if let Some(record) = self.transaction(&transaction.id()).map_err(|rejection| refuse(None, rejection))? {
            return Ok(Admission::Known(transaction.id(), record));
        }
        let time = now.max(self.tip().time);
        let overlay = self.overlay();
        let authenticated = transaction.check_time(time).and_then(|()| {
            let (identity, _) = self.identities.creator(&transaction, &overlay, time)?;
            transaction.verify(&identity.public_key)?;
            Ok(identity)
        });
        let identity = authenticated.map_err(|rejection| refuse(None, rejection))?;
        let body = transaction.body();
        self.call(&identity, time, transaction.id(), &body.chaincode, &body.function, &body.args)
            .map_err(|rejection| refuse(Some(&identity), rejection))?;
        self.verified.lock().unwrap_or_else(PoisonError::into_inner).insert(leaf(transaction.encoded()));
        Ok(Admission::New(transaction))
    }

    /// Calls a function on the committed state and throws its writes away. Answers with the height of that state.
    /// `now` as in [`Ledger::admit`].
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
        let mut retries = 0;
        loop {
            let tip = self.tip();
            let answer = self.call(caller, now.max(tip.time), Hash::ZERO, chaincode, function, args);
            // Blocks that were committed in between may have been seen by one half of the reads only.
            if self.tip().height == tip.height || retries == QUERY_RETRIES {
                return answer.map(|response| (response, tip.height));
            }
            retries += 1;
        }
    }

    /// Refuses a caller whose certificate was revoked, or whose organisation was removed.
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

    /// May this identity see this event? Decided on the committed state.
    ///
    /// # Errors
    /// The reason why not.
    pub fn may_read(&self, reader: &Identity, event: &Event) -> Result<(), Rejection> {
        check_organisation(reader, &self.msps())?;
        let mut overlay = self.overlay();
        check_revoked(reader, &overlay)?;
        let chaincode = self.registry.find(&event.chaincode)?;
        let tip = self.tip();
        let environment = self.environment(Some(reader), &tip, tip.time);
        chaincode.may_read(&Context::new(environment, chaincode.name(), &mut overlay, &mut Vec::new()), event)
    }

    /// The earliest block time at which a chaincode has something to do without being called, microseconds.
    pub fn next_deadline(&self) -> Option<u64> {
        let mut overlay = self.overlay();
        let tip = self.tip();
        let deadlines = self.registry.iter().filter_map(|chaincode| {
            let environment = self.environment(None, &tip, tip.time);
            chaincode.next_deadline(&Context::new(environment, chaincode.name(), &mut overlay, &mut Vec::new()))
        });
        deadlines.min()
    }

    /// Where a transaction is and what became of it.
    ///
    /// # Errors
    /// A fault of the store.
    pub fn transaction(&self, id: &Hash) -> Result<Option<TransactionRecord>, Rejection> {
        let Some(place) = self.state.get(&transaction_key(id))? else { return Ok(None) };
        let damaged = || Rejection::new(Code::Corrupt, format!("the index entry of transaction {id} cannot be read"));
        let (height, index) = place.split_at_checked(8).ok_or_else(damaged)?;
        let height = u64::from_be_bytes(height.try_into().map_err(|_| damaged())?);
        let index = u32::from_be_bytes(index.try_into().map_err(|_| damaged())?);
        let block = self.result(height)?.ok_or_else(damaged)?;
        let result = usize::try_from(index).ok().and_then(|i| block.results.get(i)).ok_or_else(damaged)?.clone();
        Ok(Some(TransactionRecord { height, index, time: block.time, result }))
    }

    /// What executing the block at a height gave; none if it was not executed yet.
    ///
    /// # Errors
    /// A fault of the store.
    pub fn result(&self, height: u64) -> Result<Option<BlockResult>, Rejection> {
        stored_result(&self.state, height)
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

    fn call(
        &self,
        caller: &Identity,
        time: u64,
        transaction: Hash,
        chaincode: &str,
        function: &str,
        args: &[Bytes],
    ) -> Result<Bytes, Rejection> {
        let mut overlay = self.overlay();
        let tip = self.tip();
        let environment = Environment { transaction, ..self.environment(Some(caller), &tip, time) };
        let answer = Registry::invoke(environment, &mut overlay, &mut Vec::new(), chaincode, function, args);
        overlay.finish().and(answer)
    }

    fn environment<'a>(&'a self, submitter: Option<&'a Identity>, tip: &Tip, time: u64) -> Environment<'a> {
        let (registry, network) = (&self.registry, self.network);
        Environment { registry, submitter, network, height: tip.height, time, transaction: Hash::ZERO }
    }

    fn overlay(&self) -> Overlay {
        Overlay::new(Arc::clone(&self.state) as Arc<dyn StateRead>)
    }
}

/// What a state keeps of the block at a height.
pub(crate) fn stored_result(state: &State, height: u64) -> Result<Option<BlockResult>, Rejection> {
    state.get(&result_key(height))?.map(BlockResult::from_bytes).transpose()
}

/// A transaction that was refused before it was ordered, and whose it was if that is known.
#[derive(Clone, Debug, PartialEq)]
pub struct Refusal {
    /// Who signed it, e.g. `Org1/Farhad`; none if the signature was not verified.
    pub who: Option<String>,
    /// The transaction, if the bytes are one.
    pub transaction: Option<Transaction>,
    /// Why.
    pub rejection: Rejection,
}

impl Refusal {
    fn anonymous(rejection: Rejection) -> Box<Self> {
        Box::new(Self { who: None, transaction: None, rejection })
    }
}

/// Leaves whose signature this node has verified. Two generations, so that it stays small without an order.
#[derive(Default)]
struct Verified {
    young: HashSet<Hash>,
    old: HashSet<Hash>,
}

impl Verified {
    fn insert(&mut self, leaf: Hash) {
        if self.young.len() >= VERIFIED_MAX {
            self.old = std::mem::take(&mut self.young);
        }
        self.young.insert(leaf);
    }

    fn take(&mut self, leaf: &Hash) -> bool {
        self.young.remove(leaf) || self.old.remove(leaf)
    }
}
