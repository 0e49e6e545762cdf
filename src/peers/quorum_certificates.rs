//! Certificates of blocks: this node states what executing gave, hears what others state, and keeps what enough have signed.
//!
//! ```text
//! certificates   the task around the machine of `ledger_replica::certifier`; the view of the rest of the node
//!   keys         the node's key, and whose certificates are believed
//!   inbox        statements of peers that wait: a few of each
//!   kept         the files below the data directory
//!   recent       the newest certificates, for those who ask for a proof
//!   passed       one in ten seconds of all before, on the disk
//! ```
//! Executing a block costs a message to the task, and nothing else: signing and checking happen beside the threads that
//! order and execute.

mod inbox;
mod kept;
mod keys;
mod passed;
mod recent;

pub(crate) use kept::{newest_proof, set_proofs_aside};
pub(crate) use keys::Keys;

use crate::ordering::Ordering;
use crate::ordering::directory::Directory;
use crate::peers::connections::Connections;
use bytes::Bytes;
use inbox::Inbox;
use kept::{Kept, Lied};
use ledger::{Ledger, Outcome};
use ledger_base::rejection::Rejection;
use ledger_light::fact::Fact;
use ledger_light::{Certificate, DoubleHead, DoubleVote, Lie, Proof, Signed, Statement};
use ledger_raft::{PeerMessage, SignedStatement};
use ledger_replica::Observer;
use ledger_replica::certifier::{Certifier, Effect, Era, Event};
use passed::Passed;
use recent::Recent;
use std::path::Path;
use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::mpsc;

/// Pause before the disk is asked again for a block that is to be signed.
const DISK_PAUSE: Duration = Duration::from_millis(2);
/// Time between two writes of the newest proof, at least: a crash loses that much of them.
const KEEP_EVERY: Duration = Duration::from_secs(2);

/// The node tells the task.
pub(crate) enum Told {
    /// A step of the machine.
    Event(Event),
    /// A voter has voted for two nodes in one term.
    VotedTwice(Box<DoubleVote>),
    /// A leader has signed two logs in one term.
    TwoHeads(Box<DoubleHead>),
}

/// The view that the rest of the node has of its certificates.
pub(crate) struct Certificates {
    told: mpsc::UnboundedSender<Told>,
    heard: Inbox,
    certified: AtomicU64,
    /// The lies of which this node has proofs.
    lies: Mutex<Vec<Lied>>,
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
        let lies = Mutex::new(kept.lies()?);
        let (heard, recent) = (Inbox::default(), Recent::default());
        let passed = Passed::open(kept.directory())?;
        Ok((Arc::new(Self { told, heard, certified, lies, recent, kept, passed }), events))
    }

    /// The newest height for which this node has a certificate; 0 if there is none.
    pub(crate) fn certified(&self) -> u64 {
        self.certified.load(Relaxed)
    }

    /// The nodes that have lied, in words; empty if none has.
    pub(crate) fn lies(&self, directory: &Directory) -> String {
        let lies = self.lies.lock().unwrap_or_else(PoisonError::into_inner);
        let words = |lied: &Lied| match lied {
            Lied::About { height, node } => {
                format!("{} has signed two different statements about block {height}", directory.name(*node))
            }
            Lied::Voted { term, node } => {
                format!("{} has voted for two nodes in term {term}", directory.name(*node))
            }
            Lied::Led { term, node } => {
                format!("{} has led with two different logs in term {term}", directory.name(*node))
            }
        };
        lies.iter().map(words).collect::<Vec<_>>().join(", ")
    }

    /// A peer has sent a statement. It waits for the task, or is lost if too many of that peer wait.
    pub(crate) fn hear(&self, from: u64, statement: SignedStatement) {
        self.heard.put(from, statement.signed);
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

    /// The engine has a proof that a voter has voted for two nodes. The task keeps it: nobody waits for the disk here.
    pub(crate) fn voted_twice(&self, proof: Box<DoubleVote>) {
        let _stopping = self.told.send(Told::VotedTwice(proof));
    }

    /// The engine has a proof that a leader has signed two logs in one term. The task keeps it.
    pub(crate) fn two_heads(&self, proof: Box<DoubleHead>) {
        let _stopping = self.told.send(Told::TwoHeads(proof));
    }

    /// Notes a lie; false if it is known.
    fn note(&self, lied: Lied) -> bool {
        let mut lies = self.lies.lock().unwrap_or_else(PoisonError::into_inner);
        let is_new = !lies.contains(&lied);
        lies.extend(is_new.then_some(lied));
        is_new
    }
}

impl Observer for Certificates {
    fn executed(&self, outcome: &Arc<Outcome>, ledger: &Ledger) {
        let (header, governs) = (&outcome.header, outcome.governs);
        if let Some(roots) = outcome.certifiable {
            let statement = Statement {
                network: ledger.network(),
                height: header.height,
                time: header.time,
                block: outcome.hash,
                results: roots.results,
            };
            let _stopping = self.told.send(Told::Event(Event::Executed { statement, governs }));
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
    /// Signs, hears and counts until the node stops.
    pub(crate) async fn run(mut self) {
        let started = Instant::now();
        let now = || u64::try_from(started.elapsed().as_micros()).unwrap_or(u64::MAX);
        let (mut effects, mut written) = (Vec::new(), None);
        loop {
            let event = tokio::select! {
                told = self.told.recv() => match told {
                    Some(Told::Event(event)) => event,
                    Some(Told::VotedTwice(proof)) => {
                        self.voted_twice(&proof).await;
                        continue;
                    }
                    Some(Told::TwoHeads(proof)) => {
                        self.two_heads(&proof).await;
                        continue;
                    }
                    None => return,
                },
                (from, signed) = self.certificates.heard.next() => match Signed::from_bytes(&signed) {
                    Ok(signed) => Event::Heard { from, signed },
                    Err(reason) => {
                        tracing::warn!(node = self.ordering.directory.name(from), code = reason.code.name(), %reason, "a statement cannot be read");
                        continue;
                    }
                },
                () = tokio::time::sleep(DISK_PAUSE), if self.certifier.waits_for_disk() => Event::Time,
                () = until(self.certifier.wait(now())) => Event::Time,
            };
            self.certifier.step(now(), event, &mut effects);
            self.certifier.step(now(), Event::Durable(self.ordering.storage.log.store.durable_index()), &mut effects);
            for effect in effects.drain(..) {
                self.act(effect, &mut written).await;
            }
        }
    }

    async fn act(&self, effect: Effect, written: &mut Option<Instant>) {
        match effect {
            Effect::Tell(signed) => {
                let message = PeerMessage::Statement(SignedStatement { signed: signed.to_bytes() });
                for member in self.ordering.directory.members().iter().filter(|member| member.id != self.me) {
                    // Lost if it is not connected; the newest is told again.
                    self.connections.send(member.id, &message);
                }
            }
            Effect::Certified { certificate, governs } => {
                let height = certificate.statement.height;
                self.certificates.certified.fetch_max(height, Relaxed);
                let newest = height == self.certificates.certified();
                let due = newest && written.is_none_or(|before| before.elapsed() >= KEEP_EVERY);
                self.certificates.recent.add(certificate.clone());
                let passes = self.certificates.passed.wants(height, certificate.statement.time);
                if due || governs || passes {
                    *written = if due { Some(Instant::now()) } else { *written };
                    self.keep_proof(certificate, due, governs, passes).await;
                }
            }
            Effect::Lied(lie) => self.lied(&lie).await,
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

    async fn lied(&self, lie: &Lie) {
        let (node, height) = (lie.first.signature.node, lie.first.statement.height);
        tracing::error!(
            node = self.ordering.directory.name(node),
            height,
            first = %lie.first.statement.results,
            second = %lie.second.statement.results,
            "a node has signed two different statements about one block; the proof is kept"
        );
        self.keep_lie(lie.into(), lie.to_bytes()).await;
    }

    async fn voted_twice(&self, proof: &DoubleVote) {
        let (node, term) = (self.ordering.directory.name(proof.voter()), proof.term);
        let [first, second] = proof.votes.each_ref().map(|(candidate, _)| self.ordering.directory.name(*candidate));
        tracing::error!(node, term, first, second, "a voter has voted for two nodes in one term; the proof is kept");
        self.keep_lie(proof.into(), proof.to_bytes()).await;
    }

    async fn two_heads(&self, proof: &DoubleHead) {
        let (node, DoubleHead { term, height, branches: [own, other], .. }) =
            (self.ordering.directory.name(proof.leader), proof);
        tracing::error!(
            node, term, height, own = %own.base, other = %other.base,
            "a leader has signed two different logs in one term; the proof is kept"
        );
        self.keep_lie(proof.into(), proof.to_bytes()).await;
    }

    async fn keep_lie(&self, lied: Lied, proof: Bytes) {
        if self.certificates.note(lied) {
            self.keep(move |kept| kept.lie(lied, &proof)).await;
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

/// Waits so many microseconds, or for ever.
async fn until(microseconds: Option<u64>) {
    match microseconds {
        Some(wait) => tokio::time::sleep(Duration::from_micros(wait)).await,
        None => std::future::pending().await,
    }
}
