//! Rules that say who must agree to a set of policies: of the network for every organisation, and stricter of one itself.

use crate::arguments::{Arguments, shown};
use crate::policy::texts;
use crate::records::{policy_set, store};
use ledger::{ApprovedBy, Context, Quorum};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::PolicyNeed;
use ledger_identity::Identity;

/// The rule of an organisation that has none.
pub(crate) const NO_RULE: &str = "none";

/// The name of the network's rule among those that must be met.
pub(crate) const OF_NETWORK: &str = "network";

/// The rule of an organisation itself. It stands in its newest set, so that whoever changes it must meet it.
pub(crate) fn own(ctx: &Context<'_>, organisation: &str) -> Result<Option<Quorum>, Rejection> {
    let version = texts::version(ctx, organisation)?.number;
    let set = policy_set::of(ctx, organisation, version)?;
    parse(set.and_then(|set| set.approvals).as_deref())
}

/// Reads a rule as the state holds it.
pub(crate) fn parse(text: Option<&str>) -> Result<Option<Quorum>, Rejection> {
    let read = |text: &str| {
        text.parse().map_err(|_| {
            Rejection::new(Code::Corrupt, "an approval rule is not readable").found(text.to_owned()).wanted("a quorum")
        })
    };
    text.map(read).transpose()
}

pub(crate) fn network(ctx: &Context<'_>) -> Result<Option<Quorum>, Rejection> {
    parse(store::read::<String>(ctx, store::APPROVALS)?.as_deref())
}

/// The rules for a set of an organisation, with how many approvals are missing. `admins` are those who agree.
pub(crate) fn needs<'a>(
    ctx: &mut Context<'_>,
    organisation: &str,
    admins: impl Iterator<Item = (&'a str, &'a str)>,
) -> Result<Vec<PolicyNeed>, Rejection> {
    let mut approved = ApprovedBy { proposer: organisation.to_owned(), ..ApprovedBy::default() };
    for (of, name) in admins {
        approved.admins.entry(of.to_owned()).or_default().insert(name.to_owned());
    }
    let organisations: Vec<String> = store::parse(b"msp organisations", &ctx.call("msp", "organisations", &[])?)?;
    let rules = [(OF_NETWORK, network(ctx)?), (organisation, own(ctx, organisation)?)];
    // A rule that names an organisation which has left could be met by nobody.
    let meant =
        |quorum: &Quorum| !matches!(quorum, Quorum::Admins { of: Some(named), .. } if !organisations.contains(named));
    let need = |(of, quorum): (&str, Option<Quorum>)| {
        let quorum = quorum.filter(meant)?;
        let missing = quorum.missing(&approved, &organisations) as u64;
        Some(PolicyNeed { of: of.to_owned(), quorum: quorum.to_string(), missing })
    };
    Ok(rules.into_iter().filter_map(need).collect())
}

/// Refuses who may not change policies alone.
pub(crate) fn check_alone(ctx: &mut Context<'_>, caller: &Identity) -> Result<(), Rejection> {
    let alone = [(caller.organisation.as_str(), caller.name.as_str())];
    let needs = needs(ctx, &caller.organisation, alone.into_iter())?;
    match needs.iter().find(|need| need.missing > 0) {
        None => Ok(()),
        Some(need) => Err(not_agreed(&caller.organisation, need).found(format!("{} alone", caller.id())).next(
            "propose the complete set, with every policy that must stay: ledgerctl policy propose FILE... (or \
                   --restore VERSION, --built-in); then to approve: ledgerctl policy approve ID",
        )),
    }
}

/// The refusal of a set to which too few agree.
pub(crate) fn not_agreed(organisation: &str, PolicyNeed { of, quorum, missing }: &PolicyNeed) -> Rejection {
    let whose = if of == OF_NETWORK { "the network".to_owned() } else { of.clone() };
    let message = format!("a change of the policies of {organisation} needs approvals");
    Rejection::new(Code::NeedsApproval, message).wanted(format!("{quorum}, as {whose} requires: {missing} more"))
}

/// Reads the rule that an organisation gives itself.
pub(crate) fn quorum(ctx: &mut Context<'_>, args: Arguments<'_>, text: &str) -> Result<Quorum, Rejection> {
    let quorum: Quorum = text.parse().map_err(|wanted: ledger::NotAQuorum| {
        args.bad(0, "approvals", shown(text), &format!("{wanted}; or \"{NO_RULE}\""))
    })?;
    if let Quorum::Admins { of: Some(named), .. } = &quorum {
        let known: Vec<String> = store::parse(b"msp organisations", &ctx.call("msp", "organisations", &[])?)?;
        if !known.contains(named) {
            return Err(args.bad(0, "approvals", shown(named), &format!("one of {}", known.join(", "))));
        }
    }
    Ok(quorum)
}
