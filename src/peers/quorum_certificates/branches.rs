//! Certificates of other blocks than this node has: they stop it, or are shown where a certificate of its own contradicts them.

use super::{Certifying, Told};
use crate::storage::files::{CONTRADICTED_FILE, CONTRADICTED_NEXT};
use ledger::branch::CertifiedBranch;
use ledger::network::Genesis;
use ledger_base::durable::{PUBLIC_MODE, replace};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_light::{Certificate, Governance, Misbehaviour, Signed};
use ledger_replica::branches::Branches;
use ledger_replica::certifier::Signing;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Most old statements that are remembered because the signatures of a certificate were sent for them.
const EXCHANGED_MAX: usize = 4096;
/// Most statements passed on by one peer in a second whose signatures are checked here.
const PASSED_MAX: u32 = 64;
/// The second in which they are counted.
const PASSED_TIME: Duration = Duration::from_secs(1);

/// The other blocks that voters have signed.
#[derive(Default)]
pub(crate) struct OtherBlocks {
    branches: Branches,
    /// Statements of others that each peer has passed on in the second that began then.
    passed: BTreeMap<u64, (Instant, u32)>,
}

impl OtherBlocks {
    fn may_pass(&mut self, peer: u64) -> bool {
        self.passed.retain(|_, (begun, _)| begun.elapsed() < PASSED_TIME);
        let (_, count) = self.passed.entry(peer).or_insert((Instant::now(), 0));
        *count = count.saturating_add(1);
        *count <= PASSED_MAX
    }
}

impl Certifying {
    /// A node has signed something else about a block than this node's certificate says: the signatures in the certificate
    /// are exchanged for it. A block that the certifier still holds is its own matter.
    pub(super) async fn compare(&mut self, signed: &Signed) {
        let (height, node) = (signed.statement.height, signed.signature.node);
        let Some(certificate) = self.certificates.recent.of(height).filter(|own| own.statement != signed.statement)
        else {
            return;
        };
        if self.certifier.holds(height) || self.exchanged.contains(&(height, node)) || self.check(signed).is_err() {
            return;
        }
        self.exchanged.insert((height, node));
        if self.exchanged.len() > EXCHANGED_MAX {
            self.exchanged.pop_first();
        }
        let Certificate { statement, signatures } = certificate;
        for signature in signatures {
            let other = Signed { statement, signature };
            self.send_statement(&other);
            if let Some(proof) = Misbehaviour::of(other, signed.clone()) {
                self.misbehaved(&proof, self.me).await;
            }
        }
    }

    fn check(&self, signed: &Signed) -> Result<(), Rejection> {
        let (ledger, Signed { statement, signature }) = (&self.ordering.storage.ledger, signed);
        let identity = self.keys.identify(&ledger.msps(), &signature.certificate, statement.time)?;
        ledger.voters()?.check(statement, signature, &identity)
    }

    /// A voter has signed something about a block, which this node does not have, or has not executed yet.
    pub(super) fn hear_of_branch(&mut self, from: u64, signed: &Signed) {
        let (statement, node) = (&signed.statement, signed.signature.node);
        let ledger = &self.ordering.storage.ledger;
        if statement.network != ledger.network() || node == self.me || self.certifier.agrees_with(statement) {
            return;
        }
        let differs = match ledger.block_hashes(statement.height) {
            Ok(own) => own.map_or(statement.height > ledger.tip().height, |own| own.hash != statement.block),
            Err(_) => false,
        };
        let is_signed = |this: &mut Self| node == from || (this.others.may_pass(from) && this.check(signed).is_ok());
        if differs && is_signed(self) {
            self.others.branches.heard(signed.clone());
        }
    }

    /// Looks whether voters have certified another block than this node has executed.
    pub(super) async fn look_at_branches(&mut self) {
        let ledger = Arc::clone(&self.ordering.storage.ledger);
        let own = |height| Ok(ledger.block_hashes(height)?.map(|own| own.hash));
        match self.others.branches.contradicting(ledger.tip().height, own) {
            Ok(certificates) => {
                for certificate in certificates {
                    self.judge_branch(CertifiedBranch::of(certificate)).await;
                }
            }
            Err(fault) => {
                tracing::warn!(code = fault.code.name(), reason = %fault, "cannot compare the blocks of voters")
            }
        }
    }

    /// Does the certificate of a branch contradict this node? Then it stops, unless a strict certificate of its own covers its block:
    /// then both are shown, and people decide.
    pub(super) async fn judge_branch(&mut self, branch: CertifiedBranch) {
        match self.contradicts(&branch) {
            Ok(Some(Against::Chain { own })) => self.end_contradicted(branch, own).await,
            Ok(Some(Against::Certificate)) => self.show_branch(branch).await,
            Ok(None) => {}
            Err(reason) => {
                tracing::debug!(height = branch.height(), code = reason.code.name(), %reason, "the certificate of another branch does not count");
            }
        }
    }

    fn contradicts(&self, branch: &CertifiedBranch) -> Result<Option<Against>, Rejection> {
        let ledger = &self.ordering.storage.ledger;
        let (height, certified) = (branch.height(), self.certificates.certified());
        let own = ledger.block_hashes(height)?.map(|own| own.hash);
        let Some(own) = own.filter(|own| *own != branch.block()) else { return Ok(None) };
        let common = self.governance(certified.min(height.saturating_sub(1)))?;
        common.check_strict(branch.certificate())?;
        let is_covered = certified >= height && self.governance(certified)?.certificate_rule()?.strict_since.is_some();
        Ok(Some(if is_covered { Against::Certificate } else { Against::Chain { own } }))
    }

    /// The governance after the own block at a height.
    fn governance(&self, height: u64) -> Result<Governance, Rejection> {
        let storage = &self.ordering.storage;
        let changes = storage.ledger.changes(0, usize::MAX)?;
        Genesis::governance(&storage.document)?.as_of(height, &changes)
    }

    /// Stops the node, and keeps the certificate, so that it does not start again as it is.
    async fn end_contradicted(&self, branch: CertifiedBranch, own: Hash) {
        let reason = contradicted(&branch, &own.to_string());
        let ordering = Arc::clone(&self.ordering);
        let newest = self.certificates.newest(&ordering.storage.ledger).ok().flatten();
        let certificates = Arc::clone(&self.certificates);
        let ended = tokio::task::spawn_blocking(move || {
            ordering.slot.stop();
            let mark = ordering.storage.data.join(CONTRADICTED_FILE);
            let kept = replace(&mark, &branch.to_bytes(), PUBLIC_MODE);
            // What the own certificate covers is never dropped.
            let kept = kept.and(newest.map_or(Ok(()), |newest| certificates.kept.proof(&newest, true, false)));
            if let Err(fault) = kept {
                tracing::error!(code = fault.code.name(), reason = %fault, "cannot keep the certificate that contradicts this node");
            }
            ordering.failure.fail(reason);
        });
        if ended.await.is_err() {
            tracing::error!("a thread panicked while it stopped the node");
        }
    }

    /// Two strict certificates contradict each other. That takes lies of several organisations, or of one that has more voters
    /// than is declared.
    async fn show_branch(&self, branch: CertifiedBranch) {
        if !self.certificates.evidence.set_other(&branch) {
            return;
        }
        let (height, other) = (branch.height(), branch.block());
        tracing::error!(height, %other, "voters have certified another block than this node's own certificate covers; people must decide");
        self.keep(move |kept| kept.other_branch(&branch)).await;
    }
}

/// The thing that the certificate of another branch contradicts.
enum Against {
    /// Blocks without a strict certificate.
    Chain {
        /// The own block.
        own: Hash,
    },
    /// A strict certificate of this node.
    Certificate,
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
        self.evidence.other()
    }
}
