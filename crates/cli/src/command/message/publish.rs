//! `publish`: send messages to a service.

use super::secret::Sealing;
use crate::answer;
use crate::argument::bytes;
use crate::argument::message::{Definitions, refused};
use crate::argument::number;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output};
use crate::session::{ABAC, Session};
use crate::time;
use crate::words::Words;
use ::bytes::Bytes;
use ledger_api::Call;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Grant, ServiceState};
use ros_message::{ByteOrder, Message, Time, Written};
use serde::Serialize;
use std::io::{self, Write};
use std::path::PathBuf;
use std::time::Duration;

/// Most messages per second that `--rate` may ask for: each waits for the verdict of the one before.
const RATE_HZ_MAX: f64 = 1000.0;
/// How long a message may wait to be executed: a command to a robot is worth nothing later.
pub(crate) const COMMAND_TTL: Duration = Duration::from_secs(2);

/// Advice to those whose bytes are no message.
const AS_TEXT: &str = "write the message as YAML; it is encoded automatically: '{linear: {x: 0.5}}'";

/// The words of the command line where the chaincode has other names.
const WORDS: Words = Words { arguments: &[("PAYLOAD", "the message")], help: "ledgerctl publish" };

/// Publish a message on a service, under the grant that you hold.
///
/// The message is YAML or JSON, as for `ros2 topic pub`: omitted fields are zero, and `now` or `auto` sets a stamp or a
/// header. Or it is CDR bytes with the header of four bytes, such as 00 01 00 00 for little endian. A service in open
/// mode needs no grant.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl publish Turtlebot4/cmd_vel '{linear: {x: 0.5}, angular: {z: 0.1}}'
  ledgerctl publish Turtlebot4/cmd_vel '{linear: {x: 0.1}}' --count 100 --rate 50
  ledgerctl publish Arm/grip '{force: 2.5}' --msg arm_msgs/msg/Grip=Grip.msg
  ledgerctl publish Turtlebot4/cmd_vel --file twist.cdr
  ledgerctl publish Turtlebot4/cmd_vel --hex 000100009a9999999999b93f00000000000000000000000000000000000000000000000000000000000000000000000000000000")]
pub(crate) struct Publish {
    /// The service; the robot alone if it offers exactly one
    #[arg(value_name = "ROBOT/TOPIC")]
    service: String,
    #[command(flatten)]
    source: Source,
    #[command(flatten)]
    definitions: Definitions,
    /// Publish the message N times
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = number::count)]
    count: u64,
    /// Messages per second with --count
    #[arg(long, value_name = "HZ", default_value_t = 10.0, value_parser = rate)]
    rate: f64,
}

#[derive(Debug, clap::Args)]
#[group(required = true, multiple = false)]
struct Source {
    /// The message as YAML or JSON, in quotes; {} is all zeros
    #[arg(value_name = "MESSAGE")]
    message: Option<String>,
    /// The message as bytes, in hexadecimal
    #[arg(long, value_name = "BYTES")]
    hex: Option<String>,
    /// Read the bytes of the message from this file
    #[arg(long, value_name = "FILE")]
    file: Option<PathBuf>,
    /// Read the bytes of the message from standard input
    #[arg(long)]
    stdin: bool,
}

fn rate(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|hz| *hz > 0.0 && *hz <= RATE_HZ_MAX)
        .ok_or_else(|| format!("wanted messages per second, above 0 and at most {RATE_HZ_MAX}"))
}

/// The message to publish, before the type of the service is known.
enum Content {
    Written(Written),
    Bytes(Bytes),
}

impl Source {
    fn read(&self) -> Result<Content, Rejection> {
        match (&self.message, &self.hex, &self.file) {
            // What a script's variable without a value gives must not move or stop a robot.
            (Some(text), ..) if text.trim().is_empty() => Err(Rejection::new(Code::BadMessage, "the message is empty")
                .found("an empty text")
                .wanted("YAML or JSON; {} is a message with default values")),
            (Some(text), ..) => Written::parse(text).map(Content::Written).map_err(refused),
            (None, Some(digits), _) => bytes::from_hex(digits).map(Content::Bytes),
            (None, None, Some(path)) => bytes::from_file(path).map(Content::Bytes),
            (None, None, None) => bytes::from_stdin().map(Content::Bytes),
        }
    }
}

impl Content {
    /// The bytes to publish at this moment. Text needs the type; bytes are compared with it if it is known.
    fn payload(&self, message: &Result<Message, Rejection>, now: u64) -> Result<Bytes, Rejection> {
        match (self, message) {
            (Self::Written(_), Err(unknown)) => Err(unknown.clone()),
            (Self::Written(written), Ok(message)) => {
                let encoded = message.encode(written, ByteOrder::Little, Time::from_micros(now));
                encoded.map(Bytes::from).map_err(refused)
            }
            (Self::Bytes(bytes), Ok(message)) => message.check_whole(bytes).map(|()| bytes.clone()).map_err(|fault| {
                let refused = refused(fault);
                if refused.advice().is_empty() { refused.next(AS_TEXT) } else { refused }
            }),
            (Self::Bytes(bytes), Err(_)) => Ok(bytes.clone()),
        }
    }
}

#[derive(Serialize)]
struct Sent {
    service: String,
    epoch: u64,
    seq: u64,
    bytes: usize,
    height: u64,
    time: u64,
    transaction: Hash,
}

impl Facts for Sent {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self { service, epoch, seq, bytes, height, .. } = self;
        writeln!(out, "published {bytes} bytes on {service}: block {height}, epoch {epoch}, sequence {seq}")
    }
}

impl Publish {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let content = self.source.read()?;
        self.definitions.check(output)?;
        let session = Session::open(global).await?;
        let named = || vec![Bytes::from(self.service.clone())];
        let (service, grants) =
            tokio::try_join!(session.ask(ABAC, "service", named()), session.ask(ABAC, "grants", named()))
                .map_err(|refused| WORDS.told(refused))?;
        let service: ServiceState = answer::parse(&service, "a service")?;
        let grants: Vec<Grant> = answer::parse(&grants, "grants")?;
        let message = self.definitions.message(&service.type_name);
        content.payload(&message, time::now())?;
        let me = session.identity()?.id();
        let grant = grants.into_iter().find(|grant| grant.holder == me);
        // Without a grant the epoch is 0: right in open mode, and otherwise the node says what is missing.
        let (epoch, mut next_seq) = grant.map_or((0, 0), |grant| (grant.epoch, grant.next_seq));
        let mut sealing = Sealing::begin(&session, &service, epoch).await.map_err(|refused| WORDS.told(refused))?;
        let service = service.service;

        let mut ticks = tokio::time::interval(Duration::from_secs_f64(1.0 / self.rate));
        for _ in 0..self.count {
            ticks.tick().await;
            let seq = next_seq.max(time::now());
            let payload = content.payload(&message, time::now())?;
            let text = |number: u64| Bytes::from(number.to_string());
            let done = loop {
                let args = vec![Bytes::from(service.clone()), text(epoch), text(seq), sealing.seal(seq, &payload)?];
                let call = Call { chaincode: ABAC.to_owned(), function: "set".to_owned(), args, ttl: COMMAND_TTL };
                match session.client.submit(session.client.prepare(call)?).await {
                    Ok(done) => break done,
                    Err(refused) if sealing.renewed(&refused).await? => {}
                    Err(refused) => return Err(WORDS.told(refused).into()),
                }
            };
            next_seq = seq + 1;
            output.show(&Sent {
                service: service.clone(),
                epoch,
                seq,
                bytes: payload.len(),
                height: done.height,
                time: done.time,
                transaction: done.id,
            })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_above_zero_and_bounded() {
        assert_eq!(rate("50"), Ok(50.0));
        for text in ["0", "-1", "nan", "inf", "1001", "x"] {
            assert!(rate(text).is_err_and(|error| error.contains("messages per second")), "{text}");
        }
    }
}
