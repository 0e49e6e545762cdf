//! Certificates of blocks: this node signs what executing gave, receives what others signed, and keeps what enough have signed.
//!
//! ```text
//! certificates   the task around the machine of `ledger_replica::certifier`; the view of the rest of the node
//!   keys         the node's key, and whose certificates are believed
//!   inbox        statements of peers that wait: a few of each
//!   branches     certificates of other blocks than this node has
//!   evidence     proofs of misbehaviour
//!   kept         the files below the data directory
//!   lag          how long a block that is due has had no certificate; waiting for one
//!   recent       the newest certificates, for those who ask for a proof
//!   passed       one in ten seconds of all before, on the disk
//! ```
//! Executing a block costs a message to the task, and nothing else: signing and checking happen beside the threads that
//! order and execute.

mod branches;
mod evidence;
mod inbox;
mod kept;
mod keys;
mod lag;
mod passed;
mod recent;

pub(crate) use branches::OtherBlocks;
pub(crate) use kept::{certified_up_to, newest_proof, set_proofs_aside};
pub(crate) use keys::Keys;

use crate::ordering::Ordering;
use crate::ordering::directory::Directory;
use crate::peers::connections::Connections;
use crate::storage::files::DIVERGED_FILE;
use evidence::Evidence;
use inbox::Inbox;
use kept::Kept;
use lag::Lag;
use ledger::branch::CertifiedBranch;
use ledger::{Ledger, Outcome};
use ledger_base::rejection::{Code, Rejection};
use ledger_light::fact::Fact;
use ledger_light::{Certificate, Misbehaviour, Proof, Signed, Statement};
use ledger_raft::{self as raft, PeerMessage, SignedStatement};
use ledger_replica::Observer;
use ledger_replica::certifier::{Certifiable, Certifier, Effect, Era, Event, Signing};
use passed::Passed;
use recent::Recent;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use tokio::time::{MissedTickBehavior, interval};

/// Pause before the disk is asked again for a block that is to be signed.
const DISK_PAUSE: Duration = Duration::from_millis(2);
/// Time between two writes of the newest proof, at least: a crash loses that much of them.
const KEEP_EVERY: Duration = Duration::from_secs(2);
/// Time until the proofs of misbehaviour are sent to every member again: a member may have been away.
const EVIDENCE_EVERY: Duration = Duration::from_secs(10);

/// The node tells the task.
pub(crate) enum Told {
    /// A step of the machine.
    Event(Event),
    /// A node has misbehaved, as this node has seen.
    Misbehaved(Box<Misbehaviour>),
    /// The certified part of the branch of another node.
    Branch(Box<CertifiedBranch>),
}

/// The view that the rest of the node has of its certificates.
pub(crate) struct Certificates {
    told: mpsc::UnboundedSender<Told>,
    heard: Inbox,
    /// Proofs that peers have sent.
    shown: Inbox,
    certified: AtomicU64,
    lag: Lag,
    evidence: Evidence,
    recent: Recent,
    kept: Kept,
    passed: Passed,
}

impl Certificates {
    /// With what the data directory holds, and the events of executed blocks.
    ///
    /// # Errors
    /// A fault of the disk.
    pub(crate) fn open(data: &Path) -> Result<(Arc<Self>, mpsc::UnboundedReceiver<Told>), Rejection> {
        let kept = Kept::open(data)?;
        // Bounded by what is executed, which takes longer than signing.
        let (told, events) = mpsc::unbounded_channel();
        let certified = AtomicU64::new(kept.newest()?.map_or(0, |newest| newest.certificate.statement.height));
        let evidence = Evidence::new(kept.misbehaviours()?, kept.kept_branch()?.as_ref());
        let (heard, shown, recent) = (Inbox::default(), Inbox::default(), Recent::default());
        let passed = Passed::open(kept.directory())?;
        Ok((
            Arc::new(Self { told, heard, shown, certified, lag: Lag::default(), evidence, recent, kept, passed }),
            events,
        ))
    }

    /// The statements that this node has signed last, as far as its record has them.
    ///
    /// # Errors
    /// A fault of the disk.
    pub(crate) fn recorded(&self) -> Result<Vec<Statement>, Rejection> {
        self.kept.recorded()
    }

    /// The newest height for which this node has a certificate; 0 if there is none.
    pub(crate) fn certified(&self) -> u64 {
        self.certified.load(Relaxed)
    }

    /// The members that have lied, in words; empty if none has.
    pub(crate) fn lies(&self, directory: &Directory) -> String {
        self.evidence.lies(directory)
    }

    /// The members that have signed different results of one block, in words; empty if there are none.
    pub(crate) fn faults(&self, directory: &Directory) -> String {
        self.evidence.faults(directory)
    }

    /// A peer has sent a statement. It waits for the task, or is lost if too many of that peer wait.
    pub(crate) fn hear(&self, from: u64, statement: SignedStatement) {
        self.heard.put(from, statement.signed);
    }

    /// A peer has sent a proof of misbehaviour. It waits for the task, or is lost if too many of that peer wait.
    pub(crate) fn show(&self, from: u64, evidence: raft::Evidence) {
        self.shown.put(from, evidence.proof);
    }

    /// A proof of a certified block, with the facts that are wanted. Waits a while for the certificate. None if there is
    /// none, or the block was executed too long ago.
    ///
    /// # Errors
    /// A fault of the store.
    pub(crate) async fn prove(
        &self,
        ledger: &Ledger,
        height: u64,
        wanted: impl Fn(&Fact<'_>) -> bool,
    ) -> Result<Option<Proof>, Rejection> {
        let Some(certificate) = self.recent.wait_for(height).await else { return Ok(None) };
        proof(ledger, certificate, wanted)
    }

    /// A proof of the block at a height, with the verdict at that position, or else of the next certified block. None if none is
    /// known, nor comes in two seconds.
    ///
    /// # Errors
    /// A fault of the store or of the disk.
    pub(crate) async fn covering(&self, ledger: &Ledger, height: u64, index: u32) -> Result<Option<Proof>, Rejection> {
        let wanted = |fact: &Fact<'_>| matches!(fact, Fact::Verdict { index: of, .. } if *of == index);
        if self.passed.at_or_after(height)?.is_none() {
            self.recent.wait_from(height).await;
        }
        let recent = self.recent.at_or_after(height).map(|certificate| proof(ledger, certificate, wanted));
        let recent = recent.transpose()?.flatten();
        let (passed, governing) = (self.passed.at_or_after(height)?, self.kept.governing(height)?);
        let known = [recent, governing, passed].into_iter().flatten();
        Ok(known.min_by_key(|proof| proof.certificate.statement.height))
    }

    /// The proof of the newest certified block; none if there is none.
    ///
    /// # Errors
    /// A fault of the store or of the disk.
    pub(crate) fn newest(&self, ledger: &Ledger) -> Result<Option<Proof>, Rejection> {
        let newest =
            self.recent.newest().map(|certificate| proof(ledger, certificate, |_| false)).transpose()?.flatten();
        newest.map_or_else(|| self.kept.newest(), |newest| Ok(Some(newest)))
    }

    /// The proof of a block that changed who governs, if this node has it.
    ///
    /// # Errors
    /// A fault of the disk.
    pub(crate) fn governing(&self, height: u64) -> Result<Option<Proof>, Rejection> {
        self.kept.governing(height)
    }

    /// A part of the node has a proof of misbehaviour. The task keeps it: the caller does not wait for the disk.
    pub(crate) fn misbehaved(&self, proof: Box<Misbehaviour>) {
        let _stopping = self.told.send(Told::Misbehaved(proof));
    }
}

impl Observer for Certificates {
    fn executed(&self, outcome: &Arc<Outcome>, ledger: &Ledger) {
        let (header, governs) = (&outcome.header, outcome.governs);
        if let Some(roots) = outcome.certifiable {
            let (height, time, block) = (header.height, header.time, outcome.hash);
            let block = Certifiable { height, time, block, results: roots.results };
            self.lag.executed(Instant::now());
            let _stopping = self.told.send(Told::Event(Event::Executed { block, governs }));
        }
        if governs {
            match era(ledger) {
                Ok(era) => drop(self.told.send(Told::Event(Event::Voters(era)))),
                Err(fault) => {
                    tracing::error!(code = fault.code.name(), reason = %fault, "cannot read the voters of the next block")
                }
            }
        }
    }
}

/// A certificate, with facts of its block; none if the ledger cannot say any more what the block wrote.
fn proof(
    ledger: &Ledger,
    certificate: Certificate,
    wanted: impl Fn(&Fact<'_>) -> bool,
) -> Result<Option<Proof>, Rejection> {
    let facts = ledger.shown(certificate.statement.height, wanted)?;
    Ok(facts.map(|facts| Proof { certificate, facts }))
}

/// The voters whose signatures count for the blocks after the ledger's newest.
///
/// # Errors
/// A fault of the store.
pub(crate) fn era(ledger: &Ledger) -> Result<Era, Rejection> {
    Ok(Era { from: ledger.tip().height + 1, voters: ledger.voters()?, msps: ledger.msps() })
}

/// The task that makes certificates.
pub(crate) struct Certifying {
    /// The rest of the node.
    pub certificates: Arc<Certificates>,
    /// Decides.
    pub certifier: Certifier<Keys>,
    /// Checks the signatures in proofs.
    pub keys: Keys,
    /// Results of execution, the log whose blocks are signed, and the members of the network.
    pub ordering: Arc<Ordering>,
    /// The other nodes.
    pub connections: Arc<Connections>,
    /// This node's number.
    pub me: u64,
    /// Heights and nodes for whose statements the signatures of a certificate were sent.
    pub exchanged: BTreeSet<(u64, u64)>,
    /// Other blocks than this node has.
    pub others: OtherBlocks,
    /// Executed blocks and proofs.
    pub told: mpsc::UnboundedReceiver<Told>,
}

impl Certifying {
    /// Signs, receives and counts until the node stops.
    pub(crate) async fn run(mut self) {
        let started = Instant::now();
        let now = || u64::try_from(started.elapsed().as_micros()).unwrap_or(u64::MAX);
        let (mut effects, mut written) = (Vec::new(), None);
        let mut again = interval(EVIDENCE_EVERY);
        again.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            let event = tokio::select! {
                told = self.told.recv() => match told {
                    Some(Told::Event(event)) => event,
                    Some(Told::Misbehaved(proof)) => {
                        self.misbehaved(&proof, self.me).await;
                        continue;
                    }
                    Some(Told::Branch(branch)) => {
                        self.judge_branch(*branch).await;
                        continue;
                    }
                    None => return,
                },
                (from, signed) = self.certificates.heard.next() => match Signed::from_bytes(&signed) {
                    Ok(signed) => {
                        self.compare(&signed).await;
                        self.hear_of_branch(from, &signed);
                        Event::Heard { from, signed }
                    }
                    Err(reason) => {
                        tracing::warn!(node = self.ordering.directory.name(from), code = reason.code.name(), %reason, "a statement cannot be read");
                        continue;
                    }
                },
                (from, proof) = self.certificates.shown.next() => {
                    self.shown(from, &proof).await;
                    continue;
                }
                _ = again.tick() => {
                    // An engine with a full inbox has not taken it before.
                    self.ordering.slot.exclude(self.certificates.evidence.liars());
                    for proof in self.certificates.evidence.about_members(&self.ordering.directory) {
                        self.send_proof(&proof, self.me);
                    }
                    continue;
                }
                () = tokio::time::sleep(DISK_PAUSE), if self.certifier.waits_for_disk() => Event::Time,
                () = until(self.certifier.wait(now())) => Event::Time,
            };
            self.certifier.step(now(), event, &mut effects);
            self.certifier.step(now(), Event::Durable(self.ordering.storage.log.store.durable_index()), &mut effects);
            for effect in effects.drain(..) {
                self.act(effect, &mut written).await;
            }
            self.look_at_branches().await;
        }
    }

    async fn act(&self, effect: Effect, written: &mut Option<Instant>) {
        match effect {
            Effect::Record(statement) => self.keep(move |files| files.record(&statement)).await,
            // Lost where a member is not connected; the newest own one is sent again.
            Effect::Tell(signed) => self.send_statement(&signed),
            Effect::Pass(signed) => {
                let (node, height) = (self.ordering.directory.name(signed.signature.node), signed.statement.height);
                tracing::debug!(node, height, "voters have signed different things about a block; passing it on");
                self.send_statement(&signed);
            }
            Effect::Certified { certificate, governs } => {
                let height = certificate.statement.height;
                self.certificates.certified.fetch_max(height, Relaxed);
                let is_newest = height >= self.certifier.executed_height();
                self.certificates.lag.certified(is_newest, Instant::now());
                let newest = height == self.certificates.certified();
                let due = newest && written.is_none_or(|before| before.elapsed() >= KEEP_EVERY);
                self.certificates.recent.add(certificate.clone());
                let passes = self.certificates.passed.wants(height, certificate.statement.time);
                if due || governs || passes {
                    *written = if due { Some(Instant::now()) } else { *written };
                    self.keep_proof(certificate, due, governs, passes).await;
                }
            }
            Effect::Misbehaved(proof) => self.misbehaved(&proof, self.me).await,
        }
    }

    async fn keep_proof(&self, certificate: Certificate, newest: bool, governs: bool, passes: bool) {
        let (ledger, first) =
            (Arc::clone(&self.ordering.storage.ledger), self.ordering.storage.log.store.first_index());
        let certificates = Arc::clone(&self.certificates);
        self.keep(move |kept| match proof(&ledger, certificate, |_| false)? {
            Some(proof) => {
                if passes {
                    certificates.passed.keep(&proof, first)?;
                }
                kept.proof(&proof, newest, governs)
            }
            // It was certified long after it was executed. Another node has it.
            None => Ok(()),
        })
        .await;
    }

    fn send_statement(&self, signed: &Signed) {
        self.send(&PeerMessage::Statement(SignedStatement { signed: signed.to_bytes() }), self.me);
    }

    fn send_proof(&self, proof: &Misbehaviour, except: u64) {
        self.send(&PeerMessage::Evidence(raft::Evidence { proof: proof.to_bytes() }), except);
    }

    /// Sends a message to every member but this node and another one.
    fn send(&self, message: &PeerMessage, except: u64) {
        let members = self.ordering.directory.members();
        for member in members.iter().filter(|member| ![self.me, except].contains(&member.id)) {
            self.connections.send(member.id, message);
        }
    }

    /// A peer has sent a proof. It counts if the organisations that this node knows say so.
    async fn shown(&self, from: u64, proof: &[u8]) {
        let ledger = &self.ordering.storage.ledger;
        let checked = Misbehaviour::from_bytes(proof).and_then(|proof| {
            if !self.certificates.evidence.has(&proof) {
                let msps = ledger.msps();
                proof.verify(&ledger.network(), &ledger.voters()?.nodes, |der, time| {
                    self.keys.identify(&msps, der, time)
                })?;
            }
            Ok(proof)
        });
        match checked {
            Ok(proof) => self.misbehaved(&proof, from).await,
            Err(reason) => {
                let node = self.ordering.directory.name(from);
                tracing::warn!(node, code = reason.code.name(), %reason, "a proof of misbehaviour is not accepted");
            }
        }
    }

    /// Keeps a checked proof, and passes it on once.
    async fn misbehaved(&self, proof: &Misbehaviour, from: u64) {
        if !self.certificates.evidence.add(proof) {
            return;
        }
        let (evidence, node) = (&self.certificates.evidence, self.ordering.directory.name(proof.node()));
        self.send_proof(proof, from);
        self.ordering.slot.exclude(evidence.liars());
        match proof {
            Misbehaviour::Lie(lie) => {
                let (height, first, second) =
                    (lie.first.statement.height, lie.first.statement.block, lie.second.statement.block);
                tracing::error!(node, height, %first, %second, "a node has signed two different blocks of one height; the proof is kept");
            }
            Misbehaviour::DoubleVote(votes) => {
                let [first, second] = votes.votes.each_ref().map(|(to, _)| self.ordering.directory.name(*to));
                tracing::error!(
                    node,
                    term = votes.term,
                    first,
                    second,
                    "a voter has voted for two nodes in one term; the proof is kept"
                );
            }
            Misbehaviour::DoubleHead(heads) => {
                let [first, second] = heads.branches.each_ref().map(|branch| branch.base);
                tracing::error!(
                    node, term = heads.term, height = heads.height, %first, %second,
                    "a leader has signed two different logs in one term; the proof is kept"
                );
            }
            Misbehaviour::Fault(fault) => {
                let (height, first, second) =
                    (fault.first.statement.height, fault.first.statement.results, fault.second.statement.results);
                tracing::error!(node, height, %first, %second, "a node has signed two different results of one block; the proof is kept");
            }
        }
        let kept = proof.clone();
        self.keep(move |files| files.misbehaviour(&kept)).await;
        if let Misbehaviour::Fault(fault) = proof
            && proof.node() == self.me
        {
            self.stop(fault.first.statement.height).await;
        }
    }

    /// This node has computed one block in two ways: it stops, and computes its state again from the blocks at its next start.
    async fn stop(&self, height: u64) {
        let reason = Rejection::new(Code::Diverged, "this node has signed two different results of one block")
            .found(format!("two results of block {height}, both with its own signature"))
            .wanted("one result of each block, as all nodes compute it");
        let ordering = Arc::clone(&self.ordering);
        let marked = tokio::task::spawn_blocking(move || {
            ordering.slot.stop();
            let mark = ordering.storage.data.join(DIVERGED_FILE);
            if let Err(error) = std::fs::write(&mark, reason.to_string()) {
                tracing::error!(%error, mark = %mark.display(), "cannot mark the world state");
            }
            ordering.failure.fail(reason);
        });
        if marked.await.is_err() {
            tracing::error!("a thread panicked while it stopped the node");
        }
    }

    /// Writes to the disk, on a thread that may wait for it.
    async fn keep(&self, write: impl FnOnce(&Kept) -> Result<(), Rejection> + Send + 'static) {
        let certificates = Arc::clone(&self.certificates);
        match tokio::task::spawn_blocking(move || write(&certificates.kept)).await {
            Ok(Ok(())) => {}
            Ok(Err(fault)) => tracing::warn!(code = fault.code.name(), reason = %fault, "a proof is not kept"),
            Err(_) => tracing::error!("a thread panicked while it wrote a proof"),
        }
    }
}

/// Waits for this number of microseconds, or permanently.
async fn until(microseconds: Option<u64>) {
    match microseconds {
        Some(wait) => tokio::time::sleep(Duration::from_micros(wait)).await,
        None => std::future::pending().await,
    }
}
