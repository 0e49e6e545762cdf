//! The records of the ledger about the network, read from a world state: for the node, and for a reader of a snapshot.

use super::IdentityRecord;
use super::attestations::{ATTESTATIONS_MAX, AttestationRecord};
use super::invitations::Invitation;
use super::nodes::{NodeRecord, RECORDS_MAX};
use super::organisations::ORGANISATIONS_MAX;
use super::revocation_lists::{LISTS_MAX, ListRecord, current};
use super::store::{
    ACTIVATIONS, ATTESTATIONS, CERTIFICATE_RULE, CHANGE_KEYS, LISTS, MEMBERS_KEY, NODES, ORGANISATION_KEYS,
    ORGANISATIONS, RECOVERY_KEYS, change_key, full, identity_key, invitation_key, json, list_state, parse, read_state,
    registered_key, revoked_key,
};
use crate::members::Membership;
use crate::network::FoundingOrganisation;
use crate::rules::Activation;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use ledger_light::{CertificateRule, Change, Voter, Voters};
use ledger_storage::state::{Overlay, StateRead};
use std::collections::BTreeMap;

/// Records of identities that are read at once.
const IDENTITIES_PAGE: usize = 256;
/// Most forced recoveries that are counted.
const RECOVERIES_MAX: usize = 1 << 20;

/// The records of the nodes in order of ids, removed ones among them: what the network wants (see
/// [`super::desired`]).
///
/// # Errors
/// A fault of the store; [`Code::Corrupt`] if a record cannot be read. So for all functions here.
pub fn nodes(state: &dyn StateRead) -> Result<Vec<NodeRecord>, Rejection> {
    list_state(state, NODES, RECORDS_MAX)
}

/// The organisations with their authorities, in order of names.
///
/// # Errors
/// As [`nodes`].
pub fn organisations(state: &dyn StateRead) -> Result<Vec<FoundingOrganisation>, Rejection> {
    list_state(state, ORGANISATIONS, ORGANISATIONS_MAX)
}

/// The same, as the transactions of a block so far have left them.
pub(crate) fn organisations_in(overlay: &Overlay) -> Result<Vec<FoundingOrganisation>, Rejection> {
    overlay.range(ORGANISATION_KEYS, ORGANISATIONS_MAX).iter().map(|(key, value)| parse(key, value)).collect()
}

/// The revocation lists of authorities that say something about today.
///
/// # Errors
/// As [`nodes`].
pub fn revocation_lists(state: &dyn StateRead) -> Result<Vec<ListRecord>, Rejection> {
    list_state(state, LISTS, LISTS_MAX).map(current)
}

/// The last attestation of each node.
///
/// # Errors
/// As [`nodes`].
pub fn attestations(state: &dyn StateRead) -> Result<Vec<AttestationRecord>, Rejection> {
    list_state(state, ATTESTATIONS, ATTESTATIONS_MAX)
}

/// The approved invitation of an organisation; it may have expired.
///
/// # Errors
/// As [`nodes`].
pub fn invitation(state: &dyn StateRead, name: &str) -> Result<Option<Invitation>, Rejection> {
    read_state(state, &invitation_key(name))
}

/// Does this organisation register names on the ledger? One whose CA is another software does not.
///
/// # Errors
/// As [`nodes`].
pub fn has_registry(state: &dyn StateRead, organisation: &str) -> Result<bool, Rejection> {
    Ok(read_state::<u64>(state, &registered_key(organisation))?.is_some_and(|names| names > 0))
}

/// The end of the last certificate of an admin of this organisation that is valid now, microseconds; 0 if there is none.
///
/// # Errors
/// As [`nodes`].
pub fn admins_until(state: &dyn StateRead, organisation: &str, now: u64) -> Result<u64, Rejection> {
    let prefix = full(identity_key(organisation, "").as_bytes());
    let mut after: Option<Bytes> = None;
    let mut last = 0;
    loop {
        let page = state.range(&prefix, after.as_deref(), IDENTITIES_PAGE)?;
        for (key, value) in &page {
            let record: IdentityRecord = parse(key, value)?;
            let issued =
                record.certificates.iter().filter(|issued| record.role == Role::Admin && issued.not_after > now);
            for issued in issued {
                let serial = hex::decode(&issued.serial).unwrap_or_default();
                let is_revoked = state.get(&revoked_key(&[&issued.issuer.0[..], &serial].concat()))?.is_some();
                last = if is_revoked { last } else { last.max(issued.not_after) };
            }
        }
        match page.into_iter().next_back() {
            Some((key, _)) => after = Some(key),
            None => return Ok(last),
        }
    }
}

/// The voters and learners in fact.
///
/// # Errors
/// As [`nodes`].
pub fn members(state: &dyn StateRead) -> Result<Membership, Rejection> {
    let record =
        state.get(MEMBERS_KEY)?.ok_or_else(|| Rejection::new(Code::Corrupt, "the world state contains no members"))?;
    parse(MEMBERS_KEY, &record)
}

/// The voters, with the names by which the certificates of all nodes are known: one that votes soon may have to be believed
/// before this state knows that it votes.
///
/// # Errors
/// As [`members`].
pub fn voters(state: &dyn StateRead) -> Result<Voters, Rejection> {
    let Membership { voters, outgoing, .. } = members(state)?;
    let nodes = nodes(state)?
        .into_iter()
        .map(|NodeRecord { id, organisation, name, .. }| (id, Voter { organisation, name }))
        .collect();
    let (rule, recoveries) = (certificate_rule(state)?, recoveries(state)?);
    Ok(Voters { nodes, voters, outgoing, rule, recoveries })
}

/// How many signatures make a certificate of the next block.
///
/// # Errors
/// As [`nodes`].
pub fn certificate_rule(state: &dyn StateRead) -> Result<CertificateRule, Rejection> {
    Ok(read_state(state, CERTIFICATE_RULE)?.unwrap_or_default())
}

/// While certificates are strict: under which hand each node is.
///
/// # Errors
/// As [`nodes`].
pub fn strict_hands(state: &dyn StateRead) -> Result<Option<BTreeMap<u64, String>>, Rejection> {
    let rule = certificate_rule(state)?;
    if rule.strict_since.is_none() {
        return Ok(None);
    }
    let hand = |node: NodeRecord| (node.id, rule.hand(&node.organisation).to_owned());
    Ok(Some(nodes(state)?.into_iter().map(hand).collect()))
}

/// The number of forced recoveries: statements and votes name it.
///
/// # Errors
/// As [`nodes`].
pub fn recoveries(state: &dyn StateRead) -> Result<u64, Rejection> {
    Ok(state.range(RECOVERY_KEYS, None, RECOVERIES_MAX)?.len() as u64)
}

/// The changes of who governs after a height, oldest first, at most so many.
///
/// # Errors
/// As [`nodes`].
pub fn changes(state: &dyn StateRead, after: u64, most: usize) -> Result<Vec<Change>, Rejection> {
    let logged = state.range(CHANGE_KEYS, Some(&change_key(after)), most)?;
    let read = |(key, value): &(Bytes, Bytes)| {
        let height = key.strip_prefix(CHANGE_KEYS).and_then(|height| std::str::from_utf8(height).ok()?.parse().ok());
        let height = height.ok_or_else(|| Rejection::new(Code::Corrupt, "a key of the change log has no height"))?;
        Change::from_bytes(height, value)
    };
    logged.iter().map(read).collect()
}

/// The rules that were activated, in order of heights.
pub(crate) fn activations(state: &dyn StateRead) -> Result<Vec<Activation>, Rejection> {
    Ok(read_state(state, ACTIVATIONS)?.unwrap_or_default())
}

/// The members as they stand on the ledger.
pub(crate) fn members_record(members: &Membership) -> Result<Bytes, Rejection> {
    json(members)
}
