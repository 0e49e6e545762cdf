//! The ledger's words about messages, and its events, as messages of types of our own. A recording has their definitions.

use super::{CDR, DEFINITION, Disk, OWN_PACKAGE, Writer};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use mcap::McapResult;
use mcap::records::MessageHeader;
use ros_message::{ByteOrder, Library, Message, Time, Written};
use std::collections::BTreeMap;

/// The type of [`Record`]: name and definition.
pub(super) const RECORD: (&str, &str) = ("Record", include_str!("Record.msg"));
/// The type of [`Event`].
pub(super) const EVENT: (&str, &str) = ("Event", include_str!("Event.msg"));

/// One message of a service, as it stands on the ledger.
#[derive(Debug)]
pub(crate) struct Record<'a> {
    /// Block time, microseconds since the UNIX epoch.
    pub(crate) time: u64,
    /// When it was signed, microseconds since the UNIX epoch.
    pub(crate) signed: u64,
    /// The channel that has it.
    pub(crate) topic: &'a str,
    /// The service.
    pub(crate) service: &'a str,
    /// The signer, e.g. `Org1/Salma`.
    pub(crate) identity: &'a str,
    /// The epoch of the grant; 0 without one.
    pub(crate) epoch: u64,
    /// The sender's number.
    pub(crate) sequence: u64,
    /// Height of the block.
    pub(crate) height: u64,
    /// Hash of the block.
    pub(crate) block: &'a str,
    /// Position of the transaction in the block.
    pub(crate) index: u32,
    /// Id of the transaction.
    pub(crate) transaction: Hash,
}

/// Something that a block did.
#[derive(Debug)]
pub(crate) struct Event<'a> {
    /// Block time, microseconds since the UNIX epoch.
    pub(crate) time: u64,
    /// Its name, such as `granted`.
    pub(crate) name: &'a str,
    /// The service or robot.
    pub(crate) subject: &'a str,
    /// The one who caused it; empty if the block did.
    pub(crate) identity: &'a str,
    /// The details, in JSON.
    pub(crate) payload: &'a str,
    /// Height of the block.
    pub(crate) height: u64,
    /// Position of the transaction in the block.
    pub(crate) index: u32,
    /// Id of the transaction, if one caused it.
    pub(crate) transaction: Option<Hash>,
}

impl Record<'_> {
    /// With its number on its channel.
    pub(super) fn written(&self, number: u32) -> Written {
        map([
            ("stamp", stamp(self.time)),
            ("signed", stamp(self.signed)),
            ("topic", text(self.topic)),
            ("number", text(number)),
            ("service", text(self.service)),
            ("identity", text(self.identity)),
            ("epoch", text(self.epoch)),
            ("sequence", text(self.sequence)),
            ("height", text(self.height)),
            ("block", text(self.block)),
            ("index", text(self.index)),
            ("transaction", text(self.transaction)),
            // Others have no event: a command that was refused reached nobody.
            ("verdict", text(Code::Ok.name())),
        ])
    }
}

impl Event<'_> {
    pub(super) fn written(&self) -> Written {
        map([
            ("stamp", stamp(self.time)),
            ("name", text(self.name)),
            ("subject", text(self.subject)),
            ("identity", text(self.identity)),
            ("payload", text(self.payload)),
            ("height", text(self.height)),
            ("index", text(self.index)),
            ("transaction", text(self.transaction.map(|id| id.to_string()).unwrap_or_default())),
        ])
    }
}

fn map<const N: usize>(fields: [(&str, Written); N]) -> Written {
    Written::Map(fields.map(|(name, value)| (name.to_owned(), value)).to_vec())
}

fn text(value: impl ToString) -> Written {
    Written::Text(value.to_string())
}

fn stamp(micros: u64) -> Written {
    let Time { sec, nanosec } = Time::from_micros(micros);
    map([("sec", text(sec)), ("nanosec", text(nanosec))])
}

/// A channel of such messages.
pub(super) struct Row {
    channel: u16,
    kind: Message,
    count: u32,
}

impl Row {
    /// Adds the channel.
    pub(super) fn open(
        writer: &mut Writer,
        disk: &Disk,
        topic: &str,
        (name, definition): (&str, &str),
    ) -> Result<Self, Rejection> {
        let name = format!("{OWN_PACKAGE}/msg/{name}");
        let mut library = Library::builtin();
        let kind = library.add(&name, definition).and_then(|()| library.message(&name));
        let kind = kind.map_err(|fault| Rejection::new(Code::Internal, fault.message))?;
        let channel = (|| -> McapResult<u16> {
            let schema = writer.add_schema(&name, DEFINITION, kind.definition().as_bytes())?;
            writer.add_channel(schema, topic, CDR, &BTreeMap::new())
        })();
        let channel = channel.map_err(|error| disk.refused(&error))?;
        Ok(Self { channel, kind, count: 0 })
    }

    /// Adds a message with these log and publish times, nanoseconds since the UNIX epoch.
    pub(super) fn write(
        &mut self,
        writer: &mut Writer,
        disk: &Disk,
        (log_time, publish_time): (u64, u64),
        content: &Written,
    ) -> Result<(), Rejection> {
        let encoded = self.kind.encode(content, ByteOrder::Little, Time::default()).map_err(|fault| {
            Rejection::new(Code::Internal, "the recording cannot be written")
                .found(format!("{} (found {})", fault.message, fault.found))
        })?;
        let header = MessageHeader { channel_id: self.channel, sequence: self.count, log_time, publish_time };
        self.count = self.count.wrapping_add(1);
        writer.write_to_known_channel(&header, &encoded).map_err(|error| disk.refused(&error))
    }
}
