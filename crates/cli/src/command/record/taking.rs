//! Taking down what a stream of events delivers.

use super::selection::Selection;
use super::summary::{Counts, Ending, Recorded, Service};
use crate::answer;
use crate::command::message::{COMMAND_TTL, KEYED, Opening, Senders, payloads};
use crate::recording::{Channel, Event, Record, Recording};
use crate::session::{ABAC, Session};
use ledger::transaction::Transaction;
use ledger_api::v1;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Grant, MessageEvent};
use std::collections::{BTreeMap, HashSet};
use std::path::Path;

/// A recording, and who is known by now.
pub(super) struct Taking<'a> {
    recording: Recording,
    senders: Senders<'a>,
    opening: Opening<'a>,
    /// By service.
    channels: BTreeMap<String, Open>,
    /// Signers whose certificates are in the file.
    shown: HashSet<Hash>,
    counts: Counts,
}

struct Open {
    channel: Channel,
    topic: String,
    type_name: String,
    /// Is the definition of the type in the file?
    is_defined: bool,
    messages: u64,
}

impl<'a> Taking<'a> {
    /// Begins the file: where its content comes from, and a channel for each service.
    pub(super) fn begin(
        mut recording: Recording,
        (session, opening): (&'a Session, Opening<'a>),
        selection: &Selection,
        node: v1::StatusResponse,
    ) -> Result<Self, Rejection> {
        recording.facts(
            "ledger",
            [
                ("network", hex::encode(&node.network)),
                ("label", node.network_label),
                ("node", format!("{}/{}", node.organisation, node.node_name)),
                ("node_version", node.version),
                ("recorder", session.identity()?.id()),
            ],
        )?;
        let mut channels = BTreeMap::new();
        for chosen in &selection.services {
            let (channel, is_defined) = recording.service(&chosen.service, &chosen.topic)?;
            let (topic, type_name) = (chosen.topic.clone(), chosen.service.type_name.clone());
            let open = Open { channel, topic, type_name, is_defined, messages: 0 };
            channels.insert(chosen.service.service.clone(), open);
        }
        recording.flush()?;
        let senders = Senders::new(session);
        Ok(Self { recording, senders, opening, channels, shown: HashSet::new(), counts: Counts::default() })
    }

    /// The grants that hold when a recording begins.
    pub(super) fn held(&mut self, grants: &[Grant], height: u64, time: u64) -> Result<(), Rejection> {
        for grant in grants {
            let payload = serde_json::to_string(grant).unwrap_or_default();
            self.recording.event(&Event {
                time,
                name: "held",
                subject: &grant.service,
                identity: &grant.holder,
                payload: &payload,
                height,
                index: 0,
                transaction: None,
            })?;
            self.counts.events += 1;
            self.counts.saw(height, time);
        }
        Ok(())
    }

    /// Takes down the events of a block.
    ///
    /// # Errors
    /// [`Code::BadFile`] if the file cannot be written; the fault of a signature or of its certificate.
    pub(super) async fn take(&mut self, delivery: &v1::Delivery) -> Result<(), Rejection> {
        self.counts.height = self.counts.height.max(delivery.height);
        let block = hex::encode(&delivery.block_hash);
        // A transaction with several events comes with the first of them.
        let mut cause: Option<(u32, Transaction, String)> = None;
        for event in &delivery.events {
            if !event.transaction.is_empty() {
                let transaction = Transaction::decode(event.transaction.clone())?;
                let signer = self.signer(&transaction, &event.certificate)?;
                cause = Some((event.index, transaction, signer));
            }
            let cause = cause.as_ref().filter(|(index, ..)| *index == event.index);
            if event.chaincode != ABAC {
                continue;
            }
            if event.name == KEYED {
                self.opening.keyed(delivery.height, event, &mut self.senders)?;
            }
            match (event.name.as_str(), cause) {
                ("message", Some((_, transaction, signer))) => {
                    self.messages((delivery, &block), event, transaction, signer).await?;
                }
                ("message", None) => return Err(without_transaction(delivery.height)),
                (name, cause) => {
                    let payload = String::from_utf8_lossy(&event.payload).replace('\0', " ");
                    self.recording.event(&Event {
                        time: delivery.time,
                        name,
                        subject: &event.subject,
                        identity: cause.map_or("", |(_, _, signer)| signer),
                        payload: &payload,
                        height: delivery.height,
                        index: event.index,
                        transaction: cause.map(|(_, transaction, _)| transaction.id()),
                    })?;
                    self.counts.saw(delivery.height, delivery.time);
                    self.counts.events += 1;
                }
            }
        }
        Ok(())
    }

    /// Checks the signature. The certificate comes into the file with the first transaction of its owner.
    fn signer(&mut self, transaction: &Transaction, certificate: &[u8]) -> Result<String, Rejection> {
        let signer = self.senders.check(transaction, certificate)?;
        let id = signer.id();
        if self.shown.insert(transaction.creator()) {
            let facts = [
                ("identity", id.clone()),
                ("fingerprint", transaction.creator().to_string()),
                ("certificate", hex::encode(certificate)),
            ];
            self.recording.facts("ledger.certificate", facts)?;
        }
        Ok(id)
    }

    async fn messages(
        &mut self,
        (delivery, block): (&v1::Delivery, &str),
        event: &v1::EventRecord,
        transaction: &Transaction,
        signer: &str,
    ) -> Result<(), Rejection> {
        let Some(open) = self.channels.get_mut(&event.subject) else { return Ok(()) };
        let details: MessageEvent = answer::parse(&event.payload, "an event of messages")?;
        let ttl = u64::try_from(COMMAND_TTL.as_micros()).unwrap_or(u64::MAX);
        // As robots reckon it: one that is signed for longer is as old as its block.
        let signed = transaction.body().not_after.saturating_sub(ttl).min(delivery.time);
        let payloads = payloads(transaction.body(), &self.senders.network(), &event.subject, &details)?;
        for (sequence, payload) in (details.first_seq..).zip(payloads) {
            let (place, numbers) = ((event.subject.as_str(), signer), (details.epoch, sequence));
            let Ok(payload) = self.opening.open(place, numbers, payload, &mut self.senders).await? else {
                self.counts.unreadable += 1;
                continue;
            };
            let record = Record {
                time: delivery.time,
                signed,
                topic: &open.topic,
                service: &event.subject,
                identity: signer,
                epoch: details.epoch,
                sequence,
                height: delivery.height,
                block,
                index: event.index,
                transaction: transaction.id(),
            };
            self.recording.message(open.channel, &record, &payload)?;
            open.messages += 1;
            self.counts.messages += 1;
            self.counts.saw(delivery.height, delivery.time);
        }
        Ok(())
    }

    /// Writes what there is, so that it survives the end of this process.
    pub(super) fn flush(&mut self) -> Result<(), Rejection> {
        self.recording.flush()?;
        self.counts.bytes = self.recording.bytes();
        Ok(())
    }

    /// How much there is.
    pub(super) fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Ends the file.
    pub(super) fn end(mut self, path: &Path, ending: Ending) -> Result<Recorded, Rejection> {
        let Counts { first, last, messages, events, .. } = self.counts;
        self.recording.facts(
            "ledger.range",
            [
                ("first_height", first.0.to_string()),
                ("last_height", last.0.to_string()),
                ("first_time", first.1.to_string()),
                ("last_time", last.1.to_string()),
                ("messages", messages.to_string()),
                ("events", events.to_string()),
                ("ended", ending.name().to_owned()),
            ],
        )?;
        let services = self.channels.into_iter().map(|(service, open)| Service {
            service,
            topic: open.topic,
            type_name: open.type_name,
            is_defined: open.is_defined,
            messages: open.messages,
        });
        let services = services.collect();
        self.counts.bytes = self.recording.finish()?;
        Ok(Recorded::new(path, services, &self.counts, ending))
    }
}

fn without_transaction(height: u64) -> Rejection {
    Rejection::new(Code::Malformed, format!("a message of block {height} came without its transaction"))
        .found("no bytes of a transaction")
        .wanted("the transaction that its sender signed")
        .next("the node left it out: ask another node")
}
