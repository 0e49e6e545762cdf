//! The sessions that are open. A session is known by its token alone, which the page keeps in its memory. It ends when the page says
//! so, after [`QUIET_MAX`] without a call, and at the latest after [`LIFE_MAX`].

use ledger_base::hash::Hash;
use ledger_identity::Identity;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// Longest time without a call, while no stream is open either.
pub(super) const QUIET_MAX: Duration = Duration::from_secs(5 * 60);
/// Longest life of a session, and of a connection.
pub(super) const LIFE_MAX: Duration = Duration::from_secs(12 * 60 * 60);
/// Most sessions of one identity; beyond it its oldest one ends.
const EACH_MAX: usize = 16;
/// Most sessions; beyond it the oldest one of all ends.
const ALL_MAX: usize = 1024;
/// Most calls and streams of one session at a time: a page with many services has a stream for each.
pub(super) const CALLS_MAX: usize = 64;

/// The open sessions, by the hash of their tokens: whoever reads this memory can still open none.
#[derive(Default)]
pub(super) struct Sessions {
    open: Mutex<HashMap<Hash, Arc<Session>>>,
}

/// A session.
pub(super) struct Session {
    /// As whom its calls are answered.
    pub(super) identity: Arc<Identity>,
    opened: Instant,
    calls: Mutex<Calls>,
    ended: watch::Sender<bool>,
}

struct Calls {
    /// Calls and streams that are under way.
    open: usize,
    /// When the last one began or ended.
    last: Instant,
}

/// A call or a stream of a session, until it is dropped.
pub(super) struct Busy(Arc<Session>);

impl Sessions {
    /// Opens one under this token.
    pub(super) fn enter(&self, token: &[u8], identity: Arc<Identity>, now: Instant) {
        let mut open = self.lock();
        open.retain(|_, session| !session.is_over(now) || session.end());
        let own = open.values().filter(|session| session.identity.id() == identity.id()).count();
        let leaves = match own >= EACH_MAX {
            true => oldest(&open, |session| session.identity.id() == identity.id()),
            false if open.len() >= ALL_MAX => oldest(&open, |_| true),
            false => None,
        };
        if let Some(session) = leaves.and_then(|leaves| open.remove(&leaves)) {
            session.end();
        }
        let calls = Mutex::new(Calls { open: 0, last: now });
        let session = Session { identity, opened: now, calls, ended: watch::Sender::new(false) };
        open.insert(Hash::of(&[token]), Arc::new(session));
    }

    /// The session of this token, if there is one.
    pub(super) fn find(&self, token: &[u8], now: Instant) -> Option<Arc<Session>> {
        let mut open = self.lock();
        let (name, session) = open.get_key_value(&Hash::of(&[token]))?;
        if session.is_over(now) {
            let name = *name;
            open.remove(&name)?.end();
            return None;
        }
        Some(Arc::clone(session))
    }

    /// Ends the session of this token.
    pub(super) fn leave(&self, token: &[u8]) {
        if let Some(session) = self.lock().remove(&Hash::of(&[token])) {
            session.end();
        }
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<Hash, Arc<Session>>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn oldest(open: &HashMap<Hash, Arc<Session>>, which: impl Fn(&Session) -> bool) -> Option<Hash> {
    let candidates = open.iter().filter(|(_, session)| which(session));
    candidates.min_by_key(|(_, session)| session.opened).map(|(name, _)| *name)
}

impl Session {
    /// Counts a call; none if too many are under way.
    pub(super) fn begin(self: &Arc<Self>, now: Instant) -> Option<Busy> {
        let mut calls = self.lock();
        if calls.open >= CALLS_MAX {
            return None;
        }
        calls.open += 1;
        calls.last = now;
        Some(Busy(Arc::clone(self)))
    }

    /// Waits for its end.
    pub(super) async fn over(self: Arc<Self>) {
        let mut ended = self.ended.subscribe();
        let left = LIFE_MAX.saturating_sub(self.opened.elapsed());
        tokio::select! {
            _ended = ended.wait_for(|ended| *ended) => (),
            () = tokio::time::sleep(left) => (),
        }
    }

    fn is_over(&self, now: Instant) -> bool {
        let calls = self.lock();
        let is_silent = calls.open == 0 && now.saturating_duration_since(calls.last) >= QUIET_MAX;
        is_silent || now.saturating_duration_since(self.opened) >= LIFE_MAX
    }

    /// Ends what is under way. Answers false: nothing is left.
    fn end(&self) -> bool {
        self.ended.send_replace(true);
        false
    }

    fn lock(&self) -> MutexGuard<'_, Calls> {
        self.calls.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        let mut calls = self.0.lock();
        calls.open -= 1;
        calls.last = Instant::now();
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_identity::Role;
    use ledger_identity::key::PublicKey;
    use std::collections::BTreeMap;

    fn identity(name: &str) -> Arc<Identity> {
        Arc::new(Identity {
            organisation: "Org1".into(),
            name: name.into(),
            role: Role::Member,
            attributes: BTreeMap::new(),
            issuer: [0; 32],
            serial: vec![1],
            fingerprint: [0; 32],
            public_key: PublicKey::from_ed25519([1; 32]),
            valid_from: 0,
            not_before: 0,
            not_after: u64::MAX,
        })
    }

    #[test]
    fn a_session_ends_in_silence_when_the_page_says_so_and_after_half_a_day() {
        let (sessions, start) = (Sessions::default(), Instant::now());
        let second = Duration::from_secs(1);
        for token in [b"silent", b"leaves", b"talks "] {
            sessions.enter(token, identity("Salma"), start);
        }
        assert!(sessions.find(b"unknown", start).is_none());
        sessions.leave(b"leaves");
        assert!(sessions.find(b"leaves", start).is_none());
        let stream = sessions.find(b"talks ", start).unwrap().begin(start).unwrap();
        assert!(sessions.find(b"silent", start + QUIET_MAX - second).is_some());
        assert!(sessions.find(b"silent", start + QUIET_MAX).is_none());
        assert!(sessions.find(b"silent", start).is_none(), "it does not come back");
        assert!(sessions.find(b"talks ", start + LIFE_MAX - second).is_some(), "a stream is open");
        assert!(sessions.find(b"talks ", start + LIFE_MAX).is_none());
        assert!(*stream.0.ended.borrow(), "its stream is told");
    }

    #[test]
    fn the_calls_of_one_session_are_limited_and_end_when_they_are_dropped() {
        let (sessions, start) = (Sessions::default(), Instant::now());
        sessions.enter(b"Salma's", identity("Salma"), start);
        let session = sessions.find(b"Salma's", start).unwrap();
        let mut calls: Vec<_> = (0..CALLS_MAX).map(|_| session.begin(start).unwrap()).collect();
        assert!(session.begin(start).is_none());
        calls.pop();
        assert!(session.begin(start).is_some());
    }

    #[test]
    fn nobody_ends_the_sessions_of_others_by_opening_many() {
        let (sessions, start) = (Sessions::default(), Instant::now());
        let token = |who: &str, number: usize| format!("{who}{number}").into_bytes();
        sessions.enter(b"Salma's", identity("Salma"), start);
        for number in 0..10 * EACH_MAX {
            let at = start + Duration::from_millis(number as u64);
            sessions.enter(&token("Mallory", number), identity("Mallory"), at);
        }
        let open = |name: &[u8]| sessions.find(name, start).is_some();
        assert!(open(b"Salma's") && !open(&token("Mallory", 0)));
        assert!(open(&token("Mallory", 10 * EACH_MAX - 1)));
        assert_eq!(sessions.lock().len(), 1 + EACH_MAX);
    }
}
