//! Changing and listing the policies on the ledger: `policy`, `policies`.

use super::{end, policy_proposals, policy_rules, policy_sets, reachable, robots};
use crate::arguments::{Arguments, shown};
use crate::policy::Texts;
use crate::policy::decider::Decider;
use crate::policy::defaults::DEFAULT_POLICY;
use crate::policy::limits::POLICY_BYTES_MAX;
use crate::policy::texts::{self, DEFAULT_ID, own};
use crate::records::store;
use bytes::Bytes;
use ledger::msp::quota_reached;
use ledger::{Context, Paging, Quorum};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{PolicyChange, PolicyEntry};

/// Longest id of a policy, in bytes.
pub(super) const ID_BYTES_MAX: usize = 64;
/// Longest argument that is read as a policy at all, in bytes; the limit of a policy itself is smaller and says so.
const DOCUMENT_BYTES_MAX: usize = 1024 * 1024;
const _: () = assert!(POLICY_BYTES_MAX < DOCUMENT_BYTES_MAX);

const USAGE: &str = "policy put ID TEXT [i-mean-it] | policy remove ID [i-mean-it]";
/// The word of who means it, even if nobody may publish to some robot then.
const MEANT: &str = "i-mean-it";

/// The circumstances in which a set comes in force.
#[derive(Default)]
pub(super) struct Made {
    pub(super) by: String,
    pub(super) message: String,
    pub(super) approved_by: Vec<String>,
    pub(super) break_glass: bool,
    pub(super) restores: Option<u64>,
    /// The rule of the organisation from then on.
    pub(super) rule: Option<Quorum>,
}

/// `policy VERB …`: by an admin, for the robots of their organisation.
pub(crate) fn change(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    match args {
        [verb, rest @ ..] => match verb.as_ref() {
            b"apply" => policy_sets::apply(ctx, decider, rest),
            b"propose" => policy_proposals::propose(ctx, decider, rest),
            b"approve" => policy_proposals::approve(ctx, rest),
            b"withdraw" => policy_proposals::withdraw(ctx, rest),
            b"enact" => policy_proposals::enact(ctx, decider, rest),
            _ => change_one(ctx, decider, args),
        },
        _ => change_one(ctx, decider, args),
    }
}

/// `policy put ID TEXT`, `policy remove ID`: the set in force with one policy changed.
fn change_one(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let (args, means_it) = match args {
        [given @ .., last] if given.len() > 1 && last == MEANT => (given, true),
        _ => (args, false),
    };
    let args = Arguments::new(USAGE, args, 2, 3)?;
    let caller = robots::admin(ctx, "change policies")?;
    let organisation = &caller.organisation;
    let id = args.text(1, "ID")?;
    let mut set = own(ctx, organisation)?;
    let at = set.iter().position(|(known, _)| known == id);
    let change = match (args.text(0, "put or remove")?, args.has(2)) {
        ("put", true) => {
            check_id(id)?;
            let text = args.document(2, "TEXT", DOCUMENT_BYTES_MAX)?;
            decider.check(ctx, text)?;
            match at.and_then(|at| set.get_mut(at)) {
                Some((_, known)) => text.clone_into(known),
                None => {
                    check_number(ctx, organisation, set.len() + 1)?;
                    set.push((id.to_owned(), text.to_owned()));
                    set.sort();
                }
            }
            "put"
        }
        ("remove", false) => {
            let Some(at) = at.filter(|_| id.len() <= ID_BYTES_MAX) else {
                return Err(Rejection::new(Code::NotFound, format!("{organisation} has no policy {}", shown(id)))
                    .found(shown(id))
                    .wanted("the id of one of its own policies")
                    .next("ledgerctl policy list"));
            };
            set.remove(at);
            "removed"
        }
        (verb, _) => return Err(args.bad(0, "put or remove", shown(verb), "put with ID and TEXT, or remove with ID")),
    };
    policy_rules::check_alone(ctx, caller)?;
    reachable::check(ctx, decider, organisation, &set, means_it)?;
    let made = Made { by: caller.id(), rule: policy_rules::own(ctx, organisation)?, ..Made::default() };
    replace(ctx, decider, organisation, &set, (id, change), made)
}

/// Puts a set in the place of the one in force, and ends the grants that it does not permit. `change` is the changed policy,
/// and what became of it.
pub(super) fn replace(
    ctx: &mut Context<'_>,
    decider: &Decider,
    organisation: &str,
    set: &Texts,
    (id, change): (&str, &str),
    made: Made,
) -> Result<Bytes, Rejection> {
    let before = own(ctx, organisation)?;
    texts::check(ctx, organisation, &before);
    let kept = |id: &str| set.iter().any(|(known, _)| known == id);
    for (gone, _) in before.iter().filter(|(id, _)| !kept(id)) {
        ctx.delete(&store::policy_key(organisation, gone));
    }
    for (id, text) in set.iter().filter(|policy| !before.contains(policy)) {
        ctx.put(&store::policy_key(organisation, id), text.as_bytes().to_vec());
    }
    let version = texts::changed(ctx, organisation, set)?;
    let change = PolicyChange {
        organisation: organisation.to_owned(),
        id: id.to_owned(),
        change: change.to_owned(),
        default_in_force: set.is_empty(),
        ended: end::policies_changed(ctx, decider, organisation)?,
        version,
        by: made.by.clone(),
        message: made.message.clone(),
    };
    policy_sets::record(ctx, organisation, version, set, made)?;
    let change = store::json(&change)?;
    ctx.emit("policy", organisation, change.clone());
    Ok(change)
}

/// Refuses more policies than an organisation may have.
pub(super) fn check_number(ctx: &mut Context<'_>, organisation: &str, wanted: usize) -> Result<(), Rejection> {
    let most = robots::quotas(ctx, organisation)?.policies;
    if wanted as u64 <= most {
        return Ok(());
    }
    Err(quota_reached(organisation, "policies", most, "put several rules into one policy, or remove one"))
}

/// `policies [PAGE_JSON]`: those of every organisation, and the built-in one.
pub(crate) fn list(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    Arguments::new("policies [PAGE_JSON]", args, 0, 1)?;
    let paging = Paging::of("policies", args)?;
    let mut page = paging.page(ctx, b"policy/", |key, value| Ok(entry(key, value)))?;
    if paging.after.is_none() {
        page.items.insert(0, built_in());
    }
    paging.answer(&page)
}

fn built_in() -> PolicyEntry {
    PolicyEntry { organisation: String::new(), id: DEFAULT_ID.to_owned(), text: DEFAULT_POLICY.to_owned() }
}

fn entry(key: &[u8], text: &[u8]) -> Option<PolicyEntry> {
    let (organisation, id) = std::str::from_utf8(key).ok()?.strip_prefix("policy/")?.split_once('/')?;
    let text = String::from_utf8_lossy(text).into_owned();
    Some(PolicyEntry { organisation: organisation.to_owned(), id: id.to_owned(), text })
}

pub(super) fn check_id(id: &str) -> Result<(), Rejection> {
    let allowed = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'_' | b'-');
    if (1..=ID_BYTES_MAX).contains(&id.len()) && id.bytes().all(allowed) {
        return Ok(());
    }
    Err(Rejection::new(Code::BadName, "id of a policy is not usable")
        .found(shown(id))
        .wanted(format!("1 to {ID_BYTES_MAX} letters, digits, \"_\" and \"-\"")))
}
