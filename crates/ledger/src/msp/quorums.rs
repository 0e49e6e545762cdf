//! How many must approve which call: a rule for each function that needs approval, on the ledger.
//!
//! A function begins with the quorum of its chaincode's table. Another one is set by a proposal, which needs the quorum
//! that the function has then: nobody makes it easier than it is to decide.

use super::caller::object;
use super::store::{self, QUORUMS, json, quorum_key};
use super::{NAME, SET_QUORUM, misbehaviour, organisations};
use crate::chaincode::{Call, Context, Quorum, quorum_of};
use bytes::Bytes;
use ledger_base::rejection::Rejection;
use serde::{Deserialize, Serialize};

/// Most rules that are read at once; there is at most one for each function.
const QUORUMS_MAX: usize = 1024;

/// Argument of `set_quorum`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetQuorum {
    /// Name of the chaincode.
    pub chaincode: String,
    /// Name of the function.
    pub function: String,
    /// Its quorum; that of the chaincode's table if it is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quorum: Option<Quorum>,
}

/// The quorum of a function; answer of `quorums`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FunctionQuorum {
    /// Name of the chaincode.
    pub chaincode: String,
    /// Name of the function.
    pub function: String,
    /// The quorum in force.
    pub quorum: Quorum,
    /// Was it set by a proposal? Otherwise it is that of the chaincode's table.
    pub set: bool,
}

/// `quorums`: every function that needs approval. `set_quorum` has that of the function whose quorum it sets.
pub(super) fn list(ctx: &Context<'_>) -> Result<Bytes, Rejection> {
    let mut quorums = Vec::new();
    for chaincode in ctx.registry().iter() {
        for (function, default) in chaincode.needs_approval() {
            if (chaincode.name(), *function) == (NAME, SET_QUORUM) {
                continue;
            }
            let set = store::read::<Quorum>(ctx, &quorum_key(chaincode.name(), function))?;
            quorums.push(FunctionQuorum {
                chaincode: chaincode.name().to_owned(),
                function: (*function).to_owned(),
                set: set.is_some(),
                quorum: set.unwrap_or_else(|| default.clone()),
            });
        }
    }
    json(&quorums)
}

/// The quorum that a proposed call needs now. A function that newer rules have taken away needs what most do; its call is
/// then refused.
fn of(ctx: &Context<'_>, call: &Call) -> Result<Quorum, Rejection> {
    let Call { chaincode, function, args } = call;
    let changed = ((chaincode.as_str(), function.as_str()) == (NAME, SET_QUORUM)).then_some(args.first()).flatten();
    let (chaincode, function) = match changed.map(argument).transpose()? {
        Some(set) => (set.chaincode, set.function),
        None => (chaincode.clone(), function.clone()),
    };
    if let Some(set) = store::read(ctx, &quorum_key(&chaincode, &function))? {
        return Ok(set);
    }
    let default = ctx.registry().find(&chaincode).and_then(|chaincode| quorum_of(chaincode, &function).cloned());
    Ok(default.unwrap_or(Quorum::Majority))
}

/// The organisations whose approvals count for a proposed call, and the quorum of them that it needs. The organisation of a
/// node that has lied has no voice in the end of its vote; where its admins alone would decide, most of the others do.
pub(super) fn electorate(ctx: &Context<'_>, call: &Call) -> Result<(Vec<String>, Quorum), Rejection> {
    let (mut organisations, quorum) = (organisations::names(ctx)?, of(ctx, call)?);
    let Some(accused) = misbehaviour::accused(call) else { return Ok((organisations, quorum)) };
    organisations.retain(|name| *name != accused);
    Ok(match quorum {
        Quorum::Admins { of: Some(name), .. } if name == accused => (organisations, Quorum::Majority),
        quorum => (organisations, quorum),
    })
}

/// Rules that count admins of an organisation end when it leaves: nobody could fulfil them.
pub(super) fn forget_organisation(ctx: &mut Context<'_>, name: &str) -> Result<(), Rejection> {
    for (key, value) in ctx.range(QUORUMS.as_bytes(), QUORUMS_MAX) {
        if matches!(store::parse(&key, &value)?, Quorum::Admins { of: Some(organisation), .. } if organisation == name)
        {
            ctx.delete(&key);
        }
    }
    Ok(())
}

/// The argument of `set_quorum`.
pub(super) fn argument(argument: &Bytes) -> Result<SetQuorum, Rejection> {
    let wanted = "{\"chaincode\": NAME, \"function\": NAME, \"quorum\": \"organisations = majority\"}";
    object(SET_QUORUM, argument, wanted)
}
