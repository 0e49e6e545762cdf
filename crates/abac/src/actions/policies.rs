//! Changing and listing the policies on the ledger: `policy`, `policies`.

use super::{end, robots};
use crate::arguments::{Arguments, shown};
use crate::policy::decider::Decider;
use crate::policy::defaults::Defaults;
use crate::policy::limits::POLICY_BYTES_MAX;
use crate::policy::texts::{self, DEFAULT_ID, POLICIES_MAX, own};
use crate::records::{robot, store};
use bytes::Bytes;
use ledger::msp::quota_reached;
use ledger::{Context, Paging};
use ledger_contract::{PolicyChange, PolicyEntry};
use ledger_rejection::{Code, Rejection};

/// Most policies that `policies` lists as a transaction, which it was before rules 3.
const LISTED_MAX: usize = 4096;
/// Longest id of a policy, in bytes.
pub(super) const ID_BYTES_MAX: usize = 64;
/// Longest argument that is read as a policy at all, in bytes; the limit of a policy itself is smaller and says so.
const DOCUMENT_BYTES_MAX: usize = 1024 * 1024;
const _: () = assert!(POLICY_BYTES_MAX < DOCUMENT_BYTES_MAX);

const USAGE: &str = "policy put ID TEXT | policy remove ID";

/// `policy put ID TEXT`, `policy remove ID`: by an admin, for the robots of their organisation.
pub(crate) fn change(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new(USAGE, args, 2, 3)?;
    let organisation = &robots::admin(ctx, "change policies")?.organisation;
    let id = args.text(1, "ID")?;
    let key = store::policy_key(organisation, id);
    let before = own(ctx, organisation)?;
    texts::check(ctx, organisation, &before);
    let change = match (args.text(0, "put or remove")?, args.has(2)) {
        ("put", true) => {
            check_id(id)?;
            let text = args.document(2, "TEXT", DOCUMENT_BYTES_MAX)?;
            decider.check(ctx, text)?;
            if ctx.get(&key).is_none() && robot::has_quotas(ctx) {
                let most = robots::quotas(ctx, organisation)?.policies;
                if before.len() as u64 >= most {
                    let free = "put several rules into one policy, or remove one";
                    return Err(quota_reached(organisation, "policies", most, free));
                }
            } else if ctx.get(&key).is_none() && before.len() >= POLICIES_MAX {
                return Err(Rejection::new(Code::LimitExceeded, format!("{organisation} has too many policies"))
                    .found(format!("{POLICIES_MAX} policies"))
                    .wanted(format!("at most {POLICIES_MAX}"))
                    .next("put several rules into one policy, or remove one"));
            }
            ctx.put(&key, text.as_bytes().to_vec());
            "put"
        }
        ("remove", false) => {
            if id.len() > ID_BYTES_MAX || ctx.get(&key).is_none() {
                return Err(Rejection::new(Code::NotFound, format!("{organisation} has no policy {}", shown(id)))
                    .found(shown(id))
                    .wanted("the id of one of its own policies")
                    .next("ledgerctl policy list"));
            }
            ctx.delete(&key);
            "removed"
        }
        (verb, _) => return Err(args.bad(0, "put or remove", shown(verb), "put with ID and TEXT, or remove with ID")),
    };
    let own = own(ctx, organisation)?;
    texts::changed(ctx, organisation, &own, change == "put")?;
    let change = PolicyChange {
        organisation: organisation.clone(),
        id: id.to_owned(),
        change: change.to_owned(),
        default_in_force: own.is_empty(),
        ended: end::policies_changed(ctx, decider, organisation)?,
    };
    let change = store::json(&change)?;
    ctx.emit("policy", organisation, change.clone());
    Ok(change)
}

/// `policies [PAGE_JSON]`: those of every organisation, and the built-in one.
pub(crate) fn list(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    if let Some(paging) = Paging::of(ctx, "policies", args)? {
        let mut page = paging.page(ctx, b"policy/", |key, value| Ok(entry(key, value)))?;
        if paging.after.is_none() {
            page.items.insert(0, built_in(ctx));
        }
        return paging.answer(&page);
    }
    Arguments::new("policies", args, 0, 0)?;
    let mut entries = vec![built_in(ctx)];
    entries.extend(ctx.range(b"policy/", LISTED_MAX).iter().filter_map(|(key, value)| entry(key, value)));
    store::json(&entries)
}

fn built_in(ctx: &Context<'_>) -> PolicyEntry {
    let text = Defaults::of(ctx.rules()).policy.to_owned();
    PolicyEntry { organisation: String::new(), id: DEFAULT_ID.to_owned(), text }
}

fn entry(key: &[u8], text: &[u8]) -> Option<PolicyEntry> {
    let (organisation, id) = std::str::from_utf8(key).ok()?.strip_prefix("policy/")?.split_once('/')?;
    let text = String::from_utf8_lossy(text).into_owned();
    Some(PolicyEntry { organisation: organisation.to_owned(), id: id.to_owned(), text })
}

fn check_id(id: &str) -> Result<(), Rejection> {
    let allowed = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'_' | b'-');
    if (1..=ID_BYTES_MAX).contains(&id.len()) && id.bytes().all(allowed) {
        return Ok(());
    }
    Err(Rejection::new(Code::BadName, "id of a policy is not usable")
        .found(shown(id))
        .wanted(format!("1 to {ID_BYTES_MAX} letters, digits, \"_\" and \"-\"")))
}
