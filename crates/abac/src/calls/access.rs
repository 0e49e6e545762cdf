//! `access`: the rights of people on a robot.

use crate::arguments::Arguments;
use crate::calls::question;
use crate::calls::question::ASK_BYTES_MAX;
use crate::lifecycle::{access, people};
use crate::policy::decider::Decider;
use crate::policy::texts;
use crate::policy::texts::TextSet;
use crate::records::principal::Principal;
use crate::records::{robot, store};
use bytes::Bytes;
use ledger::{Context, Page, Paging};
use ledger_base::rejection::Rejection;
use ledger_contract::{Access, AskAccess};
use ledger_identity::Role;

/// Most people of a page: each is decided about.
const PEOPLE_MAX: usize = 32;

/// `access ACCESS_JSON [PAGE_JSON]`: who may do what on this robot? The answer has all people with a right for admins of its owner,
/// those of their organisation for other admins, and the caller alone for others.
pub(crate) fn access(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let given = Arguments::new("access ACCESS_JSON [PAGE_JSON]", args, 1, 2)?;
    let wanted = "JSON with robot, and some of who, at and policies";
    let ask: AskAccess = serde_json::from_str(given.document(0, "ACCESS_JSON", ASK_BYTES_MAX)?)
        .map_err(|fault| given.bad(0, "ACCESS_JSON", fault.to_string(), wanted))?;
    let mut paging = Paging::of("access", given.rest(1))?;
    let caller = Principal::of(ctx.submitter()?);
    let robot = robot::find(ctx, &ask.robot)?;
    let set = TextSet::of(match &ask.policies {
        Some(policies) => question::given(ctx, decider, policies)?,
        None => texts::in_force(ctx, &robot.organisation)?,
    })?;
    let time = ask.at.unwrap_or(ctx.block_time());
    let of_owner = caller.governs(&robot);
    let page = match &ask.who {
        Some(who) if *who != caller.id() => Page { items: vec![people::certified(ctx, who)?], next: None },
        None if caller.role == Role::Admin => {
            paging.most = Some(paging.most.unwrap_or(PEOPLE_MAX).min(PEOPLE_MAX));
            let mut page = access::people_of(ctx, &paging)?;
            // A certificate that was issued beside the ledger is in no registry.
            if paging.after.is_none() && people::certified(ctx, &caller.id()).is_err() {
                page.items.insert(0, caller.clone());
            }
            page
        }
        _ => Page { items: vec![caller.clone()], next: None },
    };
    let mut items = Vec::new();
    for principal in page.items {
        let is_own = principal.organisation == caller.organisation;
        if !is_own && !of_owner && ask.who.is_none() {
            continue;
        }
        let rights = access::rights(ctx, decider, &principal, &robot, &set, time)?;
        if is_own || ask.who.is_some() || !rights.is_empty() {
            items.push(Access { who: principal.id(), role: principal.role.to_string(), rights });
        }
    }
    store::json(&Page { items, next: page.next })
}
