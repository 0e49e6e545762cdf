//! The quality of service of a route, in ROS 2's words.
//!
//! Reader and writer match only if the writer offers at least what the reader requests: a reliable
//! reader does not hear a best-effort writer. Sensors often publish best effort.

use ledger_base::settings::Section;
use rtps::qos::{self, History, Qos as Policies};

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

/// The settings that a route copies from the endpoints that it finds on its topic, because nobody has set them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct AdoptedQos {
    pub(crate) reliability: bool,
    pub(crate) durability: bool,
}

impl Default for AdoptedQos {
    fn default() -> Self {
        Self { reliability: true, durability: true }
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
    /// Is the topic declared with keys? DDS connects no endpoint with keys to one without. Default: without, as ROS 2's
    /// topics are.
    pub keyed: bool,
}

impl Default for Qos {
    fn default() -> Self {
        let (reliability, durability) = (Reliability::default(), Durability::default());
        Self { reliability, durability, depth: DEPTH_SAMPLES_DEFAULT, keyed: false }
    }
}

impl Qos {
    /// Reads the settings; answers what is not set.
    pub(crate) fn read(&mut self, section: &mut Section<'_, '_>) -> AdoptedQos {
        let (mut reliability, mut durability) = (None, None);
        section.text("reliability", "\"reliable\" or \"best_effort\"", &mut reliability, |text| {
            let known = [Reliability::Reliable, Reliability::BestEffort].into_iter();
            known.map(Some).find(|known| known.is_some_and(|known| known.name() == text))
        });
        section.text("durability", "\"volatile\" or \"transient_local\"", &mut durability, |text| {
            let known = [Durability::Volatile, Durability::TransientLocal].into_iter();
            known.map(Some).find(|known| known.is_some_and(|known| known.name() == text))
        });
        section.integer("depth", 1..=u64::from(DEPTH_SAMPLES_MAX), &mut self.depth);
        self.reliability = reliability.unwrap_or_default();
        self.durability = durability.unwrap_or_default();
        AdoptedQos { reliability: reliability.is_none(), durability: durability.is_none() }
    }

    /// Checks the ranges; call it after reading a configuration.
    pub fn validate(&self) -> Result<()> {
        if (1..=DEPTH_SAMPLES_MAX).contains(&self.depth) {
            return Ok(());
        }
        let wanted = format!("1 to {DEPTH_SAMPLES_MAX} samples");
        let hint = format!("depth = {DEPTH_SAMPLES_DEFAULT}");
        Err(Error::Setting(Explained::new("qos depth is out of range", self.depth.to_string(), wanted, hint)))
    }

    /// The settings for a topic with these endpoints at the other end. `reads` if the route reads what they publish.
    ///
    /// A reader that asks for no more than every publisher offers hears all of them. A writer that offers what any reader asks for
    /// reaches all. Commands are never latched unless somebody sets it: an old one would move the robot again.
    pub(crate) fn meeting(self, copied: AdoptedQos, reads: bool, is_command: bool, others: &[&Policies]) -> Self {
        let mut met = self;
        if others.is_empty() {
            return met;
        }
        if copied.reliability {
            let is_reliable = !reads || others.iter().all(|other| other.is_reliable());
            met.reliability = if is_reliable { Reliability::Reliable } else { Reliability::BestEffort };
        }
        if copied.durability {
            let mut latched = others.iter().map(|other| other.durability != qos::Durability::Volatile);
            let is_latched = if reads { latched.all(|is| is) } else { latched.any(|is| is) };
            let is_latched = is_latched && !is_command;
            met.durability = if is_latched { Durability::TransientLocal } else { Durability::Volatile };
        }
        met
    }

    /// The same as policies of DDS.
    pub fn policies(&self) -> Policies {
        Policies {
            reliability: match self.reliability {
                Reliability::Reliable => qos::Reliability::Reliable,
                Reliability::BestEffort => qos::Reliability::BestEffort,
            },
            durability: match self.durability {
                Durability::Volatile => qos::Durability::Volatile,
                Durability::TransientLocal => qos::Durability::TransientLocal,
            },
            history: History::KeepLast(self.depth.clamp(1, DEPTH_SAMPLES_MAX)),
            ..Policies::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_reliable_volatile_and_deep_enough_for_bursts() {
        let policies = Qos::default().policies();
        let (reliable, volatile) = (qos::Reliability::Reliable, qos::Durability::Volatile);
        assert_eq!((policies.reliability, policies.durability), (reliable, volatile));
        assert_eq!(policies.history, History::KeepLast(100));
    }

    #[test]
    fn settings_become_policies_of_dds() {
        let (reliability, durability) = (Reliability::BestEffort, Durability::TransientLocal);
        let policies = Qos { reliability, durability, depth: 5, keyed: false }.policies();
        assert_eq!(policies.reliability, qos::Reliability::BestEffort);
        assert_eq!(policies.durability, qos::Durability::TransientLocal);
        assert_eq!(policies.history, History::KeepLast(5));
    }

    #[test]
    fn a_depth_out_of_range_is_refused() {
        for depth in [0, DEPTH_SAMPLES_MAX + 1, u32::MAX] {
            assert!(Qos { depth, ..Qos::default() }.validate().is_err());
        }
        assert!(Qos::default().validate().is_ok());
    }

    #[test]
    fn a_route_meets_the_endpoints_on_its_topic_where_nobody_has_set_how() {
        let of = |reliability, durability| Qos { reliability, durability, depth: 1, keyed: false }.policies();
        let (latched, plain) =
            (of(Reliability::Reliable, Durability::TransientLocal), of(Reliability::BestEffort, Durability::Volatile));
        let meet = |reads, is_command, others: &[&Policies]| {
            let met = Qos::default().meeting(AdoptedQos::default(), reads, is_command, others);
            (met.reliability, met.durability, met.depth)
        };
        let (reliable, best, depth) = (Reliability::Reliable, Reliability::BestEffort, DEPTH_SAMPLES_DEFAULT);
        assert_eq!(meet(true, false, &[]), (reliable, Durability::Volatile, depth));
        assert_eq!(meet(true, false, &[&latched, &latched]), (reliable, Durability::TransientLocal, depth));
        assert_eq!(meet(true, false, &[&latched, &plain]), (best, Durability::Volatile, depth), "it hears both");
        assert_eq!(meet(false, false, &[&latched, &plain]), (reliable, Durability::TransientLocal, depth));
        assert_eq!(meet(false, false, &[&plain]), (reliable, Durability::Volatile, depth));
        for reads in [true, false] {
            assert_eq!(meet(reads, true, &[&latched]).1, Durability::Volatile, "an old command moves no robot");
        }
        let set = AdoptedQos { reliability: false, durability: false };
        assert_eq!(Qos::default().meeting(set, true, false, &[&plain, &latched]), Qos::default());
    }
}
