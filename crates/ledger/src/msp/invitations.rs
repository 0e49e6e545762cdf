//! How an organisation comes in: the others approve an invitation, the newcomer answers it with a signature.
//!
//! Nobody of the network signs for the newcomer, who has no certificate that counts yet. So the invitation names a
//! public key, its private half travels in the token, and the newcomer signs all that it brings with it. A carrier of
//! the request can lose it but not change it.

use super::INVITE_ORGANISATION;
use super::address::check_address;
use super::arguments::InviteOrganisation;
use super::caller::{admin, check_name, node, object};
use super::organisations;
use super::own_call::own_call;
use super::proposals::decide;
use super::store::{self, INVITATIONS, invitation_key, json};
use crate::chaincode::Context;
use crate::network::{FoundingOrganisation, hex_list};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::moment::rfc3339;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::{PublicKey, SigningKey};
use ledger_identity::{NAME_BYTES_MAX, check_readable, looks};
use serde::{Deserialize, Deserializer, Serialize};

/// Longest life of an invitation, in microseconds of block time: thirty days.
pub const INVITATION_LIFE_MAX: u64 = 30 * 24 * 3600 * 1_000_000;
/// Most invitations that stand at once.
pub const INVITATIONS_MAX: usize = 64;
/// Separates these signatures from everything else that is signed.
const SIGNATURE_DOMAIN: &[u8] = b"ledgerd join organisation v1\0";

/// An invitation that stands on the ledger: approved, not yet answered.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Invitation {
    /// Name of the organisation that may join.
    pub name: String,
    /// The public half of an Ed25519 key.
    pub key: Hash,
    /// Last block time at which it can be answered, microseconds.
    pub expires: u64,
    /// The organisation that proposed it, which can take it back.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub by: String,
}

/// Argument of `cancel_invitation`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CancelInvitation {
    /// Name of the organisation that was invited.
    pub name: String,
}

/// Argument of `join_organisation`: what the newcomer brings, and its signature.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JoinOrganisation {
    /// Name and authorities. Its certificates name roles in our words: nobody signs for others.
    #[serde(flatten, deserialize_with = "with_our_words")]
    pub organisation: FoundingOrganisation,
    /// Name of its first node.
    pub node_name: String,
    /// `HOST:PORT` of that node.
    pub address: String,
    /// Signature with the invitation's key, in hexadecimal (see [`JoinOrganisation::sign`]).
    pub signature: String,
}

impl JoinOrganisation {
    /// Answers an invitation to a network; `key` is the key of the invitation.
    pub fn sign(
        network: &Hash,
        organisation: FoundingOrganisation,
        node_name: &str,
        address: &str,
        key: &SigningKey,
    ) -> Self {
        let (node_name, address) = (node_name.to_owned(), address.to_owned());
        let mut join = Self { organisation, node_name, address, signature: String::new() };
        join.signature = hex::encode(key.sign(&join.signed_bytes(network)));
        join
    }

    /// The signed bytes: every part with its length in front, so that it can be read in one way only.
    fn signed_bytes(&self, network: &Hash) -> Vec<u8> {
        let mut bytes = SIGNATURE_DOMAIN.to_vec();
        let mut part = |part: &[u8]| {
            bytes.extend_from_slice(&(part.len() as u64).to_be_bytes());
            bytes.extend_from_slice(part);
        };
        part(&network.0);
        part(self.organisation.name.as_bytes());
        for list in [&self.organisation.roots, &self.organisation.intermediates] {
            part(&(list.len() as u64).to_be_bytes());
            list.iter().for_each(|certificate| part(certificate));
        }
        part(self.node_name.as_bytes());
        part(self.address.as_bytes());
        bytes
    }
}

/// Reads what the signature of a [`JoinOrganisation`] covers, and nothing else.
fn with_our_words<'de, D: Deserializer<'de>>(deserializer: D) -> Result<FoundingOrganisation, D::Error> {
    #[derive(Deserialize)]
    struct Signed {
        name: String,
        #[serde(with = "hex_list")]
        roots: Vec<Bytes>,
        #[serde(with = "hex_list", default)]
        intermediates: Vec<Bytes>,
    }

    let Signed { name, roots, intermediates } = Signed::deserialize(deserializer)?;
    Ok(FoundingOrganisation { name, roots, intermediates, units: None })
}

/// `invite_organisation {name, key, expires}`
pub(super) fn invite(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let wanted = "{\"name\": NAME, \"key\": 64 hex digits, \"expires\": block time in microseconds}";
    let invite: InviteOrganisation = object("invite_organisation", argument, wanted)?;
    if let Some(approved) = ctx.approved_by() {
        return execute(ctx, invite, &approved.proposer);
    }
    let caller = admin(ctx, "invite organisations")?;
    check(ctx, &invite.name, invite.expires)?;
    let call = own_call(INVITE_ORGANISATION, &invite)?;
    json(&decide(ctx, caller, call)?)
}

/// Does what was approved.
fn execute(ctx: &mut Context<'_>, invite: InviteOrganisation, by: &str) -> Result<Bytes, Rejection> {
    let InviteOrganisation { name, key, expires } = invite;
    check(ctx, &name, expires)?;
    for old in store::list::<Invitation>(ctx, INVITATIONS.as_bytes(), INVITATIONS_MAX)? {
        if old.expires < ctx.block_time() {
            ctx.delete(invitation_key(&old.name).as_bytes());
        }
    }
    let standing: Vec<Invitation> = store::list(ctx, INVITATIONS.as_bytes(), INVITATIONS_MAX)?;
    if standing.len() >= INVITATIONS_MAX && standing.iter().all(|other| other.name != name) {
        return Err(Rejection::new(Code::LimitExceeded, "there are too many open invitations")
            .found(standing.len().to_string())
            .wanted(format!("at most {INVITATIONS_MAX}")));
    }
    let invitation = Invitation { name, key, expires, by: by.to_owned() };
    store::write(ctx, &invitation_key(&invitation.name), &invitation)?;
    let answer = json(&invitation)?;
    ctx.emit("invited", &invitation.name, answer.clone());
    Ok(answer)
}

/// `invitations`: those that can still be answered.
pub(super) fn list(ctx: &Context<'_>) -> Result<Bytes, Rejection> {
    let mut standing: Vec<Invitation> = store::list(ctx, INVITATIONS.as_bytes(), INVITATIONS_MAX)?;
    standing.retain(|invitation| invitation.expires >= ctx.block_time());
    json(&standing)
}

/// `cancel_invitation {name}`: by an admin of the organisation that proposed it; from then on its token is good for
/// nothing.
pub(super) fn cancel(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let CancelInvitation { name } = object("cancel_invitation", argument, "{\"name\": NAME}")?;
    let caller = admin(ctx, "cancel invitations")?;
    let key = invitation_key(&name);
    let standing: Option<Invitation> = if name.len() <= NAME_BYTES_MAX { store::read(ctx, &key)? } else { None };
    let Some(invitation) = standing else {
        let name: String = name.chars().take(NAME_BYTES_MAX).collect();
        return Err(Rejection::new(Code::NotFound, format!("there is no invitation of {name:?}"))
            .wanted("an invitation that was approved and not used yet")
            .next("ledgerctl network invite --list; open proposals: ledgerctl network proposals"));
    };
    if !invitation.by.is_empty() && invitation.by != caller.organisation {
        return Err(Rejection::new(Code::NotAdmin, format!("{} may not cancel this invitation", caller.id()))
            .found(format!("an admin of {}", caller.organisation))
            .wanted(format!("an admin of {}, which proposed it", invitation.by))
            .next(format!("ask an admin of {}", invitation.by)));
    }
    ctx.delete(key.as_bytes());
    ctx.emit("invitation_cancelled", &name, json(&invitation)?);
    json(&invitation)
}

/// Takes back what an organisation that leaves has proposed: nobody else can cancel it.
pub(super) fn forget_organisation(ctx: &mut Context<'_>, name: &str) -> Result<(), Rejection> {
    for invitation in store::list::<Invitation>(ctx, INVITATIONS.as_bytes(), INVITATIONS_MAX)? {
        if invitation.by == name {
            ctx.delete(invitation_key(&invitation.name).as_bytes());
            ctx.emit("invitation_cancelled", &invitation.name, json(&invitation)?);
        }
    }
    Ok(())
}

/// `join_organisation {name, roots, intermediates, node_name, address, signature}`: carried by a node of the network.
pub(super) fn join(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    let wanted = "{\"name\", \"roots\", \"intermediates\", \"node_name\", \"address\", \"signature\"}";
    let join: JoinOrganisation = object("join_organisation", argument, wanted)?;
    node(ctx, "forward the request of an organisation to join")?;
    let name = &join.organisation.name;
    // An answer that was lost is asked for again.
    if organisations::find(ctx, name)?.is_some_and(|known| known == join.organisation) {
        return json(&organisations::describe(&join.organisation)?);
    }
    let key = invitation_key(name);
    let invitation: Option<Invitation> = if name.len() <= NAME_BYTES_MAX { store::read(ctx, &key)? } else { None };
    let Some(invitation) = invitation else { return Err(not_invited(name, "no approved invitation")) };
    if invitation.expires < ctx.block_time() {
        return Err(not_invited(name, "an expired invitation"));
    }
    let signature = hex::decode(&join.signature).unwrap_or_default();
    PublicKey::from_ed25519(invitation.key.0)
        .verify(&join.signed_bytes(&ctx.network()), &signature)
        .map_err(|error| not_invited(name, &error.to_string()))?;
    check_name(&join.node_name)?;
    check_address(&join.address)?;
    organisations::add(ctx, &join.organisation)?;
    ctx.delete(key.as_bytes());
    let answer = json(&organisations::describe(&join.organisation)?)?;
    ctx.emit("organisation_joined", name, answer.clone());
    Ok(answer)
}

fn check(ctx: &Context<'_>, name: &str, expires: u64) -> Result<(), Rejection> {
    check_name(name)?;
    if organisations::find(ctx, name)?.is_some() {
        return Err(Rejection::new(Code::AlreadyExists, format!("the network has an organisation {name} already"))
            .next("choose another name; for a node of it: ledgerctl network invite --node NAME"));
    }
    check_look(ctx, name)?;
    organisations::check_room(ctx)?;
    let now = ctx.block_time();
    if expires <= now || expires > now.saturating_add(INVITATION_LIFE_MAX) {
        return Err(Rejection::new(Code::BadArgument, "the expiry of the invitation is out of range")
            .found(format!("{}, block time {}", rfc3339(expires), rfc3339(now)))
            .wanted("a time in the next 30 days"));
    }
    Ok(())
}

/// A new organisation has a name that people can tell from the others.
pub(super) fn check_look(ctx: &Context<'_>, name: &str) -> Result<(), Rejection> {
    check_readable(name)?;
    let wanted = looks(name);
    let alike = |known: &FoundingOrganisation| !looks(&known.name).is_disjoint(&wanted);
    let Some(known) = organisations::all(ctx)?.into_iter().find(alike) else {
        return Ok(());
    };
    Err(Rejection::new(Code::AlreadyExists, format!("{name:?} looks like an organisation of the network"))
        .found(format!("{:?}", known.name))
        .wanted("a name that is visibly different from the others (UTS 39)")
        .next("choose another name"))
}

fn not_invited(name: &str, found: &str) -> Rejection {
    let name: String = name.chars().take(128).collect();
    Rejection::new(Code::NotInvited, format!("organisation {name:?} may not join"))
        .found(found.to_owned())
        .wanted("a request signed with the key of an invitation that more than half of the organisations approved")
        .next(format!(
            "ledgerctl network proposals shows the missing approvals; ledgerctl network invite \
                       --organisation {name} invites again"
        ))
}
