//! The last answers of nodes that could not serve, so that a call that is given up names them and not only the last broken connection.

use ledger_base::rejection::{Code, Rejection};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Most nodes whose answers are kept.
const NODES_MAX: usize = 32;
/// An answer older than this says nothing about now.
const FRESH: Duration = Duration::from_secs(30);

/// The last answer of each node that did not serve a call, with its time.
#[derive(Debug, Default)]
pub(super) struct LastAnswers(Mutex<BTreeMap<Arc<str>, (Instant, Rejection)>>);

impl LastAnswers {
    /// A node could not serve a call.
    pub(super) fn rejected(&self, address: &Arc<str>, rejection: &Rejection, now: Instant) {
        // A broken connection is no answer of the node.
        if rejection.code == Code::Unreachable {
            return;
        }
        let mut answers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if answers.len() < NODES_MAX || answers.contains_key(address) {
            answers.insert(Arc::clone(address), (now, rejection.clone()));
        }
    }

    /// A node has served a call.
    pub(super) fn served(&self, address: &str) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).remove(address);
    }

    /// The reason for which a call is given up: the newest answer of a node, with those of the others. Without an answer it is the
    /// broken connection.
    pub(super) fn instead_of(&self, broken: Rejection, now: Instant) -> Rejection {
        if broken.code != Code::Unreachable {
            return broken;
        }
        let answers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let fresh = answers.iter().filter(|(_, (at, _))| now.duration_since(*at) < FRESH);
        let fresh: Vec<_> = fresh.map(|(address, (at, rejection))| (at, address, rejection)).collect();
        let Some((_, newest_address, newest)) = fresh.iter().max_by_key(|(at, ..)| **at) else { return broken };
        let mut told = vec![format!("{newest_address} answered: {}", in_words(newest))];
        let others = fresh.iter().filter(|(_, address, _)| address != newest_address);
        told.extend(others.map(|(_, address, rejection)| format!("{address} answered: {}", in_words(rejection))));
        told.push(format!("now {}", broken.message));
        Rejection::clone(newest).found(told.join("; "))
    }
}

fn in_words(Rejection { code, message, found, .. }: &Rejection) -> String {
    let found = if found.is_empty() { String::new() } else { format!(" ({found})") };
    format!("{message}{found} [{code}]")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_call_that_is_given_up_names_the_last_answer_of_each_node() {
        let (answers, now) = (LastAnswers::default(), Instant::now());
        let broken = || Rejection::new(Code::Unreachable, "none of 3 nodes can be reached").found("refused");
        assert_eq!(answers.instead_of(broken(), now), broken(), "nobody has answered");
        let (one, two) = (Arc::from("a:1"), Arc::from("b:2"));
        answers.rejected(&one, &Rejection::new(Code::NoLeader, "no majority: 1 of 3 voters answers"), now);
        answers.rejected(&two, &Rejection::new(Code::DiskFull, "the disk is full").found("0 bytes"), now + SECOND);
        answers.rejected(&two, &broken(), now + 2 * SECOND);
        let reason = answers.instead_of(broken(), now + 3 * SECOND);
        assert_eq!((reason.code, reason.message.as_str()), (Code::DiskFull, "the disk is full"));
        assert_eq!(
            reason.found,
            "b:2 answered: the disk is full (0 bytes) [LGR-5001]; a:1 answered: no majority: 1 of 3 voters answers \
             [LGR-4002]; now none of 3 nodes can be reached"
        );
        let closed = Rejection::new(Code::WrongNetwork, "another network");
        assert_eq!(answers.instead_of(closed.clone(), now), closed, "a final reason stays");
        answers.served("b:2");
        assert_eq!(answers.instead_of(broken(), now + 3 * SECOND).code, Code::NoLeader);
        assert_eq!(answers.instead_of(broken(), now + 2 * FRESH).code, Code::Unreachable, "that was long ago");
    }

    const SECOND: Duration = Duration::from_secs(1);
}
