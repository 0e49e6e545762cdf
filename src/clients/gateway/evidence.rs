//! Evidence of one transaction: from its bytes to a certified block.

use super::Proofs;
use super::missing::Kept;
use crate::storage::Storage;
use crate::storage::blocks::Blocks;
use bytes::Bytes;
use ledger::evidence::Link;
use ledger::headers::HEADERS_MAX;
use ledger::transaction::Transaction;
use ledger::{Ledger, Outcome, TransactionRecord};
use ledger_api::v1::ProveTransactionResponse;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_light::Proof;
use std::sync::Arc;

impl Proofs {
    /// The link from a transaction to a certificate.
    pub(super) async fn link(&self, reader: Arc<Identity>, id: &[u8]) -> Result<ProveTransactionResponse, Rejection> {
        let id = Hash::from_slice(id).ok_or_else(|| {
            Rejection::new(Code::BadArgument, "the transaction id is not usable")
                .found(format!("{} bytes", id.len()))
                .wanted("32 bytes")
        })?;
        if self.ordering.storage.ledger.transaction(&id)?.is_none() {
            self.ordering.reads.reach().await?;
        }
        let TransactionRecord { height, index, .. } =
            self.ordering.storage.ledger.transaction(&id)?.ok_or_else(|| {
                let Storage { ledger, blocks, .. } = &*self.ordering.storage;
                Kept { first: blocks.first_height(), tip: ledger.tip().height }.no_transaction(&id)
            })?;
        let proof = self
            .peers
            .certificates
            .covering(&self.ordering.storage.ledger, height)
            .await?
            .ok_or_else(|| no_proof(height))?;
        let turn = self.questions.turn(&reader).await;
        let (ledger, blocks) = (Arc::clone(&self.ordering.storage.ledger), Arc::clone(&self.ordering.storage.blocks));
        let made = tokio::task::spawn_blocking(move || make(&ledger, &blocks, &reader, (height, index), proof));
        let link = made.await.map_err(|_| Rejection::new(Code::Internal, "a thread panicked"))??;
        drop(turn);
        Ok(ProveTransactionResponse { link: link.to_bytes() })
    }
}

fn make(
    ledger: &Ledger,
    blocks: &Blocks,
    reader: &Identity,
    (height, index): (u64, u32),
    proof: Proof,
) -> Result<Link, Rejection> {
    let last = proof.certificate.statement.height;
    if last - height >= HEADERS_MAX as u64 {
        return Err(no_proof(height));
    }
    let own = block(blocks, height)?;
    for caused in own.events.iter().filter(|emitted| emitted.index == Some(index)) {
        ledger.may_read(reader, &caused.event)?;
    }
    let before = ledger.block_hashes(height.saturating_sub(1))?.ok_or_else(|| no_proof(height))?.digest;
    let later = (height + 1..=last).map(|height| block(blocks, height));
    Link::of((&own, index), before, certificate(ledger, &own, index)?, later, proof)
}

fn block(blocks: &Blocks, height: u64) -> Result<Arc<Outcome>, Rejection> {
    blocks.get(height)?.ok_or_else(|| {
        // It was there when the transaction was found.
        Kept { first: blocks.first_height().max(height.saturating_add(1)), tip: height }.no_block(height)
    })
}

/// The certificate of the creator.
fn certificate(ledger: &Ledger, outcome: &Outcome, index: u32) -> Result<Bytes, Rejection> {
    let encoded = outcome.transactions.get(index as usize).cloned().unwrap_or_default();
    let transaction = Transaction::decode(encoded)?;
    if let Some(certificate) = transaction.certificate() {
        return Ok(certificate.clone());
    }
    ledger.certificate(&transaction.creator())?.ok_or_else(|| {
        Rejection::new(Code::NotFound, "the certificate of the creator is unknown to this node")
            .found(transaction.creator().to_string())
            .wanted("a transaction whose signature was valid")
    })
}

fn no_proof(height: u64) -> Rejection {
    Rejection::new(Code::NotFound, format!("this node has no quorum certificate that proves block {height}"))
        .wanted(format!(
            "a certificate of a block at most {HEADERS_MAX} blocks later, signed by a majority of the \
                         voters"
        ))
        .next("try again in a moment, or ask another node; ledgerctl status shows the certified height")
}
