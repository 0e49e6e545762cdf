//! The policies that ROS 2 uses, and when a writer fits a reader (DDS 1.4 §2.2.3).

mod partition;

use crate::time::Ticks;

/// Whether lost samples are sent again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reliability {
    /// A sample that is lost is lost.
    #[default]
    BestEffort,
    /// Samples that the writer still has are repaired.
    Reliable,
}

/// Which samples a late reader gets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Durability {
    /// None from before.
    #[default]
    Volatile,
    /// The newest ones of writers that still exist ("latched").
    TransientLocal,
    /// Kept by a service; announced by others only.
    Transient,
    /// Kept on a disk; announced by others only.
    Persistent,
}

/// The entity that asserts that a writer is alive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum LivelinessKind {
    /// Its middleware.
    #[default]
    Automatic,
    /// Any writer of its participant.
    ManualByParticipant,
    /// The writer itself, by writing.
    ManualByTopic,
}

/// How many samples are kept. `KEEP_ALL` is kept within the byte limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum History {
    /// The newest ones.
    KeepLast(u32),
    /// As many as fit ([`crate::limits::HISTORY_BYTES_MAX`]).
    KeepAll,
}

/// `Share` or `Exclusive`: whether readers take one writer only.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Ownership {
    /// All writers count.
    #[default]
    Shared,
    /// The strongest writer counts. Announced by others only.
    Exclusive,
}

/// How samples are serialized (`DataRepresentationId`, XTypes 7.6.3.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Representation(pub i16);

impl Representation {
    /// XCDR version 1, the default.
    pub const XCDR1: Self = Self(0);
    /// XML.
    pub const XML: Self = Self(1);
    /// XCDR version 2.
    pub const XCDR2: Self = Self(2);
}

/// The policies of an endpoint: offered by a writer, requested by a reader.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Qos {
    /// Lost samples.
    pub reliability: Reliability,
    /// Late readers.
    pub durability: Durability,
    /// How many samples are kept.
    pub history: History,
    /// Longest time between two samples.
    pub deadline: Ticks,
    /// The entity that asserts that a writer is alive.
    pub liveliness: LivelinessKind,
    /// Longest time between two assertions.
    pub liveliness_lease: Ticks,
    /// Age beyond which a sample is not delivered.
    pub lifespan: Ticks,
    /// Accepted delay; only announced.
    pub latency_budget: Ticks,
    /// Only announced by others.
    pub ownership: Ownership,
    /// Only endpoints with a partition in common match; none is the same as the empty name. Names may have `*`, `?` and `[]`.
    pub partitions: Vec<String>,
    /// How samples are serialized: offered by a writer (the first one counts), accepted by a reader. Empty: XCDR1.
    pub representations: Vec<Representation>,
}

impl Default for Qos {
    fn default() -> Self {
        Self {
            reliability: Reliability::BestEffort,
            durability: Durability::Volatile,
            history: History::KeepLast(1),
            deadline: Ticks::INFINITE,
            liveliness: LivelinessKind::Automatic,
            liveliness_lease: Ticks::INFINITE,
            lifespan: Ticks::INFINITE,
            latency_budget: Ticks::ZERO,
            ownership: Ownership::Shared,
            partitions: Vec::new(),
            representations: Vec::new(),
        }
    }
}

/// The policy for which a writer does not fit a reader.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Policy {
    /// The reader requests more than is offered.
    Reliability,
    /// The reader requests more than is offered.
    Durability,
    /// The writer offers a longer one.
    Deadline,
    /// The writer offers less, or a longer lease.
    Liveliness,
    /// The writer offers a longer one.
    LatencyBudget,
    /// They differ.
    Ownership,
    /// They have none in common. DDS counts this as no match, not as incompatible; here it is shown like the others.
    Partition,
    /// The reader does not accept the writer's.
    Representation,
}

impl Policy {
    /// Its name in lower case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Reliability => "reliability",
            Self::Durability => "durability",
            Self::Deadline => "deadline",
            Self::Liveliness => "liveliness",
            Self::LatencyBudget => "latency_budget",
            Self::Ownership => "ownership",
            Self::Partition => "partition",
            Self::Representation => "data_representation",
        }
    }
}

impl Qos {
    /// Are lost samples sent again?
    pub fn is_reliable(&self) -> bool {
        self.reliability == Reliability::Reliable
    }

    /// The policies for which a reader that requests `requested` does not fit a writer that offers these. Empty: they match.
    pub fn mismatches(&self, requested: &Self) -> Vec<Policy> {
        let liveliness = self.liveliness < requested.liveliness || self.liveliness_lease > requested.liveliness_lease;
        [
            (self.reliability < requested.reliability, Policy::Reliability),
            (self.durability < requested.durability, Policy::Durability),
            (self.deadline > requested.deadline, Policy::Deadline),
            (liveliness, Policy::Liveliness),
            (self.latency_budget > requested.latency_budget, Policy::LatencyBudget),
            (self.ownership != requested.ownership, Policy::Ownership),
            (!partition::have_one_in_common(&self.partitions, &requested.partitions), Policy::Partition),
            (!requested.accepts(self.offered_representation()), Policy::Representation),
        ]
        .into_iter()
        .filter_map(|(is_mismatch, policy)| is_mismatch.then_some(policy))
        .collect()
    }

    /// How a writer serializes (XTypes 7.6.3.1.1).
    fn offered_representation(&self) -> Representation {
        self.representations.first().copied().unwrap_or(Representation::XCDR1)
    }

    /// Can a reader read this (XTypes 7.6.3.1.1)?
    fn accepts(&self, representation: Representation) -> bool {
        self.representations.contains(&representation)
            || self.representations.is_empty() && representation == Representation::XCDR1
    }
}

#[cfg(test)]
mod tests;
