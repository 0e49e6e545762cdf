//! The certificates that nodes have recorded: only those whom the ledger knows by name are passed a service.

use super::{Model, Person, Verdict};
use ledger_base::rejection::Code;
use ledger_identity::Role;
use serde::Deserialize;
use std::collections::BTreeSet;

/// The nodes that may record, and the certificates that they recorded.
#[derive(Clone, Default)]
pub(super) struct Enrolled {
    /// Nodes and the organisations whose CAs they carry. A node that was removed carries none.
    carriers: Vec<(String, String)>,
    /// Indexes among the people, in the order in which they were recorded.
    recorded: Vec<usize>,
}

#[derive(Deserialize)]
struct Carry {
    organisation: String,
}

#[derive(Deserialize)]
struct Record {
    organisation: String,
    certificate: String,
}

impl Model {
    pub(super) fn carry(&mut self, who: &Person, argument: &str) -> Verdict {
        let Carry { organisation } = serde_json::from_str(argument).map_err(|_| Code::BadArgument)?;
        if who.identity.role != Role::Node {
            return Err(Code::WrongRole);
        }
        if !self.network_of_nodes.present(&who.id()) {
            return Err(Code::NotAMember);
        }
        self.enrolled.carriers.push((who.id(), organisation));
        Ok(Code::Ok.into())
    }

    pub(super) fn record(&mut self, who: &Person, argument: &str) -> Verdict {
        let Record { organisation, certificate } = serde_json::from_str(argument).map_err(|_| Code::BadArgument)?;
        let carries = self.enrolled.carriers.contains(&(who.id(), organisation));
        if !carries || !self.network_of_nodes.present(&who.id()) {
            return Err(Code::NotAdmin);
        }
        let all = &self.people.all;
        let at = all.iter().position(|person| hex::encode(&person.certificate) == certificate);
        let at = at.ok_or(Code::BadArgument)?;
        if !self.enrolled.recorded.contains(&at) {
            self.enrolled.recorded.push(at);
        } else if self.is_revoked_now(at) {
            return Err(Code::EnrolmentRefused);
        }
        Ok(Code::Ok.into())
    }

    /// Everybody with a certificate that counts.
    pub(super) fn certified(&self, time: u64) -> impl Iterator<Item = &Person> {
        let recorded = self.enrolled.recorded.iter().filter_map(|at| self.people.all.get(*at));
        let names: BTreeSet<String> = recorded.map(Person::id).collect();
        names.into_iter().filter_map(move |name| self.people.all.get(self.newest_of(&name, time)?))
    }

    /// The newest certificate of a name that counts.
    pub(super) fn newest_of(&self, name: &str, time: u64) -> Option<usize> {
        let counts = |person: &Person| person.id() == name && person.identity.not_after >= time;
        let recorded = self.enrolled.recorded.iter().rev();
        recorded.copied().find(|at| self.people.all.get(*at).is_some_and(counts) && !self.is_revoked_now(*at))
    }
}
