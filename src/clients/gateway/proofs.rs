//! Proofs, for readers that believe no single node.

use super::{Questions, status};
use crate::ordering::Ordering;
use crate::peers::Peers;
use bytes::Bytes;
use ledger_api::v1::{GovernanceChange, GovernanceStep, ProveRequest, ProveResponse};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_light::Proof;
use ledger_light::fact::Fact;
use std::sync::Arc;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;

/// Most changes that are read from the state at once.
const CHANGES_AT_ONCE: usize = 64;
/// Bytes of changes in one step, from which on they go without a proof.
const STEP_BYTES: usize = 1024 * 1024;
/// Steps that wait for a slow reader.
const WAITING_MAX: usize = 4;
/// Most verdicts of one proof.
const VERDICTS_MAX: usize = 32;

/// The proofs that a node can give.
pub(crate) struct Proofs {
    /// The ledger, its blocks, and readers that wait for a current state.
    pub ordering: Arc<Ordering>,
    /// The certified blocks, and whether the leader is reached.
    pub peers: Arc<Peers>,
    /// The turns to read.
    pub questions: Questions,
}

type Steps = mpsc::Sender<Result<GovernanceStep, Status>>;

impl Proofs {
    /// The way from a height to the newest proof.
    pub(super) fn governance(
        self: &Arc<Self>,
        reader: Arc<Identity>,
        after: u64,
    ) -> ReceiverStream<Result<GovernanceStep, Status>> {
        let (steps, stream) = mpsc::channel(WAITING_MAX);
        let proofs = Arc::clone(self);
        tokio::spawn(async move {
            if let Err(fault) = proofs.walk(&reader, after, &steps).await {
                let _reader_is_gone = steps.send(Err(status(&fault))).await;
            }
        });
        ReceiverStream::new(stream)
    }

    async fn walk(&self, reader: &Identity, after: u64, steps: &Steps) -> Result<(), Rejection> {
        let genesis = if after == 0 { self.ordering.storage.document.clone() } else { Bytes::new() };
        let (mut step, mut bytes, mut reached) = (GovernanceStep { genesis, ..Default::default() }, 0, after);
        // What changes while the reader is slow comes with its next question.
        let newest = self.peers.certificates.newest(&self.ordering.storage.ledger)?;
        let until = newest.as_ref().map_or(0, |newest| newest.certificate.statement.height);
        loop {
            let turn = self.questions.turn(reader).await;
            let mut changes = self.ordering.storage.ledger.changes(reached, CHANGES_AT_ONCE)?;
            drop(turn);
            changes.retain(|change| change.height <= until);
            if changes.is_empty() {
                break;
            }
            for change in changes {
                reached = change.height;
                let writes = change.to_bytes();
                bytes += writes.len();
                step.changes.push(GovernanceChange { height: reached, writes });
                let proof = self.peers.certificates.governing(reached)?.filter(|_| reached < until);
                if proof.is_some() || bytes > STEP_BYTES {
                    step.proof = proof.as_ref().map(Proof::to_bytes).unwrap_or_default();
                    bytes = 0;
                    if steps.send(Ok(std::mem::take(&mut step))).await.is_err() {
                        return Ok(());
                    }
                }
            }
        }
        step.proof = newest.as_ref().map(Proof::to_bytes).unwrap_or_default();
        let _reader_is_gone = steps.send(Ok(step)).await;
        Ok(())
    }

    /// The proof of a block, with verdicts.
    pub(super) async fn prove(&self, request: ProveRequest) -> Result<ProveResponse, Rejection> {
        let ProveRequest { height, verdicts } = request;
        if verdicts.len() > VERDICTS_MAX {
            return Err(Rejection::new(Code::TooLarge, "too many verdicts in one request")
                .found(verdicts.len().to_string())
                .wanted(format!("at most {VERDICTS_MAX}")));
        }
        self.ordering.reads.reach_height(height).await?;
        let wanted = |fact: &Fact<'_>| matches!(fact, Fact::Verdict { index, .. } if verdicts.contains(index));
        match self.peers.certificates.prove(&self.ordering.storage.ledger, height, wanted).await? {
            Some(proof) => Ok(ProveResponse { proof: proof.to_bytes() }),
            None => Err(Rejection::new(Code::NotFound, format!("this node has no proof of block {height}"))
                .found(format!("certified up to block {}", self.peers.certificates.certified()))
                .wanted("a recent block with control writes, or the first one of 200 ms, signed by enough voters")
                .next(
                    "try again in a moment; if it persists, check with ledgerctl status that voters of two \
                     organisations run",
                )),
        }
    }
}
