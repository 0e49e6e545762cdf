//! The quality of service of a route, in ROS 2's words.
//!
//! Reader and writer match only if the writer offers at least what the reader requests: a reliable
//! reader does not hear a best-effort writer. Sensors often publish best effort.

use rustdds::{Duration, QosPolicies, QosPolicyBuilder, policy};

use crate::error::{Error, Explained, Result};

/// Most samples that a reader or writer may keep.
pub const DEPTH_SAMPLES_MAX: u32 = 10_000;
/// Default of [`Qos::depth`]. Readers lose samples of a burst below about 100.
pub const DEPTH_SAMPLES_DEFAULT: u32 = 100;

/// Whether lost samples are sent again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Reliability {
    /// Lost samples are sent again, in order.
    #[default]
    Reliable,
    /// Lost samples stay lost; matches every writer.
    BestEffort,
}

impl Reliability {
    /// As it is written in a configuration.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Reliable => "reliable",
            Self::BestEffort => "best_effort",
        }
    }
}

/// Whether a reader that comes late receives what was published before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Durability {
    /// Only what is published while the reader is there.
    #[default]
    Volatile,
    /// Also the last samples of every writer that is still there ("latched").
    TransientLocal,
}

impl Durability {
    /// As it is written in a configuration.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Volatile => "volatile",
            Self::TransientLocal => "transient_local",
        }
    }
}

/// The settings of one route; unset ones have ROS 2's defaults for publishers and subscriptions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Qos {
    /// Default: reliable.
    pub reliability: Reliability,
    /// Default: volatile.
    pub durability: Durability,
    /// Samples kept, counted per topic on the reading side. Default 100; smaller loses bursts,
    /// larger costs memory with large messages (they are counted, not weighed).
    pub depth: u32,
}

impl Default for Qos {
    fn default() -> Self {
        Self { reliability: Reliability::default(), durability: Durability::default(), depth: DEPTH_SAMPLES_DEFAULT }
    }
}

impl Qos {
    /// Checks the ranges; call it after reading a configuration.
    pub fn validate(&self) -> Result<()> {
        if (1..=DEPTH_SAMPLES_MAX).contains(&self.depth) {
            return Ok(());
        }
        let wanted = format!("1 to {DEPTH_SAMPLES_MAX} samples");
        let hint = format!("depth = {DEPTH_SAMPLES_DEFAULT}");
        Err(Error::Setting(Explained::new("qos depth is out of range", self.depth.to_string(), wanted, hint)))
    }

    /// The same in the terms of `rustdds`.
    ///
    /// The longest blocking time is zero: a write that finds its window full says so at once and
    /// never holds up the caller.
    pub fn policies(&self) -> QosPolicies {
        let depth = i32::try_from(self.depth.clamp(1, DEPTH_SAMPLES_MAX)).unwrap_or(1);
        let builder =
            QosPolicyBuilder::new().history(policy::History::KeepLast { depth }).durability(match self.durability {
                Durability::Volatile => policy::Durability::Volatile,
                Durability::TransientLocal => policy::Durability::TransientLocal,
            });
        match self.reliability {
            Reliability::Reliable => builder.reliable(Duration::ZERO).build(),
            Reliability::BestEffort => builder.best_effort().build(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_reliable_volatile_and_deep_enough_for_bursts() {
        let qos = Qos::default();
        let policies = qos.policies();
        assert!(policies.is_reliable());
        assert!(policies.is_volatile());
        assert_eq!(policies.history(), Some(policy::History::KeepLast { depth: 100 }));
    }

    #[test]
    fn settings_become_policies_of_dds() {
        let qos = Qos { reliability: Reliability::BestEffort, durability: Durability::TransientLocal, depth: 5 };
        let policies = qos.policies();
        assert!(!policies.is_reliable());
        assert_eq!(policies.durability(), Some(policy::Durability::TransientLocal));
        assert_eq!(policies.history(), Some(policy::History::KeepLast { depth: 5 }));
    }

    #[test]
    fn a_depth_out_of_range_is_refused() {
        for depth in [0, DEPTH_SAMPLES_MAX + 1, u32::MAX] {
            assert!(Qos { depth, ..Qos::default() }.validate().is_err());
        }
        assert!(Qos::default().validate().is_ok());
    }

    #[test]
    fn a_write_never_blocks() {
        assert_eq!(Qos::default().policies().reliable_max_blocking_time(), Some(Duration::ZERO));
    }
}
