//! The execution of one block: a function of the block and the state before it, the same on every node.

mod check;
mod trust;

use crate::block::{Header, Payload, leaf, opaque_root};
use crate::chaincode::{Chaincode, Context, Environment, Meter, Registry};
use crate::facts::{self, ControlWrites};
use crate::identities::Identities;
use crate::msp::{self, MEMBERS_KEY, Recovery, certificate_key, found, members_record};
use crate::network::Genesis;
use crate::rules::Rules;
use crate::transaction::Transaction;
use crate::window::Window;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_light::digest::digest;
use ledger_light::{Change, merkle};
use ledger_storage::entry::{Entry, EntryKind};
use ledger_storage::result::{BlockKind, BlockResult, EmittedEvent, Event, Roots, TransactionResult};
use ledger_storage::state::{Overlay, StateRead, Tip, WriteSet};
use ring::digest::{Context as Sha256, SHA256};
use std::collections::HashSet;
use std::sync::{Arc, PoisonError, RwLock};
use trust::Trust;

/// Microseconds of block time of which at least the first block is certified.
const CERTIFIED_EVERY: u64 = 200_000;

/// The needs of the execution of a block besides the block.
pub(crate) struct Executor<'a> {
    pub(crate) network: Hash,
    /// By which the block is executed.
    pub(crate) rules: Rules,
    /// Those of the newest block before that is to be certified.
    pub(crate) roots: Roots,
    pub(crate) registry: &'a Registry,
    pub(crate) identities: &'a Identities,
    pub(crate) state: Arc<dyn StateRead>,
    /// Was the signature of exactly these bytes (by their [`leaf`]) verified by this node before?
    pub(crate) verified: &'a dyn Fn(&Hash) -> bool,
    /// The transaction of exactly these bytes, if this node has read it before: a shortcut for large ones.
    pub(crate) read: &'a dyn Fn(&Bytes) -> Option<Transaction>,
    /// Ids executed before this block.
    pub(crate) window: &'a RwLock<Window>,
}

/// The outcome of the execution of a block.
pub(crate) struct Execution {
    pub(crate) tip: Tip,
    pub(crate) header: Header,
    pub(crate) result: BlockResult,
    /// Which transactions had the response and the events that their calls foretell.
    pub(crate) foretold: Vec<bool>,
    pub(crate) transactions: Vec<Bytes>,
    /// Id of each transaction; zero where the bytes are no transaction.
    pub(crate) ids: Vec<Hash>,
    /// To the world state.
    pub(crate) writes: WriteSet,
    /// Its place in the chains of certified blocks, if it is to be certified.
    pub(crate) certifiable: Option<Roots>,
    /// A change of members that the ledger does not want: voters sign nothing of it.
    pub(crate) is_unwanted: bool,
    /// It changes whom others trust.
    pub(crate) governs: bool,
}

impl Executor<'_> {
    /// Executes the entry that follows `previous`.
    pub(crate) fn execute(&self, previous: &Tip, entry: &Entry) -> Result<Execution, Rejection> {
        let (kind, payload) = match entry.kind {
            // A leader that orders rubbish gets an empty block, on every node alike.
            EntryKind::Normal => (BlockKind::Transactions, Payload::from_bytes(entry.data.clone()).ok()),
            EntryKind::ConfChange | EntryKind::ConfChangeV2 => (BlockKind::Membership, None),
        };
        let decoded = payload.as_ref().map(|payload| self.decoded(&payload.transactions));
        let (decoded, leaves) = decoded.map_or_else(|| (Vec::new(), None), |(decoded, leaves)| (decoded, Some(leaves)));
        let root = leaves.clone().map_or_else(|| opaque_root(entry), merkle::root);
        let Payload { time, transactions } = payload.unwrap_or_default();
        let time = time.max(previous.time);
        let header = Header { height: entry.index, term: entry.term, time, previous: previous.hash, root };

        let mut overlay = Overlay::new(Arc::clone(&self.state));
        let (mut events, meter) = (Vec::new(), Meter::of_block());
        self.begin_block(&header, &mut overlay, &mut events);
        let (mut taken, mut trust) = (HashSet::<Hash>::new(), Trust::new(self.identities));
        let mut results = Vec::with_capacity(transactions.len());
        let mut ids = Vec::with_capacity(transactions.len());
        let mut foretold = Vec::with_capacity(transactions.len());
        let verified = self.verify_together(&decoded, &leaves.unwrap_or_default(), time);
        for (position, (decoded, verified)) in (0u32..).zip(decoded.into_iter().zip(verified)) {
            let (mut emitted, identities) = (Vec::new(), trust.now(&overlay)?);
            let (mut id, mut not_after, mut as_foretold) = (Hash::ZERO, None, false);
            let outcome = decoded.and_then(|transaction| {
                id = transaction.id();
                self.check_first(&transaction, &taken, time)?;
                let (identity, new) = self.authenticate(&transaction, verified, &header, (identities, &overlay))?;
                // From here on the id is taken: its creator signed it, and this is its one verdict.
                taken.insert(id);
                not_after = Some(transaction.body().not_after);
                if let Some(certificate) = new {
                    overlay.write(certificate_key(&transaction.creator()), Some(certificate));
                    for (key, value) in identities.seen(&identity, time)?.into_iter().flatten() {
                        overlay.write(key, Some(value));
                    }
                }
                let body = transaction.body();
                let executed = |id: &Hash, not_after| taken.contains(id) || self.is_in_window(id, not_after);
                let environment = Environment {
                    submitter: Some(&identity),
                    transaction: id,
                    ..self.environment(&header, &executed, &meter)
                };
                let (chaincode, function, args) = (&body.chaincode, &body.function, &body.args);
                let response = Registry::invoke(environment, &mut overlay, &mut emitted, chaincode, function, args)?;
                let told = self.registry.foretell(chaincode, function, args);
                as_foretold = told.is_some_and(|told| told.response == response && told.events == emitted);
                Ok(response)
            });
            ids.push(id);
            foretold.push(as_foretold);
            let id_bytes = if id == Hash::ZERO { Bytes::new() } else { Bytes::copy_from_slice(&id.0) };
            results.push(TransactionResult { id: id_bytes, not_after, ..outcome.into() });
            events.extend(emitted.into_iter().map(|event| EmittedEvent { index: Some(position), event }));
        }

        if let Some(recovery) = Recovery::of(entry) {
            self.note_recovery(&header, &mut overlay, &mut events, &recovery);
        }

        let mut is_wanted = Recovery::of(entry).is_none();
        if kind == BlockKind::Membership {
            let before = msp::members(&*self.state)?;
            if let Some(members) = before.after(entry) {
                is_wanted &= msp::leads_to_wanted(&before, &members, &msp::nodes(&*self.state)?);
                overlay.write(Bytes::from_static(MEMBERS_KEY), Some(members_record(&members)?));
                self.settle_certificate_rule(&header, &mut overlay, &mut events);
            }
        }

        // Many blocks are kept in memory for their readers.
        events.shrink_to_fit();

        let mut writes = overlay.finish()?;
        let control = ControlWrites::of(&writes, self.registry);
        let governs = control.govern();
        // A change of members is not signed. So voters sign none that the ledger does not want, nor one by force: a leader that
        // lies could leave itself as the only voter.
        if !is_wanted {
            tracing::error!(height = header.height, "change of members does not match the ledger; not certified");
        }
        let is_certified = is_certified(previous, &header, &control);
        if governs {
            log_change(&facts::change(header.height, &writes, self.registry), &mut writes);
        }
        let wrote = hash_of_writes(&writes);
        let digest = digest(previous.digest, effects(wrote, &results));
        let hash = header.hash();
        let roots = || facts::roots(&self.roots, (header.height, digest), (&results, &events), &control);
        let certifiable = is_certified.then(roots).transpose()?;
        let result = BlockResult {
            term: header.term,
            time,
            hash: Bytes::copy_from_slice(&hash.0),
            digest: Bytes::copy_from_slice(&digest.0),
            kind: kind.into(),
            results,
            events,
            roots: certifiable.as_ref().map_or_else(Bytes::new, Roots::to_bytes),
            writes: Bytes::copy_from_slice(&wrote.0),
        };
        let tip = Tip { height: header.height, term: header.term, time, hash, digest };
        Ok(Execution {
            tip,
            header,
            result,
            foretold,
            transactions,
            ids,
            writes,
            certifiable,
            governs,
            is_unwanted: !is_wanted,
        })
    }

    fn environment<'a>(
        &'a self,
        header: &Header,
        executed: &'a dyn Fn(&Hash, u64) -> bool,
        meter: &'a Meter,
    ) -> Environment<'a> {
        Environment {
            registry: self.registry,
            submitter: None,
            network: self.network,
            rules: self.rules,
            height: header.height,
            time: header.time,
            transaction: Hash::ZERO,
            executed,
            meter,
        }
    }

    /// Was this transaction executed before this block?
    fn is_in_window(&self, id: &Hash, not_after: u64) -> bool {
        self.window.read().unwrap_or_else(PoisonError::into_inner).find(id, not_after).is_some()
    }

    fn begin_block(&self, header: &Header, overlay: &mut Overlay, events: &mut Vec<EmittedEvent>) {
        for chaincode in self.registry.iter() {
            self.beside_transactions(header, chaincode, (overlay, events), |ctx| chaincode.begin_block(ctx));
        }
    }

    /// The members were changed by force: whoever reads the ledger later shall know.
    fn note_recovery(
        &self,
        header: &Header,
        overlay: &mut Overlay,
        events: &mut Vec<EmittedEvent>,
        recovery: &Recovery,
    ) {
        if let Ok(msp) = self.registry.find(msp::NAME) {
            self.beside_transactions(header, msp, (overlay, events), |ctx| {
                if let Err(fault) = msp::note_recovery(ctx, recovery) {
                    tracing::error!(height = ctx.height(), code = fault.code.name(), reason = %fault, "cannot record \
                                                                                                       a forced \
                                                                                                       recovery");
                }
            });
        }
    }

    /// Other voters may make certificates strict.
    fn settle_certificate_rule(&self, header: &Header, overlay: &mut Overlay, events: &mut Vec<EmittedEvent>) {
        if let Ok(msp) = self.registry.find(msp::NAME) {
            self.beside_transactions(header, msp, (overlay, events), |ctx| {
                if let Err(fault) = msp::settle_certificate_rule(ctx) {
                    tracing::error!(height = ctx.height(), code = fault.code.name(), reason = %fault, "cannot record \
                                                                                                       whether \
                                                                                                       certificates \
                                                                                                       are strict");
                }
            });
        }
    }

    /// Work of a chaincode that no transaction asked for.
    fn beside_transactions(
        &self,
        header: &Header,
        chaincode: &dyn Chaincode,
        (overlay, events): (&mut Overlay, &mut Vec<EmittedEvent>),
        body: impl FnOnce(&mut Context<'_>),
    ) {
        let mut emitted: Vec<Event> = Vec::new();
        let meter = Meter::of_block();
        let executed = |id: &Hash, not_after| self.is_in_window(id, not_after);
        let hook = Registry::hook(self.environment(header, &executed, &meter), chaincode, overlay, &mut emitted, body);
        if let Err(rejection) = hook {
            tracing::error!(height = header.height, chaincode = chaincode.name(), code = rejection.code.name(), reason = %rejection, "cleanup \
                                                                                                                                      at \
                                                                                                                                      the \
                                                                                                                                      end \
                                                                                                                                      of \
                                                                                                                                      a \
                                                                                                                                      block \
                                                                                                                                      was \
                                                                                                                                      rolled \
                                                                                                                                      back");
        }
        events.extend(emitted.into_iter().map(|event| EmittedEvent { index: None, event }));
    }

    /// The transactions, and their leaves.
    fn decoded(&self, transactions: &[Bytes]) -> (Vec<Result<Transaction, Rejection>>, Vec<Hash>) {
        let decode = |encoded: &Bytes| match (self.read)(encoded) {
            Some(transaction) => (transaction.leaf(), Ok(transaction)),
            None => (leaf(encoded), Transaction::decode(encoded.clone())),
        };
        let (leaves, decoded) = transactions.iter().map(decode).unzip();
        (decoded, leaves)
    }

    /// The signers whose signatures this node has verified, now or before.
    fn verify_together(&self, decoded: &[Result<Transaction, Rejection>], leaves: &[Hash], time: u64) -> Vec<bool> {
        let mut verified: Vec<_> = leaves.iter().map(self.verified).collect();
        let rest = (0..).zip(decoded).filter(|(position, _)| verified.get(*position) == Some(&false));
        let rest = rest.filter_map(|(position, decoded)| Some((position, decoded.as_ref().ok()?)));
        for position in self.identities.verify_together(rest, time) {
            verified.get_mut(position).into_iter().for_each(|verified| *verified = true);
        }
        verified
    }

    fn authenticate(
        &self,
        transaction: &Transaction,
        verified: bool,
        header: &Header,
        (identities, overlay): (&Identities, &Overlay),
    ) -> Result<(Arc<Identity>, Option<Bytes>), Rejection> {
        check_network(transaction, &self.network)?;
        transaction.check_time(header.time)?;
        let (identity, new) = identities.creator(transaction, overlay, header.time)?;
        if !verified {
            transaction.verify(&identity.public_key)?;
        }
        Ok((identity, new))
    }

    /// An id is executed once: neither twice in this block, nor again in a later one. Ids that block time has passed
    /// are not asked for: they are refused as expired, whether or not the window still has them.
    fn check_first(&self, transaction: &Transaction, taken: &HashSet<Hash>, time: u64) -> Result<(), Rejection> {
        let (id, not_after) = (transaction.id(), transaction.body().not_after);
        if taken.contains(&id) || (not_after >= time && self.is_in_window(&id, not_after)) {
            return Err(Rejection::new(Code::Duplicate, format!("transaction {id} was executed before")));
        }
        Ok(())
    }
}

/// Are voters to sign what executing this block gave? Where control state was written, and for the first block of each
/// window of block time.
fn is_certified(previous: &Tip, header: &Header, control: &ControlWrites) -> bool {
    !control.is_empty() || header.time / CERTIFIED_EVERY != previous.time / CERTIFIED_EVERY
}

/// Refuses a transaction that was signed for another network.
pub(crate) fn check_network(transaction: &Transaction, network: &Hash) -> Result<(), Rejection> {
    if transaction.body().network == network.0[..] {
        return Ok(());
    }
    Err(Rejection::new(Code::WrongNetwork, "the transaction is for another network")
        .found(hex::encode(&transaction.body().network))
        .wanted(network.to_string())
        .next("select a context of this network, or enrol at it"))
}

/// The hash over what a block wrote.
fn hash_of_writes(writes: &WriteSet) -> Hash {
    let mut sha = Sha256::new(&SHA256);
    let mut part = |bytes: &[u8]| {
        sha.update(&(bytes.len() as u64).to_be_bytes());
        sha.update(bytes);
    };
    part(b"ledgerd writes v1");
    part(&(writes.len() as u64).to_be_bytes());
    for (key, value) in in_order(writes) {
        part(key);
        match value {
            Some(value) => {
                part(b"put");
                part(value);
            }
            None => part(b"delete"),
        }
    }
    Hash::finish(sha)
}

/// The effects of a block: its writes and its verdicts.
pub(crate) fn effects(writes: Hash, results: &[TransactionResult]) -> Hash {
    ledger_light::digest::effects(writes, facts::verdicts(results).map(|verdict| verdict.leaf()).collect())
}

/// Logs who governs from this block on, so that a reader can follow it from the beginning.
fn log_change(change: &Change, writes: &mut WriteSet) {
    writes.insert(msp::change_key(change.height), Some(change.to_bytes()));
}

/// The writes in the order of their keys, which is the same on every node.
fn in_order(writes: &WriteSet) -> Vec<(&Bytes, &Option<Bytes>)> {
    if active(Mutation::UnsortedDigest) {
        return writes.iter().collect::<std::collections::HashMap<_, _>>().into_iter().collect();
    }
    writes.iter().collect()
}

/// The tip, the writes and the result of the genesis block.
pub(crate) fn genesis(
    genesis: &Genesis,
    network: Hash,
    registry: &Registry,
) -> Result<(Tip, WriteSet, BlockResult), Rejection> {
    let writes = found(genesis)?;
    let wrote = hash_of_writes(&writes);
    let digest = digest(Hash::ZERO, effects(wrote, &[]));
    let control = ControlWrites::of(&writes, registry);
    let roots = facts::roots(&facts::NOTHING, (0, digest), (&[], &[]), &control)?.to_bytes();
    let result = BlockResult {
        time: genesis.created,
        hash: Bytes::copy_from_slice(&network.0),
        digest: Bytes::copy_from_slice(&digest.0),
        kind: BlockKind::Genesis.into(),
        roots,
        writes: Bytes::copy_from_slice(&wrote.0),
        ..BlockResult::default()
    };
    Ok((Tip { height: 0, term: 0, time: genesis.created, hash: network, digest }, writes, result))
}
