//! QoS policies as parameters (§9.6.3). An absent policy has its default.

use super::payload::{read_duration, read_text, write_text};
use crate::limits::{PARTITIONS_MAX, REPRESENTATIONS_MAX};
use crate::qos::{Durability, History, LivelinessKind, Ownership, Qos, Reliability, Representation};
use crate::time::Ticks;
use crate::wire::cursor::{Cursor, Malformed};
use crate::wire::encoder::Encoder;
use crate::wire::parameters::ParameterWriter;
use crate::wire::pid;

/// `max_blocking_time` of RELIABILITY, 100 ms: the default of DDS. No writer here blocks, and no reader uses it.
const MAX_BLOCKING: Ticks = Ticks(0x1999_999a);
/// From 0 on.
const DURABILITIES: [Durability; 4] =
    [Durability::Volatile, Durability::TransientLocal, Durability::Transient, Durability::Persistent];
/// From 0 on.
const LIVELINESS_KINDS: [LivelinessKind; 3] =
    [LivelinessKind::Automatic, LivelinessKind::ManualByParticipant, LivelinessKind::ManualByTopic];
/// From 0 on.
const OWNERSHIPS: [Ownership; 2] = [Ownership::Shared, Ownership::Exclusive];
/// From 1 on.
const RELIABILITIES: [Reliability; 2] = [Reliability::BestEffort, Reliability::Reliable];
/// `KEEP_LAST_HISTORY_QOS`.
const KEEP_LAST: u32 = 0;
/// `KEEP_ALL_HISTORY_QOS`.
const KEEP_ALL: u32 = 1;
/// The depth next to `KEEP_ALL_HISTORY_QOS`: the default of DDS. It has no effect.
const DEPTH_DEFAULT: i32 = 1;

impl Qos {
    /// The reliability of an endpoint that announces none.
    pub(super) fn default_reliability(is_writer: bool) -> Reliability {
        if is_writer { Reliability::Reliable } else { Reliability::BestEffort }
    }

    /// Appends every policy, also those that have their default.
    pub(super) fn write(&self, list: &mut ParameterWriter<'_>) {
        list.add(pid::RELIABILITY, |value| {
            value.u32(1 + number_of(self.reliability, &RELIABILITIES));
            value.ticks(MAX_BLOCKING);
        });
        list.add(pid::DURABILITY, |value| value.u32(number_of(self.durability, &DURABILITIES)));
        list.add(pid::HISTORY, |value| write_history(self.history, value));
        list.add(pid::DEADLINE, |value| value.ticks(self.deadline));
        list.add(pid::LIVELINESS, |value| {
            value.u32(number_of(self.liveliness, &LIVELINESS_KINDS));
            value.ticks(self.liveliness_lease);
        });
        list.add(pid::LIFESPAN, |value| value.ticks(self.lifespan));
        list.add(pid::LATENCY_BUDGET, |value| value.ticks(self.latency_budget));
        list.add(pid::OWNERSHIP, |value| value.u32(number_of(self.ownership, &OWNERSHIPS)));
        if !self.partitions.is_empty() {
            list.add(pid::PARTITION, |value| write_partitions(&self.partitions, value));
        }
        if !self.representations.is_empty() {
            list.add(pid::DATA_REPRESENTATION, |value| {
                value.u32(u32::try_from(self.representations.len()).unwrap_or(u32::MAX));
                self.representations.iter().for_each(|Representation(number)| value.u16(number.cast_unsigned()));
            });
        }
    }

    /// Takes in a policy. False: the parameter is none.
    pub(super) fn read(&mut self, id: u16, value: &mut Cursor) -> Result<bool, Malformed> {
        match id {
            pid::RELIABILITY => {
                let number = value.u32()?.checked_sub(1).ok_or(Malformed)?;
                self.reliability = kind_of(number, &RELIABILITIES)?;
            }
            pid::DURABILITY => self.durability = kind_of(value.u32()?, &DURABILITIES)?,
            pid::HISTORY => self.history = read_history(value)?,
            pid::DEADLINE => self.deadline = read_duration(value)?,
            pid::LIVELINESS => {
                self.liveliness = kind_of(value.u32()?, &LIVELINESS_KINDS)?;
                self.liveliness_lease = read_duration(value)?;
            }
            pid::LIFESPAN => self.lifespan = read_duration(value)?,
            pid::LATENCY_BUDGET => self.latency_budget = read_duration(value)?,
            pid::OWNERSHIP => self.ownership = kind_of(value.u32()?, &OWNERSHIPS)?,
            pid::PARTITION => self.partitions = read_partitions(value)?,
            pid::DATA_REPRESENTATION => self.representations = read_representations(value)?,
            _ => return Ok(false),
        }
        Ok(true)
    }
}

/// The number of a kind on the wire: its place in the list.
fn number_of<Kind: PartialEq>(kind: Kind, kinds: &[Kind]) -> u32 {
    (0..).zip(kinds).find(|(_, other)| **other == kind).map_or(0, |(number, _)| number)
}

/// The kind with this number.
fn kind_of<Kind: Copy>(number: u32, kinds: &[Kind]) -> Result<Kind, Malformed> {
    usize::try_from(number).ok().and_then(|number| kinds.get(number)).copied().ok_or(Malformed)
}

fn write_history(history: History, value: &mut Encoder) {
    let (kind, depth) = match history {
        History::KeepLast(depth) => (KEEP_LAST, i32::try_from(depth).unwrap_or(i32::MAX)),
        History::KeepAll => (KEEP_ALL, DEPTH_DEFAULT),
    };
    value.u32(kind);
    value.i32(depth);
}

fn read_history(value: &mut Cursor) -> Result<History, Malformed> {
    match (value.u32()?, value.i32()?) {
        (KEEP_LAST, depth) => u32::try_from(depth).map(History::KeepLast).map_err(|_| Malformed),
        (KEEP_ALL, _) => Ok(History::KeepAll),
        _ => Err(Malformed),
    }
}

fn write_partitions(partitions: &[String], value: &mut Encoder) {
    value.u32(u32::try_from(partitions.len()).unwrap_or(u32::MAX));
    for partition in partitions {
        value.align();
        write_text(partition, value);
    }
}

/// Keeps at most [`PARTITIONS_MAX`], and none with a name that is too long. If none is left, the list is rejected: an empty one means
/// the default partition.
fn read_partitions(value: &mut Cursor) -> Result<Vec<String>, Malformed> {
    let mut partitions = Vec::new();
    let count = value.u32()?;
    for _ in 0..count {
        value.align()?;
        let name = read_text(value)?;
        if partitions.len() < PARTITIONS_MAX {
            partitions.extend(name);
        }
    }
    if count > 0 && partitions.is_empty() { Err(Malformed) } else { Ok(partitions) }
}

/// Keeps at most [`REPRESENTATIONS_MAX`].
fn read_representations(value: &mut Cursor) -> Result<Vec<Representation>, Malformed> {
    let mut representations = Vec::new();
    for _ in 0..value.u32()? {
        let number = value.i16()?;
        if representations.len() < REPRESENTATIONS_MAX {
            representations.push(Representation(number));
        }
    }
    Ok(representations)
}
