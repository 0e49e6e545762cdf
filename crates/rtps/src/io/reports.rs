//! Which losses are logged: the first of a kind at once, later ones together, at most once in a minute for each kind and endpoint.

use crate::guid::EntityId;
use std::collections::BTreeMap;

/// Time between two log lines of one kind, microseconds.
const PERIOD_MICROS: u64 = 60_000_000;

/// A limit of log lines for each endpoint and kind.
#[derive(Debug)]
pub(super) struct Reports<Kind>(BTreeMap<(EntityId, Kind), Report>);

#[derive(Debug, Default)]
struct Report {
    /// When the next line may be logged.
    next: u64,
    /// Events that no line has told of.
    unlogged: u64,
}

impl<Kind> Default for Reports<Kind> {
    fn default() -> Self {
        Self(BTreeMap::new())
    }
}

impl<Kind: Ord> Reports<Kind> {
    /// Something has happened this many times. How many times since the last line, if one may be logged now.
    pub(super) fn admit(&mut self, steady: u64, endpoint: EntityId, kind: Kind, count: u64) -> Option<u64> {
        let report = self.0.entry((endpoint, kind)).or_default();
        report.unlogged = report.unlogged.saturating_add(count);
        if steady < report.next {
            return None;
        }
        report.next = steady.saturating_add(PERIOD_MICROS);
        Some(std::mem::take(&mut report.unlogged))
    }

    /// An endpoint has been closed.
    pub(super) fn forget(&mut self, endpoint: EntityId) {
        self.0.retain(|(other, _), _| *other != endpoint);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_event_is_logged_at_once_and_the_others_together_a_minute_later() {
        let [one, other] = [1, 2].map(|key| EntityId::reader(key, false));
        let mut reports = Reports::default();
        assert_eq!(reports.admit(5, one, 'a', 3), Some(3));
        assert_eq!(reports.admit(6, one, 'a', 2), None);
        assert_eq!((reports.admit(6, one, 'b', 1), reports.admit(6, other, 'a', 1)), (Some(1), Some(1)));
        assert_eq!(reports.admit(5 + PERIOD_MICROS, one, 'a', 1), Some(3));
        reports.forget(one);
        assert_eq!(reports.0.len(), 1);
    }
}
