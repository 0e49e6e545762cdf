//! The quality of service of a route, in ROS 2's words.
//!
//! Reader and writer match only if the writer offers at least what the reader requests: a reliable
//! reader does not hear a best-effort writer. Sensors often publish best effort.

use std::{fmt, time::Duration};

use ledger_base::settings::Section;
use rtps::{
    qos::{self, History, LivelinessKind, Qos as Policies},
    time::Ticks,
};

use crate::error::{Error, Explained, Result};

/// Most samples that a reader or writer may keep.
pub const DEPTH_SAMPLES_MAX: u32 = 10_000;
/// Default of [`Qos::depth`]. Readers lose samples of a burst below about 100.
pub const DEPTH_SAMPLES_DEFAULT: u32 = 100;
/// Shortest deadline and lease that a writer offers, microseconds. A subscriber that requests a shorter one is not served.
const TIMELINESS_MICROS_MIN: u64 = 1000;

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

/// The timeliness that a writer offers because subscribers request it. A publisher that becomes silent breaks it, and the watchdog of
/// the subscriber takes effect. So the bridge keeps it by delivered samples only, never by a timer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timeliness {
    /// Longest time between two samples.
    pub deadline: Ticks,
    /// Longest time for which one sample proves that the writer is alive (MANUAL_BY_TOPIC). None: no subscriber requests it.
    pub liveliness_lease: Option<Ticks>,
}

impl Timeliness {
    /// Nothing is promised.
    pub const NONE: Self = Self { deadline: Ticks::INFINITE, liveliness_lease: None };

    /// The strictest of these requests.
    fn meeting(others: &[&Policies]) -> Self {
        let shortest = |times: &mut dyn Iterator<Item = Ticks>| {
            times.min().map(|time| time.max(Ticks::from_micros(TIMELINESS_MICROS_MIN)))
        };
        let has_watchdog = |other: &&&Policies| {
            other.liveliness != LivelinessKind::Automatic || other.liveliness_lease < Ticks::INFINITE
        };
        Self {
            deadline: shortest(&mut others.iter().map(|other| other.deadline)).unwrap_or(Ticks::INFINITE),
            liveliness_lease: shortest(&mut others.iter().filter(has_watchdog).map(|other| other.liveliness_lease)),
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
    /// Is the topic declared with keys? DDS connects no endpoint with keys to one without. Default: without, as ROS 2's
    /// topics are.
    pub keyed: bool,
    /// Offered by writers as subscribers request it; not a setting. Readers request none.
    pub timeliness: Timeliness,
}

impl Default for Qos {
    fn default() -> Self {
        Self::new(Reliability::default(), Durability::default(), DEPTH_SAMPLES_DEFAULT)
    }
}

impl Qos {
    /// Of a topic without keys, with no timeliness.
    pub const fn new(reliability: Reliability, durability: Durability, depth: u32) -> Self {
        Self { reliability, durability, depth, keyed: false, timeliness: Timeliness::NONE }
    }

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
        if !reads {
            met.timeliness = Timeliness::meeting(others);
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
            deadline: self.timeliness.deadline,
            liveliness: match self.timeliness.liveliness_lease {
                // By topic: one that DDS asserts by itself would hide a silent driver from the robot's watchdog.
                Some(_) => LivelinessKind::ManualByTopic,
                None => LivelinessKind::Automatic,
            },
            liveliness_lease: self.timeliness.liveliness_lease.unwrap_or(Ticks::INFINITE),
            ..Policies::default()
        }
    }
}

impl fmt::Display for Qos {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, {}", self.reliability.name(), self.durability.name())?;
        if self.keyed {
            f.write_str(", with keys")?;
        }
        let finite = |time: Ticks| time.to_micros().map(Duration::from_micros);
        if let Some(deadline) = finite(self.timeliness.deadline) {
            write!(f, ", deadline {deadline:?}")?;
        }
        match self.timeliness.liveliness_lease.map(finite) {
            Some(Some(lease)) => write!(f, ", liveliness {lease:?}"),
            Some(None) => f.write_str(", liveliness"),
            None => Ok(()),
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
        let policies = Qos::new(reliability, durability, 5).policies();
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
        let of = |reliability, durability| Qos::new(reliability, durability, 1).policies();
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

    #[test]
    fn a_writer_offers_the_strictest_timeliness_that_is_requested_and_no_timer_keeps_it() {
        let requests = |deadline, liveliness, lease| Policies {
            deadline: Ticks::from_micros(deadline),
            liveliness,
            liveliness_lease: if lease == 0 { Ticks::INFINITE } else { Ticks::from_micros(lease) },
            ..Policies::default()
        };
        let plain = Policies::default();
        let slow = requests(500_000, LivelinessKind::Automatic, 2_000_000);
        let fast = requests(100_000, LivelinessKind::ManualByTopic, 300_000);
        let endless = requests(1, LivelinessKind::ManualByParticipant, 0);
        let meet =
            |reads, others: &[&Policies]| Qos::default().meeting(AdoptedQos::default(), reads, true, others).policies();
        for others in [&[&plain, &slow, &fast][..], &[&slow][..], &[&fast, &slow][..], &[&endless][..], &[&plain][..]] {
            let offered = meet(false, others);
            for other in others {
                let misses = offered.mismatches(other);
                // A microsecond is below what is offered to anybody.
                let is_too_fast = other.deadline < Ticks::from_micros(TIMELINESS_MICROS_MIN);
                assert_eq!(misses.as_slice(), if is_too_fast { &[qos::Policy::Deadline][..] } else { &[] });
            }
            let is_watched = others.iter().any(|other| **other != plain);
            assert_eq!(offered.liveliness == LivelinessKind::ManualByTopic, is_watched, "a sample alone proves it");
            assert_eq!(meet(true, others).deadline, Ticks::INFINITE, "a reader requests none");
            assert_eq!(meet(true, others).liveliness, LivelinessKind::Automatic);
        }
        assert_eq!(meet(false, &[&slow, &fast]).deadline, fast.deadline);
        assert_eq!(meet(false, &[&slow, &fast]).liveliness_lease, fast.liveliness_lease);
    }
}
