//! Numbered sets of policies, and their texts.
//!
//! A set is a record of its policies by their hashes. Texts are kept by their hashes, so that sets which share policies share
//! texts. A text stays while a kept set or a proposal has it. The newest [`KEPT`] sets are kept; the blocks have the others.

use super::{proposed, store};
use ledger::Context;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{PolicyDigest, PolicySet, PolicyText};
use std::collections::BTreeSet;

/// How many sets of an organisation are kept.
pub(crate) const KEPT: u64 = 32;

/// The set of that number, if it is kept.
pub(crate) fn of(ctx: &Context<'_>, organisation: &str, version: u64) -> Result<Option<PolicySet>, Rejection> {
    store::read(ctx, &store::set_key(organisation, version))
}

/// The kept sets of an organisation, the newest first.
pub(crate) fn all(ctx: &Context<'_>, organisation: &str) -> Result<Vec<PolicySet>, Rejection> {
    let pairs = ctx.range(&store::sets_prefix(organisation), usize::MAX);
    pairs.iter().rev().map(|(key, value)| store::parse(key, value)).collect()
}

/// Writes a set, and forgets the one that is kept no longer.
pub(crate) fn put(ctx: &mut Context<'_>, set: &PolicySet) -> Result<(), Rejection> {
    let organisation = &set.organisation;
    store::write(ctx, &store::set_key(organisation, set.version), set)?;
    let Some(oldest) = set.version.checked_sub(KEPT) else { return Ok(()) };
    let Some(forgotten) = of(ctx, organisation, oldest)? else { return Ok(()) };
    ctx.delete(&store::set_key(organisation, oldest));
    forget(ctx, organisation, &forgotten.policies)
}

/// Keeps these texts, and says which they are.
pub(crate) fn keep(ctx: &mut Context<'_>, organisation: &str, texts: &[(String, String)]) -> Vec<PolicyDigest> {
    let kept = texts.iter().map(|(id, text)| {
        let sha256 = Hash::of(&[text.as_bytes()]).to_string();
        let key = store::text_key(organisation, &sha256);
        if ctx.get(&key).is_none() {
            ctx.put(&key, text.as_bytes().to_vec());
        }
        PolicyDigest { id: id.clone(), sha256, bytes: text.len() as u64 }
    });
    kept.collect()
}

/// Forgets those of these texts that no kept set and no proposal has.
pub(crate) fn forget(ctx: &mut Context<'_>, organisation: &str, digests: &[PolicyDigest]) -> Result<(), Rejection> {
    let mut unused: BTreeSet<&str> = digests.iter().map(|digest| digest.sha256.as_str()).collect();
    let in_sets = all(ctx, organisation)?.into_iter().flat_map(|set| set.policies);
    let proposals = proposed::all(ctx)?.into_iter().filter(|proposed| proposed.organisation == organisation);
    for used in in_sets.chain(proposals.flat_map(|proposed| proposed.policies)) {
        unused.remove(used.sha256.as_str());
    }
    for sha256 in unused {
        ctx.delete(&store::text_key(organisation, sha256));
    }
    Ok(())
}

/// The texts behind these hashes.
///
/// # Errors
/// [`Code::Corrupt`] if one is not there.
pub(crate) fn texts(
    ctx: &Context<'_>,
    organisation: &str,
    digests: &[PolicyDigest],
) -> Result<Vec<PolicyText>, Rejection> {
    let text = |digest: &PolicyDigest| {
        let bytes = ctx.get(&store::text_key(organisation, &digest.sha256));
        let text = bytes.and_then(|bytes| String::from_utf8(bytes.to_vec()).ok()).ok_or_else(|| {
            Rejection::new(Code::Corrupt, format!("the text of policy {} of {organisation} is missing", digest.id))
                .found("no text")
                .wanted(format!("one with SHA-256 {}", digest.sha256))
                .next("stop the node and delete its directory state/; it is rebuilt from the blocks")
        })?;
        Ok(PolicyText { id: digest.id.clone(), text })
    };
    digests.iter().map(text).collect()
}

/// Forgets all sets, texts and proposals of an organisation that leaves.
pub(crate) fn forget_all(ctx: &mut Context<'_>, organisation: &str) -> Result<(), Rejection> {
    for mut proposed in proposed::all(ctx)? {
        let before = proposed.approved.len();
        proposed.approved.retain(|approval| approval.principal.organisation != organisation);
        if proposed.organisation == organisation {
            proposed::remove(ctx, &proposed.id)?;
        } else if proposed.approved.len() < before {
            proposed::write(ctx, &proposed)?;
        }
    }
    for prefix in [store::sets_prefix(organisation), store::texts_prefix(organisation)] {
        for (key, _) in ctx.range(&prefix, usize::MAX) {
            ctx.delete(&key);
        }
    }
    Ok(())
}
