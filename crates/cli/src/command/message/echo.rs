//! `echo`: print the messages of a service as they are committed.

use super::payloads;
use super::place::Place;
use super::secret::{KEYED, Opening};
use super::senders::Senders;
use crate::answer;
use crate::argument::message::Definitions;
use crate::argument::number;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, printable};
use crate::session::{ABAC, Session};
use crate::time;
use crate::words::Words;
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_api::{Subscription, v1};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_contract::{MessageEvent, ServiceState};
use ros_message::{Message as Type, Value};
use serde::Serialize;
use std::io::{self, Write};

/// How often the node says that it is alive while there is nothing to print, in milliseconds.
pub(super) const HEARTBEAT_MS: u32 = 2_000;
/// Most elements of an array and characters of a text that are shown, unless all are asked for: as `ros2 topic echo`.
const LENGTH_MAX: usize = 128;
/// The words of the command line where the chaincode has other names.
const WORDS: Words = Words { arguments: &[], help: "ledgerctl echo" };

/// Print the messages of a service as they are committed, until Ctrl-C.
///
/// Each message is YAML in the format of `ros2 topic echo`, after a comment with block, time, sender, epoch and
/// sequence number, and ends with `---`. The sender's signature is verified. A type without a definition is printed in
/// hexadecimal. With `-o json` each line is an object.
///
/// On a confidential service, the command registers as a reader and decrypts messages that are published from then on.
/// It reports messages that are encrypted for others.
///
/// If the owner limits the subscribers, the command takes a slot, waits for one if the service has a queue, and
/// releases it at the end.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl echo Turtlebot4/cmd_vel
  ledgerctl echo Arm/grip --msg arm_msgs/msg/Grip=Grip.msg
  ledgerctl echo Turtlebot4/cmd_vel --from 1 --count 10 -o json")]
pub(crate) struct Echo {
    /// The service; the robot alone if it offers exactly one
    #[arg(value_name = "ROBOT/TOPIC")]
    service: String,
    /// Start at this height, 0 for the first stored block; by default with the next block
    #[arg(long, value_name = "HEIGHT", value_parser = number::height)]
    from: Option<u64>,
    /// End after N messages
    #[arg(long, value_name = "N", value_parser = number::count)]
    count: Option<u64>,
    /// Print the bytes in hexadecimal, one line per message
    #[arg(long, conflicts_with = "full_length")]
    hex: bool,
    /// Print long arrays and texts completely, not only the first 128 elements
    #[arg(long)]
    full_length: bool,
    #[command(flatten)]
    definitions: Definitions,
}

/// How messages are shown.
pub(super) struct Shown {
    /// None if they are shown as bytes.
    kind: Option<Type>,
    type_name: String,
    length_max: Option<usize>,
}

/// One message.
#[derive(Serialize)]
pub(super) struct Message {
    pub(super) height: u64,
    pub(super) time: u64,
    index: u32,
    service: String,
    pub(super) sender: String,
    pub(super) epoch: u64,
    pub(super) seq: u64,
    #[serde(rename = "type")]
    type_name: String,
    /// Its content; left out where that is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) message: Option<Value>,
    /// Why it is not known although the type is.
    #[serde(skip_serializing_if = "Option::is_none")]
    fault: Option<String>,
    pub(super) payload: String,
    transaction: Hash,
    #[serde(skip)]
    length_max: Option<usize>,
}

impl Facts for Message {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self { height, sender, epoch, seq, payload, .. } = self;
        let time = time::time_of_day(self.time);
        if let Some(fault) = &self.fault {
            writeln!(out, "# {}", printable(fault))?;
        }
        match &self.message {
            None => writeln!(out, "{height}  {time}  {sender}  epoch {epoch}  seq {seq}  {payload}"),
            Some(message) => {
                writeln!(out, "# block {height}, {time}, {sender}, epoch {epoch}, sequence {seq}")?;
                writeln!(out, "{}---", message.to_yaml(self.length_max))
            }
        }
    }
}

impl Shown {
    /// How messages of this type are shown; says so where that is not what was hoped for.
    pub(super) fn of(definitions: &Definitions, hex: bool, type_name: &str, output: &Output) -> Self {
        let kind = match definitions.message(type_name) {
            _ if hex => None,
            Ok(kind) => Some(kind),
            Err(unknown) => {
                output.note(&format!(
                    "{}: messages are printed in hexadecimal; --msg {type_name}=FILE.msg decodes them",
                    unknown.message
                ));
                None
            }
        };
        Self { kind, type_name: type_name.to_owned(), length_max: Some(LENGTH_MAX) }
    }

    /// The message of these bytes, or why they are none; neither if the type is not known.
    fn read(&self, payload: &[u8]) -> (Option<Value>, Option<String>) {
        match self.kind.as_ref().map(|kind| kind.decode(payload)) {
            None => (None, None),
            Some(Ok(message)) => (Some(message), None),
            Some(Err(fault)) => (None, Some(format!("{} (found {})", fault.message, fault.found))),
        }
    }
}

impl Echo {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        self.definitions.check(output)?;
        let session = Session::open(global).await?;
        let response = session.ask(ABAC, "service", vec![Bytes::from(self.service.clone())]).await;
        let response = response.map_err(|refused| WORDS.told(refused))?;
        let service: ServiceState = answer::parse(&response, "a service")?;
        let place = Place::take(&session, &service, output).await?;
        let done = tokio::select! {
            done = self.follow(&session, &service, output) => done,
            lost = place.keep() => Err(lost.into()),
            _ = tokio::signal::ctrl_c() => Ok(()),
        };
        place.give_back().await;
        done
    }

    async fn follow(&self, session: &Session, service: &ServiceState, output: &mut Output) -> Result<(), Failure> {
        let mut shown = Shown::of(&self.definitions, self.hex, &service.type_name, output);
        if self.full_length {
            shown.length_max = None;
        }
        let mut stream = session.client.subscribe(Subscription {
            // To the node 0 means the next block. The genesis, block 0, has no messages.
            from_height: self.from.map_or(0, |height| height.max(1)),
            chaincode: ABAC.to_owned(),
            subjects: vec![service.service.clone()],
            names: vec!["message".to_owned(), KEYED.to_owned()],
            heartbeat: HEARTBEAT_MS,
            ..Subscription::default()
        });
        // Who may not read hears it now.
        stream.open().await?;
        if let Some(from) = self.from {
            let node = session.client.status().await?;
            if from > node.height {
                output.note(&format!("the last block is {}: waiting for block {from}", node.height));
            } else if from > 0 && from < node.first_height {
                output.note(&format!("this node has no blocks before {}", node.first_height));
            }
        }
        let (mut senders, mut opening) =
            (Senders::new(session), Opening::enter(session, std::iter::once(service)).await?);
        let mut left = self.count.unwrap_or(u64::MAX);
        loop {
            let delivery = stream.next().await?;
            for event in &delivery.events {
                if event.name == KEYED {
                    opening.keyed(delivery.height, event, &mut senders)?;
                    continue;
                }
                for message in messages(&delivery, event, (&mut senders, &mut opening), &shown).await? {
                    output.show(&message)?;
                    left -= 1;
                    if left == 0 {
                        return Ok(());
                    }
                }
            }
        }
    }
}

/// The messages of one event: what the event says about them, and their bytes from the signed transaction.
pub(super) async fn messages(
    delivery: &v1::Delivery,
    event: &v1::EventRecord,
    (senders, opening): (&mut Senders<'_>, &mut Opening<'_>),
    shown: &Shown,
) -> Result<Vec<Message>, Rejection> {
    let details: MessageEvent = answer::parse(&event.payload, "an event of messages")?;
    let transaction = Transaction::decode(event.transaction.clone())?;
    let sender = senders.check(&transaction, &event.certificate)?.id();
    let network = senders.network();
    let payloads = payloads(transaction.body(), &network, &event.subject, &details)?;
    let mut messages = Vec::new();
    for (seq, payload) in (details.first_seq..).zip(payloads) {
        let opened = opening.open((&event.subject, &sender), (details.epoch, seq), payload, senders).await?;
        let (message, fault) = match &opened {
            Ok(payload) => shown.read(payload),
            Err(unreadable) => (None, Some(unreadable.clone())),
        };
        messages.push(Message {
            height: delivery.height,
            time: delivery.time,
            index: event.index,
            service: event.subject.clone(),
            sender: sender.clone(),
            epoch: details.epoch,
            seq,
            type_name: shown.type_name.clone(),
            message,
            fault,
            payload: hex::encode(opened.as_ref().unwrap_or(payload)),
            transaction: transaction.id(),
            length_max: shown.length_max,
        });
    }
    Ok(messages)
}
