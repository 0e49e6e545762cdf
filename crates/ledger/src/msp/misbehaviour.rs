//! The proof that a node has lied, in a proposal that ends its vote: its organisation need not approve then.

use super::arguments::SetNodeRole;
use super::nodes::{NodeRecord, NodeRole};
use super::{NAME, SET_NODE_ROLE, organisations};
use crate::chaincode::{Call, Context};
use ledger_base::rejection::{Code, Rejection};
use ledger_light::{Misbehaviour, Voter};
use std::collections::BTreeMap;

/// Does this prove that the node has lied, and may the proof give it this role? Certificates count at the time of what was
/// signed, by the organisations of now. One that was revoked since proves as much, or its organisation could revoke it to
/// end the proof.
///
/// # Errors
/// [`Code::BadArgument`] if the role keeps the vote, or if it is no proof about this node; as [`Misbehaviour::verify`].
pub(super) fn check(
    ctx: &Context<'_>,
    nodes: &[NodeRecord],
    (node, role): (&NodeRecord, NodeRole),
    proof: &str,
) -> Result<(), Rejection> {
    let wanted = |what: &str, found: String| {
        Rejection::new(Code::BadArgument, "the proof of a lie does not justify this change").found(found).wanted(what)
    };
    if role == NodeRole::Voter {
        return Err(wanted("a proposal that ends the vote of the node", format!("role {role}")));
    }
    let bytes = hex::decode(proof).map_err(|error| wanted("the proof in hexadecimal", error.to_string()))?;
    let proof = Misbehaviour::from_bytes(&bytes)?;
    if !proof.is_lie() {
        return Err(wanted(
            "two blocks of one height, or two votes or two logs in one term",
            "two results of one block".into(),
        ));
    }
    if proof.node() != node.id {
        let found = format!("a proof about node {}", proof.node());
        return Err(wanted(&format!("one about node {} ({})", node.id, node.full_name()), found));
    }
    let known: BTreeMap<u64, Voter> = nodes
        .iter()
        .map(|node| (node.id, Voter { organisation: node.organisation.clone(), name: node.name.clone() }))
        .collect();
    let msps = organisations::trusted(ctx)?;
    proof.verify(&ctx.network(), &known, |der, time| Ok(msps.verify(der, &[], time)?)).map(drop)
}

/// The organisation that need not approve this call: that of a node that has lied, by a proof that was checked when the
/// call was proposed.
pub(super) fn accused(call: &Call) -> Option<String> {
    let [argument] = call.args.as_slice() else { return None };
    if (call.chaincode.as_str(), call.function.as_str()) != (NAME, SET_NODE_ROLE) {
        return None;
    }
    let set: SetNodeRole = serde_json::from_slice(argument).ok()?;
    set.proof.and(set.organisation)
}
