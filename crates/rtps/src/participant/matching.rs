//! Which own endpoints match which of others: the same topic and type, and policies that fit (DDS 1.4 §2.2.3). Whether instances have
//! keys does not count: samples are carried as bytes. Own endpoints do not match each other.

use super::{OwnEndpoint, Participant, Role};
use crate::discovery::LivelinessChange;
use crate::endpoint::Peer;
use crate::guid::{EntityId, Guid};
use crate::interface::{EndpointSettings, Output, RemoteEndpoint};
use crate::qos::Policy;
use crate::time::Now;

/// How an endpoint of others fits an own one of the same topic and type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fit {
    /// Samples go from one to the other.
    Matched,
    /// This policy is in the way.
    Incompatible(Policy),
}

impl Participant {
    /// An own endpoint is new.
    pub(super) fn match_own(&mut self, now: Now, entity: EntityId, out: &mut Vec<Output>) {
        let others: Vec<Guid> = self.discovery.endpoints().map(|other| other.guid).collect();
        for other in others {
            self.match_pair(now, entity, other, out);
        }
    }

    /// An endpoint of others is new, or has changed.
    pub(super) fn match_other(&mut self, now: Now, other: Guid, out: &mut Vec<Output>) {
        let own: Vec<EntityId> = self.own.keys().copied().collect();
        for entity in own {
            self.match_pair(now, entity, other, out);
        }
    }

    fn match_pair(&mut self, now: Now, entity: EntityId, other: Guid, out: &mut Vec<Output>) {
        let Some(own) = self.own.get_mut(&entity) else { return };
        let Some((endpoint, peer)) = self.discovery.endpoint(other) else { return };
        let before = self.matches.get(&other).and_then(|matches| matches.get(&entity)).copied();
        let after = fit(own, endpoint).filter(|_| peer.is_some());
        if before == Some(Fit::Matched) && after != before {
            self.held = self.held.saturating_sub(remove(own, other));
            out.push(Output::Unmatched { endpoint: entity, other });
        }
        match (after, peer) {
            (Some(Fit::Matched), Some(peer)) => {
                if before != after {
                    out.push(Output::Matched { endpoint: entity, other });
                }
                add(own, now, peer);
                if before != after && other.entity.is_writer() && !self.discovery.is_alive(other) {
                    out.push(Output::Liveliness { reader: entity, writer: other, is_alive: false });
                }
            }
            (Some(Fit::Incompatible(policy)), _) if before != after => {
                out.push(Output::Incompatible { endpoint: entity, other, policy });
            }
            _ if before == after => return,
            _ => {}
        }
        self.timers.set(entity, Some(now.steady));
        match after {
            Some(fit) => {
                self.matches.entry(other).or_default().insert(entity, fit);
            }
            None => self.forget_pair(entity, other),
        }
    }

    fn forget_pair(&mut self, entity: EntityId, other: Guid) {
        if let Some(matches) = self.matches.get_mut(&other) {
            matches.remove(&entity);
            if matches.is_empty() {
                self.matches.remove(&other);
            }
        }
    }

    /// An endpoint of others has gone.
    pub(super) fn unmatch_other(&mut self, now: Now, other: Guid, out: &mut Vec<Output>) {
        for (entity, fit) in self.matches.remove(&other).unwrap_or_default() {
            if let Some(own) = self.own.get_mut(&entity).filter(|_| fit == Fit::Matched) {
                self.held = self.held.saturating_sub(remove(own, other));
                self.timers.set(entity, Some(now.steady));
                out.push(Output::Unmatched { endpoint: entity, other });
            }
        }
    }

    /// The liveliness of a writer has changed.
    pub(super) fn report_liveliness(&mut self, change: LivelinessChange, out: &mut Vec<Output>) {
        let LivelinessChange { writer, is_alive } = change;
        let readers = self.matches.get(&writer).into_iter().flatten().filter(|(_, fit)| **fit == Fit::Matched);
        out.extend(readers.map(|(reader, _)| Output::Liveliness { reader: *reader, writer, is_alive }));
    }

    /// An own endpoint has been closed.
    pub(super) fn unmatch_own(&mut self, entity: EntityId) {
        self.matches.retain(|_, matches| {
            matches.remove(&entity);
            !matches.is_empty()
        });
    }
}

/// `None`: they have nothing to do with each other.
fn fit(own: &OwnEndpoint, other: &RemoteEndpoint) -> Option<Fit> {
    let OwnEndpoint { settings: EndpointSettings { topic, qos, .. }, role } = own;
    let is_writer = matches!(role, Role::Writer { .. });
    let is_opposite = is_writer == other.guid.entity.is_reader();
    if !is_opposite || topic.name != other.topic.name || topic.type_name != other.topic.type_name {
        return None;
    }
    let mismatches = if is_writer { qos.mismatches(&other.qos) } else { other.qos.mismatches(qos) };
    Some(mismatches.first().map_or(Fit::Matched, |policy| Fit::Incompatible(*policy)))
}

fn add(own: &mut OwnEndpoint, now: Now, peer: Peer) {
    match &mut own.role {
        Role::Writer { writer, .. } => writer.add_reader(now, peer),
        Role::Reader(reader) => reader.add_writer(now, peer),
    }
}

/// Returns how many bytes of samples that waited are free now.
fn remove(own: &mut OwnEndpoint, other: Guid) -> usize {
    match &mut own.role {
        Role::Writer { writer, .. } => {
            writer.remove_reader(other);
            0
        }
        Role::Reader(reader) => {
            let before = reader.held();
            reader.remove_writer(other);
            before.saturating_sub(reader.held())
        }
    }
}
