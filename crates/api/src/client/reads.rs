//! Calls that change nothing, and so may be repeated.

use super::Client;
use super::retry::{ATTEMPT_MAX, RETRY_AFTER, is_final};
use super::uplink::Uplink;
use crate::report::accepted;
use crate::{pages, v1};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use serde::de::DeserializeOwned;
use std::time::{Duration, Instant};
use tokio::time::{sleep, timeout, timeout_at};
use tonic::{Response, Status};

/// The answer of a query.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    /// The answer of the function.
    pub response: Bytes,
    /// Height of the state that answered.
    pub height: u64,
    /// Block time of that height, microseconds since the UNIX epoch.
    pub time: u64,
    /// For so long the node has reached no leader, microseconds; 0 if it reaches one.
    pub stale_for: u64,
}

impl Client {
    /// Calls a function on the committed state, throwing its writes away. The answer reflects everything that any node
    /// had acknowledged to anybody before this call: that costs a round from the node to the leader, and from there to
    /// a majority.
    ///
    /// # Errors
    /// The verdict, if it is not 0; [`Code::NoLeader`] if no leader could confirm it before the deadline;
    /// [`Code::Unreachable`] and its kin when the deadline has passed.
    pub async fn query(&self, chaincode: &str, function: &str, args: Vec<Bytes>) -> Result<Answer, Rejection> {
        let (chaincode, function) = (chaincode.into(), function.into());
        self.query_for(v1::QueryRequest { chaincode, function, args, min_height: 0, may_be_stale: false }).await
    }

    /// All elements of a list that comes in pages (see [`pages::follow`]).
    ///
    /// # Errors
    /// As [`Client::query`]; [`Code::Malformed`] for an answer that is no page.
    pub async fn list<T: DeserializeOwned>(&self, chaincode: &str, function: &str) -> Result<Vec<T>, Rejection> {
        let ask = |args| async move { Ok(self.query(chaincode, function, args).await?.response) };
        pages::follow(&format!("the answer to {chaincode} {function}"), ask).await
    }

    /// As [`Client::query`], on whatever state of at least this height the node has; 0 = any. Asks nobody else, so it
    /// is answered without a leader, too, and may be older than what others were told.
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
        let ask = |up: Uplink| {
            let request = request.clone();
            async move { up.gateway().query(request).await }
        };
        let answer = self.ask(ask, |answer| accepted(answer.verdict.as_ref())).await?;
        let v1::QueryResponse { response, height, time, stale_for, .. } = answer;
        Ok(Answer { response, height, time, stale_for })
    }

    /// How the node is that the client is connected to.
    ///
    /// # Errors
    /// [`Code::Unreachable`] and its kin when the deadline has passed.
    pub async fn status(&self) -> Result<v1::StatusResponse, Rejection> {
        self.ask(|up| async move { up.gateway().status(v1::StatusRequest {}).await }, |_| Ok(())).await
    }

    /// How every node of the network is, as the node says to which the client is connected: it asks the others, at most every
    /// five seconds.
    ///
    /// # Errors
    /// As [`Client::status`].
    pub async fn nodes(&self) -> Result<Vec<v1::NodeStatus>, Rejection> {
        let ask = |up: Uplink| async move { up.gateway().nodes(v1::NodesRequest {}).await };
        Ok(self.ask(ask, |_| Ok(())).await?.nodes)
    }

    /// One block with its transactions and verdicts.
    ///
    /// # Errors
    /// [`Code::NotFound`] if there is none of this height yet, [`Code::Pruned`] if the node has dropped it; else as [`Client::status`].
    pub async fn block(&self, height: u64) -> Result<v1::Block, Rejection> {
        self.ask(|up| async move { up.gateway().get_block(v1::GetBlockRequest { height }).await }, |_| Ok(())).await
    }

    /// Where a transaction is and what became of it.
    ///
    /// # Errors
    /// [`Code::NotFound`] if the node knows none of this id, [`Code::Pruned`] if it may be in a dropped block; else as [`Client::status`].
    pub async fn transaction(&self, id: Hash) -> Result<v1::TransactionRecord, Rejection> {
        self.record(id, Duration::ZERO).await
    }

    /// Waits so long until a transaction is certified: enough voters have signed its block or a later one, as the node says. Is it?
    ///
    /// # Errors
    /// As [`Client::transaction`].
    pub async fn certified(&self, id: Hash, within: Duration) -> Result<bool, Rejection> {
        Ok(self.record(id, within).await?.certified)
    }

    pub(super) async fn record(&self, id: Hash, within: Duration) -> Result<v1::TransactionRecord, Rejection> {
        let certified_within_ms = u32::try_from(within.as_millis()).unwrap_or(u32::MAX);
        let ask = |up: Uplink| async move {
            let id = Bytes::copy_from_slice(id.as_ref());
            up.gateway().get_transaction(v1::GetTransactionRequest { id, certified_within_ms }).await
        };
        self.ask(ask, |_| Ok(())).await
    }

    /// Calls that the node refused lately before ordering, newest first; for admins. 0 = the node's default number.
    ///
    /// # Errors
    /// [`Code::NotAdmin`]; else as [`Client::status`].
    pub async fn denials(&self, limit: u32) -> Result<Vec<v1::Denial>, Rejection> {
        let ask = |up: Uplink| async move { up.gateway().denials(v1::DenialsRequest { limit }).await };
        Ok(self.ask(ask, |_| Ok(())).await?.denials)
    }

    /// Tells who did what, and who was refused, from the index of the node: one part of the answer, which says where the next goes on.
    ///
    /// # Errors
    /// As [`Client::status`].
    pub async fn audit(&self, request: v1::AuditRequest) -> Result<v1::AuditResponse, Rejection> {
        let ask = |up: Uplink| {
            let request = request.clone();
            async move { up.gateway().audit(request).await }
        };
        self.ask(ask, |_| Ok(())).await
    }

    /// The node's description of its network.
    ///
    /// # Errors
    /// As [`Client::status`].
    pub async fn network(&self) -> Result<v1::NetworkResponse, Rejection> {
        self.ask(|up| async move { up.enrolment().network(v1::NetworkRequest {}).await }, |_| Ok(())).await
    }

    /// Has a key certified by the CA of the own organisation, by what proves who we are: the present certificate.
    pub(crate) async fn certify(&self, request: Bytes) -> Result<Bytes, Rejection> {
        let up = timeout(self.session.options.deadline, self.session.carrier());
        let up = up.await.map_err(|_| self.session.no_connection())??;
        let mut enrolment = up.enrolment();
        // Once: a CA that says "not now" means minutes.
        let answer = timeout(ATTEMPT_MAX, enrolment.renew(v1::RenewRequest { request })).await;
        let answer =
            answer.map_err(|_| crate::connect::unreachable(&up.connection.address, "no answer to a renewal"))?;
        let answer = answer.map_err(|status| up.connection.refusal(&status))?.into_inner();
        accepted(answer.verdict.as_ref())?;
        Ok(answer.certificate)
    }

    /// Asks until a node answers, or the deadline has passed. `check` finds the verdict in an answer.
    pub(super) async fn ask<R, F, A>(
        &self,
        call: F,
        check: impl Fn(&R) -> Result<(), Rejection>,
    ) -> Result<R, Rejection>
    where
        F: Fn(Uplink) -> A,
        A: Future<Output = Result<Response<R>, Status>>,
    {
        let deadline = Instant::now() + self.session.options.deadline;
        let mut last = None;
        while Instant::now() < deadline {
            let Ok(up) = timeout_at(deadline.into(), self.session.up()).await else { break };
            let up = up?;
            let (number, connection) = (up.number, up.connection.clone());
            let until = deadline.min(Instant::now() + ATTEMPT_MAX);
            let (refused, leave) = match timeout_at(until.into(), call(up)).await {
                Ok(Ok(answer)) => {
                    let answer = answer.into_inner();
                    match check(&answer) {
                        Ok(()) => {
                            self.session.last_answers.served(&connection.address);
                            return Ok(answer);
                        }
                        Err(refused) => (refused, false),
                    }
                }
                Ok(Err(status)) => {
                    let refused = connection.refusal(&status);
                    // Cut off from the leader, or behind: another node may be neither.
                    let own = self.session.several()
                        && matches!(refused.code, Code::NoLeader | Code::Behind | Code::ClockOutOfBounds);
                    let leave = own || refused.code == Code::ShuttingDown;
                    (refused, leave)
                }
                // Cut short by the deadline: what the node said before is the better reason.
                Err(_) if until == deadline && last.is_some() => break,
                Err(_) => (crate::connect::unreachable(&connection.address, "no answer to a query"), true),
            };
            if is_final(&refused) {
                return Err(refused);
            }
            self.session.last_answers.rejected(&connection.address, &refused, Instant::now());
            // A connection that broke is replaced without our asking.
            if leave {
                self.session.leave(number);
            }
            last = Some(refused);
            sleep(RETRY_AFTER).await;
        }
        let answers = &self.session.last_answers;
        Err(last.map_or_else(|| self.session.no_connection(), |last| answers.instead_of(last, Instant::now())))
    }
}
