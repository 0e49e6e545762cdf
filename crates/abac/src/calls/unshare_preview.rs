//! `unshare_preview`: the set in force without a share.

use crate::arguments::{Arguments, shown};
use crate::calls::diff;
use crate::lifecycle::{access, robots};
use crate::policy::decider::Decider;
use crate::policy::texts;
use crate::policy::texts::TextSet;
use crate::records::{robot, store};
use bytes::Bytes;
use ledger::{Context, Paging};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Access, PolicyDraft, PolicyText, ShareEntry, UnsharePreview};

/// Most people who are asked about.
const PEOPLE_MAX: usize = 512;

/// `unshare_preview ID`: the set without a share as an argument of `policy apply`, what that would change, and who may still use the
/// robot.
pub(crate) fn preview(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("unshare_preview ID", args, 1, 1)?;
    let id = args.text(0, "ID")?;
    let owner = robots::admin(ctx, "share robots")?.organisation.clone();
    let own = texts::own(ctx, &owner)?;
    let shares: Vec<ShareEntry> = own.iter().filter_map(|(id, text)| ShareEntry::of(&owner, id, text)).collect();
    let Some(share) = shares.iter().find(|share| share.id == id) else {
        let ids: Vec<&str> = shares.iter().map(|share| share.id.as_str()).collect();
        return Err(Rejection::new(Code::NotFound, format!("{owner} has no share of this name"))
            .found(shown(id))
            .wanted(if ids.is_empty() {
                "a share; it has none".to_owned()
            } else {
                format!("one of {}", ids.join(", "))
            })
            .next("ledgerctl share list"));
    };
    let mut set: Vec<_> = own.iter().filter(|(known, _)| known != id).cloned().collect();
    if set == texts::built_in() {
        set.clear();
    }
    let policies: Vec<PolicyText> = set.iter().cloned().map(|(id, text)| PolicyText { id, text }).collect();
    let robot = share.terms.as_ref().map(|terms| terms.robot().to_owned());
    let time = share.terms.as_ref().and_then(|terms| terms.from).unwrap_or_default().max(ctx.block_time());
    let diff = diff::of(ctx, decider, &owner, &policies, robot.as_deref(), time)?;
    let still = match robot {
        Some(robot) => still(ctx, decider, &robot, &TextSet::of(set)?)?,
        None => Vec::new(),
    };
    let base = Some(texts::version(ctx, &owner)?.number);
    let message = format!("unshare {id}");
    store::json(&UnsharePreview {
        id: id.to_owned(),
        text: share.text.clone(),
        set: PolicyDraft { policies: Some(policies), message, base, ..PolicyDraft::default() },
        diff,
        still,
    })
}

/// The people of other organisations with rights on a robot under a set.
fn still(ctx: &mut Context<'_>, decider: &Decider, robot: &str, set: &TextSet) -> Result<Vec<Access>, Rejection> {
    let Ok(robot) = robot::find(ctx, robot) else { return Ok(Vec::new()) };
    let (mut still, mut after, mut asked) = (Vec::new(), None, 0);
    loop {
        let page = access::people_of(ctx, &Paging::at(after))?;
        for principal in page.items.iter().filter(|principal| principal.organisation != robot.organisation) {
            let rights = access::rights(ctx, decider, principal, &robot, set, ctx.block_time())?;
            if !rights.is_empty() {
                still.push(Access { who: principal.id(), role: principal.role.to_string(), rights });
            }
            asked += 1;
        }
        after = page.next;
        if after.is_none() || asked >= PEOPLE_MAX {
            return Ok(still);
        }
    }
}
