//! The calls that a bridge needs of the ledger, so that routes can be tested without one.

use std::{collections::BTreeSet, time::Duration};

use bytes::Bytes;
use futures::{
    FutureExt,
    future::BoxFuture,
    stream::{self, BoxStream, StreamExt},
};
use ledger::CallRef;
use ledger_api::{Answer, Call, Certified, Client, Subscription, v1::Delivery};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_gate::{ABAC, gate::COMMAND_TTL};
use ledger_light::Governance;
use serde::de::DeserializeOwned;

use super::reader_slot::SlotSubscription;

/// How often the ledger gives a sign of life.
pub(crate) const HEARTBEAT_MS: u32 = 250;
/// How long a question may be on its way to its block.
const QUESTION_TTL: Duration = Duration::from_secs(5);

/// Deliveries as they come; an error is followed by more, some time later.
pub(crate) type Deliveries = BoxStream<'static, Result<Delivery, Rejection>>;
/// A verdict to come.
pub(crate) type Verdict = BoxFuture<'static, Result<(), Rejection>>;

/// The ledger as routes see it.
pub(crate) trait Gateway: Send + Sync + 'static {
    /// Calls a function on a state of at least that height.
    fn query(
        &self,
        height: u64,
        chaincode: &str,
        function: &str,
        args: Vec<Bytes>,
    ) -> BoxFuture<'static, Result<Answer, Rejection>>;

    /// Address of the node that answers, or that did last.
    fn node(&self) -> String;

    /// Height of the last executed block.
    fn height(&self) -> BoxFuture<'static, Result<u64, Rejection>>;

    /// The governance at the genesis, as the network's name covers it; none if nobody certified that.
    fn beginning(&self) -> BoxFuture<'static, Result<Governance, Rejection>>;

    /// Asks in a transaction how a robot stands, and which of these stops are settled. The answer comes with its proof, checked from
    /// what is known.
    fn declare(
        &self,
        robot: &str,
        stops: &BTreeSet<CallRef>,
        known: Governance,
    ) -> BoxFuture<'static, Result<Certified, Rejection>>;

    /// Events from a height on; resumes by itself.
    fn subscribe(&self, wanted: Subscription) -> Deliveries;

    /// Signs and submits `abac set` at once, in the order of the calls; the verdict need not be awaited. The id is that of
    /// the transaction, if it could be signed.
    fn set(&self, args: Vec<Bytes>) -> (Option<Hash>, Verdict);

    /// Calls a function of `abac` in a transaction, and answers with its response.
    fn invoke(&self, function: &str, args: Vec<Bytes>) -> BoxFuture<'static, Result<Bytes, Rejection>>;
}

impl Gateway for Client {
    fn query(
        &self,
        height: u64,
        chaincode: &str,
        function: &str,
        args: Vec<Bytes>,
    ) -> BoxFuture<'static, Result<Answer, Rejection>> {
        let (client, chaincode, function) = (self.clone(), chaincode.to_owned(), function.to_owned());
        async move {
            match client.query_at(height, &chaincode, &function, args.clone()).await {
                // What the node's own state lacks, a newer one may have.
                Err(refused) if refused.code.is_final() => client.query(&chaincode, &function, args).await,
                // What is old is made up for by the events that follow.
                answer => answer,
            }
        }
        .boxed()
    }

    fn node(&self) -> String {
        Self::node(self).to_string()
    }

    fn height(&self) -> BoxFuture<'static, Result<u64, Rejection>> {
        let client = self.clone();
        async move { Ok(client.status().await?.height) }.boxed()
    }

    fn beginning(&self) -> BoxFuture<'static, Result<Governance, Rejection>> {
        let client = self.clone();
        async move { Self::beginning(&client).await }.boxed()
    }

    fn declare(
        &self,
        robot: &str,
        stops: &BTreeSet<CallRef>,
        known: Governance,
    ) -> BoxFuture<'static, Result<Certified, Rejection>> {
        let stops = stops.iter().map(|stop| Bytes::from(stop.to_string()));
        let args = std::iter::once(Bytes::copy_from_slice(robot.as_bytes())).chain(stops).collect();
        let client = self.clone();
        let call = Call { chaincode: ABAC.to_owned(), function: "declare".to_owned(), args, ttl: QUESTION_TTL };
        async move { client.invoke_certified(Some(&known), call).await }.boxed()
    }

    fn subscribe(&self, wanted: Subscription) -> Deliveries {
        // The stream keeps a wait that was begun when its caller turns to something else in between.
        stream::unfold(SlotSubscription::start(self, wanted), |mut reading| async move {
            let delivery = reading.next().await;
            Some((delivery, reading))
        })
        .boxed()
    }

    fn set(&self, args: Vec<Bytes>) -> (Option<Hash>, Verdict) {
        let call = Call { chaincode: ABAC.to_owned(), function: "set".to_owned(), args, ttl: COMMAND_TTL };
        match self.prepare(call) {
            Ok(transaction) => {
                let verdict = self.submit_nowait(&transaction).map(|verdict| verdict.map(drop)).boxed();
                (Some(transaction.id()), verdict)
            }
            Err(refused) => (None, std::future::ready(Err(refused)).boxed()),
        }
    }

    fn invoke(&self, function: &str, args: Vec<Bytes>) -> BoxFuture<'static, Result<Bytes, Rejection>> {
        let (client, function) = (self.clone(), function.to_owned());
        async move { Ok(Self::invoke(&client, ABAC, &function, args).await?.response) }.boxed()
    }
}

/// Asks for JSON; answers with the height of the state as well.
pub(crate) async fn ask<T: DeserializeOwned>(
    gateway: &dyn Gateway,
    height: u64,
    chaincode: &str,
    function: &str,
    args: &[&str],
) -> Result<(T, u64), Rejection> {
    let args = args.iter().map(|arg| Bytes::copy_from_slice(arg.as_bytes())).collect();
    let answer = gateway.query(height, chaincode, function, args).await?;
    Ok((read(&format!("{chaincode} {function}"), &answer.response)?, answer.height))
}

/// Reads the JSON that a function has answered.
pub(crate) fn read<T: DeserializeOwned>(function: &str, answer: &[u8]) -> Result<T, Rejection> {
    serde_json::from_slice(answer).map_err(|error| {
        Rejection::new(Code::Malformed, format!("the answer to {function} cannot be read"))
            .found(error.to_string())
            .wanted("the JSON that this version knows")
            .next("use the same version for node and bridge")
    })
}
