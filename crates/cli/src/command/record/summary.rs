//! The end of a recording, for people and programs.

use crate::output::{Facts, Table, printable};
use crate::time;
use serde::Serialize;
use std::io::{self, Write};
use std::path::Path;

/// How much is recorded.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Counts {
    pub(super) messages: u64,
    pub(super) events: u64,
    /// Encrypted messages that are for others.
    pub(super) unreadable: u64,
    /// Bytes of the file.
    pub(super) bytes: u64,
    /// The last block that was looked at.
    pub(super) height: u64,
    /// Height and time of the first block that has something.
    pub(super) first: (u64, u64),
    /// Height and time of the last one.
    pub(super) last: (u64, u64),
}

impl Counts {
    /// Notes a block that has something.
    pub(super) fn saw(&mut self, height: u64, time: u64) {
        if self.first == (0, 0) {
            self.first = (height, time);
        }
        self.last = (height, time);
    }
}

/// The reason why a recording ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Ending {
    /// Everything that was asked for is recorded.
    Reached,
    /// Somebody ended it.
    Interrupted,
    /// The node refused to go on.
    Refused,
}

impl Ending {
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Reached => "reached",
            Self::Interrupted => "interrupted",
            Self::Refused => "refused",
        }
    }
}

/// A recording that has ended.
#[derive(Debug, Serialize)]
pub(super) struct Recorded {
    file: String,
    bytes: u64,
    services: Vec<Service>,
    messages: u64,
    events: u64,
    #[serde(skip_serializing_if = "is_zero")]
    unreadable: u64,
    first_height: u64,
    last_height: u64,
    first_time: u64,
    last_time: u64,
    ended: Ending,
}

/// One service of it.
#[derive(Debug, Serialize)]
pub(super) struct Service {
    pub(super) service: String,
    /// Its channel.
    pub(super) topic: String,
    #[serde(rename = "type")]
    pub(super) type_name: String,
    /// Has the file the definition of its type?
    #[serde(rename = "definition")]
    pub(super) is_defined: bool,
    pub(super) messages: u64,
}

impl Recorded {
    pub(super) fn new(path: &Path, services: Vec<Service>, counts: &Counts, ended: Ending) -> Self {
        let Counts { messages, events, unreadable, bytes, first, last, .. } = *counts;
        let ((first_height, first_time), (last_height, last_time)) = (first, last);
        let file = path.display().to_string();
        Self {
            file,
            bytes,
            services,
            messages,
            events,
            unreadable,
            first_height,
            last_height,
            first_time,
            last_time,
            ended,
        }
    }
}

impl Facts for Recorded {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self { file, messages, events, first_height, last_height, .. } = self;
        write!(out, "recorded {messages} messages and {events} events into {}", printable(file))?;
        let bytes = size(self.bytes);
        if messages + events == 0 {
            writeln!(out, " ({bytes})")?;
        } else {
            let span = time::span(self.last_time.saturating_sub(self.first_time));
            writeln!(out, ": blocks {first_height} to {last_height}, {span} ({bytes})")?;
        }
        if self.unreadable > 0 {
            writeln!(out, "left out {} encrypted messages that are not for this reader", self.unreadable)?;
        }
        let mut table = Table::new(["SERVICE", "CHANNEL", "TYPE", "MESSAGES"]);
        for service in &self.services {
            let note = if service.is_defined { "" } else { " (no definition)" };
            let kind = format!("{}{note}", service.type_name);
            table.row([service.service.clone(), service.topic.clone(), kind, service.messages.to_string()]);
        }
        table.write(out, 2)
    }
}

fn is_zero(number: &u64) -> bool {
    *number == 0
}

/// A number of bytes in a unit that people use.
pub(super) fn size(bytes: u64) -> String {
    const UNITS: [(u64, &str); 3] = [(1_000_000_000, "GB"), (1_000_000, "MB"), (1_000, "kB")];
    let unit = UNITS.into_iter().find(|(size, _)| bytes >= *size);
    unit.map_or_else(
        || format!("{bytes} bytes"),
        |(size, name)| format!("{}.{} {name}", bytes / size, bytes % size * 10 / size),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_told_in_units_that_people_use() {
        assert_eq!(size(999), "999 bytes");
        assert_eq!(size(1_250), "1.2 kB");
        assert_eq!(size(73_900_000), "73.9 MB");
        assert_eq!(size(2_000_000_000), "2.0 GB");
    }
}
