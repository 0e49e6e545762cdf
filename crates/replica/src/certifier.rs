//! From statements to certificates: the node signs its own, receives those of others, and notices when they are enough.
//!
//! It has no thread, clock or key of its own. It takes executed blocks, the end of the log, time and the statements of
//! peers, and returns what to send and to keep. It keeps a bounded number of statements of each voter, nothing of
//! others, and checks each signature once. Checking takes longer than ordering a block, so the thread that
//! orders never does it.
//!
//! **Disputes.** Where a voter has signed another statement than this node about a block, this node passes on all signed
//! statements that it has about that height, once each. So a voter that signs one block for one node and another block for
//! another node is seen by both. A peer may pass on statements of others: their signatures are checked at once, and only
//! a bounded number a second.
//!
//! **Restarts.** A node signs one block for each place, whatever disk it finds. So about a block that its log held when it
//! started, it signs only the statement that its own record has. Without a record it signs nothing about these blocks; the
//! next one certifies all before it.

mod heard;

use heard::{Heard, Height};
use ledger_base::hash::Hash;
use ledger_base::invariant;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::Rejection;
use ledger_identity::Identity;
use ledger_identity::msp::Msps;
use ledger_light::{Certificate, Complaint, Head, Misbehaviour, Signature, Signed, Statement, Transfer, Vote, Voters};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

/// Most executed heights whose statements are kept.
pub const HEIGHTS_MAX: usize = 128;
/// Most heights above the newest executed one for which the statement of one node is kept.
pub const AHEAD_MAX: usize = 128;
/// Most changes of the voters that are kept for older heights.
const ERAS_MAX: usize = 64;
/// Most older statements that are told again with the newest one: about blocks that change whom others trust, as every
/// node keeps their certificates.
const GOVERNING_MAX: usize = 8;
/// Time until the newest statement is told again, microseconds. It doubles each time: a message may have been lost.
const TELL_AGAIN_MIN: u64 = 1_000_000;
/// The longest such time, microseconds.
const TELL_AGAIN_MAX: u64 = 64_000_000;
/// Most statements of others, passed on by one peer in a second, whose signatures are checked.
const PASSED_MAX: u32 = 256;
/// The second in which they are counted, microseconds.
const PASSED_TIME: u64 = 1_000_000;

/// The voters whose statements count from a height on: those as of the block before it.
#[derive(Clone)]
pub struct Era {
    /// The first height.
    pub from: u64,
    /// The voters.
    pub voters: Voters,
    /// The organisations that their certificates are checked by.
    pub msps: Arc<Msps>,
}

/// The key of the node, and how certificates of others are checked.
pub trait Signing {
    /// Signs a statement as this node.
    ///
    /// # Errors
    /// If the system's randomness fails.
    fn sign(&self, statement: &Statement) -> Result<Signed, Rejection>;

    /// Signs a vote of this node.
    ///
    /// # Errors
    /// As [`Signing::sign`].
    fn sign_vote(&self, vote: &Vote) -> Result<Signature, Rejection>;

    /// Signs that this node hands its leadership over.
    ///
    /// # Errors
    /// As [`Signing::sign`].
    fn sign_transfer(&self, transfer: &Transfer) -> Result<Signature, Rejection>;

    /// Signs a complaint of this node.
    ///
    /// # Errors
    /// As [`Signing::sign`].
    fn sign_complaint(&self, complaint: &Complaint) -> Result<Signature, Rejection>;

    /// Signs the head of this leader's log.
    ///
    /// # Errors
    /// As [`Signing::sign`].
    fn sign_head(&self, head: &Head) -> Result<Signature, Rejection>;

    /// The owner of this certificate at that time (microseconds since the UNIX epoch), by these organisations. A revoked one is
    /// nobody's.
    ///
    /// # Errors
    /// The reason why it is not valid.
    fn identify(&self, msps: &Arc<Msps>, certificate: &[u8], time: u64) -> Result<Identity, Rejection>;
}

/// A block that is to be certified, as this node has executed it.
#[derive(Clone, Copy, Debug)]
pub struct Certifiable {
    /// Its height.
    pub height: u64,
    /// Block time, microseconds since the UNIX epoch.
    pub time: u64,
    /// Hash of the block.
    pub block: Hash,
    /// Root over the facts that executing it gave.
    pub results: Hash,
}

/// The state of a node's disk at its start.
#[derive(Clone, Debug, Default)]
pub struct Earlier {
    /// The end of its log.
    pub end: u64,
    /// The newest statements that it has signed, as far as its record has them.
    pub signed: Vec<Statement>,
}

/// An event.
pub enum Event {
    /// A block that is to be certified was executed. Heights grow.
    Executed {
        /// The result of the block.
        block: Certifiable,
        /// It changes whom others trust.
        governs: bool,
    },
    /// Other nodes vote, or others are trusted, from a height on.
    Voters(Era),
    /// The log of this node is on its disk up to this height.
    Durable(u64),
    /// A peer has sent a statement.
    Heard {
        /// The peer, as its connection names it.
        from: u64,
        /// Its statement, or one of another node that it passes on.
        signed: Signed,
    },
    /// Time has gone on.
    Time,
}

/// An effect: the node must do it.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Record that the node signs this statement, before the next effect. After a crash it signs the same again only if the
    /// record has it, so losing the record is allowed.
    Record(Statement),
    /// Send this statement of the node to every member. Losing it is allowed.
    Tell(Signed),
    /// Send this statement of another node to every member: there is another one about the same height. Losing it is
    /// allowed.
    Pass(Signed),
    /// Enough have signed.
    Certified {
        /// The certificate.
        certificate: Certificate,
        /// Its block changes whom others trust: keep it for as long as the ledger.
        governs: bool,
    },
    /// A node has signed two different statements about one height: keep the proof, and send it to every member.
    Misbehaved(Box<Misbehaviour>),
}

/// Makes certificates of statements.
pub struct Certifier<S> {
    me: u64,
    network: Hash,
    signing: S,
    /// Ascending.
    eras: VecDeque<Era>,
    heights: BTreeMap<u64, Height>,
    /// Newest height that was executed and is to be certified.
    executed: u64,
    /// Newest height of the log on the disk.
    durable: u64,
    /// Newest own statement, and when it is told again: the moment, and the pause before it.
    newest: Option<(Signed, u64, u64)>,
    earlier: Earlier,
    /// The number of statements of others that each peer has passed on in the second that began then.
    passed: BTreeMap<u64, (u64, u32)>,
}

impl<S: Signing> Certifier<S> {
    /// For this node of this network, with the voters as of its newest block, and what it found when it started.
    pub fn new(me: u64, network: Hash, signing: S, era: Era, earlier: Earlier) -> Self {
        let (executed, eras) = (era.from.saturating_sub(1), VecDeque::from([era]));
        let (heights, passed) = (BTreeMap::new(), BTreeMap::new());
        Self { me, network, signing, eras, heights, executed, durable: 0, newest: None, earlier, passed }
    }

    /// Takes an event; `now` is steadily growing time in microseconds.
    pub fn step(&mut self, now: u64, event: Event, out: &mut Vec<Effect>) {
        match event {
            Event::Executed { block, governs } => self.executed(now, block, governs, out),
            Event::Voters(era) => self.voters(era),
            Event::Durable(height) => {
                self.durable = self.durable.max(height);
                self.sign_what_is_durable(now, out);
            }
            Event::Heard { from, signed } => self.heard(now, from, signed, out),
            Event::Time => self.tell_again(now, out),
        }
    }

    /// Has this node executed the block at this height, and does it still take statements about it?
    pub fn holds(&self, height: u64) -> bool {
        self.heights.get(&height).is_some_and(|entry| entry.own.is_some())
    }

    /// The newest height that was executed and is to be certified.
    pub fn executed_height(&self) -> u64 {
        self.executed
    }

    /// Does this node state the same about that block?
    pub fn agrees_with(&self, statement: &Statement) -> bool {
        self.heights.get(&statement.height).and_then(|entry| entry.own).is_some_and(|(own, _)| own == *statement)
    }

    /// Does a statement of this node wait until its block is on the disk?
    pub fn waits_for_disk(&self) -> bool {
        self.heights.range(self.durable + 1..).any(|(_, height)| height.own.is_some())
    }

    /// Microseconds until [`Event::Time`] is to be told, if nothing else happens.
    pub fn wait(&self, now: u64) -> Option<u64> {
        self.newest.as_ref().map(|(_, due, _)| due.saturating_sub(now))
    }

    /// Statements about later blocks were checked by the voters before, so they are checked again.
    fn voters(&mut self, era: Era) {
        for (_, entry) in self.heights.range_mut(era.from..) {
            entry.heard.values_mut().for_each(|heard| heard.good = false);
        }
        self.eras.push_back(era);
        if self.eras.len() > ERAS_MAX {
            self.eras.pop_front();
        }
    }

    fn era(&self, height: u64) -> Option<&Era> {
        self.eras.iter().rfind(|era| era.from <= height)
    }

    fn executed(&mut self, now: u64, block: Certifiable, governs: bool, out: &mut Vec<Effect>) {
        let Certifiable { height, time, block, results } = block;
        let recoveries = self.era(height).map_or(0, |era| era.voters.recoveries);
        let statement = Statement { network: self.network, recoveries, height, time, block, results };
        invariant!(height > self.executed, "blocks are stated in order", "block {height} after {}", self.executed);
        self.executed = height;
        self.heights.entry(height).or_default().own = Some((statement, governs));
        // Statements about blocks that are not due wait for nothing.
        self.heights.retain(|other, entry| *other >= height || entry.own.is_some());
        while self.heights.range(..=height).count() > HEIGHTS_MAX {
            self.heights.pop_first();
        }
        let oldest = self.heights.keys().next().copied().unwrap_or(height);
        while self.eras.get(1).is_some_and(|next| next.from <= oldest) {
            self.eras.pop_front();
        }
        self.sign_what_is_durable(now, out);
        self.count(height, out);
        self.dispute(height, out);
    }

    /// Signs what the log holds on the disk: a restart then finds the same block at this height, or the end of its log is below
    /// it. A block that the log held at the start is signed only as it was signed before.
    fn sign_what_is_durable(&mut self, now: u64, out: &mut Vec<Effect>) {
        let durable = self.durable;
        let unsigned = |height: &Height| height.own.is_some() && !height.heard.contains_key(&self.me);
        let due = self.heights.range(..=durable.min(self.executed)).filter(|(_, height)| unsigned(height));
        let due: Vec<u64> = due.map(|(height, _)| *height).collect();
        for height in due {
            let votes = self.era(height).is_some_and(|era| era.voters.is_voter(self.me));
            let Some(entry) = self.heights.get_mut(&height).filter(|_| votes) else { continue };
            let Some((statement, _)) = entry.own else { continue };
            let is_new = height > self.earlier.end;
            if !is_new && !self.earlier.signed.contains(&statement) {
                continue;
            }
            invariant!(
                durable >= height,
                "a voter signs what its own log holds",
                "{height}, and {durable} on the disk"
            );
            match self.signing.sign(&statement) {
                Ok(signed) => {
                    entry.heard.insert(self.me, Heard::good(signed.clone()));
                    out.extend(is_new.then_some(Effect::Record(statement)));
                    out.push(Effect::Tell(signed.clone()));
                    self.newest = Some((signed, now + TELL_AGAIN_MIN, TELL_AGAIN_MIN));
                }
                Err(reason) => tracing::warn!(code = reason.code.name(), %reason, height, "cannot sign a statement"),
            }
            self.count(height, out);
        }
    }

    fn tell_again(&mut self, now: u64, out: &mut Vec<Effect>) {
        if let Some((signed, due, pause)) = self.newest.as_mut().filter(|(_, due, _)| *due <= now) {
            *pause = (*pause * 2).min(TELL_AGAIN_MAX);
            *due = now + *pause;
            let newest = signed.statement.height;
            let older = self.heights.range(..newest).rev().map(|(_, height)| height);
            let governing = older.filter(|height| height.own.is_some_and(|(_, governs)| governs));
            let told = governing.filter_map(|height| Some(height.heard.get(&self.me)?.signed.clone()));
            out.extend(told.take(GOVERNING_MAX).map(Effect::Tell));
            out.push(Effect::Tell(signed.clone()));
        }
    }

    fn heard(&mut self, now: u64, from: u64, signed: Signed, out: &mut Vec<Effect>) {
        let (node, height) = (signed.signature.node, signed.statement.height);
        if node == self.me || from == self.me || signed.statement.network != self.network {
            return;
        }
        let votes = self.era(height).is_some_and(|era| era.voters.is_voter(node));
        if !votes && !active(Mutation::CountALearner) {
            return;
        }
        // A block that is not due, or not kept any more, has no place here.
        let known = self.heights.get(&height).is_some_and(|height| height.own.is_some());
        if height <= self.executed && !known {
            return;
        }
        let before = self.heights.get(&height).and_then(|entry| entry.heard.get(&node));
        if before.is_some_and(|before| before.signed.statement == signed.statement) {
            return;
        }
        // No peer fills the room of another one: of what a peer passes on, only what its signer has signed counts.
        let is_passed_on = node != from;
        if is_passed_on && !(self.may_pass(now, from) && self.is_good(&signed)) {
            return;
        }
        if height > self.executed {
            self.make_room_ahead(node);
        }
        let entry = self.heights.entry(height).or_default();
        match entry.heard.get(&node) {
            None if is_passed_on => drop(entry.heard.insert(node, Heard::good(signed))),
            None => drop(entry.heard.insert(node, Heard::unchecked(signed))),
            Some(_) => self.contradiction(signed, is_passed_on, out),
        }
        self.count(height, out);
        self.dispute(height, out);
    }

    /// May this peer pass on another statement now? Counts.
    fn may_pass(&mut self, now: u64, peer: u64) -> bool {
        self.passed.retain(|_, (begun, _)| now.saturating_sub(*begun) < PASSED_TIME);
        let (_, count) = self.passed.entry(peer).or_insert((now, 0));
        *count = count.saturating_add(1);
        *count <= PASSED_MAX
    }

    /// The oldest of too many statements of one node about blocks that this node has not executed makes room.
    fn make_room_ahead(&mut self, from: u64) {
        let ahead = self.heights.range(self.executed + 1..);
        let of_node: Vec<u64> = ahead.filter(|(_, entry)| entry.heard.contains_key(&from)).map(|(at, _)| *at).collect();
        let Some(oldest) = of_node.first().filter(|_| of_node.len() >= AHEAD_MAX) else { return };
        if let Some(entry) = self.heights.get_mut(oldest) {
            entry.heard.remove(&from);
        }
        self.heights.retain(|_, entry| entry.own.is_some() || !entry.heard.is_empty());
    }

    /// A node states something else about a height than before.
    fn contradiction(&mut self, signed: Signed, is_checked: bool, out: &mut Vec<Effect>) {
        let (node, height) = (signed.signature.node, signed.statement.height);
        let Some(mut before) = self.heights.get_mut(&height).and_then(|entry| entry.heard.remove(&node)) else {
            return;
        };
        if is_checked || (before.may_be_contradicted() && self.is_good(&signed)) {
            before.good = before.good || self.is_good(&before.signed);
            if before.good {
                let proof = before.contradicted_by(signed);
                out.extend(proof.map(|proof| Effect::Misbehaved(Box::new(proof))));
            } else {
                // It never signed the first one.
                before = Heard::good(signed);
            }
        }
        self.heights.entry(height).or_default().heard.insert(node, before);
    }

    /// Passes on the statements about a height if some voter has signed another one than this node.
    fn dispute(&mut self, height: u64, out: &mut Vec<Effect>) {
        let Some(entry) = self.heights.get(&height) else { return };
        let Some((own, _)) = entry.own else { return };
        let others = || entry.heard.iter().filter(|(node, _)| **node != self.me);
        let agree = others().all(|(_, heard)| heard.signed.statement == own);
        if agree || others().all(|(_, heard)| heard.passed) {
            return;
        }
        let checked: Vec<_> =
            others().map(|(node, heard)| (*node, heard.good || self.is_good(&heard.signed))).collect();
        let Some(entry) = self.heights.get_mut(&height) else { return };
        for (node, good) in checked {
            match entry.heard.get_mut(&node) {
                Some(heard) if good => heard.good = true,
                _ => drop(entry.heard.remove(&node)),
            }
        }
        if entry.heard.values().all(|heard| heard.signed.statement == own) {
            return;
        }
        let me = self.me;
        let others = entry.heard.iter_mut().filter(|(node, heard)| **node != me && !heard.passed);
        out.extend(others.map(|(_, heard)| {
            heard.passed = true;
            Effect::Pass(heard.signed.clone())
        }));
    }

    /// Is it signed by a node that votes on the height?
    fn is_good(&self, signed: &Signed) -> bool {
        let Signed { statement, signature } = signed;
        let Some(era) = self.era(statement.height) else { return false };
        let identity = self.signing.identify(&era.msps, &signature.certificate, statement.time);
        let checked = identity.and_then(|identity| match active(Mutation::CountALearner) {
            true => Ok(()),
            false => era.voters.check(statement, signature, &identity),
        });
        checked
            .inspect_err(|reason| tracing::debug!(code = reason.code.name(), %reason, "statement of a peer rejected"))
            .is_ok()
    }

    /// Looks whether enough have signed what this node says about a height.
    fn count(&mut self, height: u64, out: &mut Vec<Effect>) {
        let Some(entry) = self.heights.get(&height).filter(|entry| !entry.certified) else { return };
        let Some((statement, governs)) = entry.own else { return };
        let agrees = |heard: &Heard| heard.signed.statement == statement || active(Mutation::CountOtherResults);
        let unchecked = entry.heard.iter().filter(|(_, heard)| !heard.good && agrees(heard));
        let checked: Vec<_> = unchecked.map(|(node, heard)| (*node, self.is_good(&heard.signed))).collect();
        let voters = self.era(height).map(|era| era.voters.clone()).unwrap_or_default();
        let Some(entry) = self.heights.get_mut(&height) else { return };
        for (node, good) in checked {
            match entry.heard.get_mut(&node) {
                Some(heard) if good => heard.good = true,
                _ => drop(entry.heard.remove(&node)),
            }
        }
        let agree = entry.heard.iter().filter(|(_, heard)| heard.good && agrees(heard));
        let agree: BTreeMap<u64, &Heard> = agree.map(|(node, heard)| (*node, heard)).collect();
        if enough(&voters, agree.keys().copied().collect()) {
            let signatures = agree.values().map(|heard| heard.signed.signature.clone()).collect();
            out.push(Effect::Certified { certificate: Certificate { statement, signatures }, governs });
            entry.certified = true;
        }
    }
}

fn enough(voters: &Voters, signers: BTreeSet<u64>) -> bool {
    if active(Mutation::CountAVoterTwice) {
        return signers.len() * 2 > voters.voters.len() / 2 + 1;
    }
    if active(Mutation::CountALearner) {
        return signers.len() > voters.voters.len() / 2;
    }
    voters.enough(&signers).is_ok()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing, reason = "tests")]
mod tests;
