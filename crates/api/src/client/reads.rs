//! Calls that change nothing, and so may be repeated; and registrations.

use super::Client;
use super::dialer::is_final;
use super::in_flight::{ATTEMPT_MAX, RETRY_AFTER};
use super::session::Up;
use crate::report::accepted;
use crate::v1;
use ledger::identity::Role;
use ledger::{Bytes, Code, Hash, Rejection};
use std::collections::BTreeMap;
use std::time::Instant;
use tokio::time::{sleep, timeout, timeout_at};
use tonic::{Response, Status};

/// Who is asked.
#[derive(Clone, Copy)]
enum Whom {
    /// The node that the client is connected to.
    Anybody,
    /// A node that carries the CA of the own organisation.
    Carrier,
}

/// What a query answered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    /// What the function returned.
    pub response: Bytes,
    /// Height of the state that answered.
    pub height: u64,
}

/// A new registration.
#[derive(Clone, PartialEq, Eq)]
pub struct Registered {
    /// The one-time secret for the enrolment; the node does not show it again.
    pub secret: String,
    /// The organisation that will issue the certificate.
    pub organisation: String,
}

impl Client {
    /// Calls a function on the committed state, throwing its writes away. The answer reflects everything that any node
    /// had acknowledged to anybody before this call: that costs a round from the node to the leader, and from there to a
    /// majority.
    ///
    /// # Errors
    /// The verdict, if it is not 0; [`Code::NoLeader`] if no leader could confirm it before the deadline;
    /// [`Code::Unreachable`] and its kin when the deadline has passed.
    pub async fn query(&self, chaincode: &str, function: &str, args: Vec<Bytes>) -> Result<Answer, Rejection> {
        let (chaincode, function) = (chaincode.into(), function.into());
        let min_height = self.height_seen();
        self.query_for(v1::QueryRequest { chaincode, function, args, min_height, may_be_stale: false }).await
    }

    /// As [`Client::query`], on whatever state of at least this height the node has; 0 = any. Asks nobody else, so it is
    /// answered without a leader, too, and may be older than what others were told.
    ///
    /// # Errors
    /// As [`Client::query`]; [`Code::Behind`] if no node reaches the height in time.
    pub async fn query_at(
        &self,
        min_height: u64,
        chaincode: &str,
        function: &str,
        args: Vec<Bytes>,
    ) -> Result<Answer, Rejection> {
        let (chaincode, function) = (chaincode.into(), function.into());
        self.query_for(v1::QueryRequest { chaincode, function, args, min_height, may_be_stale: true }).await
    }

    async fn query_for(&self, request: v1::QueryRequest) -> Result<Answer, Rejection> {
        let ask = |up: Up| {
            let request = request.clone();
            async move { up.gateway().query(request).await }
        };
        let answer = self.ask(ask, |answer| accepted(answer.verdict.as_ref())).await?;
        Ok(Answer { response: answer.response, height: answer.height })
    }

    /// How the node is that the client is connected to.
    ///
    /// # Errors
    /// [`Code::Unreachable`] and its kin when the deadline has passed.
    pub async fn status(&self) -> Result<v1::StatusResponse, Rejection> {
        self.ask(|up| async move { up.gateway().status(v1::StatusRequest {}).await }, |_| Ok(())).await
    }

    /// One block with its transactions and verdicts.
    ///
    /// # Errors
    /// [`Code::NotFound`] if there is none of this height yet; else as [`Client::status`].
    pub async fn block(&self, height: u64) -> Result<v1::Block, Rejection> {
        self.ask(|up| async move { up.gateway().get_block(v1::GetBlockRequest { height }).await }, |_| Ok(())).await
    }

    /// Where a transaction is and what became of it.
    ///
    /// # Errors
    /// [`Code::NotFound`] if the node knows none of this id; else as [`Client::status`].
    pub async fn transaction(&self, id: Hash) -> Result<v1::TransactionRecord, Rejection> {
        let ask = |up: Up| async move {
            let id = Bytes::copy_from_slice(id.as_ref());
            up.gateway().get_transaction(v1::GetTransactionRequest { id }).await
        };
        self.ask(ask, |_| Ok(())).await
    }

    /// What the node refused lately before it was ordered, newest first; for admins. 0 = the node's default number.
    ///
    /// # Errors
    /// [`Code::NotAdmin`]; else as [`Client::status`].
    pub async fn denials(&self, limit: u32) -> Result<Vec<v1::Denial>, Rejection> {
        let ask = |up: Up| async move { up.gateway().denials(v1::DenialsRequest { limit }).await };
        Ok(self.ask(ask, |_| Ok(())).await?.denials)
    }

    /// What the node says of its network.
    ///
    /// # Errors
    /// As [`Client::status`].
    pub async fn network(&self) -> Result<v1::NetworkResponse, Rejection> {
        self.ask(|up| async move { up.enrolment().network(v1::NetworkRequest {}).await }, |_| Ok(())).await
    }

    /// The registered identities of the own organisation: of this name, or all for an empty one.
    ///
    /// # Errors
    /// [`Code::NotAdmin`]; else as [`Client::status`].
    pub async fn identities(&self, name: &str) -> Result<Vec<v1::RegisteredIdentity>, Rejection> {
        let ask = |up: Up| {
            let request = v1::ListIdentitiesRequest { name: name.into() };
            async move { up.enrolment().list_identities(request).await }
        };
        Ok(self.ask_of(Whom::Carrier, ask, |answer| accepted(answer.verdict.as_ref())).await?.identities)
    }

    /// Registers a name with its role and attributes, as an admin of the organisation. Not repeated if the connection
    /// breaks: the secret is shown once.
    ///
    /// # Errors
    /// [`Code::NotAdmin`], [`Code::AlreadyRegistered`]; [`Code::Timeout`] if no answer came and it may have happened.
    pub async fn register(
        &self,
        name: &str,
        role: Role,
        attributes: &BTreeMap<String, String>,
    ) -> Result<Registered, Rejection> {
        let (name, role, attributes) = (name.to_owned(), role.as_str().to_owned(), attributes.clone());
        self.register_once(v1::RegisterRequest { name, role, attributes, reissue: false }).await
    }

    /// A new one-time secret for a registered name, whose role stays; attributes replace the old ones, none keep them.
    /// Certificates issued before stay valid until they expire or are revoked.
    ///
    /// # Errors
    /// [`Code::NotAdmin`], [`Code::NotFound`]; [`Code::Timeout`] as [`Client::register`].
    pub async fn reissue(&self, name: &str, attributes: &BTreeMap<String, String>) -> Result<Registered, Rejection> {
        let (name, attributes) = (name.to_owned(), attributes.clone());
        self.register_once(v1::RegisterRequest { name, role: String::new(), attributes, reissue: true }).await
    }

    async fn register_once(&self, request: v1::RegisterRequest) -> Result<Registered, Rejection> {
        let name = request.name.clone();
        let up = timeout(self.session.options.deadline, self.session.carrier());
        let up = up.await.map_err(|_| self.session.no_connection())??;
        let mut enrolment = up.enrolment();
        let unknown = |found: String| {
            Rejection::new(
                Code::Timeout,
                format!("no answer came to the registration of {name:?}; it may have happened"),
            )
            .found(found)
            .next(format!("ledgerctl identity show {name}"))
        };
        let answer = timeout(self.session.options.deadline, enrolment.register(request)).await;
        let answer = answer.map_err(|_| unknown("the deadline has passed".into()))?.map_err(|status| {
            let refused = up.connection.refusal(&status);
            if refused.code == Code::Unreachable { unknown(refused.found) } else { refused }
        })?;
        let answer = answer.into_inner();
        accepted(answer.verdict.as_ref())?;
        Ok(Registered { secret: answer.secret, organisation: answer.organisation })
    }

    /// Has a key certified by the CA of the own organisation, by what proves who we are: the present certificate.
    pub(crate) async fn certify(&self, request: Bytes) -> Result<Bytes, Rejection> {
        let ask = |up: Up| {
            let request = v1::RenewRequest { request: request.clone() };
            async move { up.enrolment().renew(request).await }
        };
        Ok(self.ask_of(Whom::Carrier, ask, |answer| accepted(answer.verdict.as_ref())).await?.certificate)
    }

    /// Asks until a node answers, or the deadline has passed. `check` finds the verdict in an answer.
    pub(super) async fn ask<R, F, A>(
        &self,
        call: F,
        check: impl Fn(&R) -> Result<(), Rejection>,
    ) -> Result<R, Rejection>
    where
        F: Fn(Up) -> A,
        A: Future<Output = Result<Response<R>, Status>>,
    {
        self.ask_of(Whom::Anybody, call, check).await
    }

    async fn ask_of<R, F, A>(
        &self,
        whom: Whom,
        call: F,
        check: impl Fn(&R) -> Result<(), Rejection>,
    ) -> Result<R, Rejection>
    where
        F: Fn(Up) -> A,
        A: Future<Output = Result<Response<R>, Status>>,
    {
        let deadline = Instant::now() + self.session.options.deadline;
        let mut last = None;
        while Instant::now() < deadline {
            let up = async {
                match whom {
                    Whom::Anybody => self.session.up().await,
                    Whom::Carrier => self.session.carrier().await,
                }
            };
            let Ok(up) = timeout_at(deadline.into(), up).await else { break };
            let up = up?;
            let (number, connection) = (up.number, up.connection.clone());
            let until = deadline.min(Instant::now() + ATTEMPT_MAX);
            let (refused, leave) = match timeout_at(until.into(), call(up)).await {
                Ok(Ok(answer)) => {
                    let answer = answer.into_inner();
                    match check(&answer) {
                        Ok(()) => return Ok(answer),
                        Err(refused) => (refused, false),
                    }
                }
                Ok(Err(status)) => {
                    let refused = connection.refusal(&status);
                    // Cut off from the leader, or behind: another node may be neither.
                    let own = self.session.several() && matches!(refused.code, Code::NoLeader | Code::Behind);
                    let leave = own || refused.code == Code::ShuttingDown;
                    (refused, leave)
                }
                // Cut short by the deadline: what the node said before is the better reason.
                Err(_) if until == deadline && last.is_some() => break,
                Err(_) => (crate::connect::unreachable(&connection.address, "no answer to a question"), true),
            };
            if is_final(&refused) {
                return Err(refused);
            }
            // A connection that broke is replaced without our asking.
            if leave {
                self.session.leave(number);
            }
            last = Some(refused);
            sleep(RETRY_AFTER).await;
        }
        Err(last.unwrap_or_else(|| self.session.no_connection()))
    }
}
