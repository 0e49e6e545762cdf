//! Whole sets of policies, and who must agree to them (docs/policies.md, "Versions" and "Approval rules").

use super::{Judged, Model, Person, Verdict, only_admins};
use crate::policy::Policy;
use ledger_base::rejection::Code;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};

/// How many sets of an organisation the ledger keeps.
const KEPT: u64 = 32;
/// The organisations of the network.
const ORGANISATIONS: usize = 3;
/// So many of them set the rule of the network.
const MAJORITY: usize = 2;

/// The policies of an organisation, by id.
pub(super) type Policies = BTreeMap<String, Policy>;

/// A set that is or was in force.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Set {
    policies: Policies,
    pub(super) rule: Option<Rule>,
}

/// Those that must agree.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Rule {
    /// So many admins of an organisation; of the one whose set it is if none is named.
    Admins(Option<String>, usize),
    /// So many organisations.
    Organisations(usize),
}

/// The rules about sets of all organisations, and the sets themselves.
#[derive(Clone, Default)]
pub(super) struct Governance {
    /// By organisation and number.
    sets: BTreeMap<(String, u64), Set>,
    network: Option<Rule>,
    /// The admins who want a rule of the network, each with the certificate that says so.
    wanted: BTreeMap<String, BTreeMap<String, usize>>,
}

/// The argument of `apply` and `propose`.
#[derive(Deserialize)]
struct Asked {
    policies: Option<Vec<Text>>,
    restores: Option<u64>,
    base: Option<u64>,
    approvals: Option<String>,
    #[serde(default)]
    means_it: bool,
}

#[derive(Deserialize)]
struct Text {
    id: String,
    text: String,
}

/// The argument of `propose` about the rule of the network.
#[derive(Deserialize)]
struct ProposedCall {
    chaincode: String,
    function: String,
    args: Vec<String>,
}

/// A usable draft.
pub(super) struct Draft {
    pub(super) set: Set,
    pub(super) base: u64,
    pub(super) means_it: bool,
    pub(super) is_in_force: bool,
}

impl Rule {
    /// The rule, or none.
    fn read(text: &str) -> Option<Self> {
        let (who, least) = text.split_once(" = ")?;
        let least = least.parse().unwrap_or_else(|_| panic!("the model does not know {text}"));
        Some(match who.strip_prefix("admins of ") {
            Some(organisation) => Self::Admins(Some(organisation.to_owned()), least),
            None if who == "admins" => Self::Admins(None, least),
            None => Self::Organisations(least),
        })
    }

    /// How many more must agree to a set of an organisation.
    fn missing(&self, organisation: &str, agreed: &BTreeSet<String>) -> usize {
        let of = |admin: &String| admin.split('/').next().unwrap_or_default().to_owned();
        match self {
            Self::Admins(named, least) => {
                let of_which = named.as_deref().unwrap_or(organisation);
                least.saturating_sub(agreed.iter().filter(|admin| of(admin) == of_which).count())
            }
            Self::Organisations(least) => {
                let organisations: BTreeSet<String> = agreed.iter().map(of).collect();
                (*least).min(ORGANISATIONS).saturating_sub(organisations.len())
            }
        }
    }
}

impl Governance {
    /// How many approvals the rule of the network and the organisation's own one miss.
    pub(super) fn missing(&self, organisation: &str, own: Option<&Rule>, agreed: &BTreeSet<String>) -> (usize, usize) {
        let missing = |rule: Option<&Rule>| rule.map_or(0, |rule| rule.missing(organisation, agreed));
        (missing(self.network.as_ref()), missing(own))
    }
}

impl Model {
    /// The policies of an organisation that are in force.
    pub(super) fn policies_of(&self, organisation: &str) -> Policies {
        let own = self.policies.iter().filter(|((owner, _), _)| owner == organisation);
        own.map(|((_, id), policy)| (id.clone(), *policy)).collect()
    }

    /// The number of the set in force; 0 before the first one.
    pub(super) fn version(&self, organisation: &str) -> u64 {
        let known = self.governance.sets.keys().filter(|(owner, _)| owner == organisation).map(|(_, number)| *number);
        known.max().unwrap_or(0)
    }

    /// A set that the ledger keeps.
    fn kept(&self, organisation: &str, number: u64) -> Option<Set> {
        let known = self.governance.sets.get(&(organisation.to_owned(), number)).cloned();
        known.filter(|_| number + KEPT > self.version(organisation))
    }

    /// The rule that an organisation has given itself.
    pub(super) fn own_rule(&self, organisation: &str) -> Option<Rule> {
        self.kept(organisation, self.version(organisation)).and_then(|set| set.rule)
    }

    pub(super) fn apply(&mut self, who: &Person, argument: &str, time: u64) -> Verdict {
        only_admins(who)?;
        let organisation = &who.identity.organisation;
        let draft = self.draft(organisation, argument)?;
        self.alone(who)?;
        if draft.is_in_force {
            return Ok(Judged { version: Some(draft.base), ..Code::Ok.into() });
        }
        self.put_in_force(organisation, draft.set, draft.means_it, time)
    }

    /// Reads a set that is to take the place of the one in force.
    pub(super) fn draft(&self, organisation: &str, argument: &str) -> Result<Draft, Code> {
        let Asked { policies, restores, base: seen, approvals, means_it } =
            serde_json::from_str(argument).map_err(|_| Code::BadArgument)?;
        let base = self.version(organisation);
        if seen.is_some_and(|seen| seen != base) {
            return Err(Code::PoliciesChanged);
        }
        let own = self.own_rule(organisation);
        let mut set = match (policies, restores) {
            (Some(texts), None) => {
                let read = |Text { id, text }: Text| {
                    let policy = Policy::read(&id, &text);
                    (id, policy.unwrap_or_else(|| panic!("no policy of the collection: {text}")))
                };
                Set { policies: texts.into_iter().map(read).collect(), rule: own.clone() }
            }
            (None, Some(number)) => self.kept(organisation, number).ok_or(Code::NotFound)?,
            _ => return Err(Code::BadArgument),
        };
        if let Some(text) = approvals {
            set.rule = Rule::read(&text);
        }
        let is_in_force = base > 0 && set == Set { policies: self.policies_of(organisation), rule: own };
        Ok(Draft { set, base, means_it, is_in_force })
    }

    /// May an admin change the policies of the organisation alone?
    pub(super) fn alone(&self, who: &Person) -> Result<(), Code> {
        let organisation = &who.identity.organisation;
        let own = self.own_rule(organisation);
        match self.governance.missing(organisation, own.as_ref(), &BTreeSet::from([who.id()])) {
            (0, 0) => Ok(()),
            _ => Err(Code::NeedsApproval),
        }
    }

    /// A set takes the place of the one in force, unless it makes a robot that nobody may publish to any more.
    pub(super) fn put_in_force(&mut self, organisation: &str, set: Set, means_it: bool, time: u64) -> Verdict {
        let (before, version) = (self.policies_of(organisation), self.version(organisation));
        let unreachable = self.unreachable(organisation, time);
        self.replace_policies(organisation, &set.policies);
        if !means_it && !self.unreachable(organisation, time).is_subset(&unreachable) {
            self.replace_policies(organisation, &before);
            return Err(Code::NobodyMayPublish);
        }
        let sets = &mut self.governance.sets;
        sets.insert((organisation.to_owned(), version + 1), set);
        sets.retain(|(owner, number), _| owner != organisation || number + KEPT > version + 1);
        self.end_unfit(|robot| robot.owner == *organisation, time);
        Ok(Judged { version: Some(version + 1), ..Code::Ok.into() })
    }

    /// Would a set make a robot that nobody may publish to any more?
    pub(super) fn cuts_off(&self, organisation: &str, set: &Set, time: u64) -> bool {
        let mut after = self.clone();
        after.replace_policies(organisation, &set.policies);
        !after.unreachable(organisation, time).is_subset(&self.unreachable(organisation, time))
    }

    fn replace_policies(&mut self, organisation: &str, policies: &Policies) {
        self.policies.retain(|(owner, _), _| owner != organisation);
        let own = policies.iter().map(|(id, policy)| ((organisation.to_owned(), id.clone()), *policy));
        self.policies.extend(own);
    }

    /// An admin wants a rule of the network. It comes into force once enough organisations want the same.
    pub(super) fn propose_rule(&mut self, (who, person): (&Person, usize), argument: &str) -> Verdict {
        let ProposedCall { chaincode, function, args } =
            serde_json::from_str(argument).map_err(|_| Code::BadArgument)?;
        only_admins(who)?;
        assert_eq!((&*chaincode, &*function), ("abac", "set_policy_approvals"), "the model knows no other proposal");
        let text = args.first().and_then(|text| String::from_utf8(hex::decode(text).ok()?).ok()).unwrap_or_default();
        let people = std::sync::Arc::clone(&self.people);
        let mut wanted = self.governance.wanted.remove(&text).unwrap_or_default();
        wanted.insert(who.id(), person);
        wanted.retain(|_, person| !self.is_revoked_now(*person));
        let organisations: BTreeSet<&str> =
            wanted.values().map(|person| &*people.all[*person].identity.organisation).collect();
        if organisations.len() >= MAJORITY {
            self.governance.network = Rule::read(&text);
        } else {
            self.governance.wanted.insert(text, wanted);
        }
        Ok(Code::Ok.into())
    }
}
