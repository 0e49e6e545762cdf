//! Log messages: their limit in rate, and a rejection in one line.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use ledger_base::costly_invariant;
use ledger_base::rejection::{Code, Rejection};

/// The same log_limiter is logged at most this often.
const COMPLAINT_EVERY: Duration = Duration::from_secs(10);

/// Decides what is worth a line in the log: a reason that is new, or the same again after a while.
#[derive(Debug, Default)]
pub(crate) struct LogLimiter {
    /// When each reason was last told, and how often it was not since then. The program has a few reasons.
    told: BTreeMap<&'static str, (Instant, u64)>,
}

impl LogLimiter {
    /// Is it worth a line? Then with the number of those for the same reason that were not.
    pub(crate) fn admit(&mut self, name: &'static str, now: Instant) -> Option<u64> {
        let Some((told, silent)) = self.told.get_mut(name) else {
            self.told.insert(name, (now, 0));
            return Some(0);
        };
        if now.saturating_duration_since(*told) < COMPLAINT_EVERY {
            *silent = silent.saturating_add(1);
            return None;
        }
        *told = now;
        Some(std::mem::take(silent))
    }
}

/// Code and reason of a refusal in one line.
pub(crate) fn one_line(refused: &Rejection) -> String {
    let Rejection { code, message, found, wanted, .. } = refused;
    let detail = |label: &str, text: &str| if text.is_empty() { String::new() } else { format!("; {label} {text}") };
    costly_invariant!(*code != Code::Ok, "a refusal has a code", "{message}");
    format!("{code} {message}{}{}", detail("found", found), detail("wanted", wanted))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_complaint_is_repeated_after_a_while_only() {
        let (mut log_limiter, start) = (LogLimiter::default(), Instant::now());
        assert_eq!(log_limiter.admit("HELD", start), Some(0));
        assert_eq!(log_limiter.admit("HELD", start + Duration::from_secs(1)), None);
        assert_eq!(log_limiter.admit("HELD", start + Duration::from_secs(2)), None);
        assert_eq!(log_limiter.admit("HELD", start + Duration::from_secs(11)), Some(2));
        assert_eq!(log_limiter.admit("NOT_HOLDER", start + Duration::from_secs(11)), Some(0));
    }

    #[test]
    fn reasons_in_turn_are_told_once_each_and_not_with_every_sample() {
        let (mut log_limiter, start) = (LogLimiter::default(), Instant::now());
        let told = (0..1000).filter(|number| {
            let name = if number % 2 == 0 { "BAD_MESSAGE" } else { "NOT_HOLDER" };
            log_limiter.admit(name, start + Duration::from_millis(*number)).is_some()
        });
        assert_eq!(told.count(), 2);
        assert_eq!(log_limiter.admit("NOT_HOLDER", start + COMPLAINT_EVERY * 2), Some(499));
    }
}
