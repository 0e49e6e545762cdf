//! The client of a network: signs, submits, asks and subscribes, through whichever of its nodes answers.
//!
//! ```text
//! client          the calls that a program makes
//!   session       the one connection, and its replacement by another when it breaks
//!     dialer      finding a node that serves
//!     learning    which nodes there are, as the network tells it
//!     in_flight   transactions without a verdict yet; survives the connection
//!     fresh       which of them no node has seen
//!     clock       the node's clock
//!     uplink      the connection in use, with its services
//!     retry       when to try again
//!   pending       the future verdict on a transaction
//!   reads         queries, status, blocks
//!   believing     answers that need no trust in a node
//!   identities    the registry of the own organisation
//!   leadership    choosing who leads
//!   events        subscriptions that resume where they were cut off
//! ```

mod believing;
mod clock;
mod dialer;
mod events;
mod fresh;
mod identities;
mod in_flight;
mod last_answers;
mod leadership;
mod learning;
mod pending;
mod reads;
mod retry;
mod session;
mod uplink;

pub use believing::{Certified, read_checkpoint};
pub use events::{EventStream, Subscription};
pub use identities::{Registered, SECRET_LIFE};
pub use in_flight::{IN_FLIGHT_BYTES_MAX, IN_FLIGHT_MAX};
pub use leadership::Leadership;
pub use pending::Pending;
pub use reads::Answer;

use crate::connect::Credentials;
use crate::context::Context;
use crate::tls::TlsIdentity;
use crate::v1;
use bytes::Bytes;
use in_flight::Patience;
use learning::Nodes;
use ledger::transaction::{Body, NONCE_BYTES, Transaction};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ring::rand::{SecureRandom, SystemRandom};
use session::Session;
use std::sync::Arc;
use std::time::Duration;

/// How long an outcome is waited for to be certified: a majority of the voters is one exchange of messages away.
const CERTIFIED_WITHIN: Duration = Duration::from_secs(2);

/// Time for the question about it besides.
const ANSWER_TIME: Duration = Duration::from_secs(1);

/// How patient a client is.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// How long a call is tried, through one node after another, until it fails.
    pub deadline: Duration,
    /// How long connecting to one node may take.
    pub connect: Duration,
    /// How long after now transactions of [`Client::invoke`] may still be executed, by the node's clock. Longer than
    /// `deadline`, or a late retry expires instead of being answered.
    pub ttl: Duration,
    /// How long [`Client::invoke`] waits until its outcome is certified, where the network certifies now.
    pub certified: Duration,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            deadline: Duration::from_secs(10),
            connect: Duration::from_secs(3),
            ttl: Duration::from_secs(30),
            certified: CERTIFIED_WITHIN,
        }
    }
}

/// A call of a chaincode function that is to be signed.
#[derive(Clone, Debug)]
pub struct Call {
    /// Name of the chaincode.
    pub chaincode: String,
    /// Name of its function.
    pub function: String,
    /// Arguments in order.
    pub args: Vec<Bytes>,
    /// How long after now it may still be executed. Commands to a robot: a second or two.
    pub ttl: Duration,
}

/// A transaction that was executed with verdict 0.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Committed {
    /// Id of the transaction.
    pub id: Hash,
    /// Height of its block.
    pub height: u64,
    /// Its position in the block.
    pub index: u32,
    /// Block time, microseconds since the UNIX epoch.
    pub time: u64,
    /// The answer of the function.
    pub response: Bytes,
    /// Enough voters have signed its block or a later one, as the node says. [`Client::invoke`] waits for that; other ways to submit do
    /// not. Under a leader that lies, only certified outcomes are final.
    pub certified: bool,
    /// Voters sign its block, as the node says: it changed who may do what, or the last signed block is 200 ms old. True where no node
    /// has said it.
    pub certificate_due: bool,
}

/// A connection to a network as one identity. Clones share it; it ends with the last clone.
#[derive(Clone)]
pub struct Client {
    session: Arc<Session>,
    credentials: Arc<Credentials>,
    random: SystemRandom,
}

impl Client {
    /// Connects as a stored identity, to whichever node of its network serves. Which nodes there are is learnt from
    /// them while the client lives, and kept in the context if that was loaded from a disk that can be written.
    ///
    /// # Errors
    /// [`Code::Unreachable`] if no node answers; the refusal of a node that does not accept the identity, or ours of its certificate;
    /// [`Code::WrongNetwork`].
    pub async fn connect(context: &Context) -> Result<Self, Rejection> {
        let trusted = context.trusted();
        let credentials = context.credentials_with(&trusted)?;
        Self::over(Nodes::of(context, trusted), credentials, Options::default()).await
    }

    /// Connects to one of these nodes (`HOST:PORT`), the first if it answers, and never to another one.
    ///
    /// # Errors
    /// As [`Client::connect`].
    pub async fn connect_to(nodes: Vec<String>, credentials: Credentials) -> Result<Self, Rejection> {
        Self::connect_with(nodes, credentials, Options::default()).await
    }

    /// As [`Client::connect_to`], with another patience.
    ///
    /// # Errors
    /// As [`Client::connect`].
    pub async fn connect_with(
        nodes: Vec<String>,
        credentials: Credentials,
        options: Options,
    ) -> Result<Self, Rejection> {
        Self::over(Nodes::fixed(nodes), credentials, options).await
    }

    async fn over(nodes: Nodes, credentials: Credentials, options: Options) -> Result<Self, Rejection> {
        let session = Session::start(nodes, &credentials, options).await?;
        Ok(Self { session, credentials: Arc::new(credentials), random: SystemRandom::new() })
    }

    /// Signs a call now. The certificate comes along until the ledger is known to have it. When it is submitted for the
    /// first time, by this client, the node is told that no other node has seen it; so give it to no other client
    /// before.
    ///
    /// # Errors
    /// [`Code::Malformed`] or [`Code::TooLarge`] if the call cannot be a transaction.
    pub fn prepare(&self, call: Call) -> Result<Transaction, Rejection> {
        let mut nonce = [0; NONCE_BYTES];
        self.random
            .fill(&mut nonce)
            .map_err(|_| Rejection::new(Code::Internal, "the system's source of randomness failed"))?;
        let ttl = u64::try_from(call.ttl.as_micros()).unwrap_or(u64::MAX);
        let own = self.credentials.identity.own();
        let creator = own.creator;
        let body = Body {
            network: Bytes::copy_from_slice(self.credentials.network.as_ref()),
            creator: Bytes::copy_from_slice(creator.as_ref()),
            nonce: Bytes::copy_from_slice(&nonce),
            not_after: self.now().saturating_add(ttl),
            chaincode: call.chaincode,
            function: call.function,
            args: call.args,
            known_block: self.session.known_block(),
        };
        let transaction = Transaction::sign_by_id(&body, &own.key)?;
        self.session.in_flight.signed(transaction.id());
        if self.session.in_flight.introduced(&creator) {
            return Ok(transaction);
        }
        transaction.with_certificate(Bytes::copy_from_slice(own.certificate()))
    }

    /// Signs a call, submits it and waits for its verdict; then until that is certified, for as long as [`Options::certified`] says.
    ///
    /// # Errors
    /// The verdict, if it is not 0. [`Code::Timeout`] if the outcome is unknown: the text has the id. [`Code::Contradicted`] if a node
    /// has executed it, and the network does not have it.
    pub async fn invoke(&self, chaincode: &str, function: &str, args: Vec<Bytes>) -> Result<Committed, Rejection> {
        let done = self.execute(chaincode, function, args).await?;
        let within = self.session.options.certified;
        match tokio::time::timeout(within + ANSWER_TIME, self.record(done.id, within)).await {
            Ok(Ok(v1::TransactionRecord { certified, certificate_due, .. })) => {
                Ok(Committed { certified, certificate_due, ..done })
            }
            Ok(Err(refused)) if matches!(refused.code, Code::NotFound | Code::Pruned) => Err(lost(&done)),
            // No node answers that question now.
            _ => Ok(done),
        }
    }

    /// Signs a call, submits it and waits for its verdict, but not until that is certified.
    ///
    /// # Errors
    /// The verdict, if it is not 0. [`Code::Timeout`] if the outcome is unknown: the text has the id.
    pub async fn execute(&self, chaincode: &str, function: &str, args: Vec<Bytes>) -> Result<Committed, Rejection> {
        let call = Call { chaincode: chaincode.into(), function: function.into(), args, ttl: self.session.options.ttl };
        let first = self.submit(self.prepare(call.clone())?).await;
        match first {
            // Refused for its time before it was ordered, so it never will be: sign anew by the right clock.
            Err(refused) if matches!(refused.code, Code::Expired | Code::NotAfterTooFar) => {
                match self.session.learn_clock().await {
                    Ok(()) => self.submit(self.prepare(call)?).await,
                    Err(_) => Err(refused),
                }
            }
            done => done,
        }
    }

    /// Submits a transaction and waits for its verdict. Waits also while too much is in flight.
    ///
    /// After a lost connection, a timeout or "not now", the client sends the same bytes again, through another node if
    /// there is one. The id makes sure that they are executed once. A final answer is not repeated. A refusal is the
    /// chain's verdict, or a promise that the transaction never becomes part of the chain. While neither is known, a
    /// retry is told to ask again. In the end it is told that the outcome is unknown.
    ///
    /// # Errors
    /// As [`Client::invoke`].
    pub async fn submit(&self, transaction: Transaction) -> Result<Committed, Rejection> {
        let room = self.session.in_flight.room(&transaction).await?;
        Pending::send(&self.session, &transaction, room, Patience::Call).await
    }

    /// Submits a transaction at once and answers with its future verdict, which need not be awaited. If too much is in
    /// flight, the verdict is [`Code::Overloaded`] and nothing was sent. A node that says so is not asked again either,
    /// other than by [`Client::submit`]: this is for commands, and by then there is a newer one.
    pub fn submit_nowait(&self, transaction: &Transaction) -> Pending {
        match self.session.in_flight.room_now(transaction) {
            Ok(room) => Pending::send(&self.session, transaction, room, Patience::Command),
            Err(refused) => Pending::refused(refused),
        }
    }

    /// The node's clock now, microseconds since the UNIX epoch: what transactions are dated by. Learnt when a
    /// connection is made, and again when a transaction is refused for its time.
    pub fn now(&self) -> u64 {
        self.session.clock.now()
    }

    /// Address of the node that the client is connected to, or was last.
    pub fn node(&self) -> Arc<str> {
        self.session.address()
    }

    /// SHA-256 of the own certificate.
    pub fn creator(&self) -> Hash {
        self.credentials.identity.own().creator
    }

    /// Goes on with a renewed certificate of the same identity: it signs what comes next, and a new connection shows
    /// it. Transactions in flight are sent again there, and executed once.
    pub fn renew(&self, identity: &TlsIdentity) {
        self.credentials.identity.renew(identity);
        self.session.reconnect();
    }

    /// The largest height at which a transaction or a delivery of this client was.
    pub fn height_seen(&self) -> u64 {
        self.session.height_seen()
    }
}

/// A node has answered that a transaction was executed, and another one has no such transaction.
fn lost(done: &Committed) -> Rejection {
    let Committed { id, height, .. } = done;
    Rejection::new(
        Code::Contradicted,
        format!("transaction {id} was executed by a node, but is not part of the network's chain"),
    )
    .found(format!("an answer for block {height} that is not certified"))
    .wanted("a certified outcome")
    .next("check ledgerctl network status, and repeat calls that are still wanted")
}
