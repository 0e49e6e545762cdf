//! The end of a node that a certificate of another block contradicts. Where its own certificate covers its block, both are shown.

use super::{Certifying, Told};
use crate::storage::files::{CONTRADICTED_FILE, CONTRADICTED_NEXT};
use ledger::branch::CertifiedBranch;
use ledger_base::durable::{PUBLIC_MODE, replace};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_light::Certificate;
use std::sync::{Arc, PoisonError};

impl Certifying {
    /// Stops the node, and keeps the certificate, so that it does not start again as it is.
    pub(super) async fn end_contradicted(&self, branch: CertifiedBranch, own: Hash) {
        let reason = contradicted(&branch, &own.to_string());
        let ordering = Arc::clone(&self.ordering);
        let certificates = Arc::clone(&self.certificates);
        let ended = tokio::task::spawn_blocking(move || {
            ordering.slot.stop();
            let mark = ordering.storage.data.join(CONTRADICTED_FILE);
            let kept = replace(&mark, &branch.to_bytes(), PUBLIC_MODE);
            // What the own certificate covers is never dropped.
            let kept = kept.and_then(|()| certificates.keep_newest(&ordering.storage.ledger));
            if let Err(fault) = kept {
                tracing::error!(code = fault.code.name(), reason = %fault, "cannot store the certificate that \
                                                                            contradicts this node");
            }
            ordering.failure.fail(reason);
        });
        if ended.await.is_err() {
            tracing::error!("thread panicked while stopping the node");
        }
    }

    /// Two strict certificates contradict each other. That takes lies of several organisations, or of one that has more voters
    /// than is declared.
    pub(super) async fn show_branch(&self, branch: CertifiedBranch) {
        if !self.certificates.set_two(&branch) {
            return;
        }
        let (height, other) = (branch.height(), branch.block());
        tracing::error!(height, %other, "voters certified another block than this node's own certificate covers; \
                                         people must decide");
        self.keep(move |certificates| certificates.kept.other_branch(&branch)).await;
    }
}

/// The end of a node that a strict certificate contradicts. `found` is its own block.
fn contradicted(branch: &CertifiedBranch, found: &str) -> Rejection {
    let Certificate { statement, signatures } = branch.certificate();
    Rejection::new(Code::Contradicted, "enough voters have certified another block than this node has executed")
        .found(format!("block {found} at height {}", branch.height()))
        .wanted(format!(
            "block {}, which the certificate of block {} with {} signatures covers",
            branch.block(),
            statement.height,
            signatures.len()
        ))
        .next(CONTRADICTED_NEXT)
}

impl super::Certificates {
    /// Another node has shown the certified part of its branch.
    pub(crate) fn branch(&self, branch: CertifiedBranch) {
        let _stopping = self.told.send(Told::Branch(Box::new(branch)));
    }

    /// Two contradicting strict certificates in words; empty if there are none.
    pub(crate) fn two_certificates(&self) -> String {
        self.two.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Keeps that a strict certificate contradicts one of this node; false if there was one before.
    fn set_two(&self, branch: &CertifiedBranch) -> bool {
        let mut two = self.two.lock().unwrap_or_else(PoisonError::into_inner);
        let is_first = two.is_empty();
        if is_first {
            *two = two_certificates(branch);
        }
        is_first
    }
}

/// Two strict certificates that contradict each other, in words.
pub(super) fn two_certificates(branch: &CertifiedBranch) -> String {
    format!(
        "voters have certified two blocks of height {}, this node's own and {}: people must decide",
        branch.height(),
        branch.block()
    )
}
