//! `echo`: print the messages of a service as they are committed.

use crate::answer;
use crate::cli::Global;
use crate::failure::Failure;
use crate::output::{Facts, Output};
use crate::session::{ABAC, Session};
use crate::{context, time};
use ledger::identity::Identity;
use ledger::transaction::Transaction;
use ledger::{Bytes, Code, Hash, Rejection};
use ledger_api::{Subscription, v1};
use ledger_contract::{MessageEvent, ServiceState};
use serde::Serialize;
use std::collections::HashMap;
use std::io::{self, Write};

/// How often the node says that it is alive while there is nothing to print, in milliseconds.
const HEARTBEAT_MS: u32 = 2_000;
/// Arguments of `set` before the messages: service, epoch, sequence number.
const ARGS_BEFORE_PAYLOADS: usize = 3;

/// Print the messages of a service as they are committed, until Ctrl-C.
///
/// One line for each message: height, time, sender, epoch, sequence number, and the message in hexadecimal digits.
/// The sender's signature is checked. With `-o json` each line is an object.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl echo Turtlebot4/cmd_vel
  ledgerctl echo Turtlebot4/cmd_vel --from 1 --count 10 -o json")]
pub(crate) struct Echo {
    /// The service; the robot alone is enough if it offers exactly one
    #[arg(value_name = "ROBOT/TOPIC")]
    service: String,
    /// Begin at this height, 0 for the first block that there is; otherwise with the next one
    #[arg(long, value_name = "HEIGHT")]
    from: Option<u64>,
    /// End after so many messages
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,
}

/// One message.
#[derive(Serialize)]
struct Message {
    height: u64,
    time: u64,
    index: u32,
    service: String,
    sender: String,
    epoch: u64,
    seq: u64,
    payload: String,
    transaction: Hash,
}

impl Facts for Message {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self { height, sender, epoch, seq, payload, .. } = self;
        writeln!(out, "{height}  {}  {sender}  epoch {epoch}  seq {seq}  {payload}", time::time_of_day(self.time))
    }
}

impl Echo {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        tokio::select! {
            done = self.follow(global, output) => done,
            _ = tokio::signal::ctrl_c() => Ok(()),
        }
    }

    async fn follow(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let response = session.ask(ABAC, "service", vec![Bytes::from(self.service)]).await?;
        let service: ServiceState = answer::parse(&response, "a service")?;
        let mut stream = session.client.subscribe(Subscription {
            // To the node 0 means the next block. The genesis, block 0, has no messages.
            from_height: self.from.map_or(0, |height| height.max(1)),
            chaincode: ABAC.to_owned(),
            subjects: vec![service.service],
            names: vec!["message".to_owned()],
            heartbeat: HEARTBEAT_MS,
        });
        // Who may not read hears it now.
        stream.open().await?;
        if let Some(from) = self.from {
            let node = session.client.status().await?;
            if from > node.height {
                output.note(&format!("the last block is {}: waiting for block {from}", node.height));
            } else if from > 0 && from < node.first_height {
                output.note(&format!("this node keeps no blocks before {}", node.first_height));
            }
        }
        let mut senders = Senders::new(&session);
        let mut left = self.count.unwrap_or(u64::MAX);
        loop {
            let delivery = stream.next().await?;
            for event in &delivery.events {
                for message in messages(&delivery, event, &mut senders)? {
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
fn messages(
    delivery: &v1::Delivery,
    event: &v1::EventRecord,
    senders: &mut Senders<'_>,
) -> Result<Vec<Message>, Rejection> {
    let details: MessageEvent = answer::parse(&event.payload, "an event of messages")?;
    let transaction = Transaction::decode(event.transaction.clone())?;
    let sender = senders.check(&transaction, &event.certificate)?;
    let body = transaction.body();
    // A chaincode of the user's own may publish on behalf of its caller; then its arguments are not ours to read.
    let is_set = body.chaincode == ABAC && body.function == "set";
    let payloads = body.args.iter().skip(ARGS_BEFORE_PAYLOADS).filter(|_| is_set);
    Ok((details.first_seq..)
        .zip(payloads)
        .map(|(seq, payload)| Message {
            height: delivery.height,
            time: delivery.time,
            index: event.index,
            service: event.subject.clone(),
            sender: sender.clone(),
            epoch: details.epoch,
            seq,
            payload: hex::encode(payload),
            transaction: transaction.id(),
        })
        .collect())
}

/// Who signs: names that certificates carry, checked against the organisations of our context.
struct Senders<'a> {
    session: &'a Session,
    known: HashMap<Hash, Identity>,
}

impl<'a> Senders<'a> {
    fn new(session: &'a Session) -> Self {
        Self { session, known: HashMap::new() }
    }

    /// Checks the signature and names the signer. A stream shows each certificate once, with the first message.
    fn check(&mut self, transaction: &Transaction, certificate: &[u8]) -> Result<String, Rejection> {
        let creator = transaction.creator();
        if Hash::of(&[certificate]) == creator && !self.known.contains_key(&creator) {
            let identity = context::verified(self.session.context(), certificate)?;
            self.known.insert(creator, identity);
        }
        let signer = self.known.get(&creator).ok_or_else(|| {
            Rejection::new(Code::UnknownCreator, format!("nobody knows who signed transaction {}", transaction.id()))
                .found(format!("no certificate with fingerprint {creator}"))
                .wanted("the certificate with the first message of a sender")
                .next("the node left it out: ask another node")
        })?;
        transaction.verify(&signer.public_key)?;
        Ok(signer.id())
    }
}
