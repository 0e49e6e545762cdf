//! Signed heads: what a leader sends is signed, so that a lie can be proved.
//!
//! ```text
//! append        ends with a head: term, height of its last entry, hash of the chain up to it; signed by the leader
//! follower      takes no append whose head the leader has not signed
//! head          each voter that follows shows the newest head that it has checked to the others, once a second
//! ```
//! One head covers all entries that one round sends, and is the same for all receivers that get as far. A leader that sends two
//! followers different entries signs two logs. Each of them shows its head to the other. The one that holds a head of the same
//! leader and term above another block has the proof ([`DoubleHead`]).
//!
//! **Costs.** One signature for each round with new entries, and one check at each receiver. A head that was signed or checked
//! last costs a comparison.
//!
//! **Certificates.** A head is checked by the certificate in the vote that the leader gave itself, which its mandate shows. A
//! leader whose certificate is renewed shows its mandate again. A follower that cannot check a head asks for the
//! mandate. One that cannot for longer asks its peers for blocks: a forced recovery among them changes how heads are signed.

use super::mandate::{LogHead, Rests};
use super::{Engine, READ_BYTES};
use crate::interface::{DoubleHead, HeadBranch, Output};
use crate::message::{LeaderHead, PeerMessage, RaftKind, RaftMessage};
use bytes::Bytes;
use ledger::block::content;
use ledger_base::hash::Hash;
use ledger_base::mutation::{Mutation, active};
use ledger_light::BranchLink;
use std::collections::VecDeque;

/// Own heads that are kept with their signatures: for receivers that do not get as far as others.
const SIGNED_KEPT: usize = 16;
/// Terms whose newest head is kept: a head of an earlier leader may be shown late.
const TERMS_KEPT: usize = 8;
/// The newest head is shown once in this number of election timeouts: a second by default.
const SHOW_TIMEOUTS: u64 = 5;
/// Most blocks between two heads of which a proof is made.
const BRANCH_BLOCKS_MAX: u64 = ledger_light::head::LINKS_MAX as u64;

/// A head that was checked.
#[derive(Clone)]
struct Checked {
    head: LogHead,
    signature: Bytes,
    /// The vote of the leader for itself, which has its certificate.
    vote: Bytes,
}

/// Heads that this node has signed, and those that it has checked.
#[derive(Default)]
pub(super) struct Heads {
    signed: VecDeque<(LogHead, Bytes)>,
    /// The certificate of this leader's signatures in its term.
    certificate: (u64, Bytes),
    /// The newest one of each term, in order of terms.
    checked: VecDeque<Checked>,
    /// Leaders whose head could not be checked, and nodes that have shown one that is not signed.
    doubted: Rests,
    /// When the newest head was shown last, in ticks, and of which leader.
    shown: (u64, u64),
    /// Since when no head of the leader could be checked, in ticks.
    unchecked_since: Option<u64>,
}

impl Heads {
    fn newest(&self, term: u64) -> Option<&Checked> {
        self.checked.iter().rev().find(|checked| checked.head.term == term)
    }

    fn keep(&mut self, checked: Checked) {
        match self.checked.back_mut() {
            Some(last) if last.head.term == checked.head.term => {
                if last.head.height <= checked.head.height {
                    *last = checked;
                }
            }
            Some(last) if last.head.term > checked.head.term => {}
            _ => self.checked.push_back(checked),
        }
        if self.checked.len() > TERMS_KEPT {
            self.checked.pop_front();
        }
    }

    #[cfg(test)]
    pub(super) fn signed_so_far(&self) -> usize {
        self.signed.len()
    }

    #[cfg(test)]
    pub(super) fn pretend_certificate(&mut self, term: u64, certificate: Bytes) {
        self.certificate = (term, certificate);
    }

    /// The number of ticks for which no head of the leader could be checked. Counted again from then on.
    pub(super) fn take_unchecked(&mut self, now: u64, ticks: usize) -> bool {
        self.unchecked_since.take_if(|since| now.saturating_sub(*since) >= ticks as u64).is_some()
    }

    /// A leader has shown its certificate.
    pub(super) fn trust_again(&mut self, leader: u64) {
        self.doubted.end(leader);
    }
}

impl Engine {
    /// Signs the heads of the appends that were put out from this place on.
    pub(super) fn sign_heads(&mut self, first: usize, out: &mut Vec<Output>) {
        let mut renewed = None;
        for output in out.iter_mut().skip(first) {
            let Output::Send { message: PeerMessage::Raft(message), .. } = output else { continue };
            if message.kind != i32::from(RaftKind::Append) {
                continue;
            }
            let (term, height) = (message.term, message.index + message.entries.len() as u64);
            let Some(hash) = self.chain.hash(height) else { continue };
            let head = LogHead { term, leader: self.config.id, height, hash };
            if let Some((_, signature)) = self.heads.signed.iter().find(|(signed, _)| *signed == head) {
                message.head = signature.clone();
                continue;
            }
            match self.mandates.ballots().sign_head(head) {
                Ok((certificate, signature)) => {
                    if self.heads.certificate.0 == term && self.heads.certificate.1 != certificate {
                        renewed = Some(term);
                    }
                    self.heads.certificate = (term, certificate);
                    message.head = signature.clone();
                    self.heads.signed.push_front((head, signature));
                    self.heads.signed.truncate(SIGNED_KEPT);
                }
                Err(reason) => {
                    tracing::warn!(code = reason.code.name(), %reason, "cannot sign a head; followers do not accept its entries")
                }
            }
        }
        if let Some(term) = renewed {
            let mut shown = Vec::new();
            self.show_mandate_to_all(term, &mut shown);
            out.splice(first..first, shown);
        }
    }

    /// Has the leader signed the head of what it appends? Up to here the append agrees with this log.
    pub(super) fn check_head(
        &mut self,
        from: u64,
        message: &RaftMessage,
        hash: Hash,
        out: &mut Vec<Output>,
    ) -> Result<(), &'static str> {
        if [Mutation::BelieveAnybody, Mutation::FollowWithoutMandate].into_iter().any(active) {
            return Ok(());
        }
        // Elected by a change that waits in the log: the state of this node has no record of it yet, so its certificate cannot be
        // checked, and the state gets no further without its appends. Its connection names it.
        if !self.membership.contains(from) {
            return Ok(());
        }
        let (term, height) = (message.term, message.index + message.entries.len() as u64);
        let head = LogHead { term, leader: from, height, hash };
        if self.heads.newest(term).is_some_and(|known| known.head == head) {
            return Ok(());
        }
        let checked = self.mandates.vote_of_leader(from, term).ok_or("it has not shown its certificate");
        let checked = checked.and_then(|vote| self.check_signature(from, head, vote, message.head.clone()));
        match checked {
            Ok(checked) => {
                self.heads.keep(checked);
                self.heads.unchecked_since = None;
                Ok(())
            }
            Err(reason) => {
                self.want_mandate(from, term, out);
                self.heads.unchecked_since.get_or_insert(self.ticks);
                Err(reason)
            }
        }
    }

    /// Checks a head that `from` has sent.
    fn check_signature(
        &mut self,
        from: u64,
        head: LogHead,
        vote: Bytes,
        signature: Bytes,
    ) -> Result<Checked, &'static str> {
        if self.heads.doubted.rests(from, self.ticks, self.config.heartbeat_tick) {
            return Err("it has sent a head before that cannot be checked");
        }
        match self.mandates.ballots().check_head(head, &vote, &signature, self.now) {
            Ok(()) => Ok(Checked { head, signature, vote }),
            Err(reason) => {
                let LogHead { leader, term, height, .. } = head;
                tracing::warn!(from, leader, term, height, code = reason.code.name(), %reason, "head not signed by the leader");
                self.heads.doubted.begin(from, self.ticks);
                Err("its head is not signed by the leader")
            }
        }
    }

    /// With every tick: the newest head is shown to the other voters once a second, and when another node leads.
    pub(super) fn show_head(&mut self, out: &mut Vec<Output>) {
        let Some(Checked { head, signature, vote }) = self.heads.checked.back() else { return };
        let due = self.ticks >= self.heads.shown.0 + SHOW_TIMEOUTS * self.config.election_tick as u64;
        let leads = self.raw.raft.leader_id;
        if !self.is_voter() || !(due || self.heads.shown.1 != leads) {
            return;
        }
        let LogHead { term, leader, height, hash } = *head;
        let (hash, signature, vote) = (hash.0.to_vec().into(), signature.clone(), vote.clone());
        let shown = PeerMessage::Head(LeaderHead { term, leader, height, hash, signature, vote });
        let others = self.membership.voters.iter().filter(|node| **node != self.config.id && **node != leader);
        out.extend(others.map(|to| Output::Send { to: *to, message: shown.clone() }));
        self.heads.shown = (self.ticks, leads);
    }

    /// A voter shows the newest head that it has from a leader. If this node has one of that leader and term above another
    /// block, the two prove that the leader lies.
    pub(super) fn head_shown(&mut self, from: u64, shown: &LeaderHead, out: &mut Vec<Output>) {
        let Some(hash) = Hash::from_slice(&shown.hash) else {
            return out.push(Output::Ignored { from, reason: "the head that it shows has no hash" });
        };
        let other = LogHead { term: shown.term, leader: shown.leader, height: shown.height, hash };
        // Nothing is checked as long as the two agree.
        let Some(own) = self.heads.newest(other.term).filter(|own| own.head.leader == other.leader).cloned() else {
            return;
        };
        let differs = self.chain.hash(other.height).is_some_and(|here| here != hash);
        let is_held = other.height <= own.head.height && self.chain.hash(own.head.height) == Some(own.head.hash);
        if !differs || !is_held || !self.membership.contains(from) {
            return;
        }
        match self.check_signature(from, other, shown.vote.clone(), shown.signature.clone()) {
            Ok(checked) => self.prove_two_heads(other.height, &own, (hash, Vec::new(), checked), out),
            Err(reason) => out.push(Output::Ignored { from, reason }),
        }
    }

    /// The leader appends after a block of `height` that is another one than here, with its signature: if what this node has is
    /// the leader's, too, that is the proof. `theirs`: the blocks of the message after that height.
    pub(super) fn prove_append(
        &mut self,
        message: &RaftMessage,
        from: u64,
        (height, base): (u64, Hash),
        theirs: Vec<BranchLink>,
        out: &mut Vec<Output>,
    ) {
        let Some(own) = self.heads.newest(message.term).filter(|own| own.head.leader == from).cloned() else { return };
        if height > own.head.height || self.chain.hash(own.head.height) != Some(own.head.hash) {
            return;
        }
        let hash =
            (height + 1..).zip(&theirs).fold(base, |hash, (height, link)| ledger_light::block_hash(height, link, hash));
        let head = LogHead { term: message.term, leader: from, height: height + theirs.len() as u64, hash };
        if let Ok(checked) = self.check_signature(from, head, own.vote.clone(), message.head.clone()) {
            self.prove_two_heads(height, &own, (base, theirs, checked), out);
        }
    }

    fn prove_two_heads(
        &self,
        height: u64,
        own: &Checked,
        (base, links, other): (Hash, Vec<BranchLink>, Checked),
        out: &mut Vec<Output>,
    ) {
        let Some(own) = self.branch(height, own) else {
            tracing::warn!(height, "the proof that a leader lies is too long, or its blocks cannot be read");
            return;
        };
        let LogHead { leader, term, .. } = other.head;
        let other = HeadBranch { base, links, vote: other.vote, signature: other.signature };
        out.push(Output::TwoHeads(Box::new(DoubleHead { leader, term, height, branches: [own, other] })));
    }

    /// The part of the leader's log that this node has: from the block at a height up to the head.
    fn branch(&self, height: u64, checked: &Checked) -> Option<HeadBranch> {
        let Checked { head, signature, vote } = checked.clone();
        let base = self.chain.hash(height)?;
        let mut links = Vec::new();
        let (mut next, end) = (height + 1, head.height + 1);
        if end - next > BRANCH_BLOCKS_MAX {
            return None;
        }
        while next < end {
            let entries = self.store.entries(next..end, READ_BYTES).ok()?;
            for entry in &entries {
                let time = self.chain.link(entry.index).filter(|_| entry.index == next)?.time;
                links.push(BranchLink { term: entry.term, time, root: content(entry).0 });
                next += 1;
            }
            if entries.is_empty() {
                return None;
            }
        }
        Some(HeadBranch { base, links, vote, signature })
    }
}
