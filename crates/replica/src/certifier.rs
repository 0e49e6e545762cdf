//! From statements to certificates: the node signs its own, hears those of others, and notices when they are enough.
//!
//! It has no thread, clock or key of its own. It is told of executed blocks, of the log, of time and of the statements of
//! peers, and says what to send and to keep. It keeps a bounded number of statements of each voter, nothing of
//! others, and checks each signature once. Checking takes longer than ordering a block, so the thread that
//! orders never does it.

mod heard;

use heard::{Heard, Height};
use ledger_base::hash::Hash;
use ledger_base::invariant;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::Rejection;
use ledger_identity::Identity;
use ledger_identity::msp::Msps;
use ledger_light::{Certificate, Head, Lie, Signature, Signed, Statement, Transfer, Vote, Voters};
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

/// An event.
pub enum Event {
    /// A block that is to be certified was executed. Heights grow.
    Executed {
        /// The node's own statement about it.
        statement: Statement,
        /// It changes whom others trust.
        governs: bool,
    },
    /// Other nodes vote, or others are trusted, from a height on.
    Voters(Era),
    /// The log of this node is on its disk up to this height.
    Durable(u64),
    /// A peer says something.
    Heard {
        /// The peer, as its connection names it.
        from: u64,
        /// Its statement.
        signed: Signed,
    },
    /// Time has gone on.
    Time,
}

/// An effect: the node must do it.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Send this to every member. Losing it is allowed.
    Tell(Signed),
    /// Enough have signed.
    Certified {
        /// The certificate.
        certificate: Certificate,
        /// Its block changes whom others trust: keep it for as long as the ledger.
        governs: bool,
    },
    /// A node has said two different things about one height: keep the proof.
    Lied(Box<Lie>),
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
}

impl<S: Signing> Certifier<S> {
    /// For this node of this network, with the voters as of its newest block.
    pub fn new(me: u64, network: Hash, signing: S, era: Era) -> Self {
        let (executed, eras) = (era.from.saturating_sub(1), VecDeque::from([era]));
        Self { me, network, signing, eras, heights: BTreeMap::new(), executed, durable: 0, newest: None }
    }

    /// Takes an event; `now` is steadily growing time in microseconds.
    pub fn step(&mut self, now: u64, event: Event, out: &mut Vec<Effect>) {
        match event {
            Event::Executed { statement, governs } => self.executed(now, statement, governs, out),
            Event::Voters(era) => self.voters(era),
            Event::Durable(height) => {
                self.durable = self.durable.max(height);
                self.sign_what_is_durable(now, out);
            }
            Event::Heard { from, signed } => self.heard(from, signed, out),
            Event::Time => self.tell_again(now, out),
        }
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

    fn executed(&mut self, now: u64, statement: Statement, governs: bool, out: &mut Vec<Effect>) {
        let height = statement.height;
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
    }

    /// Signs what the log holds on the disk: a restart then finds the same block at this height, executes it to the same
    /// results, and says the same. So this node makes one statement for a height, ever.
    fn sign_what_is_durable(&mut self, now: u64, out: &mut Vec<Effect>) {
        let durable = self.durable;
        let unsigned = |height: &Height| height.own.is_some() && !height.heard.contains_key(&self.me);
        let due = self.heights.range(..=durable.min(self.executed)).filter(|(_, height)| unsigned(height));
        let due: Vec<u64> = due.map(|(height, _)| *height).collect();
        for height in due {
            let votes = self.era(height).is_some_and(|era| era.voters.is_voter(self.me));
            let Some(entry) = self.heights.get_mut(&height).filter(|_| votes) else { continue };
            let Some((statement, _)) = entry.own else { continue };
            invariant!(
                durable >= height,
                "a voter signs what its own log holds",
                "{height}, and {durable} on the disk"
            );
            match self.signing.sign(&statement) {
                Ok(signed) => {
                    entry.heard.insert(self.me, Heard::good(signed.clone()));
                    out.push(Effect::Tell(signed.clone()));
                    self.newest = Some((signed, now + TELL_AGAIN_MIN, TELL_AGAIN_MIN));
                }
                Err(reason) => tracing::warn!(code = reason.code.name(), %reason, height, "a statement is not signed"),
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

    fn heard(&mut self, from: u64, signed: Signed, out: &mut Vec<Effect>) {
        let height = signed.statement.height;
        // A node speaks for itself only, so nobody fills the room of another.
        if signed.signature.node != from || from == self.me || signed.statement.network != self.network {
            return;
        }
        let votes = self.era(height).is_some_and(|era| era.voters.is_voter(from));
        if !votes && !active(Mutation::CountALearner) {
            return;
        }
        // A block that is not due, or not kept any more, has no place here.
        let known = self.heights.get(&height).is_some_and(|height| height.own.is_some());
        if height <= self.executed && !known {
            return;
        }
        if height > self.executed {
            self.make_room_ahead(from);
        }
        let entry = self.heights.entry(height).or_default();
        match entry.heard.get(&from) {
            None => {
                entry.heard.insert(from, Heard::unchecked(signed));
                self.count(height, out);
            }
            Some(before) if before.signed.statement == signed.statement => {}
            Some(_) => self.contradiction(from, signed, out),
        }
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

    /// A node says something else about a height than before.
    fn contradiction(&mut self, from: u64, signed: Signed, out: &mut Vec<Effect>) {
        let height = signed.statement.height;
        let Some(mut before) = self.heights.get_mut(&height).and_then(|entry| entry.heard.remove(&from)) else {
            return;
        };
        if before.may_be_contradicted() && self.is_good(&signed) {
            if before.good || self.is_good(&before.signed) {
                before.proved();
                before.good = true;
                out.push(Effect::Lied(Box::new(Lie { first: before.signed.clone(), second: signed })));
            } else {
                // It never said the first one.
                before = Heard::good(signed);
            }
        }
        self.heights.entry(height).or_default().heard.insert(from, before);
        self.count(height, out);
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
            .inspect_err(
                |reason| tracing::debug!(code = reason.code.name(), %reason, "a statement of a peer is not believed"),
            )
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
