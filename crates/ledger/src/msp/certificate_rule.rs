//! How many signatures make a certificate, and which organisations are under one hand: a governing record.
//!
//! Certificates become strict ([`ledger_light::strict_quorum`]) by themselves, in the first block whose voters can lose any
//! one of them and still have enough, or by a proposal. From then on no organisation makes them weaker alone. A change of
//! roles after which no voter could be lost needs the approval of the organisations, and ends it. So does a proposal that
//! clears it.

use super::SET_CERTIFICATE_RULE;
use super::caller::{admin, object};
use super::nodes::{NodeRecord, all, certificate_rule as of, desired, members};
use super::organisations;
use super::own_call::own_call;
use super::proposals::decide;
use super::store::{self, CERTIFICATE_RULE, json};
use crate::chaincode::Context;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_light::{CertificateRule, Voter, Voters};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Most sets of organisations under one hand.
const HANDS_MAX: usize = 64;

/// Argument of `set_certificate_rule`: what is left out stays.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetCertificateRule {
    /// Are certificates strict?
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub strict: Option<bool>,
    /// Organisations under one hand, two at least in each set; an organisation is in one of them at most.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hands: Option<Vec<BTreeSet<String>>>,
}

/// The rule of a genesis: strict if its voters can lose any one.
pub(super) fn founding(nodes: &[NodeRecord]) -> Option<CertificateRule> {
    let voters = voters_of(nodes, desired(nodes).0, &CertificateRule::default());
    voters.can_be_strict().then(|| CertificateRule { strict_since: Some(0), ..CertificateRule::default() })
}

/// `set_certificate_rule {strict?, hands?}`: needs approval.
pub(super) fn set(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let wanted = "{\"strict\": true or false, \"hands\": [[NAME, NAME]]}";
    let set: SetCertificateRule = object(SET_CERTIFICATE_RULE, argument, wanted)?;
    if ctx.approved_by().is_some() {
        return change(ctx, set);
    }
    let caller = admin(ctx, "change the certificate rule")?;
    check(ctx, &set)?;
    json(&decide(ctx, caller, own_call(SET_CERTIFICATE_RULE, &set)?)?)
}

fn change(ctx: &mut Context<'_>, set: SetCertificateRule) -> Result<Bytes, Rejection> {
    check(ctx, &set)?;
    let mut rule = of(ctx)?;
    if let Some(hands) = set.hands {
        let (nodes, before) = (all(ctx)?, rule.clone());
        rule.hands = hands;
        if ends(&before, &nodes, &rule, &nodes) {
            rule.strict_since = None;
        }
    }
    match set.strict {
        Some(true) => (rule.strict_since, rule.cleared) = (rule.strict_since.or(Some(ctx.height())), false),
        Some(false) => (rule.strict_since, rule.cleared) = (None, true),
        None => {}
    }
    write(ctx, &rule)?;
    settle(ctx)?;
    json(&of(ctx)?)
}

fn check(ctx: &Context<'_>, set: &SetCertificateRule) -> Result<(), Rejection> {
    let bad = |found: String, wanted: &str| {
        Err(Rejection::new(Code::BadArgument, "these organisations cannot be counted as one")
            .found(found)
            .wanted(wanted))
    };
    if set.strict.is_none() && set.hands.is_none() {
        return Err(Rejection::new(Code::BadArgument, "msp set_certificate_rule changes nothing")
            .wanted("strict, or hands, or both"));
    }
    let hands = set.hands.as_deref().unwrap_or_default();
    if hands.len() > HANDS_MAX {
        return bad(format!("{} sets", hands.len()), "at most 64 sets of organisations");
    }
    let mut taken = BTreeSet::new();
    for hand in hands {
        if hand.len() < 2 {
            return bad(
                format!("{hand:?}"),
                "at least two organisations in each set; all others are counted separately",
            );
        }
        for name in hand {
            if !taken.insert(name) {
                return bad(format!("{name} twice"), "each organisation in at most one set");
            }
            if organisations::find(ctx, name)?.is_none() {
                return Err(organisations::unknown(ctx, name));
            }
        }
    }
    Ok(())
}

/// Makes certificates strict if the voters of the next block, and those that the ledger wants, can lose any one of them and
/// still have enough. Not while they change, and not where the organisations decided against it.
pub(crate) fn settle(ctx: &mut Context<'_>) -> Result<(), Rejection> {
    let rule = of(ctx)?;
    if rule.strict_since.is_some() || rule.cleared {
        return Ok(());
    }
    let (members, nodes) = (members(ctx)?, all(ctx)?);
    let (wanted, _) = desired(&nodes);
    let can = |voters: BTreeSet<u64>| voters_of(&nodes, voters, &rule).can_be_strict();
    if members.is_joint() || !can(members.voters) || !can(wanted) {
        return Ok(());
    }
    write(ctx, &CertificateRule { strict_since: Some(ctx.height()), ..rule })
}

/// Would these records end strict certificates? They do if a voter could be lost before, and none could afterwards.
pub(super) fn would_end(ctx: &Context<'_>, after: &[NodeRecord]) -> Result<bool, Rejection> {
    let rule = of(ctx)?;
    Ok(ends(&rule, &all(ctx)?, &rule, after))
}

fn ends(rule: &CertificateRule, before: &[NodeRecord], next: &CertificateRule, after: &[NodeRecord]) -> bool {
    let can = |rule, nodes: &[NodeRecord]| voters_of(nodes, desired(nodes).0, rule).can_be_strict();
    rule.strict_since.is_some() && can(rule, before) && !can(next, after)
}

/// The organisations have agreed to voters of whom none can be lost, or people have recovered the network: certificates are
/// not strict any more. They become so again by themselves.
pub(super) fn end(ctx: &mut Context<'_>) -> Result<(), Rejection> {
    let rule = of(ctx)?;
    write(ctx, &CertificateRule { strict_since: None, ..rule })
}

/// An organisation that leaves is under no hand.
pub(super) fn forget_organisation(ctx: &mut Context<'_>, name: &str) -> Result<(), Rejection> {
    let mut rule = of(ctx)?;
    for hand in &mut rule.hands {
        hand.remove(name);
    }
    rule.hands.retain(|hand| hand.len() > 1);
    write(ctx, &rule)
}

fn write(ctx: &mut Context<'_>, rule: &CertificateRule) -> Result<(), Rejection> {
    if of(ctx)? == *rule {
        return Ok(());
    }
    store::write(ctx, CERTIFICATE_RULE, rule)?;
    let name = if rule.strict_since.is_some() { "strict" } else { "majority" };
    ctx.emit("certificate_rule_changed", name, json(rule)?);
    Ok(())
}

fn voters_of(nodes: &[NodeRecord], voters: BTreeSet<u64>, rule: &CertificateRule) -> Voters {
    let voter = |node: &NodeRecord| Voter { organisation: node.organisation.clone(), name: node.name.clone() };
    let nodes = nodes.iter().map(|node| (node.id, voter(node))).collect();
    Voters { nodes, voters, outgoing: BTreeSet::new(), rule: rule.clone(), recoveries: 0 }
}
