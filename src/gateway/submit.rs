//! Submission: admission, then the queue of the orderer, then an answer when the verdict is known.

use super::{GatewayService, NodeView};
use crate::waiters::{Waiter, known, refused};
use ledger::transaction::Transaction;
use ledger::{Admission, Code, Refusal, Rejection};
use ledger_api::v1::{SubmitRequest, SubmitResponse};
use ledger_raft::{Input, Lane};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use tokio::sync::{OwnedSemaphorePermit, mpsc};
use tokio_stream::StreamExt;
use tokio_stream::wrappers::UnboundedReceiverStream;
use tonic::{Status, Streaming};

impl GatewayService {
    /// A place among the transactions in flight; waits for one, which is how a fast client feels that it is too fast.
    pub(super) async fn permit(&self) -> Result<OwnedSemaphorePermit, Status> {
        Arc::clone(&self.node.in_flight).acquire_owned().await.map_err(|_| Status::unavailable("the node is stopping"))
    }
}

/// Submits what comes in until the client closes its side; answers until everything is answered.
pub(super) fn stream(
    gateway: GatewayService,
    mut requests: Streaming<SubmitRequest>,
) -> UnboundedReceiverStream<Result<SubmitResponse, Status>> {
    // Unbounded in form only: each answer belongs to a permit, of which there are limited many.
    let (answers, verdicts) = mpsc::unbounded_channel();
    tokio::spawn(async move {
        loop {
            let request = tokio::select! {
                request = requests.next() => request,
                () = answers.closed() => return,
            };
            let Some(Ok(request)) = request else { return };
            let Ok(permit) = gateway.permit().await else { return };
            gateway.node.submit(request, Waiter { answers: answers.clone(), _permit: permit }).await;
        }
    });
    UnboundedReceiverStream::new(verdicts)
}

impl NodeView {
    /// Admits a transaction and hands it to the orderer. The waiter is answered now or when the verdict is known.
    pub(super) async fn submit(&self, request: SubmitRequest, waiter: Waiter) {
        self.awake.keep();
        if request.min_height > self.ledger.tip().height
            && let Err(reason) = self.reach(request.min_height).await
        {
            let id = Transaction::decode(request.transaction).ok().map(|transaction| transaction.id());
            let _gone = waiter.answers.send(Ok(refused(id.as_ref(), &reason)));
            return;
        }
        let transaction = match self.admit(request) {
            Ok(transaction) => transaction,
            Err(answer) => {
                let _gone = waiter.answers.send(Ok(*answer));
                return;
            }
        };
        let id = transaction.id();
        let body = transaction.body();
        let urgent =
            self.ledger.registry().find(&body.chaincode).is_ok_and(|chaincode| chaincode.urgent(&body.function));
        let lane = if urgent { Lane::Control } else { Lane::Data };
        self.waiters.add(&transaction, lane, waiter);
        let input = Input::Submit { lane, transaction: transaction.encoded().clone() };
        if let Err(reason) = self.seat.input(input) {
            self.waiters.refuse(&id, &reason);
        }
    }

    /// Everything that can be refused before ordering is refused here. The answer may also be an earlier verdict.
    fn admit(&self, request: SubmitRequest) -> Result<Transaction, Box<SubmitResponse>> {
        let refuse = |refusal: Refusal| {
            self.denials.record(self.clock.now(), &refusal);
            Box::new(refused(refusal.transaction.as_ref().map(Transaction::id).as_ref(), &refusal.rejection))
        };
        // Not even looked at, but named: by the id a client on a stream knows which of its transactions is meant.
        let refuse_unread = |rejection| {
            let transaction = Transaction::decode(request.transaction.clone()).ok();
            refuse(Refusal { who: None, transaction, rejection })
        };
        let limit = self.limits.payload_bytes_max;
        if request.transaction.len() as u64 > limit {
            let rejection = Rejection::new(Code::TooLarge, "transaction is larger than this node accepts")
                .found(format!("{} bytes", request.transaction.len()))
                .wanted(format!("at most {limit} bytes (limits.payload_bytes_max)"))
                .next("send less at once, or raise the limit in the node's configuration");
            return Err(refuse_unread(rejection));
        }
        if self.disk_full.load(Ordering::Relaxed) {
            let rejection =
                Rejection::new(Code::DiskFull, "the node's disk is almost full, so it accepts nothing more")
                    .next("free space on the node's disk; it goes on by itself");
            return Err(refuse_unread(rejection));
        }
        match self.ledger.admit(request.transaction, self.clock.now()) {
            Ok(Admission::New(transaction)) => Ok(transaction),
            Ok(Admission::Known(id, record)) => Err(Box::new(known(&id, &record))),
            Err(refusal) => Err(refuse(*refusal)),
        }
    }
}
