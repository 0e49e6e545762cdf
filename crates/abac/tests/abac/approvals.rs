//! Approvals of sets of policies: any sequence of calls ends as a small model says.

use crate::fleet::{Fleet, SECOND, bytes, identity};
use bytes::Bytes;
use ledger_abac::{PolicyDraft, PolicyProposal, PolicySet, PolicyText};
use ledger_base::rejection::Code;
use ledger_identity::{Identity, Role};
use proptest::prelude::*;
use std::collections::BTreeMap;

const HOUR: u64 = 3600 * SECOND;
/// The admins: two of Org1, three of Org2.
const ADMINS: [(&str, &str); 5] = [("Org1", "a"), ("Org1", "b"), ("Org2", "a"), ("Org2", "b"), ("Org2", "c")];
const RULES: [Option<&str>; 4] = [None, Some("admins = 2"), Some("organisations = 2"), Some("admins of Org1 = 2")];

/// A set as the model knows it: number of its text, and number of the rule.
type Content = (usize, usize);

#[derive(Clone, Debug)]
enum Step {
    Apply {
        who: usize,
        content: Content,
    },
    Propose {
        who: usize,
        content: Content,
    },
    Approve {
        who: usize,
        which: usize,
    },
    Withdraw {
        who: usize,
        which: usize,
    },
    Enact {
        who: usize,
        which: usize,
        breaks: bool,
    },
    Network {
        rule: usize,
    },
    Wait {
        hours: u64,
    },
    /// The certificate of an admin is revoked, and it receives another one.
    Revoke {
        who: usize,
    },
}

fn step() -> impl Strategy<Value = Step> {
    let who = || 0..ADMINS.len();
    let content = || (0..3_usize, 0..RULES.len());
    // A number far back among the proposals names one that has ended, or none.
    let which = || 0..12_usize;
    prop_oneof![
        2 => (who(), content()).prop_map(|(who, content)| Step::Apply { who, content }),
        6 => (who(), content()).prop_map(|(who, content)| Step::Propose { who, content }),
        8 => (who(), which()).prop_map(|(who, which)| Step::Approve { who, which }),
        1 => (who(), which()).prop_map(|(who, which)| Step::Withdraw { who, which }),
        6 => (who(), which(), any::<bool>()).prop_map(|(who, which, breaks)| Step::Enact { who, which, breaks }),
        1 => (0..RULES.len()).prop_map(|rule| Step::Network { rule }),
        2 => (1..60_u64).prop_map(|hours| Step::Wait { hours }),
        1 => who().prop_map(|who| Step::Revoke { who }),
    ]
}

#[derive(Clone)]
struct Proposal {
    organisation: &'static str,
    base: u64,
    content: Content,
    created: u64,
    /// Until when each admin's approval counts.
    approved: BTreeMap<usize, u64>,
}

struct Model {
    fleet: Fleet,
    serials: [u8; ADMINS.len()],
    network: usize,
    /// Number and content of the set in force.
    sets: BTreeMap<&'static str, (u64, Content)>,
    /// In the order in which they were made, with their ids; none once it has ended.
    proposals: Vec<(String, Option<Proposal>)>,
}

/// The text of a set, by its number; `usize::MAX` is the built-in policy.
fn policies(text: usize) -> Vec<PolicyText> {
    vec![PolicyText { id: "all".into(), text: format!("// {text}\npermit (principal, action, resource);") }]
}

/// The beginning: no policy of one's own, and no rule.
const BUILT_IN: Content = (usize::MAX, 0);

impl Model {
    fn new() -> Self {
        let sets = BTreeMap::from([("Org1", (0, BUILT_IN)), ("Org2", (0, BUILT_IN))]);
        Self { fleet: Fleet::of_the_paper(), serials: [50, 90, 130, 170, 210], network: 0, sets, proposals: vec![] }
    }

    fn admin(&self, who: usize) -> Identity {
        let (organisation, name) = ADMINS[who];
        identity(organisation, name, Role::Admin, &[], self.serials[who])
    }

    /// The time of the next block.
    fn now(&self) -> u64 {
        self.fleet.time + 1000
    }

    fn missing(rule: usize, organisation: &str, agreed: &[usize]) -> usize {
        let of = |organisation: &str| agreed.iter().filter(|who| ADMINS[**who].0 == organisation).count();
        let (wanted, found): (usize, usize) = match rule {
            0 => (0, 0),
            1 => (2, of(organisation)),
            2 => (2, ["Org1", "Org2"].iter().filter(|organisation| of(organisation) > 0).count()),
            _ => (2, of("Org1")),
        };
        wanted.saturating_sub(found)
    }

    fn draft(&self, (text, rule): Content) -> String {
        let draft = PolicyDraft {
            policies: Some(policies(text)),
            approvals: Some(RULES[rule].unwrap_or("none").to_owned()),
            ..PolicyDraft::default()
        };
        serde_json::to_string(&draft).unwrap()
    }

    fn call(&mut self, who: usize, args: &[&str]) -> Result<Bytes, Code> {
        let admin = self.admin(who);
        self.fleet.call(&admin, "policy", &bytes(args)).map_err(|refused| refused.code)
    }

    /// The proposal that stands at this place, counted from the newest one.
    fn find(&self, which: usize) -> Option<(usize, String, Option<Proposal>)> {
        let at = self.proposals.len().checked_sub(which + 1)?;
        let (id, proposal) = &self.proposals[at];
        Some((at, id.clone(), proposal.clone()))
    }

    fn play(&mut self, step: &Step) {
        match *step {
            Step::Wait { hours } => self.fleet.time += hours * HOUR,
            Step::Network { rule } => {
                self.fleet.approved("set_policy_approvals", &[RULES[rule].unwrap_or("none")]);
                self.network = rule;
            }
            Step::Revoke { who } => {
                let admin = self.admin(who);
                self.fleet.revoke(&admin);
                self.serials[who] += 1;
                for proposal in self.proposals.iter_mut().filter_map(|(_, proposal)| proposal.as_mut()) {
                    proposal.approved.remove(&who);
                }
            }
            Step::Apply { who, content } => self.apply(who, content),
            Step::Propose { who, content } => self.propose(who, content),
            Step::Approve { who, which } => self.approve(who, which),
            Step::Withdraw { who, which } => self.withdraw(who, which),
            Step::Enact { who, which, breaks } => self.enact(who, which, breaks),
        }
    }

    fn apply(&mut self, who: usize, content: Content) {
        let organisation = ADMINS[who].0;
        let (version, (_, rule)) = self.sets[organisation];
        let alone = [rule, self.network].iter().all(|rule| Self::missing(*rule, organisation, &[who]) == 0);
        let draft = self.draft(content);
        let done = self.call(who, &["apply", &draft]);
        assert_eq!(done.as_ref().err(), (!alone).then_some(&Code::NeedsApproval), "{content:?}");
        if alone && self.sets[organisation] != (version, content) {
            self.sets.insert(organisation, (version + 1, content));
        }
    }

    fn propose(&mut self, who: usize, content: Content) {
        let (organisation, now) = (ADMINS[who].0, self.now());
        let (base, in_force) = self.sets[organisation];
        let own = self.proposals.iter().filter_map(|(_, proposal)| proposal.as_ref());
        let wanted = if in_force == content {
            Some(Code::AlreadyExists)
        } else {
            (own.filter(|proposal| proposal.organisation == organisation).count() >= 8).then_some(Code::LimitExceeded)
        };
        // Without ids of transactions, proposals of one content would have one name.
        self.fleet.transaction = ledger_base::hash::Hash::of(&[&now.to_be_bytes()]);
        let draft = self.draft(content);
        let done = self.call(who, &["propose", &draft]);
        self.fleet.transaction = ledger_base::hash::Hash::ZERO;
        assert_eq!(done.as_ref().err().copied(), wanted, "{content:?}");
        if let Ok(answer) = done {
            let told: PolicyProposal = serde_json::from_slice(&answer).unwrap();
            let approved = BTreeMap::from([(who, now + 7 * 24 * HOUR)]);
            self.proposals.push((told.id, Some(Proposal { organisation, base, content, created: now, approved })));
        }
    }

    fn approve(&mut self, who: usize, which: usize) {
        let Some((at, id, proposal)) = self.find(which) else { return };
        let now = self.now();
        let done = self.call(who, &["approve", &id]);
        let Some(mut proposal) = proposal else { return assert_eq!(done, Err(Code::NotFound)) };
        if proposal.base != self.sets[proposal.organisation].0 {
            return assert_eq!(done, Err(Code::PoliciesChanged));
        }
        proposal.approved.retain(|_, until| now <= *until);
        proposal.approved.insert(who, now + 7 * 24 * HOUR);
        let told: PolicyProposal = serde_json::from_slice(&done.unwrap()).unwrap();
        assert_eq!(told.approved.len(), proposal.approved.len());
        self.proposals[at].1 = Some(proposal);
    }

    fn withdraw(&mut self, who: usize, which: usize) {
        let Some((at, id, proposal)) = self.find(which) else { return };
        let done = self.call(who, &["withdraw", &id]);
        let Some(mut proposal) = proposal else { return assert_eq!(done, Err(Code::NotFound)) };
        if proposal.organisation == ADMINS[who].0 {
            assert!(done.is_ok());
            self.proposals[at].1 = None;
        } else if proposal.approved.remove(&who).is_some() {
            assert!(done.is_ok());
            self.proposals[at].1 = Some(proposal);
        } else {
            assert_eq!(done, Err(Code::NotFound));
        }
    }

    fn enact(&mut self, who: usize, which: usize, breaks: bool) {
        let Some((at, id, proposal)) = self.find(which) else { return };
        let now = self.now();
        let done =
            if breaks { self.call(who, &["enact", &id, "break-glass"]) } else { self.call(who, &["enact", &id]) };
        let Some(proposal) = proposal else { return assert_eq!(done, Err(Code::NotFound)) };
        let organisation = proposal.organisation;
        let (version, (_, rule)) = self.sets[organisation];
        let counted = proposal.approved.iter().filter(|(_, until)| now <= **until);
        let agreed: Vec<usize> = counted.map(|(who, _)| *who).collect();
        let lacks = |rule| Self::missing(rule, organisation, &agreed) > 0;
        let glass = breaks && now >= proposal.created + 72 * HOUR;
        let wanted = match () {
            () if ADMINS[who].0 != organisation => Some(Code::NotOwner),
            () if proposal.base != version => Some(Code::PoliciesChanged),
            () if lacks(self.network) || (lacks(rule) && !glass) => Some(Code::NeedsApproval),
            () => None,
        };
        assert_eq!(done.err(), wanted);
        if wanted.is_none() {
            self.sets.insert(organisation, (version + 1, proposal.content));
            self.proposals[at].1 = None;
        }
    }

    /// The ledger has the sets and the proposals of the model.
    fn compare(&mut self) {
        let reader = self.admin(0);
        for (organisation, (version, (text, rule))) in self.sets.clone() {
            let sets: Vec<PolicySet> = self.fleet.get(&reader, "policy_history", &[organisation]);
            let newest = sets.first().map_or((0, None), |set| (set.version, set.approvals.as_deref()));
            assert_eq!(newest, (version, RULES[rule]));
            let texts: Vec<ledger_abac::PolicyEntry> = self.fleet.get(&reader, "policies", &[]);
            let own = texts.iter().find(|policy| policy.organisation == organisation).map(|policy| &policy.text);
            let wanted = (text != usize::MAX).then(|| policies(text).remove(0).text);
            assert_eq!(own, wanted.as_ref());
        }
        let standing: Vec<PolicyProposal> = self.fleet.get(&reader, "policy_proposals", &[]);
        let mut ids: Vec<&str> = standing.iter().map(|proposal| proposal.id.as_str()).collect();
        let mut wanted: Vec<&str> =
            self.proposals.iter().filter(|(_, proposal)| proposal.is_some()).map(|(id, _)| id.as_str()).collect();
        ids.sort_unstable();
        wanted.sort_unstable();
        assert_eq!(ids, wanted);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]

    #[test]
    fn a_set_comes_in_force_only_with_the_approvals_that_the_model_counts(
        steps in proptest::collection::vec(step(), 1..60)
    ) {
        let mut model = Model::new();
        for step in &steps {
            model.play(step);
        }
        model.compare();
    }
}
