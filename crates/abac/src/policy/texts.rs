//! The policies on the ledger: every organisation keeps its own, and they decide about its robots only.

use super::defaults::{DEFAULT_POLICY, DEFAULT_VERSION};
use super::{Texts, limits};
use crate::records::store;
use ledger::Context;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};

/// Most policies of one organisation.
pub(crate) const POLICIES_MAX: usize = 64;
/// The id under which the built-in policy is listed.
pub(crate) const DEFAULT_ID: &str = "default";

/// The policies that decide about the robots of an organisation.
pub(crate) fn in_force(ctx: &Context<'_>, organisation: &str) -> Result<Texts, Rejection> {
    let own = own(ctx, organisation)?;
    Ok(if own.is_empty() { built_in() } else { own })
}

/// The policies of an organisation that has put none.
pub(crate) fn built_in() -> Texts {
    vec![(DEFAULT_ID.to_owned(), DEFAULT_POLICY.to_owned())]
}

/// Policies that decide together, in force or not.
pub(crate) struct TextSet {
    pub(crate) texts: Texts,
    /// Over the texts.
    pub(crate) hash: Hash,
    /// Steps of a decision.
    pub(crate) steps: u64,
}

impl TextSet {
    /// These policies; the built-in one if there are none.
    ///
    /// # Errors
    /// [`Code::PolicyInvalid`] if a decision by all would take too many steps.
    pub(crate) fn of(texts: Texts) -> Result<Self, Rejection> {
        let texts = if texts.is_empty() { built_in() } else { texts };
        Ok(Self { hash: hash(&texts), steps: limits::steps_of_all(&texts)?, texts })
    }
}

/// The set of policies that decides about the robots of an organisation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Version {
    /// Over the texts.
    pub(crate) hash: Hash,
    /// Steps of a decision.
    pub(crate) steps: u64,
    /// Its number; 0 if the organisation has never had a policy.
    pub(crate) number: u64,
}

/// A set as it stands on the ledger. With policies of the organisation's own it is the hash, then the steps and the
/// number (`u64` BE each). Without any more it is the number alone.
enum Stored {
    Own(Version),
    BuiltIn(u64),
}

impl Stored {
    fn to_bytes(&self) -> Vec<u8> {
        match self {
            Self::BuiltIn(number) => number.to_be_bytes().to_vec(),
            Self::Own(Version { hash, steps, number }) => {
                [&hash.0[..], &steps.to_be_bytes(), &number.to_be_bytes()].concat()
            }
        }
    }

    fn parse(bytes: &[u8]) -> Option<Self> {
        if let Ok(number) = bytes.try_into() {
            return Some(Self::BuiltIn(u64::from_be_bytes(number)));
        }
        let (hash, rest) = bytes.split_first_chunk::<32>()?;
        let (steps, number) = rest.split_first_chunk::<8>()?;
        let (steps, number) = (u64::from_be_bytes(*steps), u64::from_be_bytes(number.try_into().ok()?));
        Some(Self::Own(Version { hash: Hash(*hash), steps, number }))
    }
}

/// The policies of an organisation have changed: writes down what names them now. Answers with the number of the set.
///
/// # Errors
/// [`Code::PolicyInvalid`] if a decision by all would take too many steps.
pub(crate) fn changed(ctx: &mut Context<'_>, organisation: &str, own: &Texts) -> Result<u64, Rejection> {
    let number = version(ctx, organisation)?.number.saturating_add(1);
    let stored = match own.is_empty() {
        true => Stored::BuiltIn(number),
        false => Stored::Own(Version { hash: hash(own), steps: limits::steps_of_all(own)?, number }),
    };
    ctx.put(&store::version_key(organisation), stored.to_bytes());
    Ok(number)
}

/// The version of the policies that decide about the robots of an organisation.
pub(crate) fn version(ctx: &Context<'_>, organisation: &str) -> Result<Version, Rejection> {
    let built_in = |number| Version { hash: *DEFAULT_VERSION, steps: DEFAULT_POLICY.len() as u64, number };
    let Some(value) = ctx.get(&store::version_key(organisation)) else { return Ok(built_in(0)) };
    match Stored::parse(&value) {
        Some(Stored::Own(version)) => Ok(version),
        Some(Stored::BuiltIn(number)) => Ok(built_in(number)),
        None => Err(Rejection::new(Code::Corrupt, format!("the policy version of {organisation} is not readable"))
            .found(format!("{} bytes", value.len()))
            .wanted("8 or 48 bytes")),
    }
}

/// Forgets the policies of an organisation that leaves. Their number goes on if it comes back.
pub(crate) fn forget(ctx: &mut Context<'_>, organisation: &str) -> Result<(), Rejection> {
    let number = version(ctx, organisation)?.number;
    for (id, _) in own(ctx, organisation)? {
        ctx.delete(&store::policy_key(organisation, &id));
    }
    match number {
        0 => ctx.delete(&store::version_key(organisation)),
        _ => ctx.put(&store::version_key(organisation), Stored::BuiltIn(number).to_bytes()),
    }
    Ok(())
}

/// The policies that an organisation has put itself.
pub(crate) fn own(ctx: &Context<'_>, organisation: &str) -> Result<Texts, Rejection> {
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

/// States that policies and the version that names them agree: decisions are remembered under that version, so one that
/// names other policies would keep an old decision in force.
pub(crate) fn check(ctx: &mut Context<'_>, organisation: &str, own: &Texts) {
    let wanted = (!own.is_empty()).then(|| hash(own).0.to_vec());
    let stored = ctx.get(&store::version_key(organisation)).filter(|version| version.len() != size_of::<u64>());
    let found = stored.map(|version| version.get(..32).unwrap_or(&version).to_vec());
    if found != wanted {
        let shown = |version: Option<Vec<u8>>| version.map_or_else(|| "none".to_owned(), hex::encode);
        ctx.contradicted(
            Rejection::new(Code::Corrupt, format!("the policies of {organisation} do not match their version"))
                .found(format!("version {}", shown(found)))
                .wanted(format!("version {} for {} policies", shown(wanted), own.len()))
                .next("stop the node and delete its directory state/; it is rebuilt from the blocks"),
        );
    }
}

/// Every part is preceded by its length, so that no two sets have the same bytes.
pub(crate) fn hash(texts: &Texts) -> Hash {
    let mut parts: Vec<Vec<u8>> = Vec::with_capacity(texts.len() * 4);
    for part in texts.iter().flat_map(|(id, text)| [id, text]) {
        parts.push((part.len() as u64).to_be_bytes().to_vec());
        parts.push(part.as_bytes().to_vec());
    }
    Hash::of(&parts.iter().map(Vec::as_slice).collect::<Vec<_>>())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::fixture::block;

    /// Changes the state as a fault of the program would, and says what becomes of the block.
    fn checked(body: impl FnOnce(&mut Context<'_>)) -> Result<(), Rejection> {
        block(|ctx| {
            body(ctx);
            let own = own(ctx, "Org2").unwrap();
            check(ctx, "Org2", &own);
        })
    }

    fn put(ctx: &mut Context<'_>) {
        ctx.put(&store::policy_key("Org2", "p"), b"permit(principal, action, resource);".to_vec());
    }

    fn name_them(ctx: &mut Context<'_>) {
        let named = hash(&own(ctx, "Org2").unwrap()).0.to_vec();
        ctx.put(&store::version_key("Org2"), named);
    }

    #[test]
    fn policies_that_their_version_does_not_name_stop_the_node() {
        assert!(checked(|_| ()).is_ok(), "none, and no version");
        let named = |ctx: &mut Context<'_>| {
            put(ctx);
            name_them(ctx);
        };
        assert!(checked(named).is_ok());
        let older = |ctx: &mut Context<'_>| {
            name_them(ctx);
            put(ctx);
        };
        assert_eq!(checked(older).unwrap_err().code, Code::Corrupt, "a version of what was there before");
        assert_eq!(checked(put).unwrap_err().code, Code::Corrupt, "no version");
        assert_eq!(checked(name_them).unwrap_err().code, Code::Corrupt, "a version of none");
    }
}
