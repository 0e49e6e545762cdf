//! Questions about the committed state and the chain.

use super::missing::Kept;
use super::{Questions, status};
use crate::ordering::Ordering;
use crate::ordering::waiters::verdict_of;
use crate::peers::Peers;
use crate::storage::Storage;
use bytes::Bytes;
use ledger::Outcome;
use ledger_api::v1::{
    Block, EventRecord, GetTransactionRequest, QueryRequest, QueryResponse, TransactionRecord, Verdict,
};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_storage::result::{BlockKind, EmittedEvent, Event};
use std::sync::Arc;
use std::time::Duration;
use tonic::Status;

/// How long a question waits for a certificate at most.
const CERTIFIED_WITHIN_MAX: Duration = Duration::from_secs(10);
/// Newest blocks that are searched for a transaction that no index has.
const SEARCHED_MAX: u64 = 256;
/// The chaincode that knows the members.
const MSP: &str = "msp";

/// The state, blocks and transactions of a node.
pub(crate) struct Records {
    /// The ledger, its blocks, and readers that wait for a current state.
    pub ordering: Arc<Ordering>,
    /// The certified blocks, and whether the leader is reached.
    pub peers: Arc<Peers>,
    /// The turns to read.
    pub questions: Questions,
}

impl Records {
    pub(super) async fn query(&self, caller: &Identity, request: QueryRequest) -> Result<QueryResponse, Status> {
        // Who looks for the fault must see the nodes: `ledgerctl network status` and `doctor` ask for them so.
        if !request.may_be_stale || request.chaincode != MSP {
            self.peers.monitor.check_clock().map_err(|rejection| status(&rejection))?;
        }
        // A current state has every height that any node has told.
        let reached = match request.may_be_stale {
            true => self.ordering.reads.reach_height(request.min_height).await,
            false => self.ordering.reads.reach().await.map(drop),
        };
        reached.map_err(|rejection| status(&self.with_voters(rejection)))?;
        let turn = self.questions.turn(caller).await;
        let answer = self.ordering.storage.ledger.query(
            caller,
            self.ordering.clock.now(),
            &request.chaincode,
            &request.function,
            &request.args,
        );
        drop(turn);
        let (verdict, response, height) = match answer {
            Ok((response, height)) => (Verdict::default(), response, height),
            Err(rejection) => ((&rejection).into(), Bytes::new(), self.ordering.storage.ledger.tip().height),
        };
        let cut_off = if request.may_be_stale {
            self.peers.monitor.cut_off_for(&self.peers.reachability)
        } else {
            Duration::ZERO
        };
        Ok(QueryResponse {
            verdict: Some(verdict),
            response,
            height,
            time: self.time_of(height).map_err(|rejection| status(&rejection))?,
            stale_for: u64::try_from(cut_off.as_micros()).unwrap_or(u64::MAX),
        })
    }

    /// Block time of a height; 0 if it is not known any more.
    fn time_of(&self, height: u64) -> Result<u64, Rejection> {
        let tip = self.ordering.storage.ledger.tip();
        if tip.height == height {
            return Ok(tip.time);
        }
        Ok(self.ordering.storage.ledger.block_hashes(height)?.map_or(0, |block| block.time))
    }

    /// A block. One that this node does not have yet may be committed.
    pub(super) async fn block(&self, caller: &Identity, height: u64) -> Result<Block, Rejection> {
        if height > self.ordering.storage.ledger.tip().height {
            self.ordering.reads.reach().await?;
        }
        let _turn = self.questions.turn(caller).await;
        self.block_here(caller, height)
    }

    /// A transaction. One that this node does not know may be committed.
    pub(super) async fn transaction(
        &self,
        caller: &Identity,
        request: &GetTransactionRequest,
    ) -> Result<TransactionRecord, Rejection> {
        let patience = Duration::from_millis(request.certified_within_ms.into()).min(CERTIFIED_WITHIN_MAX);
        let record = match self.in_turn(caller, &request.id).await {
            Err(rejection) if matches!(rejection.code, Code::NotFound | Code::Pruned) => {
                self.ordering.reads.reach().await?;
                self.in_turn(caller, &request.id).await?
            }
            found => found?,
        };
        let block = self.ordering.storage.ledger.block_hashes(record.height)?;
        let certificate_due = block.is_some_and(|block| block.roots.is_some());
        let patience = if certificate_due { patience } else { Duration::ZERO };
        let certified = self.peers.certificates.reaches(record.height, patience).await;
        Ok(TransactionRecord { certified, certificate_due, ..record })
    }

    async fn in_turn(&self, caller: &Identity, id: &[u8]) -> Result<TransactionRecord, Rejection> {
        let _turn = self.questions.turn(caller).await;
        self.transaction_here(caller, id)
    }

    fn block_here(&self, caller: &Identity, height: u64) -> Result<Block, Rejection> {
        if height == 0 {
            let result = self.ordering.storage.ledger.result(0)?.ok_or_else(|| self.no_block(0))?;
            return Ok(Block {
                hash: self.ordering.storage.ledger.network().0.to_vec().into(),
                time: result.time,
                previous_hash: Hash::ZERO.0.to_vec().into(),
                root: self.ordering.storage.ledger.network().0.to_vec().into(),
                state_digest: result.digest.clone(),
                kind: "genesis".into(),
                ..Block::default()
            });
        }
        let outcome = self.ordering.storage.blocks.get(height)?.ok_or_else(|| self.no_block(height))?;
        let transactions = (0..outcome.transactions.len()).map(|index| self.record(caller, &outcome, index)).collect();
        let own = outcome.events.iter().filter(|emitted| emitted.index.is_none());
        let events =
            own.filter(|emitted| self.ordering.storage.ledger.may_read(caller, &emitted.event).is_ok()).cloned();
        Ok(Block {
            height,
            term: outcome.header.term,
            time: outcome.header.time,
            previous_hash: outcome.header.previous.0.to_vec().into(),
            root: outcome.header.root.0.to_vec().into(),
            hash: outcome.hash.0.to_vec().into(),
            state_digest: outcome.digest.0.to_vec().into(),
            kind: match outcome.kind {
                BlockKind::Transactions => "transactions",
                BlockKind::Membership => "membership",
                BlockKind::Genesis => "genesis",
            }
            .into(),
            transactions,
            events: events.map(event_record).collect(),
        })
    }

    fn transaction_here(&self, caller: &Identity, id: &[u8]) -> Result<TransactionRecord, Rejection> {
        let id = Hash::from_slice(id).ok_or_else(|| {
            Rejection::new(Code::BadArgument, "the transaction id is not usable")
                .found(format!("{} bytes", id.len()))
                .wanted("32 bytes")
        })?;
        let (outcome, index) = match self.ordering.storage.ledger.transaction(&id)? {
            Some(place) => {
                let outcome = self.ordering.storage.blocks.get(place.height)?;
                (outcome.ok_or_else(|| self.no_block(place.height))?, place.index as usize)
            }
            None => self.rejected_in_a_block(&id)?.ok_or_else(|| self.kept().no_transaction(&id))?,
        };
        Ok(self.record(caller, &outcome, index))
    }

    /// A transaction of one of the newest blocks that was rejected there before any chaincode saw it, such as one that had expired: no
    /// index has it.
    fn rejected_in_a_block(&self, id: &Hash) -> Result<Option<(Arc<Outcome>, usize)>, Rejection> {
        let Kept { first, tip } = self.kept();
        for height in (first.max(tip.saturating_sub(SEARCHED_MAX - 1))..=tip).rev() {
            let Some(outcome) = self.ordering.storage.blocks.get(height)? else { continue };
            if let Some(index) = outcome.ids.iter().position(|known| known == id) {
                return Ok(Some((outcome, index)));
            }
        }
        Ok(None)
    }

    fn kept(&self) -> Kept {
        let Storage { ledger, blocks, .. } = &*self.ordering.storage;
        Kept { first: blocks.first_height(), tip: ledger.tip().height }
    }

    fn no_block(&self, height: u64) -> Rejection {
        self.kept().no_block(height)
    }

    /// One transaction of a block. Its bytes are only shown to those who may read all the events that it caused.
    fn record(&self, caller: &Identity, outcome: &Outcome, index: usize) -> TransactionRecord {
        let position = u32::try_from(index).unwrap_or(u32::MAX);
        let encoded = outcome.transactions.get(index).cloned().unwrap_or_default();
        let result = outcome.results.get(index).cloned().unwrap_or_default();
        let creator = ledger::transaction::Transaction::decode(encoded.clone())
            .ok()
            .and_then(|transaction| self.ordering.storage.ledger.creator_name(&transaction.creator()));
        let caused: Vec<_> = outcome.events.iter().filter(|emitted| emitted.index == Some(position)).collect();
        let events: Vec<_> = caused
            .iter()
            .filter(|emitted| self.ordering.storage.ledger.may_read(caller, &emitted.event).is_ok())
            .map(|emitted| event_record((*emitted).clone()))
            .collect();
        let readable = events.len() == caused.len();
        TransactionRecord {
            id: outcome.ids.get(index).map(|id| id.0.to_vec().into()).unwrap_or_default(),
            height: outcome.header.height,
            index: position,
            time: outcome.header.time,
            verdict: Some(verdict_of(&result)),
            response: result.response,
            transaction: if readable { encoded } else { Bytes::new() },
            creator: creator.unwrap_or_default(),
            events,
            certified: outcome.header.height <= self.peers.certificates.certified(),
            certificate_due: false,
        }
    }
}

fn event_record(EmittedEvent { index, event }: EmittedEvent) -> EventRecord {
    let Event { chaincode, name, subject, payload } = event;
    EventRecord { chaincode, name, subject, payload, index: index.unwrap_or_default(), ..EventRecord::default() }
}
