//! The members of the network: the node records on the ledger, and their part in the ordering.

use ledger::members::Membership;
use ledger::msp::{self, NodeRecord, NodeRole};
use ledger::{Ledger, Outcome};
use ledger_raft::Desired;
use ledger_replica::Observer;
use ledger_storage::result::BlockKind;
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::watch;

/// A node's part in the ordering.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// It orders.
    Voter,
    /// It only follows.
    Learner,
}

/// A node of the network, as the others need to know it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Member {
    /// Its number in the ordering protocol.
    pub id: u64,
    /// Common name of its certificate.
    pub name: String,
    /// Its organisation.
    pub organisation: String,
    /// `HOST:PORT`.
    pub address: String,
    /// The part that the ledger wants for it; none if it shall leave.
    pub wanted: Option<Part>,
    /// Its part; none if it is not in the ordering (yet).
    pub actual: Option<Part>,
}

impl Member {
    /// The name that people see: `Org1/node1`.
    pub(crate) fn full_name(&self) -> String {
        match self.organisation.is_empty() {
            // Known by its address only.
            true => self.name.clone(),
            false => format!("{}/{}", self.organisation, self.name),
        }
    }

    /// Its part, for people: `voter`, `learner`, or how it is changing.
    pub(crate) fn role(&self) -> &'static str {
        match (self.actual, self.wanted) {
            (None, Some(_)) => "joining",
            (_, None) => "leaving",
            (Some(Part::Voter), Some(_)) => "voter",
            (Some(Part::Learner), Some(_)) => "learner",
        }
    }

    /// It orders.
    pub(crate) fn votes(&self) -> bool {
        self.actual == Some(Part::Voter)
    }
}

/// The members of the network now. Follows the ledger.
pub(crate) struct Directory {
    members: watch::Sender<Arc<[Member]>>,
    /// The members that the ledger wants.
    desired: Mutex<Desired>,
    /// One reading at a time, so that an older one never replaces a newer one.
    reading: Mutex<()>,
}

impl Directory {
    /// The members as of the ledger's tip.
    pub(crate) fn read(ledger: &Ledger) -> Self {
        let (desired, reading) = Default::default();
        let directory = Self { members: watch::Sender::new(Arc::from([])), desired, reading };
        directory.refresh(ledger);
        directory
    }

    fn refresh(&self, ledger: &Ledger) {
        let _one = self.reading.lock().unwrap_or_else(PoisonError::into_inner);
        let actual = ledger.members().unwrap_or_else(|fault| {
            tracing::error!(code = fault.code.name(), reason = %fault, "cannot read the members of the network");
            Membership::default()
        });
        let records = msp::nodes(&**ledger.state()).unwrap_or_else(|fault| {
            tracing::error!(code = fault.code.name(), reason = %fault, "cannot read the target roles of the nodes");
            Vec::new()
        });
        match Desired::read(&**ledger.state()) {
            Ok(desired) => *self.desired.lock().unwrap_or_else(PoisonError::into_inner) = desired,
            Err(fault) => {
                tracing::error!(code = fault.code.name(), reason = %fault, "cannot read the target members of the \
                                                                            network")
            }
        }
        let mut members: Vec<Member> = records
            .into_iter()
            .map(|NodeRecord { id, name, organisation, address, role, .. }| {
                let wanted = match role {
                    NodeRole::Voter => Some(Part::Voter),
                    NodeRole::Learner => Some(Part::Learner),
                    NodeRole::Removed => None,
                };
                Member { id, name, organisation, address, wanted, actual: part(&actual, id) }
            })
            // Who was removed belongs here until the ordering has let it go.
            .filter(|member| member.wanted.is_some() || member.actual.is_some())
            .collect();
        // A node that lost its disk is here twice for a while: whoever looks for its name finds the new one first.
        members.sort_by_key(|member| (member.wanted.is_none(), member.id));
        let members: Arc<[Member]> = members.into();
        self.members.send_if_modified(|known| {
            let changed = **known != *members;
            *known = members;
            changed
        });
    }

    /// The members now, in order of their ids; those that leave come last.
    pub(crate) fn members(&self) -> Arc<[Member]> {
        Arc::clone(&self.members.borrow())
    }

    /// A node for people: `Org1/node1`, or its number if nothing else is known.
    pub(crate) fn name(&self, id: u64) -> String {
        let members = self.members();
        members.iter().find(|member| member.id == id).map_or_else(|| format!("node {id}"), Member::full_name)
    }

    /// Several nodes for people.
    pub(crate) fn names<'a>(&self, ids: impl IntoIterator<Item = &'a u64>) -> String {
        ids.into_iter().map(|id| self.name(*id)).collect::<Vec<_>>().join(", ")
    }

    /// The members that the ledger wants.
    pub(crate) fn desired(&self) -> Desired {
        self.desired.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The members as they change.
    pub(crate) fn subscribe(&self) -> watch::Receiver<Arc<[Member]>> {
        self.members.subscribe()
    }
}

impl Observer for Directory {
    /// A block may have changed who belongs here.
    fn executed(&self, outcome: &Arc<Outcome>, ledger: &Ledger) {
        let governed = || {
            let events = outcome.events.iter().map(|emitted| &emitted.event);
            events.filter(|event| event.name != "attested").any(|event| event.chaincode == msp::NAME)
        };
        if outcome.kind == BlockKind::Membership || governed() {
            self.refresh(ledger);
        }
    }
}

fn part(actual: &Membership, id: u64) -> Option<Part> {
    match (actual.is_voter(id), actual.contains(id)) {
        (true, _) => Some(Part::Voter),
        (false, true) => Some(Part::Learner),
        (false, false) => None,
    }
}
