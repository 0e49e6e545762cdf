//! Warnings of what ends soon: the node's certificate, the authorities of its network, and their revocation lists.
//!
//! The node's own certificate renews itself, so it is only told of where that should have happened. Nobody renews the
//! others but people, who need to know.

use ledger::Ledger;
use ledger::msp::{ListRecord, revocation_lists};
use ledger_api::context::WARNING_DAYS;
use ledger_identity::certificate::Certificate;
use ledger_identity::msp::Msps;

/// A day, microseconds.
const DAY: u64 = 86_400_000_000;

/// Tells once a day.
#[derive(Default)]
pub(super) struct Endings {
    /// When it was told last, microseconds since the UNIX epoch.
    told: u64,
}

impl Endings {
    /// Looks, by the clock of this machine in microseconds since the UNIX epoch.
    pub(super) fn look(&mut self, own: &[u8], ledger: &Ledger, now: u64) {
        if now < self.told.saturating_add(DAY) {
            return;
        }
        self.told = now;
        let lists = revocation_lists(&**ledger.state()).unwrap_or_default();
        for ending in endings(own, &ledger.msps(), &lists, now) {
            tracing::warn!(%ending, "certificate or list expires soon");
        }
    }
}

/// The things that end within thirty days or have ended, in words that name them.
fn endings(own: &[u8], msps: &Msps, lists: &[ListRecord], now: u64) -> Vec<String> {
    let near = |end: u64| end < now.saturating_add(WARNING_DAYS * DAY);
    let left = |end: u64| match end.checked_sub(now) {
        Some(left) => format!("expires in {} days", left / DAY),
        None => format!("expired {} days ago", (now - end) / DAY),
    };
    let certificate = |what: &str, der: &[u8]| {
        let Certificate { subject, not_before, not_after, .. } = Certificate::parse(der).ok()?;
        // One with a short life is near its end for most of it.
        let is_near = near(not_after) && now >= not_before.midpoint(not_after);
        is_near.then(|| format!("{what} {subject:?} {}", left(not_after)))
    };
    let mut found: Vec<String> = certificate("the certificate of this node", own).into_iter().collect();
    for msp in msps.iter() {
        let what = format!("the CA of {}", msp.organisation());
        found.extend(msp.roots().chain(msp.intermediates()).filter_map(|der| certificate(&what, der)));
    }
    // A list is made anew every few days: it is late only once it has ended.
    for list in lists {
        let ended = list.next_update.filter(|end| *end < now);
        found
            .extend(ended.map(|end| {
                format!("the revocation list of {:?} of {} {}", list.subject, list.organisation, left(end))
            }));
    }
    found
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_base::hash::Hash;
    use ledger_identity::key::KeyKind;
    use ledger_identity::msp::Msp;
    use testkit::Ca;

    /// 2031-01-01, when the certificates of the test end.
    const END: u64 = 1_924_991_999_999_999;

    #[test]
    fn what_ends_within_thirty_days_is_told_with_its_name_and_lists_only_once_they_have_ended() {
        let ca = Ca::new("ca.org1");
        let node = ca.user("node1", "node", KeyKind::P256);
        let mut msps = Msps::new();
        msps.insert(Msp::new("Org1", &[ca.root()], &[] as &[&[u8]]).unwrap()).unwrap();
        let list = ListRecord {
            organisation: "Org3".into(),
            issuer: Hash::ZERO,
            key_fingerprint: Hash::ZERO,
            scope: None,
            partial: false,
            subject: "CN=fabric\u{1b}".into(),
            this_update: 0,
            next_update: Some(END - 100 * DAY),
            number: None,
            listed: 0,
            fingerprint: Hash::ZERO,
            height: 1,
            time: 0,
            by: String::new(),
        };
        let told = |days: u64| endings(&node.certificate, &msps, std::slice::from_ref(&list), END - days * DAY);
        assert!(told(101).is_empty());
        let [ended] = <[String; 1]>::try_from(told(90)).unwrap();
        assert!(ended.contains("of Org3 expired 10 days ago") && !ended.contains('\u{1b}'), "{ended}");
        assert_eq!(told(31).len(), 1);
        let near = told(29);
        assert_eq!(near.len(), 3, "{near:?}");
        for (part, line) in [("this node", &near), ("the CA of Org1", &near)] {
            assert!(
                line.iter().any(|line| line.contains(part) && line.contains("expires in 28 days")
                    || line.contains(part) && line.contains("expires in 29 days")),
                "{part}: {line:?}"
            );
        }
    }
}
