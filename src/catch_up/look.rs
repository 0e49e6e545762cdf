//! The question with which a node starts: what do the others have, and what do they know it to have had?
//!
//! **The protection.** A voter that has lost blocks which it acknowledged must not vote: with its vote the others could
//! elect a leader that lacks what was promised. It cannot tell by itself; the leader and the attestations can.
//!
//! **How long it takes.** A node that refuses a connection has answered. A silent node is waited for until
//! [`ASK_TIME_MAX`] as long as a majority of the voters has not been heard, for then nothing can be ordered anyway. It
//! is also waited for if there is nothing in the log, which looks like a lost disk. Otherwise silence costs
//! [`PATIENCE`], and ordering begins while the question is still open. Until it is closed this node gives no vote, nor
//! does it ask for any, as its own election timeout is longer. Each entry that it acknowledges is on its disk. An
//! answer that comes in that time and says that blocks were lost ends the node as it would have before.

use super::ask::{Answers, Offer, longest_first};
use super::{ASK_TIME_MAX, CatchUp};
use crate::orderer::Shared;
use crate::peers::Member;
use futures::StreamExt;
use ledger_raft::{PeerMessage, RaftKind};
use ledger_rejection::{Code, Rejection};
use ledger_replica::REJOIN;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::time::{Instant, timeout_at};

/// Time that silent nodes cost a start when they are not needed.
const PATIENCE: Duration = Duration::from_millis(200);

/// The answers that were heard.
pub(crate) struct Look {
    /// Longest chain first.
    pub offers: Vec<Offer>,
    /// The nodes that are silent so far, if they are not waited for.
    pub open: Option<Open>,
}

/// A question that some may still answer.
pub(crate) struct Open {
    answers: Answers,
    until: Instant,
}

/// Keeps this node from voting while the question is open.
#[derive(Clone, Default)]
pub(crate) struct Ballot {
    held: Arc<AtomicBool>,
}

impl Ballot {
    /// Is this a request for a vote that must not be given now? It is lost then, as on a bad network: who stands for
    /// election asks again.
    pub(crate) fn withholds(&self, message: &PeerMessage) -> bool {
        let votes = [RaftKind::Vote, RaftKind::PreVote].map(|kind| kind as i32);
        self.held.load(Ordering::Acquire)
            && matches!(message, PeerMessage::Raft(message) if votes.contains(&message.kind))
    }
}

impl CatchUp {
    /// Asks the other nodes what they have, before the first engine starts. `election_time`: this node does not stand for
    /// election for so long.
    ///
    /// # Errors
    /// [`Code::DiskFailed`] if this node votes and has lost what it promised to keep.
    pub(crate) async fn look(&self, election_time: Duration) -> Result<Look, Rejection> {
        let members = self.shared.directory.members();
        let (mut answers, asked) = (self.question(&members), Instant::now());
        let mut offers = Vec::new();
        let open = loop {
            let heard: Vec<u64> = offers.iter().map(|offer: &Offer| offer.member.id).collect();
            let enough = self.shared.store.last_index() > 0 && is_enough(self.dialer.me, &members, &heard);
            let patience = if enough { PATIENCE } else { ASK_TIME_MAX };
            match timeout_at(asked + patience, answers.next()).await {
                Ok(Some(Some(offer))) => {
                    check_kept(&self.shared, &offer)?;
                    offers.push(offer);
                }
                Ok(Some(None)) => {}
                Ok(None) => break None,
                Err(_) => {
                    if !enough {
                        break None;
                    }
                    tracing::info!(silent = answers.len(), "begins without the answer of silent nodes");
                    break Some(Open { answers, until: asked + ASK_TIME_MAX.min(PATIENCE + election_time) });
                }
            }
        };
        longest_first(&mut offers);
        self.ballot.held.store(open.is_some(), Ordering::Release);
        Ok(Look { offers, open })
    }

    /// Hears out those that were silent, until the question is closed; then the node may vote.
    pub(crate) fn hear_out(&self, open: Option<Open>) -> impl Future<Output = ()> + Send + use<> {
        let (shared, ballot, mut stopping) = (Arc::clone(&self.shared), self.ballot.clone(), self.stopping.clone());
        async move {
            let Some(Open { mut answers, until }) = open else { return };
            loop {
                let answer = tokio::select! {
                    biased;
                    _ = stopping.wait_for(|stopping| *stopping) => return,
                    answer = timeout_at(until, answers.next()) => answer,
                };
                match answer {
                    Ok(Some(Some(offer))) => {
                        if let Err(lost) = check_kept(&shared, &offer) {
                            return shared.fate.fail(lost);
                        }
                    }
                    Ok(Some(None)) => {}
                    Ok(None) | Err(_) => break,
                }
            }
            ballot.held.store(false, Ordering::Release);
        }
    }
}

/// Are those that were heard, with this node, a majority of the voters? A node that does not vote needs nobody.
fn is_enough(me: u64, members: &[Member], heard: &[u64]) -> bool {
    let voters: Vec<u64> = members.iter().filter(|member| member.votes()).map(|member| member.id).collect();
    let known = voters.iter().filter(|voter| **voter == me || heard.contains(voter)).count();
    !voters.contains(&me) || known > voters.len() / 2
}

/// Refuses if this node votes and another knows it to have had more than it has.
fn check_kept(shared: &Shared, offer: &Offer) -> Result<(), Rejection> {
    let (last, known) = (shared.store.last_index(), offer.chain.yours);
    if !offer.chain.you_vote || known <= last {
        return Ok(());
    }
    Err(Rejection::new(Code::DiskFailed, "this voter has lost blocks that it had before")
        .found(format!("blocks up to height {last}"))
        .wanted(format!("at least height {known}, which {} knows it to have had", offer.member.full_name()))
        .next(format!("{REJOIN}: it comes back as a new node, because this one must not vote any more")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::peers::Part;
    use ledger_raft::RaftMessage;

    fn members(voters: u64, learners: u64) -> Vec<Member> {
        let member = |id| Member {
            id,
            name: format!("node{id}"),
            organisation: "Org1".into(),
            address: String::new(),
            wanted: None,
            actual: Some(if id <= voters { Part::Voter } else { Part::Learner }),
        };
        (1..=voters + learners).map(member).collect()
    }

    #[test]
    fn silence_of_those_that_a_majority_does_not_need_is_not_waited_for() {
        assert!(is_enough(1, &members(1, 2), &[]));
        assert!(is_enough(4, &members(3, 1), &[]), "a learner gives no vote");
        assert!(!is_enough(1, &members(2, 1), &[3]));
        assert!(!is_enough(1, &members(3, 1), &[4]));
        assert!(is_enough(1, &members(3, 1), &[2]));
        assert!(!is_enough(1, &members(5, 0), &[2]));
        assert!(is_enough(1, &members(5, 0), &[5, 2]));
    }

    #[test]
    fn no_vote_is_given_while_the_question_is_open() {
        let message = |kind: RaftKind| PeerMessage::Raft(RaftMessage { kind: kind as i32, ..RaftMessage::default() });
        let ballot = Ballot::default();
        assert!(!ballot.withholds(&message(RaftKind::Vote)));
        ballot.held.store(true, Ordering::Release);
        assert!(ballot.withholds(&message(RaftKind::Vote)) && ballot.withholds(&message(RaftKind::PreVote)));
        assert!(!ballot.withholds(&message(RaftKind::Append)) && !ballot.withholds(&message(RaftKind::Heartbeat)));
    }
}
