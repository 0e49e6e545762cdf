//! Calls that readers were notified of and that have no verdict yet: a node keeps them and has them ordered.

use bytes::Bytes;
use ledger::Ledger;
use ledger::transaction::Transaction;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::EARLY_BYTES_MAX;
use std::collections::BTreeMap;

/// Most calls that are kept.
pub(super) const OPEN_MAX: usize = 128;
/// Most bytes of the file that keeps them.
pub(super) const OPEN_BYTES_MAX: usize = DOMAIN.len() + OPEN_MAX * (4 + EARLY_BYTES_MAX);
/// In front of the calls in the file.
const DOMAIN: &[u8] = b"ledgerd open stops v1\0";
/// Pause before a call is given to the orderer again, microseconds. It doubles with each time.
const PAUSE: u64 = 1_000_000;
/// The longest such pause, microseconds.
const PAUSE_MAX: u64 = 8_000_000;

/// The calls that are kept, in the order in which they came.
#[derive(Debug, Default)]
pub(super) struct Open {
    calls: Vec<Kept>,
    /// The leader when they were given to it last.
    leader: Option<u64>,
    /// Do the calls differ from those that were saved?
    changed: bool,
}

#[derive(Debug)]
struct Kept {
    transaction: Transaction,
    /// Of the signer; when there is no room, the one with the most calls loses its newest.
    organisation: String,
    /// When it is given to the orderer next, in time since the node started (microseconds), and the pause after that.
    due: u64,
    pause: u64,
}

impl Open {
    /// Keeps a call that was given to the orderer now, in time since the node started (microseconds).
    pub(super) fn keep(&mut self, transaction: &Transaction, organisation: &str, elapsed: u64) {
        if transaction.encoded().len() > EARLY_BYTES_MAX || self.calls.iter().any(|kept| kept.id() == transaction.id())
        {
            return;
        }
        if self.calls.len() == OPEN_MAX && !self.make_room(organisation) {
            return;
        }
        let (transaction, organisation) = (transaction.clone(), organisation.to_owned());
        self.calls.push(Kept { transaction, organisation, due: elapsed.saturating_add(PAUSE), pause: PAUSE });
        self.changed = true;
    }

    /// Lets the newest call of the organisation go that has the most, if that is more than this one has.
    fn make_room(&mut self, organisation: &str) -> bool {
        let mut counts = BTreeMap::<&str, usize>::new();
        for kept in &self.calls {
            *counts.entry(&kept.organisation).or_default() += 1;
        }
        let own = counts.get(organisation).copied().unwrap_or_default();
        let most = counts.into_iter().max_by_key(|(_, count)| *count).filter(|(_, count)| *count > own + 1);
        let crowding = most.map(|(crowding, _)| crowding.to_owned());
        let newest = crowding.and_then(|crowding| self.calls.iter().rposition(|kept| kept.organisation == crowding));
        newest.map(|newest| self.calls.remove(newest)).is_some()
    }

    /// Forgets those that have a verdict or are over. Answers with those that are to be passed on, and given to this leader, now.
    pub(super) fn tend(&mut self, ledger: &Ledger, leader: Option<u64>, elapsed: u64) -> Vec<Bytes> {
        let before = self.calls.len();
        self.calls.retain(|kept| !ledger.is_settled(&kept.transaction.call_ref()));
        self.changed |= self.calls.len() != before;
        self.due(leader, elapsed)
    }

    fn due(&mut self, leader: Option<u64>, elapsed: u64) -> Vec<Bytes> {
        // What the one before was given may be lost with it.
        let is_new = leader.is_some_and(|leads| self.leader.replace(leads) != Some(leads));
        let due = self.calls.iter_mut().filter(|kept| is_new || kept.due <= elapsed);
        due.map(|kept| {
            kept.due = elapsed.saturating_add(kept.pause);
            kept.pause = kept.pause.saturating_mul(2).min(PAUSE_MAX);
            kept.transaction.encoded().clone()
        })
        .collect()
    }

    /// The calls.
    pub(super) fn calls(&self) -> Vec<Transaction> {
        self.calls.iter().map(|kept| kept.transaction.clone()).collect()
    }

    /// The bytes to be saved, if they have changed since they were asked for last.
    pub(super) fn changed(&mut self) -> Option<Vec<u8>> {
        std::mem::take(&mut self.changed).then(|| self.to_bytes())
    }

    fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = DOMAIN.to_vec();
        for encoded in self.calls.iter().map(|kept| kept.transaction.encoded()) {
            // Bounded by EARLY_BYTES_MAX.
            bytes.extend_from_slice(&u32::try_from(encoded.len()).unwrap_or_default().to_be_bytes());
            bytes.extend_from_slice(encoded);
        }
        bytes
    }

    /// Keeps what was saved. `organisation` is that of a signer, if it is known.
    ///
    /// # Errors
    /// [`Code::Corrupt`].
    pub(super) fn restore(
        &mut self,
        bytes: &[u8],
        organisation: impl Fn(&Transaction) -> String,
    ) -> Result<(), Rejection> {
        let corrupt = || {
            Rejection::new(Code::Corrupt, "the stored stops cannot be read")
                .wanted("a file that this version wrote")
                .next("repeat the stops that are still needed, then delete the file")
        };
        let mut rest = bytes.strip_prefix(DOMAIN).ok_or_else(corrupt)?;
        while let Some((length, after)) = rest.split_first_chunk::<4>() {
            let length = usize::try_from(u32::from_be_bytes(*length)).unwrap_or(usize::MAX);
            let (encoded, after) = after.split_at_checked(length).ok_or_else(corrupt)?;
            let transaction = Transaction::decode(Bytes::copy_from_slice(encoded)).map_err(|_| corrupt())?;
            self.keep(&transaction, &organisation(&transaction), 0);
            rest = after;
        }
        // No other node may have it: it is due at once.
        self.calls.iter_mut().for_each(|kept| kept.due = 0);
        self.changed = false;
        if rest.is_empty() { Ok(()) } else { Err(corrupt()) }
    }
}

impl Kept {
    fn id(&self) -> Hash {
        self.transaction.id()
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;
    use ledger::transaction::{Body, NONCE_BYTES};
    use ledger_identity::key::{KeyKind, SigningKey};
    use ring::rand::SystemRandom;
    use std::sync::OnceLock;

    fn call(nonce: u8) -> Transaction {
        static KEY: OnceLock<SigningKey> = OnceLock::new();
        let key = KEY.get_or_init(|| SigningKey::generate(KeyKind::Ed25519, &SystemRandom::new()).unwrap());
        let (network, nonce) = (Bytes::from(vec![1; 32]), Bytes::from(vec![nonce; NONCE_BYTES]));
        let (chaincode, function) = ("abac".to_owned(), "stop".to_owned());
        let creator = network.clone();
        let known_block = None;
        let body = Body { network, creator, nonce, not_after: 9, chaincode, function, args: Vec::new(), known_block };
        Transaction::sign(&body, key).unwrap()
    }

    #[test]
    fn a_call_is_given_to_each_new_leader_at_once_and_to_others_less_and_less_often() {
        let mut open = Open::default();
        open.keep(&call(1), "Org1", 0);
        let mut given = Vec::new();
        for elapsed in (0..30_000_000).step_by(250_000) {
            if !open.due(None, elapsed).is_empty() {
                given.push(elapsed / 1_000_000);
            }
        }
        assert_eq!(given, [1, 2, 4, 8, 16, 24], "to other nodes, while nobody leads");
        for (leader, is_given) in [(Some(2), true), (Some(2), false), (None, false), (Some(2), false), (Some(3), true)]
        {
            assert_eq!(!open.due(leader, 30_000_000).is_empty(), is_given, "{leader:?}");
        }
    }

    #[test]
    fn what_was_saved_is_kept_after_a_restart_and_due_at_once() {
        let mut open = Open::default();
        assert_eq!(open.changed(), None);
        (1..4).for_each(|nonce| open.keep(&call(nonce), "Org1", 0));
        open.keep(&call(1), "Org1", 0);
        let saved = open.changed().unwrap();
        assert_eq!(open.changed(), None);
        let mut again = Open::default();
        again.restore(&saved, |_| "Org1".to_owned()).unwrap();
        assert_eq!((again.calls(), again.changed()), ((1..4).map(call).collect(), None));
        again.leader = Some(2);
        assert_eq!(again.due(Some(2), 0).len(), 3);
        for broken in [&saved[..saved.len() - 1], &saved[1..], b""] {
            assert_eq!(Open::default().restore(broken, |_| String::new()).unwrap_err().code, Code::Corrupt);
        }
    }

    #[test]
    fn an_organisation_that_fills_the_room_leaves_the_others_theirs() {
        let mut open = Open::default();
        (0..200).for_each(|nonce| open.keep(&call(nonce), "Org1", 0));
        assert_eq!(open.calls().len(), OPEN_MAX);
        (200..=255).for_each(|nonce| open.keep(&call(nonce), "Org2", 0));
        let kept = open.calls();
        assert!((200..=255).all(|nonce| kept.contains(&call(nonce))) && kept.contains(&call(0)));
        assert_eq!(kept.len(), OPEN_MAX);
    }
}
