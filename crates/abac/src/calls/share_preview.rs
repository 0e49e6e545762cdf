//! `share_preview`: a share that is not in force yet.

use crate::arguments::{Arguments, shown};
use crate::calls::{check, diff};
use crate::lifecycle::{policy_sets, robots};
use crate::policy::decider::Decider;
use crate::policy::texts;
use crate::records::robot::Robot;
use crate::records::{robot, store, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::moment::rfc3339_seconds;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{PolicyDraft, PolicyText, ShareEntry, SharePreview, ShareTerms};
use ledger_identity::{ATTRIBUTE_FORM, read_attribute};

/// Longest terms, in bytes.
const TERMS_BYTES_MAX: usize = 8 * 1024;

/// `share_preview TERMS_JSON`: the policy of a share, the set with it as an argument of `policy apply`, and what that would change.
pub(crate) fn preview(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("share_preview TERMS_JSON", args, 1, 1)?;
    let wanted = "JSON with resource and with, and some of attribute, from, until, hours, max_linear, max_angular, rate, priority \
                  and read_only";
    let terms: ShareTerms = serde_json::from_str(args.document(0, "TERMS_JSON", TERMS_BYTES_MAX)?)
        .map_err(|fault| args.bad(0, "TERMS_JSON", fault.to_string(), wanted))?;
    let admin = robots::admin(ctx, "share robots")?;
    let robot = robot::find(ctx, terms.robot())?;
    robots::check_owner(&robot, admin)?;
    let terms = checked(ctx, args, terms, &robot)?;
    let owner = &robot.organisation;
    let own = texts::own(ctx, owner)?;
    let keeps_built_in = own.is_empty();
    let mut set = if keeps_built_in { texts::built_in() } else { own };
    let is_replaced = |entry: &ShareEntry| entry.terms.as_ref().is_some_and(|other| other.is_about_the_same(&terms));
    let replaced = set.iter().filter_map(|(id, text)| ShareEntry::of(owner, id, text)).find(is_replaced);
    let replaces = replaced.map(|entry| entry.id).unwrap_or_default();
    set.retain(|(id, _)| *id != replaces);
    let id = if replaces.is_empty() { free_id(&terms, &set) } else { replaces.clone() };
    let text = terms.text();
    set.push((id.clone(), text.clone()));
    policy_sets::check_number(ctx, owner, set.len())?;
    let mut policies: Vec<PolicyText> = set.into_iter().map(|(id, text)| PolicyText { id, text }).collect();
    policies.sort_by(|one, other| one.id.cmp(&other.id));
    let time = terms.from.unwrap_or_default().max(ctx.block_time());
    let difference = diff::of(ctx, decider, owner, &policies, Some(&robot.name), time)?;
    let meaning = check::checked(ctx, decider, &text)?;
    let message = format!("share {} with {}", terms.resource, terms.with);
    let base = Some(texts::version(ctx, owner)?.number);
    store::json(&SharePreview {
        id,
        text,
        meaning: meaning.policies,
        replaces,
        keeps_built_in,
        trusted: robot.trusted.iter().any(|name| name == terms.organisation()),
        unknown: meaning.unknown,
        set: PolicyDraft { policies: Some(policies), message, base, ..PolicyDraft::default() },
        diff: difference,
    })
}

/// The terms in the form in which they are written, if they can give something.
fn checked(ctx: &Context<'_>, args: Arguments<'_>, terms: ShareTerms, robot: &Robot) -> Result<ShareTerms, Rejection> {
    let bad = |found: String, wanted: &str| args.bad(0, "TERMS_JSON", found, wanted);
    if terms.resource.contains('/') {
        let target = target::resolve(ctx, &terms.resource)?;
        if target.is_for_readers() {
            return Err(bad(shown(&target.id), &format!("the service {}", target.service_id())));
        }
    }
    let parts: Vec<&str> = terms.with.split('/').collect();
    if !matches!(parts.as_slice(), [_] | [_, _]) || parts.iter().any(|part| part.is_empty()) {
        return Err(bad(shown(&terms.with), "ORGANISATION or ORGANISATION/NAME to share with"));
    }
    let whole = |moment: Option<u64>| moment.map(|moment| moment / 1000 * 1000);
    let (from, until) = (whole(terms.from), whole(terms.until));
    let begin = from.unwrap_or_default().max(ctx.block_time());
    if let Some(until) = until.filter(|until| *until <= begin) {
        let wanted = format!("a time after {}", rfc3339_seconds(begin));
        return Err(bad(format!("until {}", rfc3339_seconds(until)), &wanted));
    }
    let organisation = terms.organisation();
    let attribute = match terms.attribute.as_deref().map(|text| (text, read_attribute(text))) {
        Some((_, Ok((key, value)))) => Some(format!("{key}={value}")),
        Some((text, Err(fault))) => {
            return Err(bad(shown(text), ATTRIBUTE_FORM).next(fault.question("--attr ")));
        }
        None => None,
    };
    if attribute.is_some() && !robot.trusted.iter().any(|name| name == organisation) {
        let (name, trusted) = (&robot.name, robot.trusted.join(","));
        let message = format!("{name} does not trust {organisation}, so its attributes have no effect");
        return Err(Rejection::new(Code::BadArgument, message)
            .found(format!("trust={trusted}, and a share for those with {}", attribute.unwrap_or_default()))
            .wanted(format!(
                "{organisation} among the organisations that {name} trusts, or a share without an \
                             attribute"
            ))
            .next(format!("to trust its attributes: ledgerctl robot set {name} trust={trusted},{organisation}")));
    }
    Ok(ShareTerms { attribute, from, until, ..terms })
}

/// The id of a new share that no policy has.
fn free_id(terms: &ShareTerms, set: &[(String, String)]) -> String {
    let id = terms.id();
    let is_free = |wanted: &String| !set.iter().any(|(id, _)| id == wanted);
    let numbered = (2..).map(|number: u32| format!("{id}-{number}"));
    std::iter::once(id.clone()).chain(numbered).find(is_free).unwrap_or_default()
}
