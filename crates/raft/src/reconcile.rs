//! From the members that the ledger wants to the next step towards them.
//!
//! The ledger says who shall vote and who shall follow (node records of chaincode `msp`). The leader's driver asks
//! [`next_step`] on every tick and commit and carries out the answer. Nothing is remembered between two steps: whoever
//! leads next goes on from what it sees.

use crate::engine::{PeerStatus, Status};
use crate::interface::Input;
use ledger::members::{Change, MembershipChange, spare_one};
use ledger::msp;
use ledger_base::mutation::Mutation;
use ledger_base::rejection::Rejection;
use ledger_storage::state::StateRead;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

/// How far behind the newest committed block a node may be to become a voter, in blocks: what replication brings within
/// a moment. Further back, its missing vote would hold up commits. One that needs blocks which the leader has dropped
/// is no voter yet either: replication does not bring it on.
pub const PROMOTION_LAG_MAX: u64 = 1000;

/// The members that the ledger wants. A node in neither set shall not be a member; one in both shall vote.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Desired {
    /// The wanted voters.
    pub voters: BTreeSet<u64>,
    /// The wanted learners.
    pub learners: BTreeSet<u64>,
    /// The old numbers of nodes that have joined again, with the new numbers, which shall vote.
    pub replacements: BTreeMap<u64, u64>,
    /// While certificates are strict: under which hand each node is.
    pub strict_hands: Option<BTreeMap<u64, String>>,
}

impl Desired {
    /// The members that a ledger wants, by its state.
    ///
    /// # Errors
    /// If the state cannot be read.
    pub fn read(state: &dyn StateRead) -> Result<Self, Rejection> {
        let nodes = msp::nodes(state)?;
        let (voters, learners) = msp::desired(&nodes);
        let (replacements, strict_hands) = (msp::replacements(&nodes), msp::strict_hands(state)?);
        Ok(Self { voters, learners, replacements, strict_hands })
    }
}

/// The next step of a leader towards the wanted members; nothing if all is done, or while something is
/// under way, or while waiting for a node to catch up.
///
/// In this order, one step at a time:
/// 1. nodes that are missing come in as learners, which costs nobody's vote anything;
/// 2. learners that shall vote and have caught up are promoted, and voters that shall not vote lose their vote in the
///    same joint change. So replacing one needs no larger majority in between; losing a vote waits for a replacement
///    that is on its way. The old number of a node keeps its vote until its new number takes it, however long that is silent. One
///    that has lied, by proof, loses it at once;
/// 3. a leader that shall lose its own vote hands over to the desired voter that has caught up most, which goes on;
/// 4. nodes that shall be no members go.
///
/// While certificates are strict, no step leads from voters of whom any one can be lost to voters of whom none can. So a voter
/// that is replaced stays until the new one takes its place.
///
/// A change is made only if a majority of the voters after it answers and is near the end of the log. A network is
/// never led into a membership that cannot order. So there is always a voter left, too.
pub fn next_step(desired: &Desired, status: &Status) -> Option<Input> {
    if !status.may_propose || status.changing || status.transferring_to.is_some() || desired.voters.is_empty() {
        return None;
    }
    let present = status.membership.nodes();
    if let Some(node) = desired.voters.union(&desired.learners).find(|node| !present.contains(node)) {
        return Some(change([Change::AddLearner(*node)]));
    }
    let voters = &status.membership.voters;
    if let Some(step) = change_voters(desired, status, voters) {
        return Some(step);
    }
    if !desired.voters.contains(&status.id) && voters.contains(&status.id) {
        let to = (!status.transfer_rests).then(|| best(status, |node| desired.voters.contains(&node))).flatten()?;
        return Some(Input::TransferLeadership { to });
    }
    let gone = status
        .membership
        .learners
        .iter()
        .find(|node| !desired.learners.contains(node) && !desired.voters.contains(node))?;
    Some(change([Change::Remove(*gone)]))
}

/// The voter to which a leader should hand over before it stops: one that answers, and of those the one that lacks
/// least. None if no other voter answers.
pub fn successor(status: &Status) -> Option<u64> {
    best(status, |_| true)
}

fn change_voters(desired: &Desired, status: &Status, voters: &BTreeSet<u64>) -> Option<Input> {
    let missing = || desired.voters.difference(voters);
    let joining: Vec<u64> = missing().copied().filter(|node| is_ready(status, *node)).collect();
    // One that is silent holds nobody's removal up: that may be urgent. (A new one counts as heard for a while.)
    let waiting =
        missing().any(|node| !is_ready(status, *node) && peer(status, *node).is_some_and(|peer| peer.recently_active));
    let keeps_place = |node: &u64| {
        let new = desired.replacements.get(node).filter(|new| !voters.contains(new) && !joining.contains(new));
        new.is_some() && !status.excluded.contains(node)
    };
    let leaving: Vec<u64> = voters
        .iter()
        .copied()
        .filter(|node| !waiting && *node != status.id && !desired.voters.contains(node) && !keeps_place(node))
        .filter(|node| desired.learners.contains(node) || !ledger_base::mutation::active(Mutation::KeepARemovedVoter))
        .collect();
    let after: BTreeSet<u64> = voters.iter().chain(&joining).copied().filter(|node| !leaving.contains(node)).collect();
    if &after == voters || !can_order(status, &after) || ends_strict(desired, voters, &after) {
        return None;
    }
    let joining = joining.into_iter().map(Change::AddVoter);
    let leaving = leaving.into_iter().map(|node| match desired.learners.contains(&node) {
        true => Change::AddLearner(node),
        false => Change::Remove(node),
    });
    Some(change(joining.chain(leaving)))
}

fn ends_strict(desired: &Desired, before: &BTreeSet<u64>, after: &BTreeSet<u64>) -> bool {
    let hands = desired.strict_hands.as_ref();
    hands.is_some_and(|hands| spare_one(before, hands) && !spare_one(after, hands))
}

/// A majority of these voters answers and is near the end of the log. (The leader itself does and is.)
fn can_order(status: &Status, voters: &BTreeSet<u64>) -> bool {
    let ready = voters.iter().filter(|node| **node == status.id || is_ready(status, **node)).count();
    ready > voters.len() / 2
}

fn is_ready(status: &Status, node: u64) -> bool {
    let near =
        |peer: &PeerStatus| peer.matched + PROMOTION_LAG_MAX >= status.commit && peer.matched + 1 >= status.first;
    let caught_up = |peer: &PeerStatus| peer.matched > 0 && near(peer);
    peer(status, node).is_some_and(|peer| peer.recently_active && caught_up(peer))
}

fn peer(status: &Status, node: u64) -> Option<&PeerStatus> {
    status.peers.iter().find(|peer| peer.node == node)
}

/// The voter that lacks least, of those that answer; the lowest id of several.
fn best(status: &Status, wanted: impl Fn(u64) -> bool) -> Option<u64> {
    status
        .peers
        .iter()
        .filter(|peer| peer.recently_active && status.membership.voters.contains(&peer.node) && wanted(peer.node))
        .max_by_key(|peer| (peer.matched, Reverse(peer.node)))
        .map(|peer| peer.node)
}

fn change(changes: impl IntoIterator<Item = Change>) -> Input {
    Input::ChangeMembership(MembershipChange::new(changes))
}

#[cfg(test)]
mod tests;
