//! The task behind a link: takes what DDS has read, and gives it out when its reply would be heard.

use std::{collections::BTreeMap, time::Instant};

use ledger_gate::sample::{CDR_LE, HEADER_BYTES};
use rtps::{guid::Guid, interface::IncomingSample, io::DomainReader};
use tokio::{sync::mpsc, time::sleep_until};

use super::{
    arrival::{Arrival, Side},
    mapping::named,
    waiting::WaitingRequests,
};
use crate::{
    graph::{
        dds::{
            intake::Intake,
            matched::{Matched, MismatchLog},
            participant::Participant,
        },
        mark::Mark,
    },
    log::LogLimiter,
};

/// Most writers whose mark is remembered; beyond it all are looked up again.
const MARKS_MAX: usize = 256;
/// The change that brings another node together with that.
pub(super) const REMEDY: &str = "services are reliable and volatile, so change the other node";

/// The state of the task behind a link.
pub(super) struct Pump {
    pub(super) topic: String,
    pub(super) of: Side,
    pub(super) intake: Intake,
    pub(super) mismatches: MismatchLog,
    pub(super) matched: Matched,
    pub(super) hearers: Matched,
    pub(super) held: WaitingRequests<Arrival>,
    pub(super) bytes_max: usize,
    pub(super) arrivals: mpsc::Sender<Arrival>,
    pub(super) participant: Participant,
    pub(super) mark: Mark,
    /// The writers that were looked up: are they of a bridge of this network?
    pub(super) bridges: BTreeMap<Guid, bool>,
    pub(super) log_limiter: LogLimiter,
}

impl Pump {
    /// Runs until the link is dropped, or DDS ends.
    pub(super) async fn run(mut self, mut source: DomainReader) {
        let (mut matches, mut hearers) = (source.matches().clone(), self.hearers.clone());
        loop {
            let until = self.held.until();
            tokio::select! {
                // A link that is dropped ends this task; the other task may have ended before.
                Ok(()) = hearers.changed(), if until.is_some() => self.release(),
                () = async { sleep_until(until.unwrap_or_else(Instant::now).into()).await }, if until.is_some() => {
                    self.release();
                }
                sample = source.next() => match sample {
                    Some(sample) => self.take(sample, &source),
                    None => break,
                },
                Ok(()) = matches.changed() => self.mismatches.look(&matches.borrow_and_update()),
            }
        }
        tracing::error!(topic = self.topic, "DDS has ended: nothing is read any more");
    }

    fn take(&mut self, incoming: IncomingSample, source: &DomainReader) {
        let IncomingSample { writer, sequence, related, payload, .. } = incoming;
        if !self.intake.admits(writer, sequence, &source.matches().borrow().endpoints) || self.is_bridge(writer) {
            return;
        }
        if payload.len() > self.bytes_max {
            return self.drop_one("it is larger than sample_bytes_max");
        }
        if !payload.starts_with(&CDR_LE) || payload.len() < HEADER_BYTES {
            return self.drop_one("it is not little endian CDR");
        }
        let arrival = Arrival { message: payload.slice(HEADER_BYTES..), writer, sequence, related };
        if self.of == Side::Client || is_heard(&arrival, &self.matched, &self.hearers) {
            // Earlier ones of the same client go first.
            self.release();
            self.give(arrival);
        } else if let Some(oldest) = self.held.push(arrival, Instant::now()) {
            self.give(oldest);
        }
    }

    /// Gives out what waits no longer.
    fn release(&mut self) {
        let (matched, hearers) = (&self.matched, &self.hearers);
        for arrival in self.held.release(Instant::now(), |arrival| is_heard(arrival, matched, hearers)) {
            self.give(arrival);
        }
    }

    fn give(&mut self, arrival: Arrival) {
        if self.arrivals.try_send(arrival).is_err() {
            self.drop_one("too many wait");
        }
    }

    fn drop_one(&mut self, reason: &'static str) {
        if let Some(not_logged) = self.log_limiter.admit(reason, Instant::now()) {
            tracing::warn!(topic = self.topic, reason, not_logged, "request or reply dropped");
        }
    }

    /// Is it an endpoint of a bridge of this network? Messages from the ledger do not go there again.
    fn is_bridge(&mut self, writer: Guid) -> bool {
        if let Some(known) = self.bridges.get(&writer) {
            return *known;
        }
        if self.bridges.len() >= MARKS_MAX {
            self.bridges.clear();
        }
        let Some(found) = self.participant.dds.endpoint(writer) else { return false };
        let is_bridge = Mark::of(&found.qos).is_some_and(|mark| mark.is_of_network_of(self.mark));
        self.bridges.insert(writer, is_bridge);
        is_bridge
    }
}

/// Would the client of a request hear the reply? Its reader must be known. A request may name the reader. If not, as many
/// readers as writers of its participant must be known: each client has one of both.
fn is_heard(request: &Arrival, matched: &Matched, hearers: &Matched) -> bool {
    if let Some(reader) = named(request.related).filter(|named| named.entity.is_reader()) {
        return hearers.has(reader);
    }
    let participant = request.writer.prefix;
    hearers.of_participant(participant) >= matched.of_participant(participant).max(1)
}
