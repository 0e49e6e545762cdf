//! Who belongs to the network: the node records on the ledger, and what they come to in the ordering.

use ledger::members::Membership;
use ledger::network::{FoundingNode, Genesis};
use ledger::result::BlockKind;
use ledger::{Ledger, Outcome};
use ledger_raft::Desired;
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::watch;

/// What a node does in the ordering.
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
    /// What the ledger says it shall be; none if it shall leave.
    pub wanted: Option<Part>,
    /// What it is; none if it is not in the ordering (yet).
    pub actual: Option<Part>,
}

impl Member {
    /// The name that people see: `Org1/node1`.
    pub(crate) fn full_name(&self) -> String {
        format!("{}/{}", self.organisation, self.name)
    }

    /// What it is, for people: `voter`, `learner`, or how it is changing.
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

/// Who belongs to the network now. Follows the ledger.
pub(crate) struct Directory {
    founding: Vec<FoundingNode>,
    members: watch::Sender<Arc<[Member]>>,
    /// One reading at a time, so that an older one never replaces a newer one.
    reading: Mutex<()>,
}

impl Directory {
    /// The members as of the ledger's tip.
    pub(crate) fn read(genesis: &Genesis, ledger: &Ledger) -> Self {
        let directory = Self {
            founding: genesis.nodes.clone(),
            members: watch::Sender::new(Arc::from([])),
            reading: Mutex::default(),
        };
        directory.refresh(ledger);
        directory
    }

    /// Takes note of an executed block, which may have changed who belongs here.
    pub(crate) fn observe(&self, outcome: &Outcome, ledger: &Ledger) {
        let governed = || outcome.events.iter().any(|emitted| emitted.event.chaincode == ledger::governance::NAME);
        if outcome.kind == BlockKind::Membership || governed() {
            self.refresh(ledger);
        }
    }

    fn refresh(&self, ledger: &Ledger) {
        let _one = self.reading.lock().unwrap_or_else(PoisonError::into_inner);
        let actual = ledger.members().unwrap_or_else(|fault| {
            tracing::error!(%fault, "cannot read who belongs to the network");
            Membership::default()
        });
        let members: Arc<[Member]> = self
            .founding
            .iter()
            .map(|FoundingNode { id, name, organisation, address, voter }| Member {
                id: *id,
                name: name.clone(),
                organisation: organisation.clone(),
                address: address.clone(),
                wanted: Some(if *voter { Part::Voter } else { Part::Learner }),
                actual: part(&actual, *id),
            })
            .collect();
        self.members.send_if_modified(|known| {
            let changed = **known != *members;
            *known = members;
            changed
        });
    }

    /// The members now, in order of their ids.
    pub(crate) fn members(&self) -> Arc<[Member]> {
        Arc::clone(&self.members.borrow())
    }

    /// The members that the ledger wants.
    pub(crate) fn desired(&self) -> Desired {
        let members = self.members();
        let wanted = |part| members.iter().filter(move |member| member.wanted == Some(part)).map(|member| member.id);
        Desired { voters: wanted(Part::Voter).collect(), learners: wanted(Part::Learner).collect() }
    }

    /// The members as they change.
    pub(crate) fn subscribe(&self) -> watch::Receiver<Arc<[Member]>> {
        self.members.subscribe()
    }
}

fn part(actual: &Membership, id: u64) -> Option<Part> {
    match (actual.is_voter(id), actual.contains(id)) {
        (true, _) => Some(Part::Voter),
        (false, true) => Some(Part::Learner),
        (false, false) => None,
    }
}
