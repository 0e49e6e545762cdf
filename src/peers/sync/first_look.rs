//! Asks the other nodes what they have, before the first engine starts.

use super::BlockSync;
use crate::peers::question::Answers;
use futures::StreamExt;
use ledger_base::rejection::Rejection;
use ledger_replica::catch_up::{Heard, Holding, Look, Own, Stage};
use std::time::Duration;
use tokio::time::{Instant, timeout};

/// The question of a start that some may still answer.
pub(crate) struct Open {
    answers: Answers,
    look: Look,
    asked: Instant,
}

impl BlockSync {
    /// Asks the other nodes what they have, before the first engine starts. `election_time`: this node does not stand for
    /// election for so long.
    ///
    /// # Errors
    /// If this node votes and has lost what it promised to keep.
    pub(crate) async fn look(&self, election_time: u64) -> Result<(Vec<Holding>, Open), Rejection> {
        let members = self.ordering.directory.members();
        let answers = self.question(&members);
        let voters = members.iter().filter(|member| member.votes());
        let voters = voters.map(|member| (member.id, member.organisation.clone())).collect();
        let (store, asked) = (&self.ordering.storage.log.store, answers.len());
        let (term, last, key) = (store.hard_state().term, store.last_index(), self.receipts.clone());
        let own = Own { id: self.dialer.me, voters, term, last, key };
        let look = Look::new(0, own, asked, election_time, self.ballot.clone());
        let (mut open, mut offers) = (Open { answers, look, asked: Instant::now() }, Vec::new());
        while open.look.stage() == Stage::Asking {
            offers.extend(open.hear().await?);
        }
        Ok((offers, open))
    }

    /// Hears out those that were silent, until the question is closed; then the node may vote.
    pub(crate) fn hear_out(&self, mut open: Open) -> impl Future<Output = ()> + Send + use<> {
        let (failure, mut stopping) = (self.ordering.failure.clone(), self.stopping.clone());
        async move {
            while open.look.stage() != Stage::Closed {
                let heard = tokio::select! {
                    biased;
                    _ = stopping.wait_for(|stopping| *stopping) => return,
                    heard = open.hear() => heard,
                };
                if let Err(lost) = heard {
                    return failure.fail(lost);
                }
            }
        }
    }
}

impl Open {
    /// The next answer; nothing if none came in time.
    async fn hear(&mut self) -> Result<Option<Holding>, Rejection> {
        let due = self.look.due().unwrap_or_default().saturating_sub(micros(self.asked.elapsed()));
        let answer = timeout(Duration::from_micros(due), self.answers.next()).await;
        let now = micros(self.asked.elapsed());
        match answer {
            Ok(Some(Some(offer))) => {
                self.look.step(now, Heard::Answer(&offer.who, &offer.has))?;
                return Ok(Some(offer.has));
            }
            Ok(Some(None)) => self.look.step(now, Heard::Refusal)?,
            Ok(None) | Err(_) => self.look.step(now, Heard::Time)?,
        };
        Ok(None)
    }
}

fn micros(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(u64::MAX)
}
