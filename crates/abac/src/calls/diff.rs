//! `diff`: what a set of policies would change.

use crate::arguments::Arguments;
use crate::calls::question;
use crate::calls::question::{ASK_BYTES_MAX, Asked, Case};
use crate::lifecycle::{access, reachable};
use crate::policy::action::Action;
use crate::policy::decider::Decider;
use crate::policy::texts::TextSet;
use crate::policy::{Texts, limits, texts};
use crate::records::robot::Robot;
use crate::records::target::Target;
use crate::records::{grant, robot, store};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::{Can, Grant, PolicyDiff, PolicyText, WouldEnd};
use ledger_identity::Role;

/// Most grants that `diff` tells one by one.
const ENDS_MAX: usize = 256;

/// `diff POLICIES_JSON`: which grants of the caller's organisation would a set of policies end?
pub(crate) fn diff(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("diff POLICIES_JSON", args, 1, 1)?;
    let wanted = r#"JSON of policies: [{"id": "night", "text": "permit …;"}]"#;
    let policies: Vec<PolicyText> = serde_json::from_str(args.document(0, "POLICIES_JSON", ASK_BYTES_MAX)?)
        .map_err(|fault| args.bad(0, "POLICIES_JSON", fault.to_string(), wanted))?;
    let organisation = ctx.submitter()?.organisation.clone();
    let time = ctx.block_time();
    store::json(&of(ctx, decider, &organisation, &policies, None, time)?)
}

/// The differences of a set from the one in force. Rights are compared at a time (microseconds), of one robot or of all that the
/// organisation owns, and shown to its admins only.
pub(crate) fn of(
    ctx: &mut Context<'_>,
    decider: &Decider,
    organisation: &str,
    policies: &[PolicyText],
    only: Option<&str>,
    time: u64,
) -> Result<PolicyDiff, Rejection> {
    let texts = question::given(ctx, decider, policies)?;
    let own = texts::own(ctx, organisation)?;
    let text_of = |texts: &Texts, id: &str| texts.iter().find(|(known, _)| known == id).map(|(_, text)| text.clone());
    let ids = |of: &Texts, keep: &dyn Fn(&str) -> bool| {
        of.iter().map(|(id, _)| id.clone()).filter(|id| keep(id)).collect::<Vec<_>>()
    };
    let mut diff = PolicyDiff {
        organisation: organisation.to_owned(),
        added: ids(&texts, &|id| !policies.is_empty() && text_of(&own, id).is_none()),
        changed: ids(&texts, &|id| text_of(&own, id).is_some_and(|text| text_of(&texts, id) != Some(text))),
        removed: ids(&own, &|id| text_of(&texts, id).is_none()),
        grants: 0,
        ends: Vec::new(),
        ended: 0,
        unreachable: reachable::cut_off(ctx, decider, organisation, &texts)?,
        gained: Vec::new(),
        lost: Vec::new(),
        limited: Vec::new(),
        incomplete: false,
    };
    if ctx.submitter()?.role == Role::Admin {
        let robots: Vec<(Option<Robot>, Option<Robot>)> = robot::all(ctx)?
            .into_iter()
            .filter(|robot| robot.organisation == organisation && only.is_none_or(|only| robot.name == only))
            .map(|robot| (Some(robot.clone()), Some(robot)))
            .collect();
        let sets = (TextSet::of(own.clone())?, TextSet::of(texts.clone())?);
        access::compare(ctx, decider, &robots, (&sets.0, &sets.1), time, &mut diff)?;
    }
    let steps = limits::steps_of_all(&texts)?;
    let of_owner = robot::all(ctx)?.into_iter().filter(|robot| robot.organisation == organisation);
    for target in of_owner.flat_map(|robot| Target::all_of(&robot).collect::<Vec<_>>()) {
        for holding in grant::live(ctx, &target.id)? {
            diff.grants += 1;
            let action = if holding.grant.taken.is_some() { Action::Override } else { Action::Acquire };
            let asked = Asked::Service(Box::new(target.clone()), question::needed(&target, action));
            let time = ctx.block_time();
            let (action, texts) = (action.name().to_owned(), texts.clone());
            let case = Case { action, asked, texts, version: 0, steps, time };
            let people = std::iter::once(&holding.principal).chain(holding.givers.iter().map(|giver| &giver.principal));
            for principal in people {
                let Can { allowed, reason, found, wanted, .. } = case.judge(ctx, decider, principal)?;
                if allowed {
                    continue;
                }
                diff.ended += 1;
                if diff.ends.len() < ENDS_MAX {
                    let Grant { service, holder, epoch, .. } = holding.grant;
                    diff.ends.push(WouldEnd { service, holder, epoch, reason, found, wanted });
                }
                break;
            }
        }
    }
    Ok(diff)
}
