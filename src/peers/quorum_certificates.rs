//! Certificates of blocks: this node signs what executing gave, receives what others signed, and keeps what enough have signed.
//!
//! ```text
//! certificates   the task around the machines `ledger_replica::certifier` and `disputes`; the view of the rest of the node
//!   keys         the node's key, and whose certificates are believed
//!   inbox        statements of peers that wait: a few of each
//!   branches     the end of a node that a certificate contradicts
//!   evidence     proofs of misbehaviour, in words
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

pub(crate) use kept::{certified_up_to, newest_proof, set_proofs_aside};
pub(crate) use keys::Keys;

use crate::ordering::Ordering;
use crate::ordering::directory::Directory;
use crate::peers::connections::Connections;
use crate::storage::files::DIVERGED_FILE;
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
use ledger_replica::certifier::{Certifiable, Certifier, Effect, Era, Event};
use ledger_replica::disputes::{self, Disputes, Evidence, View};
use passed::Passed;
use recent::Recent;
use std::path::Path;
use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use tokio::time::{MissedTickBehavior, interval};

/// Pause before the disk is asked again for a block that is to be signed.
const DISK_PAUSE: Duration = Duration::from_millis(2);
/// Time between two writes of the newest proof: a crash loses at most that much.
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
    evidence: Arc<Evidence>,
    /// Two strict certificates that contradict each other, in words; empty if there are none.
    two: Mutex<String>,
    recent: Recent,
    kept: Kept,
    /// Height of the newest proof that was written.
    written: AtomicU64,
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
        let newest = kept.newest()?.map_or(0, |newest| newest.certificate.statement.height);
        let [certified, written] = [newest; 2].map(AtomicU64::new);
        let evidence = Arc::new(Evidence::new(kept.misbehaviours()?));
        let two = Mutex::new(kept.kept_branch()?.as_ref().map(branches::two_certificates).unwrap_or_default());
        let (heard, shown, recent) = (Inbox::default(), Inbox::default(), Recent::default());
        let passed = Passed::open(kept.directory())?;
        let lag = Lag::default();
        let certificates = Self { told, heard, shown, certified, lag, evidence, two, recent, kept, written, passed };
        Ok((Arc::new(certificates), events))
    }

    /// The proofs of misbehaviour.
    pub(crate) fn evidence(&self) -> Arc<Evidence> {
        Arc::clone(&self.evidence)
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
        evidence::lies(&self.evidence, directory)
    }

    /// The members that have signed different results of one block, in words; empty if there are none.
    pub(crate) fn faults(&self, directory: &Directory) -> String {
        evidence::faults(&self.evidence, directory)
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

    /// A proof of the block at a height, or else of the next certified block. None if none is known, nor comes in two seconds.
    ///
    /// # Errors
    /// A fault of the store or of the disk.
    pub(crate) async fn covering(&self, ledger: &Ledger, height: u64) -> Result<Option<Proof>, Rejection> {
        let newest = self.kept.newest()?.filter(|newest| newest.certificate.statement.height >= height);
        let passed = self.passed.at_or_after(height)?;
        if newest.is_none() && passed.is_none() {
            self.recent.wait_from(height).await;
        }
        let recent = self.recent.at_or_after(height).map(|certificate| proof(ledger, certificate, |_| false));
        let known = [recent.transpose()?.flatten(), newest, passed, self.kept.governing(height)?].into_iter().flatten();
        Ok(known.min_by_key(|proof| proof.certificate.statement.height))
    }

    /// Writes the newest proof, unless it was written. A network that is quiet from now on has no later certificate.
    ///
    /// # Errors
    /// A fault of the store or of the disk.
    pub(crate) fn keep_newest(&self, ledger: &Ledger) -> Result<(), Rejection> {
        let newest = self.recent.newest().filter(|newest| newest.statement.height > self.written.load(Relaxed));
        let newest = newest.map(|certificate| proof(ledger, certificate, |_| false)).transpose()?.flatten();
        let Some(newest) = newest else { return Ok(()) };
        self.kept.write_newest(&newest)?;
        self.written.fetch_max(newest.certificate.statement.height, Relaxed);
        Ok(())
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
    /// Judges proofs of misbehaviour, and certificates of other blocks.
    pub disputes: Disputes<Keys>,
    /// Results of execution, the log whose blocks are signed, and the members of the network.
    pub ordering: Arc<Ordering>,
    /// The other nodes.
    pub connections: Arc<Connections>,
    /// This node's number.
    pub me: u64,
    /// Executed blocks and proofs.
    pub told: mpsc::UnboundedReceiver<Told>,
}

impl Certifying {
    /// Signs, receives and counts until the node stops.
    pub(crate) async fn run(mut self) {
        let started = Instant::now();
        let now = || u64::try_from(started.elapsed().as_micros()).unwrap_or(u64::MAX);
        let (mut effects, mut found) = (Vec::new(), Vec::new());
        let mut again = interval(EVIDENCE_EVERY);
        again.set_missed_tick_behavior(MissedTickBehavior::Delay);
        // When the newest proof was written last; the first one is written at once.
        let mut kept: Option<Instant> = None;
        loop {
            let keeping = self.keep_wait(kept);
            let event = tokio::select! {
                told = self.told.recv() => match told {
                    Some(Told::Event(event)) => Some(event),
                    Some(Told::Misbehaved(proof)) => {
                        self.disputes.found(*proof, &mut found);
                        None
                    }
                    Some(Told::Branch(branch)) => {
                        let log = |height| self.ordering.storage.log.store.entry(height).ok().flatten();
                        self.disputes.branch(*branch, self.certificates.certified(), log, &mut found);
                        None
                    }
                    None => return,
                },
                (from, signed) = self.certificates.heard.next() => match Signed::from_bytes(&signed) {
                    Ok(signed) => {
                        self.hear(now(), from, &signed, &mut found);
                        Some(Event::Heard { from, signed })
                    }
                    Err(reason) => {
                        tracing::warn!(node = self.ordering.directory.name(from), code = reason.code.name(), %reason, "cannot \
                                                                                                                       read \
                                                                                                                       a \
                                                                                                                       signed \
                                                                                                                       statement");
                        None
                    }
                },
                (from, proof) = self.certificates.shown.next() => {
                    self.disputes.shown(from, &proof, &mut found);
                    None
                }
                _ = again.tick() => {
                    self.disputes.again(&mut found);
                    None
                }
                () = until(keeping) => {
                    self.keep_newest().await;
                    kept = Some(Instant::now());
                    None
                }
                () = tokio::time::sleep(DISK_PAUSE), if self.certifier.waits_for_disk() => Some(Event::Time),
                () = until(self.certifier.wait(now())) => Some(Event::Time),
            };
            if let Some(event) = event {
                self.certifier.step(now(), event, &mut effects);
                self.certifier.step(
                    now(),
                    Event::Durable(self.ordering.storage.log.store.durable_index()),
                    &mut effects,
                );
                for effect in effects.drain(..) {
                    self.act(effect, &mut found).await;
                }
                if let Err(fault) = self.disputes.look(self.certificates.certified(), &mut found) {
                    tracing::warn!(code = fault.code.name(), reason = %fault, "cannot compare the blocks of voters");
                }
            }
            for effect in found.drain(..) {
                self.follow(effect).await;
            }
        }
    }

    fn hear(&mut self, now: u64, from: u64, signed: &Signed, found: &mut Vec<disputes::Effect>) {
        let certificates = &self.certificates;
        let certificate = |height| certificates.recent.of(height);
        let view = View { certifier: &self.certifier, certified: certificates.certified(), certificate: &certificate };
        self.disputes.heard(now, from, signed, &view, found);
    }

    async fn act(&mut self, effect: Effect, found: &mut Vec<disputes::Effect>) {
        match effect {
            Effect::Record(statement) => self.keep(move |certificates| certificates.kept.record(&statement)).await,
            // Lost where a member is not connected; the newest own one is sent again.
            Effect::Tell(signed) => self.send_statement(&signed),
            Effect::Pass(signed) => {
                let (node, height) = (self.ordering.directory.name(signed.signature.node), signed.statement.height);
                tracing::debug!(node, height, "voters signed different results of a block; forwarding the proof");
                self.send_statement(&signed);
            }
            Effect::Certified { certificate, governs } => {
                let height = certificate.statement.height;
                self.certificates.certified.fetch_max(height, Relaxed);
                let is_newest = height >= self.certifier.executed_height();
                self.certificates.lag.certified(is_newest, Instant::now());
                self.certificates.recent.add(certificate.clone());
                let passes = self.certificates.passed.wants(height, certificate.statement.time);
                if governs || passes {
                    self.keep_proof(certificate, governs, passes).await;
                }
            }
            Effect::Misbehaved(proof) => self.disputes.found(*proof, found),
        }
    }

    /// Keeps a certificate for good: it governs, or proves the blocks of ten seconds.
    async fn keep_proof(&self, certificate: Certificate, governs: bool, passes: bool) {
        let (ledger, first) =
            (Arc::clone(&self.ordering.storage.ledger), self.ordering.storage.log.store.first_index());
        self.keep(move |certificates| {
            // One that was certified long after it was executed is left out. Another node has it.
            let Some(proof) = proof(&ledger, certificate, |_| false)? else { return Ok(()) };
            if passes {
                certificates.passed.keep(&proof, first)?;
            }
            if governs { certificates.kept.write_governing(&proof) } else { Ok(()) }
        })
        .await;
    }

    /// Microseconds until the newest proof is to be written; none if it is.
    fn keep_wait(&self, kept: Option<Instant>) -> Option<u64> {
        let since = kept.map_or(KEEP_EVERY, |kept| kept.elapsed());
        let wait = KEEP_EVERY.saturating_sub(since).as_micros();
        let is_due = self.certificates.certified() > self.certificates.written.load(Relaxed);
        is_due.then(|| u64::try_from(wait).unwrap_or(u64::MAX))
    }

    async fn keep_newest(&self) {
        let ledger = Arc::clone(&self.ordering.storage.ledger);
        self.keep(move |certificates| certificates.keep_newest(&ledger)).await;
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

    /// Does what follows from something that contradicts.
    async fn follow(&self, effect: disputes::Effect) {
        match effect {
            disputes::Effect::Pass(signed) => self.send_statement(&signed),
            disputes::Effect::Show { proof, except } => self.send_proof(&proof, except),
            disputes::Effect::Exclude(liars) => self.ordering.slot.exclude(liars),
            disputes::Effect::Keep(proof) => {
                evidence::log(&proof, &self.ordering.directory);
                self.keep(move |certificates| certificates.kept.misbehaviour(&proof)).await;
            }
            disputes::Effect::Diverged { height } => self.stop(height).await,
            disputes::Effect::Contradicted { branch, own } => self.end_contradicted(*branch, own).await,
            disputes::Effect::TwoCertificates(branch) => self.show_branch(*branch).await,
            disputes::Effect::Refused { from, reason } => {
                let node = self.ordering.directory.name(from);
                tracing::warn!(node, code = reason.code.name(), %reason, "proof of misbehaviour rejected");
            }
        }
    }

    /// This node has computed one block in two ways: it stops, and computes its state again from the blocks at its next start.
    async fn stop(&self, height: u64) {
        let reason = Rejection::new(Code::Diverged, "this node has signed two different results of one block")
            .found(format!("two results of block {height}, both with its own signature"))
            .wanted("one result per block, equal on all nodes");
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
            tracing::error!("thread panicked while stopping the node");
        }
    }

    /// Writes to the disk, on a thread that may wait for it.
    async fn keep(&self, write: impl FnOnce(&Certificates) -> Result<(), Rejection> + Send + 'static) {
        let certificates = Arc::clone(&self.certificates);
        match tokio::task::spawn_blocking(move || write(&certificates)).await {
            Ok(Ok(())) => {}
            Ok(Err(fault)) => tracing::warn!(code = fault.code.name(), reason = %fault, "cannot store a proof"),
            Err(_) => tracing::error!("thread panicked while writing a proof"),
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
