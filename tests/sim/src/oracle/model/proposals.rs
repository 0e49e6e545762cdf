//! Proposed sets of policies (docs/policies.md, "Approval rules"). The ledger chooses their names.

use super::sets::Set;
use super::{Agreed, Judged, Model, Person, Verdict, only_admins};
use ledger_base::rejection::Code;
use std::collections::{BTreeMap, BTreeSet};

/// Most proposals of one organisation.
const PROPOSALS_MAX: usize = 8;
/// For how long an approval counts: seven days, in microseconds.
const COUNTS_FOR: u64 = 7 * 24 * 3600 * 1_000_000;
/// After so long one admin needs nobody else, as far as the own rule is concerned: three days.
const ALONE_AFTER: u64 = 3 * 24 * 3600 * 1_000_000;

/// A set that others may have to agree to.
#[derive(Clone, Debug)]
pub(super) struct Proposal {
    organisation: String,
    set: Set,
    /// The number of the set that it replaces.
    base: u64,
    means_it: bool,
    created: u64,
    /// The admins who agree: with which certificate, and until when that counts.
    agree: BTreeMap<String, (usize, u64)>,
}

/// Those that stand, by name. One whose name is not known yet has none.
pub(super) type Proposals = BTreeMap<String, Proposal>;

impl Proposal {
    fn counted(&self, time: u64) -> BTreeSet<String> {
        self.agree.iter().filter(|(_, (_, until))| *until >= time).map(|(who, _)| who.clone()).collect()
    }
}

impl Model {
    pub(super) fn propose(&mut self, (who, person): (&Person, usize), argument: &str, time: u64) -> Verdict {
        only_admins(who)?;
        let organisation = &who.identity.organisation;
        let draft = self.draft(organisation, argument)?;
        if draft.is_in_force {
            return Err(Code::AlreadyExists);
        }
        if !draft.means_it && self.cuts_off(organisation, &draft.set, time) {
            return Err(Code::NobodyMayPublish);
        }
        if self.proposals.values().filter(|other| other.organisation == *organisation).count() >= PROPOSALS_MAX {
            return Err(Code::LimitExceeded);
        }
        let proposal = Proposal {
            organisation: organisation.clone(),
            set: draft.set,
            base: draft.base,
            means_it: draft.means_it,
            created: time,
            agree: BTreeMap::from([(who.id(), (person, time + COUNTS_FOR))]),
        };
        let agreed = self.agreed(&proposal, time);
        self.proposals.insert(String::new(), proposal);
        Ok(Judged { agreed: Some(agreed), ..Code::Ok.into() })
    }

    /// Was a proposal just made, whose name is not known yet?
    pub(in crate::oracle) fn is_unnamed(&self) -> bool {
        self.proposals.contains_key("")
    }

    /// The name that the ledger gave to the proposal that was just made; answers whether no other one has it.
    pub(in crate::oracle) fn named(&mut self, name: &str) -> bool {
        let Some(proposal) = self.proposals.remove("") else { return false };
        self.proposals.insert(name.to_owned(), proposal).is_none()
    }

    pub(super) fn approve(&mut self, (who, person): (&Person, usize), name: &str, time: u64) -> Verdict {
        only_admins(who)?;
        let mut proposal = self.current(name)?;
        proposal.agree.insert(who.id(), (person, time + COUNTS_FOR));
        let agreed = self.agreed(&proposal, time);
        self.proposals.insert(name.to_owned(), proposal);
        Ok(Judged { agreed: Some(agreed), ..Code::Ok.into() })
    }

    pub(super) fn withdraw(&mut self, who: &Person, name: &str, time: u64) -> Verdict {
        only_admins(who)?;
        let mut proposal = self.proposals.get(name).cloned().ok_or(Code::NotFound)?;
        let agreed = proposal.agree.remove(&who.id()).is_some();
        if proposal.organisation == who.identity.organisation {
            self.proposals.remove(name);
        } else if agreed {
            self.proposals.insert(name.to_owned(), proposal.clone());
        } else {
            return Err(Code::NotFound);
        }
        Ok(Judged { agreed: Some(self.agreed(&proposal, time)), ..Code::Ok.into() })
    }

    pub(super) fn enact(&mut self, who: &Person, name: &str, breaks: bool, time: u64) -> Verdict {
        only_admins(who)?;
        let found = self.proposals.get(name).ok_or(Code::NotFound)?;
        if found.organisation != who.identity.organisation {
            return Err(Code::NotOwner);
        }
        let proposal = self.current(name)?;
        let organisation = &proposal.organisation;
        let own = self.own_rule(organisation);
        let (network, own) = self.governance.missing(organisation, own.as_ref(), &proposal.counted(time));
        let needs_own = own > 0 && !(breaks && time >= proposal.created + ALONE_AFTER);
        if network > 0 || needs_own {
            return Err(Code::NeedsApproval);
        }
        let judged = self.put_in_force(organisation, proposal.set.clone(), proposal.means_it, time)?;
        self.proposals.remove(name);
        Ok(judged)
    }

    /// An approval of a revoked certificate does not count any more.
    pub(super) fn approvals_without(&mut self, is_revoked: impl Fn(usize) -> bool) {
        for proposal in self.proposals.values_mut() {
            proposal.agree.retain(|_, (person, _)| !is_revoked(*person));
        }
    }

    /// A proposal that was made from the set in force.
    fn current(&self, name: &str) -> Result<Proposal, Code> {
        let proposal = self.proposals.get(name).cloned().ok_or(Code::NotFound)?;
        if proposal.base == self.version(&proposal.organisation) { Ok(proposal) } else { Err(Code::PoliciesChanged) }
    }

    fn agreed(&self, proposal: &Proposal, time: u64) -> Agreed {
        let (by, own) = (proposal.counted(time), self.own_rule(&proposal.organisation));
        let (network, own) = self.governance.missing(&proposal.organisation, own.as_ref(), &by);
        Agreed { by, missing: network as u64 + own as u64 }
    }
}
