//! Steps the participant of a domain under a lock, and carries out its outputs.
//!
//! Any thread steps the participant under the lock: that of a writer with its sample, that of the task with datagrams and time. So a
//! sample leaves on the thread that writes it, its number is known when `write` returns, and no command waits in a channel. A step
//! never blocks: sockets that have no room let datagrams wait.

use super::matches::Matches;
use super::queue::SampleSender;
use super::reports::Reports;
use super::send::Senders;
use super::timer::{Timer, now};
use crate::guid::{EntityId, Guid, SequenceNumber};
use crate::interface::{
    Counters, Input, LossReason, OutgoingSample, Output, RemoteEndpoint, UnreachableParticipant, WriterLosses,
};
use crate::participant::Participant;
use bytes::Bytes;
use std::collections::BTreeMap;
use std::net::SocketAddrV4;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use tokio::sync::watch;

/// The domain has ended: by [`Domain::end`](super::Domain::end), or with the runtime of its task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the DDS domain has ended")]
pub struct Ended;

/// The participant of a domain. It leaves the domain when the last handle drops it.
#[derive(Debug)]
pub(super) struct Membership {
    /// None after the end.
    state: Mutex<Option<State>>,
    timer: Arc<Timer>,
    guid: Guid,
    changes: watch::Receiver<u64>,
}

/// The reports of an own endpoint to its handle.
#[derive(Debug)]
pub(super) struct Endpoint {
    pub(super) topic: String,
    pub(super) matches: watch::Sender<Matches>,
    pub(super) role: Role,
}

#[derive(Debug)]
pub(super) enum Role {
    Reader(SampleSender),
    /// Have all reliable readers everything?
    Writer(watch::Sender<bool>),
}

#[derive(Debug)]
struct State {
    participant: Participant,
    senders: Senders,
    endpoints: BTreeMap<EntityId, Endpoint>,
    discovered: BTreeMap<Guid, Arc<RemoteEndpoint>>,
    /// How often `discovered` has changed.
    changes: watch::Sender<u64>,
    timer: Arc<Timer>,
    /// When the timer fires next: not later than the deadline of the participant.
    alarm: Option<u64>,
    /// Empty between steps: its memory is used again.
    outputs: Vec<Output>,
    reports: Reports<Kind>,
    /// The counters of the participant when they were looked at last.
    counters: Counters,
}

/// Kinds of events that are logged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    Lost(LossReason),
    Resynchronized,
    DeadlineMissed,
    PushedOut,
    Malformed,
    BeyondLimits,
    Unreachable,
}

/// The answer to a command.
#[derive(Debug, Default)]
struct Answer {
    opened: Option<EntityId>,
    written: Option<SequenceNumber>,
    /// Have endpoints of others come, changed or gone?
    has_discovered: bool,
}

impl Membership {
    pub(super) fn new(participant: Participant, senders: Senders, timer: Arc<Timer>) -> Self {
        let (changes, changes_receiver) = watch::channel(0);
        let guid = participant.guid();
        let state = State {
            participant,
            senders,
            endpoints: BTreeMap::new(),
            discovered: BTreeMap::new(),
            changes,
            timer: Arc::clone(&timer),
            alarm: None,
            outputs: Vec::new(),
            reports: Reports::default(),
            counters: Counters::default(),
        };
        Self { state: Mutex::new(Some(state)), timer, guid, changes: changes_receiver }
    }

    pub(super) fn guid(&self) -> Guid {
        self.guid
    }

    /// Takes a datagram.
    pub(super) fn receive(&self, datagram: Input) -> Result<(), Ended> {
        self.with(|state| state.step(datagram, None)).map(drop).ok_or(Ended)
    }

    /// The timer has fired.
    pub(super) fn fired(&self) -> Result<(), Ended> {
        self.with(|state| {
            state.alarm = None;
            state.step(Input::Time, None)
        })
        .map(drop)
        .ok_or(Ended)
    }

    /// Opens an own endpoint by this command.
    pub(super) fn open(&self, command: Input, endpoint: Endpoint) -> Result<EntityId, Ended> {
        self.with(|state| state.step(command, Some(endpoint)).opened).flatten().ok_or(Ended)
    }

    pub(super) fn close(&self, entity: EntityId) {
        self.with(|state| {
            state.step(Input::Close(entity), None);
            state.endpoints.remove(&entity);
            state.reports.forget(entity);
        });
    }

    pub(super) fn write(&self, writer: EntityId, sample: OutgoingSample) -> Result<SequenceNumber, Ended> {
        let written = self.with(|state| {
            // Before the step, which may say at once that they have it.
            if let Some(Endpoint { role: Role::Writer(is_acknowledged), .. }) = state.endpoints.get(&writer) {
                is_acknowledged.send_replace(false);
            }
            let before = state.participant.writer_losses(writer);
            let written = state.step(Input::Write { writer, sample }, None).written;
            state.report_pushed_out(writer, before);
            written
        });
        written.flatten().ok_or(Ended)
    }

    /// Bytes of samples that this own writer keeps and not all reliable readers have.
    pub(super) fn unacknowledged_bytes(&self, writer: EntityId) -> usize {
        self.with(|state| state.participant.unacknowledged_bytes(writer)).unwrap_or_default()
    }

    /// Samples that this own writer has dropped too early; none after the end.
    pub(super) fn writer_losses(&self, writer: EntityId) -> WriterLosses {
        self.with(|state| state.participant.writer_losses(writer)).flatten().unwrap_or_default()
    }

    pub(super) fn assert_liveliness(&self, writer: EntityId) -> Result<(), Ended> {
        self.with(|state| state.step(Input::AssertLiveliness(writer), None)).map(drop).ok_or(Ended)
    }

    /// Counts of what was rejected and ignored so far.
    pub(super) fn counters(&self) -> Result<Counters, Ended> {
        self.with(|state| state.participant.counters()).ok_or(Ended)
    }

    /// The endpoints of other participants that `select` selects; none after the end.
    pub(super) fn discovered(&self, select: impl Fn(&RemoteEndpoint) -> bool) -> Vec<Arc<RemoteEndpoint>> {
        let all = self.with(|state| state.discovered.values().filter(|endpoint| select(endpoint)).cloned().collect());
        all.unwrap_or_default()
    }

    /// The other participants that cannot be reached; none after the end.
    pub(super) fn unreachable(&self) -> Vec<UnreachableParticipant> {
        self.with(|state| state.participant.unreachable().collect()).unwrap_or_default()
    }

    /// An endpoint of another participant.
    pub(super) fn endpoint(&self, guid: Guid) -> Option<Arc<RemoteEndpoint>> {
        self.with(|state| state.discovered.get(&guid).cloned()).flatten()
    }

    /// How often endpoints of other participants have changed. Closed after the end.
    pub(super) fn changes(&self) -> watch::Receiver<u64> {
        self.changes.clone()
    }

    /// How many datagrams were not sent so far.
    pub(super) fn unsent(&self) -> Result<u64, Ended> {
        self.with(|state| state.senders.dropped()).ok_or(Ended)
    }

    /// Sends what waits for room; wakes the task when there is some.
    pub(super) fn poll_flush(&self, context: &mut Context<'_>) -> Poll<()> {
        self.with(|state| state.senders.poll_flush(context)).unwrap_or(Poll::Ready(()))
    }

    pub(super) fn is_ended(&self) -> bool {
        self.lock().is_none()
    }

    /// Ends the domain. Others are not notified; all handles report it.
    pub(super) fn end(&self) {
        *self.lock() = None;
        // Wakes the task.
        self.timer.set(0);
    }

    /// None after the end.
    fn with<T>(&self, act: impl FnOnce(&mut State) -> T) -> Option<T> {
        self.lock().as_mut().map(act)
    }

    fn lock(&self) -> MutexGuard<'_, Option<State>> {
        self.state.lock().unwrap_or_else(|poisoned| {
            // A panic has left the state in the middle of a step.
            let mut state = PoisonError::into_inner(poisoned);
            *state = None;
            state
        })
    }
}

impl Drop for Membership {
    fn drop(&mut self) {
        self.with(|state| state.step(Input::Leave, None));
        self.end();
    }
}

impl State {
    /// `opening`: the endpoint that the command opens.
    fn step(&mut self, input: Input, mut opening: Option<Endpoint>) -> Answer {
        let mut answer = Answer::default();
        let mut outputs = std::mem::take(&mut self.outputs);
        self.participant.step(now(), input, &mut outputs);
        for output in outputs.drain(..) {
            self.carry_out(output, &mut opening, &mut answer);
        }
        self.outputs = outputs;
        self.report_counters();
        if answer.has_discovered {
            self.changes.send_modify(|changes| *changes = changes.wrapping_add(1));
        }
        if let Some(deadline) = self.participant.deadline() {
            self.wake_at(deadline);
        }
        answer
    }

    fn carry_out(&mut self, output: Output, opening: &mut Option<Endpoint>, answer: &mut Answer) {
        match output {
            Output::Send { to, bytes } => self.send(&to, &bytes),
            Output::Opened(entity) => {
                answer.opened = Some(entity);
                self.endpoints.extend(opening.take().map(|endpoint| (entity, endpoint)));
            }
            Output::Written { sequence, .. } => answer.written = Some(sequence),
            Output::Sample { reader, sample } => {
                if let Some(Role::Reader(queue)) = self.role(reader) {
                    queue.push(sample);
                }
            }
            Output::Lost { reader, writer, count, reason } => {
                if let Some(Role::Reader(queue)) = self.role(reader) {
                    queue.lost(count, reason);
                }
                self.report_lost(reader, writer, count, reason);
            }
            Output::Resynchronized { reader, writer } => {
                if let Some(Role::Reader(queue)) = self.role(reader) {
                    queue.count(|counters| counters.resynchronized += 1);
                }
                if let Some(times) = self.admit(reader, Kind::Resynchronized, 1) {
                    let topic = self.topic(reader);
                    tracing::warn!(topic, %writer, times, "the numbers of a writer began again, or others were sent in its name");
                }
            }
            Output::DeadlineMissed { reader, count } => {
                if let Some(Role::Reader(queue)) = self.role(reader) {
                    queue.count(|counters| {
                        counters.deadlines_missed = counters.deadlines_missed.saturating_add(count);
                    });
                }
                if let Some(missed) = self.admit(reader, Kind::DeadlineMissed, count) {
                    tracing::warn!(topic = self.topic(reader), missed, "no sample came within the deadline");
                }
            }
            Output::Liveliness { reader, writer, is_alive } => {
                self.change_matches(reader, |matches| matches.set_alive(writer, is_alive));
            }
            Output::Acknowledged(writer) => {
                if let Some(Role::Writer(is_acknowledged)) = self.role(writer) {
                    is_acknowledged.send_replace(true);
                }
            }
            Output::Matched { endpoint, other } => self.change_matches(endpoint, |matches| matches.add(other)),
            Output::Unmatched { endpoint, other } => self.change_matches(endpoint, |matches| matches.remove(other)),
            Output::Incompatible { endpoint, other, policy } => {
                self.change_matches(endpoint, |matches| matches.reject(other, policy));
            }
            Output::Unreachable(participant) => {
                answer.has_discovered = true;
                self.report_unreachable(participant);
            }
            Output::NotUnreachable(_) => answer.has_discovered = true,
            Output::Found(endpoint) => {
                answer.has_discovered = true;
                self.discovered.insert(endpoint.guid, Arc::from(endpoint));
            }
            Output::Gone(guid) => {
                answer.has_discovered = true;
                self.discovered.remove(&guid);
                for endpoint in self.endpoints.values() {
                    endpoint.matches.send_if_modified(|matches| matches.forget_rejected(guid));
                }
            }
        }
    }

    /// How many events of this kind a log line has to tell of, if one is due.
    fn admit(&mut self, endpoint: EntityId, kind: Kind, count: u64) -> Option<u64> {
        self.reports.admit(now().steady, endpoint, kind, count)
    }

    /// The topic of an own endpoint; of those of discovery there is none.
    fn topic(&self, endpoint: EntityId) -> &str {
        self.endpoints.get(&endpoint).map_or("", |endpoint| &endpoint.topic)
    }

    fn report_lost(&mut self, reader: EntityId, writer: Guid, count: u64, reason: LossReason) {
        let Some(lost) = self.admit(reader, Kind::Lost(reason), count) else { return };
        let (topic, reason, is_usual) = (self.topic(reader), reason.name(), reason.is_best_effort());
        if is_usual {
            tracing::debug!(topic, %writer, lost, reason, "samples did not arrive");
        } else {
            tracing::warn!(topic, %writer, lost, reason, "samples are lost and cannot be repaired");
        }
    }

    /// `before`: the losses of the writer before it has written.
    fn report_pushed_out(&mut self, writer: EntityId, before: Option<WriterLosses>) {
        let pushed_out = |losses: Option<WriterLosses>| losses.unwrap_or_default().pushed_out;
        let lost = pushed_out(self.participant.writer_losses(writer)).saturating_sub(pushed_out(before));
        if lost > 0
            && let Some(lost) = self.admit(writer, Kind::PushedOut, lost)
        {
            tracing::warn!(topic = self.topic(writer), lost, "newer samples pushed out some that not all readers have");
        }
    }

    fn report_unreachable(&mut self, participant: UnreachableParticipant) {
        if let Some(participants) = self.admit(EntityId::PARTICIPANT, Kind::Unreachable, 1) {
            let UnreachableParticipant { guid, host, .. } = participant;
            tracing::warn!(participant = %guid, %host, participants, "a participant cannot be reached: it announces no address of UDP over IPv4");
        }
    }

    fn report_counters(&mut self) {
        let (before, after) = (self.counters, self.participant.counters());
        if before == after {
            return;
        }
        self.counters = after;
        let malformed = after.malformed.saturating_sub(before.malformed);
        if malformed > 0
            && let Some(datagrams) = self.admit(EntityId::PARTICIPANT, Kind::Malformed, malformed)
        {
            tracing::warn!(datagrams, "malformed datagrams were dropped");
        }
        let beyond = after.beyond_limits.saturating_sub(before.beyond_limits);
        if beyond > 0
            && let Some(announcements) = self.admit(EntityId::PARTICIPANT, Kind::BeyondLimits, beyond)
        {
            tracing::warn!(
                announcements,
                "participants or endpoints were ignored: there are too many, or they are too large"
            );
        }
    }

    fn send(&mut self, to: &[SocketAddrV4], datagram: &Bytes) {
        for address in to {
            if self.senders.send(*address, datagram) {
                // The task polls `poll_flush` whenever it is woken.
                self.wake_at(0);
            }
        }
    }

    fn role(&self, entity: EntityId) -> Option<&Role> {
        self.endpoints.get(&entity).map(|endpoint| &endpoint.role)
    }

    fn change_matches(&self, entity: EntityId, change: impl FnOnce(&mut Matches)) {
        if let Some(endpoint) = self.endpoints.get(&entity) {
            endpoint.matches.send_modify(change);
        }
    }

    /// Wakes the task at this moment. An earlier alarm stays: the step that it causes sets the next one. So a deadline that moves
    /// away with every sample costs no system call.
    fn wake_at(&mut self, steady: u64) {
        if self.alarm.is_none_or(|alarm| steady < alarm) {
            self.alarm = Some(steady);
            self.timer.set(steady);
        }
    }
}
