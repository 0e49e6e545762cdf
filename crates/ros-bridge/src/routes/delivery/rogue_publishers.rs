//! The side door: somebody who publishes on the robot's own topic goes around the ledger. The reporter sees them; a route may
//! refuse to drive beside them.

use std::time::Instant;

use ledger_base::settings::Section;

use crate::routes::counters::{Counters, count};

/// The name of the reason for what is stopped and dropped.
pub(in crate::routes) const NAME: &str = "side_door";

/// The treatment of somebody beside the bridge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::routes) enum Treatment {
    /// A warning.
    #[default]
    Warn,
    /// The robot stops, and nothing passes while they are there.
    Stop,
}

impl Treatment {
    /// Reads `side_door`.
    pub(super) fn read(section: &mut Section<'_, '_>) -> Self {
        let mut treatment = Self::default();
        section.text(NAME, "\"warn\" or \"stop\"", &mut treatment, |text| match text {
            "warn" => Some(Self::Warn),
            "stop" => Some(Self::Stop),
            _ => None,
        });
        treatment
    }
}

/// The side door of a route.
pub(super) struct RoguePublishers {
    treatment: Treatment,
    /// Is somebody there, so that nothing passes?
    is_open: bool,
}

impl RoguePublishers {
    pub(super) fn new(treatment: Treatment) -> Self {
        Self { treatment, is_open: false }
    }

    /// Looks who is there. True if somebody has just come beside whom nothing shall pass.
    pub(super) fn opens(&mut self, counters: &Counters) -> bool {
        let was_open = self.is_open;
        self.is_open = self.treatment == Treatment::Stop && counters.lock().live.beside > 0;
        self.is_open && !was_open
    }

    /// Drops a message while somebody is there: true if so.
    pub(super) fn drops(&self, counters: &Counters) -> bool {
        if self.is_open {
            let mut counts = counters.lock();
            count(&mut counts.summary.gate, NAME, 1);
            let meaning = "somebody publishes on the robot's topic beside this bridge".to_owned();
            counts.live.refused = Some((NAME, meaning, Instant::now()));
        }
        self.is_open
    }
}
