//! Chaincode: the programs that every node executes in block order.
//!
//! A chaincode is a Rust type that implements [`Chaincode`]. It is compiled into the node and called through a
//! [`Context`], which is all it may know: no clock, no randomness, no IO, so that every node computes the same.

mod approval;
mod budget;
mod context;
mod invocation;
mod registry;

pub use approval::{ADMINS_PER_ORGANISATION_MAX, ApprovedBy, Call, NotAQuorum, Quorum};
pub(crate) use approval::{MSP, quorum_of};
pub use budget::{BLOCK_BUDGET, CALL_BUDGET, Meter, QUERY_BUDGET, Usage};
pub use context::{Context, Environment};
pub use registry::Registry;

use bytes::Bytes;
use ledger_base::rejection::Rejection;
use ledger_identity::Identity;
use ledger_storage::result::Event;

/// The budget of a service by its owner.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServiceBudget {
    /// The name of the service in full, as events have it.
    pub service: String,
    /// Its owner.
    pub organisation: String,
    /// Bytes a second, if the owner has set less than its organisation's quota.
    pub bytes_per_s: Option<u64>,
    /// Messages a second, if the owner has set less than its organisation's quota.
    pub messages_per_s: Option<u64>,
}

/// A program that every node executes in block order.
pub trait Chaincode: Send + Sync {
    /// The name under which it is called and its keys are kept: lower-case letters, digits and `-`.
    fn name(&self) -> &'static str;

    /// Executes one call. Called once per transaction call, in block order, on every node; the same function
    /// serves queries, whose writes are thrown away. Must be deterministic: everything it may know is in `ctx`.
    ///
    /// # Errors
    /// A [`Rejection`] undoes every write of the call and becomes the verdict. A panic does the same with
    /// [`ChaincodePanic`](ledger_base::rejection::Code::ChaincodePanic).
    fn invoke(&self, ctx: &mut Context<'_>, function: &str, args: &[Bytes]) -> Result<Bytes, Rejection>;

    /// The answer and the events of a successful call, where the call alone determines them. A node then keeps neither:
    /// it has the call in its block. A different outcome of [`Chaincode::invoke`] is kept as it was.
    ///
    /// The foretold outcome of a call must never change: results that were kept without it are read with it.
    fn foretell(&self, _function: &str, _args: &[Bytes]) -> Option<Foretold> {
        None
    }

    /// The functions that only read. They are queries: a transaction that calls one is refused, and one that
    /// writes or emits all the same, too. Other chaincodes may call them.
    fn reads(&self) -> &'static [&'static str] {
        &[]
    }

    /// Must calls of this function overtake data that waits to be ordered? For what ends or hands over control:
    /// release, revoke, stop. A node lets them overtake while they are small and few; the rest waits with the data.
    fn urgent(&self, _function: &str) -> bool {
        false
    }

    /// Does a call of this function only ask for certified state, for a robot that stops without an answer? Such a call waits with the
    /// data. Voters complain about a leader that leaves it out, sooner than with a call that changes something.
    fn asks(&self, _function: &str) -> bool {
        false
    }

    /// The service on which a call publishes, as the call names it, and the number of its messages; nothing for other calls.
    fn publishes<'a>(&self, _function: &str, _args: &'a [Bytes]) -> Option<(&'a str, u64)> {
        None
    }

    /// The number of messages that an event reports, which were published on the service that is its subject.
    fn published(&self, _event: &Event) -> Option<u64> {
        None
    }

    /// The budget that its owner has set for a service, if there is such a service.
    fn service_budget(&self, _ctx: &Context<'_>, _service: &str) -> Option<ServiceBudget> {
        None
    }

    /// Do calls of this function only end control, so that they are accepted while the disk has no room for others? For
    /// release and revoke. Somebody must not be able to call it often: what these calls have is a small reserve.
    fn ends(&self, _function: &str) -> bool {
        false
    }

    /// Does a call of this function only end control, for somebody's safety, so that robots hear of it before it is ordered?
    /// For an emergency stop. Every node that its caller may call it at tells its readers at once what it would do
    /// ([`Ledger::foresee`](crate::Ledger::foresee)), also where nothing can be ordered. Its verdict counts all the same.
    fn told_early(&self, _function: &str) -> bool {
        false
    }

    /// The functions whose calls need approval, each with the quorum that it needs unless the network decides otherwise.
    /// Such a call is proposed (`msp propose`) and executed once its quorum agrees; then [`Context::approved_by`] names
    /// who did, and there is no submitter. Called directly, these functions are refused before [`Chaincode::invoke`].
    fn needs_approval(&self) -> &'static [(&'static str, Quorum)] {
        &[]
    }

    /// Beginnings of the keys (without the chaincode's name) that hold *control state*: who may do what now, which a robot or an
    /// auditor believes only with a certificate. Each write to one of them makes its block one that voters certify, so no
    /// key that usual traffic writes belongs here. Part of the rules: it may only change with their number.
    fn control_keys(&self) -> &'static [&'static str] {
        &[]
    }

    /// Called at the start of every block, before its transactions, with the block's time: the place for what
    /// is due (leases, deadlines). There is no submitter.
    fn begin_block(&self, _ctx: &mut Context<'_>) {}

    /// The earliest block time (microseconds) at which [`Chaincode::begin_block`] has something to do. The
    /// leader orders an empty block when its clock passes it and no traffic did.
    fn next_deadline(&self, _ctx: &Context<'_>) -> Option<u64> {
        None
    }

    /// Called within the transaction that revokes an identity, so that its rights end in the same block.
    fn identity_revoked(&self, _ctx: &mut Context<'_>, _revoked: &Revocation) {}

    /// Called within the transaction that removes an organisation, so that the rights of its members, and rights to
    /// what it owned, end in the same block.
    fn organisation_removed(&self, _ctx: &mut Context<'_>, _organisation: &str) {}

    /// Called within the transaction by which an organisation loses an authority, so that the rights of those whom it has
    /// certified end in the same block. `issuer`: SHA-256 of its distinguished name.
    fn authority_lost(&self, _ctx: &mut Context<'_>, _issuer: &[u8; 32]) {}

    /// The names of all events that it emits, so that who subscribes to another one is told. Empty: it does not say.
    fn events(&self) -> &'static [&'static str] {
        &[]
    }

    /// May the submitter of `ctx` follow events of these names about these subjects? No names, or no subjects, stand
    /// for all that they may read. Asked when somebody subscribes, and again while the subscription lasts: without an
    /// answer here, who asks for what they may not read would hear nothing and never learn why.
    ///
    /// # Errors
    /// The reason why not; the subscription is then refused, or ends with it.
    fn may_follow(&self, _ctx: &Context<'_>, _subjects: &[String], _names: &[String]) -> Result<(), Rejection> {
        Ok(())
    }

    /// May the submitter of `ctx` see this event? Asked for each event at delivery, so it should be quick.
    ///
    /// # Errors
    /// The reason why not; the event is then skipped.
    fn may_read(&self, _ctx: &Context<'_>, _event: &Event) -> Result<(), Rejection> {
        Ok(())
    }
}

/// The answer of [`Chaincode::foretell`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Foretold {
    /// The answer of the call.
    pub response: Bytes,
    /// Its events, in order.
    pub events: Vec<Event>,
}

/// The name of a revoked certificate: never its fingerprint, because a signature can be rewritten.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Revocation {
    /// SHA-256 of the issuer's distinguished name as in the certificate.
    pub issuer: [u8; 32],
    /// The serial number, big-endian, as in the certificate.
    pub serial: Vec<u8>,
}

impl Revocation {
    /// Is this the certificate of that identity?
    pub fn names(&self, identity: &Identity) -> bool {
        self.issuer == identity.issuer && self.serial == identity.serial
    }
}
