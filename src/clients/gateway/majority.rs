//! Words for the lack of a majority: how many voters answer this node.

use super::Records;
use ledger_api::v1::Verdict;
use ledger_base::rejection::{Code, Rejection};

impl Records {
    /// A rejection because of a missing leader says how many voters answer, if they are no majority.
    pub(super) fn with_voters(&self, rejection: Rejection) -> Rejection {
        match self.too_few() {
            Some(too_few) if rejection.code == Code::NoLeader => explained(&too_few, rejection),
            _ => rejection,
        }
    }

    /// The same for the verdict of a call.
    pub(super) fn verdict_with_voters(&self, verdict: &mut Verdict) {
        if verdict.code == u32::from(Code::NoLeader.number())
            && let Some(too_few) = self.too_few()
        {
            verdict.found = found(&verdict.message, &verdict.found);
            verdict.message = too_few;
        }
    }

    /// How many voters answer, if they are no majority.
    fn too_few(&self) -> Option<String> {
        let members = self.ordering.directory.members();
        let voters: Vec<u64> = members.iter().filter(|member| member.votes()).map(|member| member.id).collect();
        let connected = voters.iter().filter(|id| self.peers.reachability.is_connected(**id)).count();
        in_words(connected, voters.len())
    }
}

fn in_words(connected: usize, voters: usize) -> Option<String> {
    let answer = if connected == 1 { "answers" } else { "answer" };
    (connected <= voters / 2).then(|| format!("no majority: {connected} of {voters} voters {answer}"))
}

fn explained(too_few: &str, rejection: Rejection) -> Rejection {
    let found = found(&rejection.message, &rejection.found);
    let mut rejection = rejection.found(found);
    too_few.clone_into(&mut rejection.message);
    rejection
}

/// The message of before with its value.
fn found(message: &str, found: &str) -> String {
    if found.is_empty() { message.to_owned() } else { format!("{message}; {found}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_minority_is_counted_and_a_majority_is_not_mentioned() {
        assert_eq!(in_words(1, 3).as_deref(), Some("no majority: 1 of 3 voters answers"));
        assert_eq!(in_words(2, 4).as_deref(), Some("no majority: 2 of 4 voters answer"));
        assert_eq!(in_words(0, 1).as_deref(), Some("no majority: 0 of 1 voters answer"));
        assert_eq!((in_words(2, 3), in_words(1, 1)), (None, None));
        let reason = Rejection::new(Code::NoLeader, "no leader is known").found("x");
        let told = explained("no majority: 1 of 3 voters answers", reason);
        assert_eq!(
            (told.message.as_str(), told.found.as_str()),
            ("no majority: 1 of 3 voters answers", "no leader is known; x")
        );
    }
}
