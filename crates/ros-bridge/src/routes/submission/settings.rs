//! The settings of a route to the ledger.

use ledger_base::settings::Section;

use super::latch::LatchSettings;
use crate::{
    graph::names::TopicName,
    routes::{
        kind::DiscoveryTerms,
        pace::{RATE_KEY, read_rate},
        shown::read_holder,
    },
};

/// The setting of how many samples share a transaction.
pub(in crate::routes) const BATCH_KEY: &str = "batch_max";
/// Most samples of one transaction.
const BATCH_SAMPLES_MAX: u32 = 256;

/// The settings of this kind.
#[derive(Debug)]
pub(in crate::routes) struct Settings {
    /// Most samples of one transaction; a batch is never waited for.
    pub(super) batch_max: usize,
    /// Most samples a second; none = any number.
    pub(super) max_rate_hz: Option<u32>,
    /// Where the local topic is latched.
    pub(super) latched: LatchSettings,
    /// Is nothing submitted without the grant that the service asks for?
    pub(super) held_only: bool,
    /// Where it is shown who holds the service.
    pub(in crate::routes) holder: Option<TopicName>,
}

impl Settings {
    /// Reads them.
    pub(in crate::routes) fn read(section: &mut Section<'_, '_>) -> Self {
        let mut batch_max = 1_u32;
        section.integer(BATCH_KEY, 1..=u64::from(BATCH_SAMPLES_MAX), &mut batch_max);
        let max_rate_hz = read_rate(section);
        if let Some(hz) = max_rate_hz.filter(|_| batch_max > 1) {
            let found = format!("{batch_max} and {hz}");
            let wanted = "one of them: with a rate each sample goes alone".to_owned();
            section.conflict([BATCH_KEY, RATE_KEY], found, wanted);
        }
        let (batch_max, latched) = (usize::try_from(batch_max).unwrap_or(1), LatchSettings::read(section));
        Self { batch_max, max_rate_hz, latched, held_only: false, holder: read_holder(section) }
    }

    /// A discovered route submits only what its grant permits, at most so often.
    pub(in crate::routes) fn discovered(terms: &DiscoveryTerms) -> Self {
        Self { max_rate_hz: terms.max_rate_hz, held_only: terms.needs_grant, ..Self::default() }
    }
}

/// One sample in a transaction, any number a second.
impl Default for Settings {
    fn default() -> Self {
        Self { batch_max: 1, max_rate_hz: None, latched: LatchSettings::default(), held_only: false, holder: None }
    }
}
