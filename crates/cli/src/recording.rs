//! Recordings: MCAP files as `ros2 bag` and Foxglove read them.
//!
//! | channel | what is on it |
//! |---|---|
//! | one for each service | its messages, byte for byte as their senders signed them |
//! | `/ledger/records` | for each of these messages who sent it, and where it stands on the ledger |
//! | `/ledger/events` | grants and their ends, stops: who held what when |
//!
//! All of them are CDR: `ros2 bag play` refuses a file whose channels have several encodings. Log time is block time, publish
//! time the moment at which the sender signed. Chunks are not compressed, and written whole, so that a file whose recorder
//! was killed can be read up to its last second. docs/record.md has the details.

mod disk;
mod items;
mod reading;
mod rows;

pub(crate) use disk::taken;
pub(crate) use reading::{Reading, Source};
pub(crate) use rows::{Event, Record};

use bytes::Bytes;
use disk::Disk;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_contract::ServiceState;
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{McapResult, WriteOptions};
use ros_message::Library;
use rows::Row;
use std::collections::BTreeMap;
use std::path::Path;

/// The channel of records.
pub(crate) const RECORDS: &str = "/ledger/records";
/// The channel of events.
pub(crate) const EVENTS: &str = "/ledger/events";
/// The package of the types of both. Nobody replays them: they are about a ledger.
pub(crate) const OWN_PACKAGE: &str = "ledgerd_msgs";
/// The key of a channel's metadata that names the service.
pub(crate) const SERVICE_KEY: &str = "service";
/// The key of a channel's metadata that names the network.
pub(crate) const NETWORK_KEY: &str = "network";

/// The encoding of definitions that ROS tools read.
const DEFINITION: &str = "ros2msg";
/// The encoding of messages.
pub(crate) const CDR: &str = "cdr";

/// Bytes at which a chunk ends, if it was not ended before.
const CHUNK_BYTES: u64 = 1024 * 1024;

/// Writes MCAP. It never seeks: a chunk comes into the file as a whole, so that a killed recorder loses at most its last one.
type Writer = mcap::Writer<NoSeek<Disk>>;

/// A channel of a service.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Channel(u16);

/// A recording that is being written.
pub(crate) struct Recording {
    writer: Writer,
    disk: Disk,
    library: Library,
    network: Hash,
    records: Row,
    events: Row,
    /// Messages so far, by channel.
    counts: BTreeMap<u16, u32>,
}

impl Recording {
    /// Creates the file. With `replace` another one of this name is lost.
    ///
    /// # Errors
    /// `ALREADY_EXISTS` and `BAD_FILE`.
    pub(crate) fn create(path: &Path, replace: bool, network: Hash, library: Library) -> Result<Self, Rejection> {
        let disk = Disk::create(path, replace)?;
        let options = WriteOptions::new()
            .profile("ros2")
            .library(concat!("ledgerctl ", env!("CARGO_PKG_VERSION")))
            .compression(None)
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true)
            // Chunks have sums of their own.
            .calculate_data_section_crc(false);
        let mut writer = options.create(NoSeek::new(disk.clone())).map_err(|error| disk.refused(&error))?;
        let records = Row::open(&mut writer, &disk, RECORDS, rows::RECORD)?;
        let events = Row::open(&mut writer, &disk, EVENTS, rows::EVENT)?;
        Ok(Self { writer, disk, library, network, records, events, counts: BTreeMap::new() })
    }

    /// Adds the channel of a service. Says whether the definition of its type is known: otherwise the file has its name only.
    ///
    /// # Errors
    /// `BAD_FILE` if the file cannot be written.
    pub(crate) fn service(&mut self, service: &ServiceState, topic: &str) -> Result<(Channel, bool), Rejection> {
        let kind = self.library.message(&service.type_name).ok();
        let mut about: BTreeMap<String, String> =
            [(SERVICE_KEY.to_owned(), service.service.clone()), (NETWORK_KEY.to_owned(), self.network.to_string())]
                .into();
        if let Some(kind) = &kind {
            about.insert("topic_type_hash".to_owned(), kind.type_hash());
        }
        let channel = (|| -> McapResult<u16> {
            let schema = match &kind {
                Some(kind) => self.writer.add_schema(kind.name(), DEFINITION, kind.definition().as_bytes())?,
                None => self.writer.add_schema(&service.type_name, "", b"")?,
            };
            self.writer.add_channel(schema, topic, CDR, &about)
        })();
        let channel = channel.map_err(|error| self.disk.refused(&error))?;
        self.facts(
            "ledger.service",
            [
                ("service", service.service.clone()),
                ("robot", service.robot.clone()),
                ("organisation", service.organisation.clone()),
                ("topic", service.topic.clone()),
                ("recorded_as", topic.to_owned()),
                ("type", service.type_name.clone()),
                ("mode", service.mode.name().to_owned()),
                ("direction", service.direction.to_string()),
            ],
        )?;
        Ok((Channel(channel), kind.is_some()))
    }

    /// Adds facts that hold for the file as a whole.
    ///
    /// # Errors
    /// `BAD_FILE` if the file cannot be written.
    pub(crate) fn facts<const N: usize>(&mut self, name: &str, facts: [(&str, String); N]) -> Result<(), Rejection> {
        let metadata = facts.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
        let metadata = Metadata { name: name.to_owned(), metadata };
        self.writer.write_metadata(&metadata).map_err(|error| self.disk.refused(&error))
    }

    /// Adds a message, and what the ledger says about it.
    ///
    /// # Errors
    /// `BAD_FILE` if the file cannot be written.
    pub(crate) fn message(&mut self, channel: Channel, record: &Record<'_>, payload: &Bytes) -> Result<(), Rejection> {
        let Self { writer, disk, records, counts, .. } = self;
        let count = counts.entry(channel.0).or_default();
        let (log_time, publish_time) = (nanoseconds(record.time), nanoseconds(record.signed));
        let sequence = *count;
        *count = count.wrapping_add(1);
        let header = MessageHeader { channel_id: channel.0, sequence, log_time, publish_time };
        writer.write_to_known_channel(&header, payload).map_err(|error| disk.refused(&error))?;
        records.write(writer, disk, (log_time, publish_time), &record.written(sequence))
    }

    /// Adds an event.
    ///
    /// # Errors
    /// `BAD_FILE` if the file cannot be written.
    pub(crate) fn event(&mut self, event: &Event<'_>) -> Result<(), Rejection> {
        let time = nanoseconds(event.time);
        self.events.write(&mut self.writer, &self.disk, (time, time), &event.written())
    }

    /// Writes what is there, so that it survives the end of this process.
    ///
    /// # Errors
    /// `BAD_FILE` if the file cannot be written. It then ends with what was flushed before.
    pub(crate) fn flush(&mut self) -> Result<(), Rejection> {
        self.writer.flush().map_err(|error| self.disk.refused(&error))?;
        self.disk.mark();
        Ok(())
    }

    /// Ends the file with its index, and waits until the disk has it. Answers with its length in bytes.
    ///
    /// # Errors
    /// `BAD_FILE` if the file cannot be written.
    pub(crate) fn finish(mut self) -> Result<u64, Rejection> {
        self.flush()?;
        let Self { mut writer, disk, .. } = self;
        writer.finish().map_err(|error| disk.refused(&error))?;
        disk.sync()
    }

    /// Bytes of the file so far.
    pub(crate) fn bytes(&self) -> u64 {
        self.disk.written()
    }
}

fn nanoseconds(micros: u64) -> u64 {
    micros.saturating_mul(1000)
}
