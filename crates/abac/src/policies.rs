//! The policies on the ledger: every organisation keeps its own, and they decide about its robots only.

use crate::arguments::{Arguments, shown};
use crate::authorize::Decider;
use crate::policy::{DEFAULT_POLICY, POLICY_BYTES_MAX, Texts};
use crate::revoke;
use crate::robot;
use crate::store;
use bytes::Bytes;
use ledger::Context;
use ledger_contract::{PolicyChange, PolicyEntry};
use ledger_hash::Hash;
use ledger_rejection::{Code, Rejection};

/// Most policies of one organisation.
const POLICIES_MAX: usize = 64;
/// Most policies that `policies` lists.
const LISTED_MAX: usize = 4096;
/// Longest id of a policy, in bytes.
const ID_BYTES_MAX: usize = 64;
/// Longest argument that is read as a policy at all, in bytes; the limit of a policy itself is smaller and says so.
const DOCUMENT_BYTES_MAX: usize = 1024 * 1024;
const _: () = assert!(POLICY_BYTES_MAX < DOCUMENT_BYTES_MAX);
/// The id under which the built-in policy is listed.
const DEFAULT_ID: &str = "default";

const USAGE: &str = "policy put ID TEXT | policy remove ID";

/// `policy put ID TEXT`, `policy remove ID`: by an admin, for the robots of their organisation.
pub(crate) fn change(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new(USAGE, args, 2, 3)?;
    let organisation = &robot::admin(ctx, "change policies")?.organisation;
    let id = args.text(1, "ID")?;
    let key = store::policy_key(organisation, id);
    let change = match (args.text(0, "put or remove")?, args.has(2)) {
        ("put", true) => {
            check_id(id)?;
            let text = args.document(2, "TEXT", DOCUMENT_BYTES_MAX)?;
            decider.check(text)?;
            if ctx.get(&key).is_none() && own(ctx, organisation)?.len() >= POLICIES_MAX {
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
                    .next("ledgerctl query abac policies"));
            }
            ctx.delete(&key);
            "removed"
        }
        (verb, _) => return Err(args.bad(0, "put or remove", shown(verb), "put with ID and TEXT, or remove with ID")),
    };
    let own = own(ctx, organisation)?;
    match hash(&own) {
        _ if own.is_empty() => ctx.delete(&store::version_key(organisation)),
        version => ctx.put(&store::version_key(organisation), version.0.to_vec()),
    }
    let change = PolicyChange {
        organisation: organisation.clone(),
        id: id.to_owned(),
        change: change.to_owned(),
        default_in_force: own.is_empty(),
        ended: revoke::policies_changed(ctx, decider, organisation)?,
    };
    let change = store::json(&change)?;
    ctx.emit("policy", organisation, change.clone());
    Ok(change)
}

/// `policies`: those of every organisation, and the built-in one.
pub(crate) fn list(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    Arguments::new("policies", args, 0, 0)?;
    let built_in =
        PolicyEntry { organisation: String::new(), id: DEFAULT_ID.to_owned(), text: DEFAULT_POLICY.to_owned() };
    let mut entries = vec![built_in];
    for (key, value) in ctx.range(b"policy/", LISTED_MAX) {
        let text = String::from_utf8_lossy(&value).into_owned();
        if let Some((organisation, id)) =
            std::str::from_utf8(&key).ok().and_then(|key| key.strip_prefix("policy/")?.split_once('/'))
        {
            entries.push(PolicyEntry { organisation: organisation.to_owned(), id: id.to_owned(), text });
        }
    }
    store::json(&entries)
}

/// The policies that decide about the robots of an organisation.
pub(crate) fn in_force(ctx: &Context<'_>, organisation: &str) -> Result<Texts, Rejection> {
    let own = own(ctx, organisation)?;
    Ok(if own.is_empty() { vec![(DEFAULT_ID.to_owned(), DEFAULT_POLICY.to_owned())] } else { own })
}

/// The hash that names them; zero for the built-in one.
pub(crate) fn version(ctx: &Context<'_>, organisation: &str) -> Result<Hash, Rejection> {
    match ctx.get(&store::version_key(organisation)) {
        None => Ok(Hash::ZERO),
        Some(value) => Hash::from_slice(&value).ok_or_else(|| {
            Rejection::new(Code::Corrupt, format!("policy version of {organisation} is not readable"))
                .found(format!("{} bytes", value.len()))
                .wanted("32 bytes")
        }),
    }
}

fn own(ctx: &Context<'_>, organisation: &str) -> Result<Texts, Rejection> {
    let prefix = store::policies_prefix(organisation);
    ctx.range(&prefix, POLICIES_MAX)
        .into_iter()
        .map(|(key, value)| {
            let id = key.strip_prefix(prefix.as_slice()).unwrap_or_default().to_vec();
            match (String::from_utf8(id), String::from_utf8(value.to_vec())) {
                (Ok(id), Ok(text)) => Ok((id, text)),
                _ => Err(Rejection::new(Code::Corrupt, format!("a policy of {organisation} is not text"))),
            }
        })
        .collect()
}

/// Every part is preceded by its length, so that no two sets have the same bytes.
fn hash(texts: &Texts) -> Hash {
    let mut parts: Vec<Vec<u8>> = Vec::with_capacity(texts.len() * 4);
    for part in texts.iter().flat_map(|(id, text)| [id, text]) {
        parts.push((part.len() as u64).to_be_bytes().to_vec());
        parts.push(part.as_bytes().to_vec());
    }
    Hash::of(&parts.iter().map(Vec::as_slice).collect::<Vec<_>>())
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
