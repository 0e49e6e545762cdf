//! The built-in chaincode `msp`: organisations, nodes, and what they decide together.
//!
//! Arguments in braces are one argument in JSON. Reading is for anyone.
//!
//! | function | who | answer |
//! |---|---|---|
//! | `organisations` | | JSON array of names |
//! | `organisation NAME` | | [`Organisation`] |
//! | `nodes` | | [`Nodes`] |
//! | `proposals` | | array of [`Decision`] |
//! | `attestations` | | array of [`AttestationRecord`] |
//! | `revocations` | | array of [`RevocationRecord`] |
//! | `join_node {address, name?, replace?}` | a node, for itself | [`NodeRecord`] |
//! | `set_node_role {id, role}`, `{organisation, name, role}` | an admin; see [`NodeRole`] | [`Decision`] |
//! | `invite_organisation {name, key, expires}` | an admin, with approval | [`Decision`] |
//! | `join_organisation {...}` ([`JoinOrganisation`]) | any node, for the newcomer | [`Organisation`] |
//! | `update_organisation {roots, intermediates}` | an admin, for their own | [`Organisation`] |
//! | `remove_organisation {name}` | an admin, with approval | [`Decision`] |
//! | `approve ID`, `withdraw ID` | an admin | [`Decision`], [`Proposal`] |
//! | `attest {height, hash, digest, content?}` | a node | nothing |
//! | `revoke ISSUER SERIAL [REASON]` | an admin of the issuing organisation | [`RevocationRecord`] |
//!
//! Events: `joined`, `moved` and `role_changed` with the [`NodeRecord`] and the node as subject; `proposed`,
//! `approved`, `withdrawn` and `executed` with the [`Proposal`] and its id; `invited` with the [`Invitation`] and
//! `organisation_joined`, `organisation_updated` and `organisation_removed` with the [`Organisation`], all with its name;
//! `attested` with the [`Attestation`] and the node; `revoked` with the [`RevocationRecord`] and the serial number.

mod attestations;
mod caller;
mod invitations;
mod nodes;
mod organisations;
mod proposals;
mod read;
mod revocations;
mod store;

pub use attestations::{Attest, Attestation, AttestationRecord};
pub use invitations::{INVITATION_LIFE_MAX, INVITATIONS_MAX, Invitation, InviteOrganisation, JoinOrganisation};
pub use nodes::{JoinNode, NODES_PER_ORGANISATION_MAX, NodeRecord, NodeRole, Nodes, SetNodeRole, desired};
pub use organisations::{Authority, ORGANISATIONS_MAX, Organisation};
pub use proposals::{Action, Decision, PROPOSAL_LIFE_MAX, PROPOSALS_MAX, Proposal};
pub use read::{attestations, invitation, members, nodes, organisations};
pub use revocations::RevocationRecord;

pub(crate) use read::members_record;
pub(crate) use store::{MEMBERS_KEY, ORGANISATION_KEYS, certificate_key, revoked_key};

use crate::WriteSet;
use crate::chaincode::{Chaincode, Context};
use crate::code::Code;
use crate::members::Membership;
use crate::network::Genesis;
use crate::rejection::Rejection;
use bytes::Bytes;
use store::{full, json};

/// Name of the chaincode.
pub const NAME: &str = "msp";

/// Every function and its arguments.
const FUNCTIONS: [(&str, &str); 16] = [
    ("approve", "ID"),
    ("attest", "ATTEST_JSON"),
    ("attestations", "none"),
    ("invite_organisation", "INVITE_JSON"),
    ("join_node", "NODE_JSON"),
    ("join_organisation", "JOIN_JSON"),
    ("nodes", "none"),
    ("organisation", "NAME"),
    ("organisations", "none"),
    ("proposals", "none"),
    ("remove_organisation", "NAME_JSON"),
    ("revocations", "none"),
    ("revoke", "ISSUER SERIAL [REASON]"),
    ("set_node_role", "ROLE_JSON"),
    ("update_organisation", "AUTHORITIES_JSON"),
    ("withdraw", "ID"),
];

/// The names of its events.
const EVENTS: [&str; 13] = [
    "approved",
    "attested",
    "executed",
    "invited",
    "joined",
    "moved",
    "organisation_joined",
    "organisation_removed",
    "organisation_updated",
    "proposed",
    "revoked",
    "role_changed",
    "withdrawn",
];

/// The chaincode; every node installs it.
pub struct Governance;

impl Chaincode for Governance {
    fn name(&self) -> &'static str {
        NAME
    }

    /// Everything but attestations, which nobody waits for.
    fn urgent(&self, function: &str) -> bool {
        function != "attest"
    }

    fn events(&self) -> &'static [&'static str] {
        &EVENTS
    }

    /// What takes rights away; for admins only.
    fn ends(&self, function: &str) -> bool {
        matches!(function, "revoke" | "set_node_role" | "remove_organisation" | "approve")
    }

    fn invoke(&self, ctx: &mut Context<'_>, function: &str, args: &[Bytes]) -> Result<Bytes, Rejection> {
        match (function, args) {
            ("attest", [attest]) => attestations::attest(ctx, attest),
            ("attestations", []) => attestations::list(ctx),
            ("nodes", []) => nodes::list(ctx),
            ("join_node", [join]) => nodes::join(ctx, join),
            ("set_node_role", [role]) => nodes::set_role(ctx, role),
            ("organisations", []) => json(&organisations::names(ctx)?),
            ("organisation", [name]) => organisations::show(ctx, name),
            ("invite_organisation", [invite]) => invitations::invite(ctx, invite),
            ("join_organisation", [join]) => invitations::join(ctx, join),
            ("update_organisation", [update]) => organisations::update(ctx, update),
            ("remove_organisation", [remove]) => organisations::remove(ctx, remove),
            ("proposals", []) => proposals::list(ctx),
            ("approve", [id]) => proposals::approve(ctx, id),
            ("withdraw", [id]) => proposals::withdraw(ctx, id),
            ("revocations", []) => revocations::list(ctx),
            ("revoke", [issuer, serial]) => revocations::revoke(ctx, issuer, serial, b""),
            ("revoke", [issuer, serial, reason]) => revocations::revoke(ctx, issuer, serial, reason),
            _ => Err(unknown_call(function, args.len())),
        }
    }
}

fn unknown_call(function: &str, found: usize) -> Rejection {
    match FUNCTIONS.iter().find(|(name, _)| *name == function) {
        Some((_, wanted)) => {
            Rejection::new(Code::BadArgument, format!("msp {function} is called with the wrong arguments"))
                .found(format!("{found} arguments"))
                .wanted(*wanted)
        }
        None => Rejection::unknown_function(NAME, function, &FUNCTIONS.map(|(name, _)| name)),
    }
}

/// The writes of the genesis block.
pub(crate) fn found(genesis: &Genesis) -> Result<WriteSet, Rejection> {
    let (nodes, next) = nodes::founding(genesis);
    let (voters, learners) = desired(&nodes);
    let mut writes = WriteSet::new();
    let mut put = |key: &[u8], value: Bytes| writes.insert(full(key), Some(value));
    for organisation in &genesis.organisations {
        put(store::organisation_key(&organisation.name).as_bytes(), json(organisation)?);
    }
    for node in &nodes {
        put(store::node_key(node.id).as_bytes(), json(node)?);
    }
    put(store::NEXT_NODE.as_bytes(), json(&next)?);
    writes.insert(Bytes::from_static(MEMBERS_KEY), Some(members_record(&Membership::new(voters, learners))?));
    Ok(writes)
}
