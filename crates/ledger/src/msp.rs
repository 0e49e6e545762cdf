//! The built-in chaincode `msp`: organisations, nodes, and what they decide together.
//!
//! Arguments in braces are one argument in JSON. Reading is for anyone.
//!
//! | function | who | answer |
//! |---|---|---|
//! | `organisations` | | JSON array of names |
//! | `organisation NAME` | | [`Organisation`] |
//! | `nodes` | | [`Nodes`] |
//! | `proposals [{after?, most?}]` ([`crate::Paging`]) | | array or [`crate::Page`] of [`Decision`] |
//! | `attestations` | | array of [`AttestationRecord`] |
//! | `revocations [{after?, most?}]` | | array or page of [`RevocationRecord`] |
//! | `join_node {address, name?, replace?}` | a node, for itself | [`NodeRecord`] |
//! | `set_node_role {id?, organisation?, name?, role, proof?}` ([`SetNodeRole`]) | an admin; see [`NodeRole`] | [`Decision`] |
//! | `invite_organisation {name, key, expires}` | an admin, with approval | [`Decision`] |
//! | `join_organisation {...}` ([`JoinOrganisation`]) | any node, for the newcomer | [`Organisation`] |
//! | `update_organisation {roots, intermediates}` | an admin, for their own | [`Organisation`] |
//! | `add_organisation {...}` ([`AddOrganisation`]) | an admin, with approval | [`Decision`] |
//! | `remove_organisation {name}` | an admin, with approval | [`Decision`] |
//! | `rules` | | [`RulesOverview`] |
//! | `speak {newest, release}` | a node, for itself | [`NodeRecord`] |
//! | `activate_rules {number, height?}` | an admin, with approval | [`Decision`] |
//! | `allow_nodes {organisation, nodes}` ([`AllowNodes`]) | an admin, with approval | [`Decision`] |
//! | `quorums` | | array of [`FunctionQuorum`] |
//! | `set_quorum {chaincode, function, quorum?}` ([`SetQuorum`]) | an admin, with approval | [`Decision`] |
//! | `set_certificate_rule {strict?, hands?}` ([`SetCertificateRule`]) | an admin, with approval | [`Decision`] |
//! | `quotas ORGANISATION` | | [`Quotas`] |
//! | `set_quota {organisation, KIND: NUMBER, …}` ([`SetQuota`]) | an admin, with approval | [`Decision`] |
//! | `propose {chaincode, function, args}` ([`crate::Call`]) | an admin | [`Decision`] |
//! | `approve ID`, `withdraw ID` | an admin | [`Decision`], [`Proposal`] |
//! | `attest {height, hash, digest, content?}` | a node | nothing |
//! | `revoke ISSUER SERIAL [REASON]` | an admin of the issuing organisation | [`RevocationRecord`] |
//! | `record_revocation_list {list}` ([`RecordList`]) | an admin, of an authority of their own | [`RecordedList`] |
//! | `revocation_lists` | | array of [`KnownList`] |
//! | `set_stale_lists {stale}` ([`SetStale`]) | an admin, for their own | [`SetStale`] |
//! | `invitations` | | array of [`Invitation`] |
//! | `cancel_invitation {name}` | an admin of the organisation that proposed it | [`Invitation`] |
//! | `register {...}` ([`Register`]) | an admin; a registrar, for its department | [`IdentityRecord`] |
//! | `cancel_registration {name}` | an admin; a registrar, what it has registered | nothing |
//! | `set_registrar {name, affiliation?, attributes?}` ([`SetRegistrar`]) | an admin | [`SetRegistrar`] |
//! | `registrars` | an admin | array of [`SetRegistrar`] |
//! | `enrolled [{after?, most?}]` | other chaincodes | page of `ORGANISATION/NAME` |
//! | `holder ORGANISATION/NAME` | everybody | [`CertifiedHolder`] |
//! | `identities [{after?, most?}]`, `identities {name}` | an admin, of their own organisation | array or page of [`IdentityRecord`] |
//! | `revoke_identity {name, reason?}` | an admin | [`RevokedIdentity`] |
//! | `record_certificate {...}` ([`RecordCertificate`]) | a node that carries the CA | [`Recorded`] |
//! | `tell_refusals {refusals}` ([`TellRefusals`]) | a node, once in a second | nothing |
//! | `carriers` | | array of [`CarrierRecord`] |
//! | `carry_ca {...}` ([`CarryCa`]) | a node, for itself | nothing |
//! | `uncarry_ca {organisation, node?}` | a node for itself, or an admin of the organisation | nothing |
//!
//! Events: `joined`, `moved`, `role_changed` and `speaks` with the [`NodeRecord`] and the node as subject; `proposed`,
//! `approved`, `withdrawn`, `executed` and `failed` with the [`Proposal`] and its id; `certificate_rule_changed` with the
//! [`CertificateRule`](ledger_light::CertificateRule) and `strict` or `majority`; `quorum_changed` with the
//! [`SetQuorum`] and `CHAINCODE/FUNCTION`; `quota_changed` with the [`SetQuota`] and `nodes_allowed` with the
//! [`AllowNodes`], both with the organisation; `invited` with the [`Invitation`] and
//! `organisation_joined`, `organisation_updated` and `organisation_removed` with the [`Organisation`], all with its
//! name; `revocation_list` with the [`RecordedList`] and the authority's name; `stale_lists_set` with the [`SetStale`] and the
//! organisation; `attested` with the [`Attestation`] and the node; `revoked` with the [`RevocationRecord`] and the serial
//! number; `invitation_cancelled` with the [`Invitation`] and its name; `name_barred` with the [`BarredName`], `registrar_set` with the [`SetRegistrar`], `registered` and `registration_cancelled` with
//! organisation, name, role and who did it, and `certified` with the [`IssuedCertificate`], all with
//! `ORGANISATION/NAME`; `ca_carried`, `ca_copied` and `ca_dropped` with the [`CarrierRecord`] and the node; `members_forced`
//! with the [`Recovery`] and the node; `rules_activated` with the [`crate::Activation`] and the number; `refused` with the [`TellRefusals`] and no subject, for admins and nodes.

mod addition;
mod address;
mod allowance;
mod arguments;
mod attestations;
mod authorities;
mod caller;
mod carriers;
mod certificate_rule;
mod identities;
mod invitations;
mod join_node;
mod joins;
mod misbehaviour;
mod node_roles;
mod nodes;
mod organisations;
mod own_call;
mod proposals;
mod quorums;
mod quotas;
mod read;
mod recovery;
mod refusals;
mod removal;
mod revocation_lists;
mod revocations;
mod rules;
mod set_quorum;
mod store;

pub use addition::AddOrganisation;
pub use address::never_dialled;
pub use allowance::{AllowNodes, NODES_ALLOWED_DEFAULT};
pub use arguments::{ActivateRules, InviteOrganisation, RemoveOrganisation, SetNodeRole};
pub use attestations::{Attest, Attestation, AttestationRecord, shared_snapshot};
pub use carriers::{ADOPTED_MAX, CarrierRecord, CarryCa, Copied, UncarryCa, carriers};
pub use certificate_rule::SetCertificateRule;
pub use identities::{
    AFFILIATION, BarredName, CERTIFICATES_MAX, CancelRegistration, CertifiedHolder, ENROLMENT_REPEAT_MAX, Ground,
    IdentityRecord, IssuedCertificate, KnownIdentity, LocalSecret, Maker, REGISTRARS_MAX, REGISTRATION_LIFE_MAX,
    RENEWAL_PAUSE, RecordCertificate, Recorded, Register, RevokeIdentity, RevokedIdentity, Secret, SetRegistrar, Use,
    identity, issued,
};
pub(crate) use identities::{check_barred, seen};
pub use invitations::{CancelInvitation, INVITATION_LIFE_MAX, INVITATIONS_MAX, Invitation, JoinOrganisation};
pub use join_node::JoinNode;
pub use joins::{JOINS_MAX, JOINS_TIME};
pub use nodes::{NodeRecord, NodeRole, Nodes, Speaks, desired, replacements};
pub use organisations::{Authority, ORGANISATIONS_MAX, Organisation};
pub use proposals::{
    Approval, CALL_ARGS_MAX, CALL_BYTES_MAX, Decision, Failed, PROPOSAL_LIFE_MAX, PROPOSALS_MAX, Proposal,
};
pub use quorums::{FunctionQuorum, SetQuorum};
pub use quotas::{QUOTAS, QUOTAS_MAX, Quotas, SetQuota, quota_reached, quotas_of};
pub use read::{
    admins_until, attestations, certificate_rule, changes, has_registry, invitation, members, nodes, organisations,
    recoveries, revocation_lists, strict_hands, voters,
};
pub use recovery::{REASON_BYTES_MAX, Recovery};
pub use refusals::{REFUSALS_BYTES_MAX, REFUSALS_MAX, REFUSALS_PAUSE, REFUSED_TEXT_MAX, Refused, TellRefusals};
pub use revocation_lists::{KnownList, LIST_AHEAD_MAX, ListRecord, RecordList, RecordedList, SetStale, Stale};
pub use revocations::RevocationRecord;
pub use rules::{RulesOverview, SpokenBy};

pub(crate) use certificate_rule::settle as settle_certificate_rule;
pub(crate) use nodes::leads_to_wanted;
pub(crate) use read::{activations, members_record, organisations_in};
pub(crate) use recovery::note as note_recovery;
pub(crate) use revocation_lists::{Due, due, publishes_list};
pub(crate) use store::{
    LIST_KEYS, MEMBERS_KEY, ORGANISATION_KEYS, RULES_KEY, STALE_KEYS, certificate_key, change_key, revoked_key,
};

use crate::chaincode::{Chaincode, Context, Foretold, MSP, Quorum};
use crate::members::Membership;
use crate::network::Genesis;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::result::Event;
use ledger_storage::state::WriteSet;
use store::{full, json};

/// Name of the chaincode.
pub const NAME: &str = MSP;

const ACTIVATE_RULES: &str = "activate_rules";
const ADD_ORGANISATION: &str = "add_organisation";
const ALLOW_NODES: &str = "allow_nodes";
const ENROLLED: &str = "enrolled";
const HOLDER: &str = "holder";
const INVITE_ORGANISATION: &str = "invite_organisation";
const RECORD_LIST: &str = "record_revocation_list";
const REMOVE_ORGANISATION: &str = "remove_organisation";
const SET_CERTIFICATE_RULE: &str = "set_certificate_rule";
const SET_NODE_ROLE: &str = "set_node_role";
const SET_QUORUM: &str = "set_quorum";
const SET_QUOTA: &str = "set_quota";
const REGISTRARS: &str = "registrars";
const SET_REGISTRAR: &str = "set_registrar";
const SET_STALE: &str = "set_stale_lists";
const LISTS: &str = "revocation_lists";
const TELL_REFUSALS: &str = "tell_refusals";

/// The functions that need approval. Called by an admin, they propose themselves. The last one needs that of the function whose
/// quorum it sets.
static NEEDS_APPROVAL: [(&str, Quorum); 9] = [
    (ADD_ORGANISATION, Quorum::Majority),
    (ACTIVATE_RULES, Quorum::Majority),
    (ALLOW_NODES, Quorum::Majority),
    (INVITE_ORGANISATION, Quorum::Majority),
    (REMOVE_ORGANISATION, Quorum::Majority),
    (SET_CERTIFICATE_RULE, Quorum::Majority),
    (SET_NODE_ROLE, Quorum::Majority),
    (SET_QUOTA, Quorum::Majority),
    (SET_QUORUM, Quorum::Majority),
];

/// Every function and its arguments.
const FUNCTIONS: [(&str, &str); 45] = [
    ("activate_rules", "RULES_JSON"),
    (ADD_ORGANISATION, "ORGANISATION_JSON"),
    (ALLOW_NODES, "ALLOW_JSON"),
    ("approve", "ID"),
    ("attest", "ATTEST_JSON"),
    ("attestations", "none"),
    ("cancel_invitation", "NAME_JSON"),
    ("cancel_registration", "NAME_JSON"),
    ("carriers", "none"),
    ("carry_ca", "CARRY_JSON"),
    (ENROLLED, "PAGE_JSON, from another chaincode"),
    (HOLDER, "ORGANISATION/NAME"),
    ("identities", "PAGE_JSON, NAME_JSON or none"),
    ("invitations", "none"),
    ("invite_organisation", "INVITE_JSON"),
    ("join_node", "NODE_JSON"),
    ("join_organisation", "JOIN_JSON"),
    ("nodes", "none"),
    ("organisation", "NAME"),
    ("organisations", "none"),
    ("proposals", "PAGE_JSON or none"),
    ("propose", "CALL_JSON"),
    ("quorums", "none"),
    ("quotas", "ORGANISATION"),
    ("record_certificate", "CERTIFICATE_JSON"),
    (RECORD_LIST, "LIST_JSON"),
    ("register", "REGISTER_JSON"),
    (REGISTRARS, "none"),
    ("remove_organisation", "NAME_JSON"),
    (LISTS, "none"),
    ("revocations", "PAGE_JSON or none"),
    ("revoke", "ISSUER SERIAL [REASON]"),
    ("revoke_identity", "REVOKE_JSON"),
    ("rules", "none"),
    (SET_CERTIFICATE_RULE, "RULE_JSON"),
    ("set_node_role", "ROLE_JSON"),
    ("set_quorum", "QUORUM_JSON"),
    ("set_quota", "QUOTA_JSON"),
    (SET_REGISTRAR, "REGISTRAR_JSON"),
    (SET_STALE, "STALE_JSON"),
    ("speak", "SPEAKS_JSON"),
    (TELL_REFUSALS, "REFUSALS_JSON"),
    ("uncarry_ca", "CARRIER_JSON"),
    ("update_organisation", "AUTHORITIES_JSON"),
    ("withdraw", "ID"),
];

/// Those of them that only read.
const READS: [&str; 16] = [
    "attestations",
    "carriers",
    ENROLLED,
    HOLDER,
    "identities",
    "invitations",
    "nodes",
    "organisation",
    "organisations",
    "proposals",
    "quorums",
    "quotas",
    REGISTRARS,
    LISTS,
    "revocations",
    "rules",
];

/// Those of them that end rights, or an invitation to rights.
const URGENT: [&str; 9] = [
    "approve",
    "cancel_invitation",
    "cancel_registration",
    RECORD_LIST,
    REMOVE_ORGANISATION,
    "revoke",
    "revoke_identity",
    SET_NODE_ROLE,
    "update_organisation",
];

/// The names of its events.
const EVENTS: [&str; 33] = [
    "approved",
    "attested",
    "ca_carried",
    "ca_copied",
    "ca_dropped",
    "certificate_rule_changed",
    "certified",
    "executed",
    "failed",
    "invitation_cancelled",
    "invited",
    "joined",
    "members_forced",
    "moved",
    "name_barred",
    "nodes_allowed",
    "organisation_joined",
    "organisation_removed",
    "organisation_updated",
    "proposed",
    "quorum_changed",
    "quota_changed",
    "refused",
    "registered",
    "registrar_set",
    "registration_cancelled",
    "revocation_list",
    "revoked",
    "role_changed",
    "rules_activated",
    "speaks",
    "stale_lists_set",
    "withdrawn",
];

/// The chaincode; every node installs it.
pub struct MspChaincode;

impl Chaincode for MspChaincode {
    fn name(&self) -> &'static str {
        NAME
    }

    fn urgent(&self, function: &str) -> bool {
        URGENT.contains(&function)
    }

    fn reads(&self) -> &'static [&'static str] {
        &READS
    }

    fn events(&self) -> &'static [&'static str] {
        &EVENTS
    }

    fn foretell(&self, function: &str, args: &[Bytes]) -> Option<Foretold> {
        match (function, args) {
            (TELL_REFUSALS, [told]) => Some(refusals::foretell(told)),
            _ => None,
        }
    }

    fn may_follow(&self, ctx: &Context<'_>, _subjects: &[String], names: &[String]) -> Result<(), Rejection> {
        if names.iter().any(|name| name == "refused") { refusals::may_read(ctx) } else { Ok(()) }
    }

    fn may_read(&self, ctx: &Context<'_>, event: &Event) -> Result<(), Rejection> {
        if event.name == "refused" { refusals::may_read(ctx) } else { Ok(()) }
    }

    /// Functions that take rights away; for admins only.
    fn ends(&self, function: &str) -> bool {
        matches!(function, "revoke" | RECORD_LIST | "set_node_role" | "remove_organisation" | "approve")
    }

    fn control_keys(&self) -> &'static [&'static str] {
        &["barred/", "certificates", "members", "node/", "organisation/", "recovery/", "revoked/", "rules"]
    }

    fn needs_approval(&self) -> &'static [(&'static str, Quorum)] {
        &NEEDS_APPROVAL
    }

    fn invoke(&self, ctx: &mut Context<'_>, function: &str, args: &[Bytes]) -> Result<Bytes, Rejection> {
        match (function, args) {
            ("attest", [attest]) => attestations::attest(ctx, attest),
            ("attestations", []) => attestations::list(ctx),
            (ENROLLED, [page]) if ctx.is_inner() => identities::enrolled(ctx, page),
            (HOLDER, [id]) => identities::holder(ctx, id),
            ("identities", [] | [_]) => identities::list(ctx, args),
            ("register", [register]) => identities::register(ctx, register),
            ("cancel_registration", [cancel]) => identities::cancel(ctx, cancel),
            ("revoke_identity", [revoke]) => identities::revoke(ctx, revoke),
            ("record_certificate", [record]) => identities::record(ctx, record),
            ("carriers", []) => carriers::list(ctx),
            ("carry_ca", [carry]) => carriers::carry(ctx, carry),
            ("uncarry_ca", [uncarry]) => carriers::uncarry(ctx, uncarry),
            ("invitations", []) => invitations::list(ctx),
            ("cancel_invitation", [cancel]) => invitations::cancel(ctx, cancel),
            ("nodes", []) => nodes::list(ctx),
            ("join_node", [join]) => join_node::join(ctx, join),
            (SET_CERTIFICATE_RULE, [rule]) => certificate_rule::set(ctx, rule),
            (SET_NODE_ROLE, [role]) => node_roles::set_role(ctx, role),
            ("organisations", []) => json(&organisations::names(ctx)?),
            ("organisation", [name]) => organisations::show(ctx, name),
            (INVITE_ORGANISATION, [invite]) => invitations::invite(ctx, invite),
            ("join_organisation", [join]) => invitations::join(ctx, join),
            ("update_organisation", [update]) => authorities::update(ctx, update),
            (REMOVE_ORGANISATION, [remove]) => removal::remove(ctx, remove),
            ("rules", []) => rules::show(ctx),
            ("speak", [speaks]) => rules::speak(ctx, speaks),
            (TELL_REFUSALS, [told]) => refusals::tell(ctx, told),
            (ACTIVATE_RULES, [activate]) => rules::activate(ctx, activate),
            (ALLOW_NODES, [allow]) => allowance::allow(ctx, allow),
            ("proposals", [] | [_]) => proposals::list(ctx, args),
            ("quorums", []) => quorums::list(ctx),
            (SET_QUORUM, [quorum]) => set_quorum::set(ctx, quorum),
            ("quotas", [organisation]) => quotas::show(ctx, organisation),
            (SET_QUOTA, [quota]) => quotas::set(ctx, quota),
            ("propose", [call]) => proposals::propose(ctx, call),
            ("approve", [id]) => proposals::approve(ctx, id),
            ("withdraw", [id]) => proposals::withdraw(ctx, id),
            ("revocations", [] | [_]) => revocations::list(ctx, args),
            (REGISTRARS, []) => identities::registrars(ctx),
            (SET_REGISTRAR, [registrar]) => identities::set_registrar(ctx, registrar),
            (LISTS, []) => revocation_lists::list(ctx),
            (RECORD_LIST, [list]) => revocation_lists::record(ctx, list),
            (SET_STALE, [stale]) => revocation_lists::set_stale(ctx, stale),
            (ADD_ORGANISATION, [add]) => addition::add(ctx, add),
            ("revoke", [issuer, serial]) => revocations::revoke(ctx, issuer, serial, b""),
            ("revoke", [issuer, serial, reason]) => revocations::revoke(ctx, issuer, serial, reason),
            _ => Err(unknown_call(function, args.len())),
        }
    }
}

fn unknown_call(function: &str, found: usize) -> Rejection {
    match FUNCTIONS.iter().find(|(name, _)| *name == function) {
        Some((_, wanted)) => Rejection::new(Code::BadArgument, format!("wrong arguments for msp {function}"))
            .found(format!("{found} arguments"))
            .wanted(*wanted),
        None => unknown_function(function),
    }
}

fn unknown_function(function: &str) -> Rejection {
    Rejection::unknown_function(NAME, function, &FUNCTIONS.map(|(name, _)| name))
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
    if let Some(rule) = certificate_rule::founding(&nodes) {
        put(store::CERTIFICATE_RULE.as_bytes(), json(&rule)?);
    }
    writes.insert(Bytes::from_static(MEMBERS_KEY), Some(members_record(&Membership::new(voters, learners))?));
    Ok(writes)
}
