//! The world as a running chaincode sees it.

use super::approval::{check_ordinary, quorum_of};
use super::budget::{Meter, Stopped};
use super::{ApprovedBy, Call, Chaincode, Registry, Revocation};
use crate::rules::Rules;
use bytes::{BufMut, Bytes, BytesMut};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Class, Code, Rejection};
use ledger_identity::Identity;
use ledger_storage::result::Event;
use ledger_storage::state::Overlay;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Deepest chain of chaincodes calling each other.
const CALL_DEPTH_MAX: usize = 8;
/// Most events of one transaction or hook.
const EVENTS_MAX: usize = 1024;
/// Of these, so many are not for hooks: whoever called one still has to tell its own.
const EVENTS_KEPT: usize = 64;
/// Most bytes of one key.
const KEY_BYTES_MAX: usize = 1024;
/// Most bytes of one value.
const VALUE_BYTES_MAX: usize = 1024 * 1024;
/// Most keys of a range that are read before they are counted.
const RANGE_PART: usize = 256;

/// The block and the caller that a call runs for.
#[derive(Clone, Copy)]
pub struct Environment<'a> {
    /// The installed chaincodes.
    pub registry: &'a Registry,
    /// The signer of the transaction; none in hooks.
    pub submitter: Option<&'a Identity>,
    /// Name of the network: hash of its genesis block.
    pub network: Hash,
    /// The rules by which the block is executed; for queries, those of the next block.
    pub rules: Rules,
    /// Height of the block that is executed; for queries, the committed height.
    pub height: u64,
    /// Block time, microseconds since the UNIX epoch.
    pub time: u64,
    /// Id of the transaction; zero in hooks and queries.
    pub transaction: Hash,
    /// Was the transaction with this id and this `not_after` executed before? Asked only while block time has not passed that.
    pub executed: &'a dyn Fn(&Hash, u64) -> bool,
    /// Counts what the calls of the block use.
    pub meter: &'a Meter,
}

impl Environment<'_> {
    /// Refuses a transaction with a call that only reads: every node would execute it, and store it with its answer.
    pub(super) fn check_changes(&self, callee: &dyn Chaincode, function: &str) -> Result<(), Rejection> {
        let ordered = self.transaction != Hash::ZERO;
        if !ordered || !callee.reads().contains(&function) {
            return Ok(());
        }
        let name = callee.name();
        Err(Rejection::new(Code::QueryOnly, format!("{name} {function} is read-only: it cannot be a transaction"))
            .found("a transaction")
            .wanted("a query")
            .next(format!("call it as a query: ledgerctl query {name} {function}")))
    }

    /// Refuses a call that went on although its budget was used up, and a query that has changed something although its
    /// function is said to only read.
    pub(super) fn check_kept(&self, callee: &dyn Chaincode, function: &str) -> Result<(), Rejection> {
        self.meter.within()?;
        let used = self.meter.used();
        let asked = self.transaction == Hash::ZERO && callee.reads().contains(&function);
        if !asked || used.writes + used.event_bytes == 0 {
            return Ok(());
        }
        Err(Rejection::new(Code::Internal, format!("{} {function} is declared as read-only", callee.name()))
            .found(format!("{} writes and {} bytes of events", used.writes, used.event_bytes))
            .wanted("no changes")
            .next("report it: this is a bug of the chaincode"))
    }

    /// A code that speaks of a node, such as [`Code::Overloaded`], tells clients to try again: no verdict on a call.
    pub(super) fn speaks_of_the_call(&self, mut refused: Rejection) -> Rejection {
        if refused.code.class() == Class::Unreachable {
            refused.code = Code::Refused;
        }
        refused
    }
}

/// All that a chaincode may know and do. Its keys are its own: no other chaincode sees them.
pub struct Context<'a> {
    environment: Environment<'a>,
    chaincode: &'static str,
    depth: usize,
    /// The approvals of this call; none if it is an ordinary one.
    approved: Option<&'a ApprovedBy>,
    overlay: &'a mut Overlay,
    events: &'a mut Vec<Event>,
    limit_exceeded: Option<Rejection>,
    /// Is it one that cannot refuse? Its events beyond the limit are not told.
    cannot_refuse: bool,
}

impl<'a> Context<'a> {
    /// The context of `chaincode` on top of an overlay; events are appended to `events`.
    pub fn new(
        environment: Environment<'a>,
        chaincode: &'static str,
        overlay: &'a mut Overlay,
        events: &'a mut Vec<Event>,
    ) -> Self {
        let (depth, approved, limit_exceeded, cannot_refuse) = (0, None, None, false);
        Self { environment, chaincode, depth, approved, overlay, events, limit_exceeded, cannot_refuse }
    }

    /// The value of one of this chaincode's keys.
    pub fn get(&self, key: &[u8]) -> Option<Bytes> {
        let value = self.overlay.get(&self.full_key(key));
        self.environment.meter.read(1, key.len() + value.as_ref().map_or(0, Bytes::len));
        value
    }

    /// Writes one of this chaincode's keys. Beyond the limits (1 KiB a key, 1 MiB a value) the call is rejected
    /// with [`Code::LimitExceeded`] when it returns.
    pub fn put(&mut self, key: &[u8], value: impl Into<Bytes>) {
        let value = value.into();
        if key.len() > KEY_BYTES_MAX || value.len() > VALUE_BYTES_MAX {
            self.exceeded(
                format!("key of {} bytes, value of {} bytes", key.len(), value.len()),
                format!("at most {KEY_BYTES_MAX} and {VALUE_BYTES_MAX} bytes"),
            );
            return;
        }
        self.environment.meter.write(key.len() + value.len());
        let key = self.full_key(key);
        self.overlay.write(key, Some(value));
    }

    /// Deletes one of this chaincode's keys.
    pub fn delete(&mut self, key: &[u8]) {
        self.environment.meter.write(key.len());
        let key = self.full_key(key);
        self.overlay.write(key, None);
    }

    /// Says that the state contradicts itself, which no sequence of calls can bring about. Nothing of this block counts
    /// then, and the node stops with this fault: it must not answer from such a state.
    pub fn contradicted(&mut self, fault: Rejection) {
        self.overlay.fail(fault);
    }

    /// At most `limit` of this chaincode's keys that start with `prefix`, in order, with their values.
    pub fn range(&self, prefix: &[u8], limit: usize) -> Vec<(Bytes, Bytes)> {
        self.range_after(prefix, None, limit)
    }

    /// As [`Context::range`], of the keys that are greater than `after`: the next page.
    pub fn range_after(&self, prefix: &[u8], after: Option<&[u8]>, limit: usize) -> Vec<(Bytes, Bytes)> {
        let (own, prefix) = (self.chaincode.len() + 1, self.full_key(prefix));
        let mut after = after.map(|after| self.full_key(after));
        let mut found = Vec::new();
        while found.len() < limit {
            let wanted = RANGE_PART.min(limit - found.len());
            let part = self.overlay.range_after(&prefix, after.as_deref(), wanted);
            let bytes = part.iter().map(|(key, value)| key.len() - own + value.len()).sum();
            self.environment.meter.read(part.len() + 1, bytes);
            let last = part.len() < wanted;
            after = part.last().map(|(key, _)| key.clone());
            found.extend(part.into_iter().map(|(key, value)| (key.slice(own..), value)));
            if last {
                break;
            }
        }
        found
    }

    /// Reads for an answer that this node may remember from another call, or another node may. They are not counted, so that
    /// all nodes count alike. The cost of the answer is to be charged whether or not it was remembered
    /// ([`Context::charge_steps`]).
    pub fn remembered<T>(&self, body: impl FnOnce() -> T) -> T {
        self.environment.meter.uncounted(body)
    }

    /// Charges the steps of an answer to the budget of `owner`, an organisation. The same question is charged once in a
    /// block; `question` names it. Steps stand for work that is not read or written, such as the evaluation of policies.
    pub fn charge_steps(&self, owner: &str, steps: u64, question: impl FnOnce() -> Hash) {
        self.environment.meter.steps(owner, steps, question);
    }

    /// The signer of the transaction.
    ///
    /// # Errors
    /// [`Code::CertificateRequired`] in hooks, which nobody signed.
    pub fn submitter(&self) -> Result<&'a Identity, Rejection> {
        self.environment
            .submitter
            .ok_or_else(|| Rejection::new(Code::CertificateRequired, "this call needs a signer, but is not signed"))
    }

    /// The approvals of this call, if it was proposed and its quorum agreed (see
    /// [`super::Chaincode::needs_approval`]). Ordinary calls have none, nor has what an approved call calls.
    pub fn approved_by(&self) -> Option<&'a ApprovedBy> {
        self.approved
    }

    /// Block time, microseconds since the UNIX epoch. The only clock there is.
    pub fn block_time(&self) -> u64 {
        self.environment.time
    }

    /// Height of the block that is executed.
    pub fn height(&self) -> u64 {
        self.environment.height
    }

    /// Name of the network: hash of its genesis block.
    pub fn network(&self) -> Hash {
        self.environment.network
    }

    /// The rules by which the block is executed. Code that differs between two of them asks here, and nowhere else.
    pub fn rules(&self) -> Rules {
        self.environment.rules
    }

    /// Id of the transaction that is executed; zero in hooks and queries.
    pub fn transaction(&self) -> Hash {
        self.environment.transaction
    }

    /// Has the transaction with this id and this `not_after` (microseconds) been executed, or can it never be, because block time
    /// has passed its `not_after`? It is the same on every node.
    pub fn is_settled(&self, id: &Hash, not_after: u64) -> bool {
        self.environment.meter.read(1, id.0.len());
        not_after < self.environment.time || (self.environment.executed)(id, not_after)
    }

    /// Does somebody only ask? No block holds the answer then, so no rules bind it.
    pub fn is_query(&self) -> bool {
        self.environment.submitter.is_some() && self.environment.transaction == Hash::ZERO
    }

    /// Does another chaincode ask, and not the submitter itself?
    pub fn is_inner(&self) -> bool {
        self.depth > 0
    }

    /// How many events there is room for.
    pub fn events_left(&self) -> usize {
        let most = if self.cannot_refuse { EVENTS_MAX - EVENTS_KEPT } else { EVENTS_MAX };
        most.saturating_sub(self.events.len())
    }

    /// Tells subscribers that something happened. Kept only if the call succeeds. Beyond the limits (1024 events of 1 MiB) the
    /// call is rejected when it returns. A hook cannot be: its events beyond the limit are not told.
    pub fn emit(&mut self, name: &str, subject: &str, payload: impl Into<Bytes>) {
        let payload = payload.into();
        if self.cannot_refuse && self.events_left() == 0 {
            return;
        }
        if self.events.len() >= EVENTS_MAX || payload.len() > VALUE_BYTES_MAX {
            self.exceeded(
                format!("event {} with {} bytes", self.events.len() + 1, payload.len()),
                format!("at most {EVENTS_MAX} events of {VALUE_BYTES_MAX} bytes"),
            );
            return;
        }
        self.environment.meter.event(subject.len() + payload.len());
        self.events.push(Event {
            chaincode: self.chaincode.to_owned(),
            name: name.to_owned(),
            subject: subject.to_owned(),
            payload,
        });
    }

    /// Calls another chaincode as the same submitter. If it is rejected, everything it wrote is undone, and the
    /// caller may go on or pass the rejection up.
    ///
    /// # Errors
    /// The callee's rejection, [`Code::UnknownChaincode`], [`Code::LimitExceeded`] if nested too deep.
    pub fn call(&mut self, chaincode: &str, function: &str, args: &[Bytes]) -> Result<Bytes, Rejection> {
        let depth = self.deeper()?;
        let environment = self.environment;
        let callee = environment.registry.find(chaincode)?;
        check_ordinary(callee, function)?;
        run((environment, None), callee.name(), depth, self.overlay, self.events, |ctx| {
            callee.invoke(ctx, function, args)
        })
    }

    /// Executes a call that was approved. It acts for those who agreed, so it has no submitter. If it is rejected,
    /// everything it wrote is undone.
    ///
    /// # Errors
    /// As [`Context::call`]; [`Code::BadArgument`] if the function takes no approval.
    pub(crate) fn call_approved(&mut self, approved: &ApprovedBy, call: &Call) -> Result<Bytes, Rejection> {
        let depth = self.deeper()?;
        let environment = Environment { submitter: None, ..self.environment };
        let callee = environment.registry.find(&call.chaincode)?;
        quorum_of(callee, &call.function)?;
        run((environment, Some(approved)), callee.name(), depth, self.overlay, self.events, |ctx| {
            callee.invoke(ctx, &call.function, &call.args)
        })
    }

    /// The outcome that [`Context::call_approved`] would have now; nothing of it is kept.
    pub(crate) fn rehearse_approved(&mut self, approved: &ApprovedBy, call: &Call) -> Result<Bytes, Rejection> {
        let emitted = self.events.len();
        self.overlay.begin();
        let outcome = self.call_approved(approved, call);
        self.overlay.rollback();
        self.events.truncate(emitted);
        outcome
    }

    /// The installed chaincodes.
    pub(crate) fn registry(&self) -> &'a Registry {
        self.environment.registry
    }

    /// The depth of a call that this one makes.
    fn deeper(&self) -> Result<usize, Rejection> {
        if self.depth + 1 < CALL_DEPTH_MAX {
            return Ok(self.depth + 1);
        }
        Err(Rejection::new(Code::LimitExceeded, "chaincode calls are nested too deeply")
            .found(format!("depth {}", self.depth + 1))
            .wanted(format!("at most {}", CALL_DEPTH_MAX - 1)))
    }

    /// Tells every installed chaincode that an identity was revoked (see [`super::Chaincode::identity_revoked`]).
    pub(crate) fn tell_revoked(&mut self, revoked: &Revocation) -> Result<(), Rejection> {
        self.tell(|chaincode, ctx| chaincode.identity_revoked(ctx, revoked))
    }

    /// Tells every installed chaincode that an organisation was removed (see
    /// [`super::Chaincode::organisation_removed`]).
    pub(crate) fn tell_organisation_removed(&mut self, organisation: &str) -> Result<(), Rejection> {
        self.tell(|chaincode, ctx| chaincode.organisation_removed(ctx, organisation))
    }

    /// Tells every installed chaincode that an organisation has lost an authority (see [`super::Chaincode::authority_lost`]).
    pub(crate) fn tell_authority_lost(&mut self, issuer: &[u8; 32]) -> Result<(), Rejection> {
        self.tell(|chaincode, ctx| chaincode.authority_lost(ctx, issuer))
    }

    fn tell(&mut self, hook: impl Fn(&dyn Chaincode, &mut Context<'_>)) -> Result<(), Rejection> {
        let (environment, depth) = (self.environment, self.depth + 1);
        // The end of somebody's rights must not fail because there are many.
        environment.meter.uncounted(|| {
            for chaincode in environment.registry.iter() {
                run_hook((environment, chaincode.name(), depth), self.overlay, self.events, |ctx| {
                    hook(chaincode, ctx)
                })?;
            }
            Ok(())
        })
    }

    fn full_key(&self, key: &[u8]) -> Bytes {
        let mut full = BytesMut::with_capacity(self.chaincode.len() + 1 + key.len());
        full.put_slice(self.chaincode.as_bytes());
        full.put_u8(0);
        full.put_slice(key);
        full.freeze()
    }

    fn exceeded(&mut self, found: String, wanted: String) {
        let chaincode = self.chaincode;
        self.limit_exceeded.get_or_insert_with(|| {
            Rejection::new(Code::LimitExceeded, format!("chaincode {chaincode:?} exceeded a limit"))
                .found(found)
                .wanted(wanted)
        });
    }
}

/// Runs a hook in a layer of its own, as [`run`] does.
pub(super) fn run_hook(
    (environment, chaincode, depth): (Environment<'_>, &'static str, usize),
    overlay: &mut Overlay,
    events: &mut Vec<Event>,
    body: impl FnOnce(&mut Context<'_>),
) -> Result<(), Rejection> {
    run((environment, None), chaincode, depth, overlay, events, |ctx| {
        ctx.cannot_refuse = true;
        body(ctx);
        Ok(Bytes::new())
    })
    .map(drop)
}

/// Runs one call in a layer of its own: kept if it succeeds, undone if it is rejected, panics, exceeded a limit or is over its
/// budget. The caller at the bottom has the reason from the meter.
pub(super) fn run(
    (environment, approved): (Environment<'_>, Option<&ApprovedBy>),
    chaincode: &'static str,
    depth: usize,
    overlay: &mut Overlay,
    events: &mut Vec<Event>,
    body: impl FnOnce(&mut Context<'_>) -> Result<Bytes, Rejection>,
) -> Result<Bytes, Rejection> {
    let (layers, emitted) = (overlay.depth(), events.len());
    overlay.begin();
    let outcome = catch_unwind(AssertUnwindSafe(|| {
        let mut ctx = Context { depth, approved, ..Context::new(environment, chaincode, overlay, events) };
        let response = body(&mut ctx)?;
        ctx.limit_exceeded.map_or(Ok(response), Err)
    }))
    .unwrap_or_else(|panic| {
        Err(match panic.is::<Stopped>() {
            true => Rejection::new(Code::OverBudget, "the call exceeds its budget"),
            false => Rejection::new(
                Code::ChaincodePanic,
                format!("chaincode {chaincode:?} panicked; its writes were discarded"),
            ),
        })
    });
    // A panic inside a nested call leaves that call's layers open.
    while overlay.depth() > layers + 1 {
        overlay.rollback();
    }
    match outcome {
        Ok(_) => overlay.commit(),
        Err(_) => {
            overlay.rollback();
            events.truncate(emitted);
        }
    }
    outcome
}
