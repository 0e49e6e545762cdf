//! The keys of this chaincode and the JSON behind them.
//!
//! | key | value |
//! |---|---|
//! | `organisation/<name>` | [`crate::network::FoundingOrganisation`] |
//! | `former/<name>` | an organisation that was removed, as it was last |
//! | `node/<id, 20 digits>` | [`super::NodeRecord`] |
//! | `allowance/<organisation>` | how many nodes it may have, if the network has decided that |
//! | `joins/<organisation>` | [`super::joins::Joins`]: how many nodes it has brought in lately |
//! | `next/node`, `next/proposal` | the next number, never given twice |
//! | `rules` | array of [`crate::Activation`]; absent until rules were activated |
//! | `members` | who votes and follows in fact; only the execution of blocks writes it |
//! | `governed/<height, 20 digits>` | the control writes of a block to this chaincode ([`ledger_light::Change`]); only the execution of blocks writes it |
//! | `recovery/<height, 20 digits>` | [`super::Recovery`]: the members were changed by force; only the execution of that block writes it |
//! | `proposal/<id>` | [`super::Proposal`] |
//! | `quota/<organisation>` | [`super::SetQuota`] |
//! | `invitation/<name>` | [`super::Invitation`] |
//! | `attestation/<organisation>/<node>` | [`super::AttestationRecord`] |
//! | `certificate/<fingerprint, 32 bytes>` | a known certificate in DER |
//! | `revoked/<issuer, 32 bytes><serial>` | [`super::RevocationRecord`] |
//! | `list/<issuer, 64 hex digits>/<key, 64 hex digits>[/<scope, 64 hex digits>]` | [`super::ListRecord`]: the newest revocation list of a key of an authority about a scope |
//! | `listed/<the same>` | array of the serial numbers in that list, in hexadecimal |
//! | `stale/<organisation>` | [`super::Stale`]: what follows when its lists have ended |
//! | `end/<issuer, 32 bytes><serial>` | 8 bytes BE: the end (µs) of a known certificate of a CA that is not ours |
//! | `seen/<organisation>/<name>/<issuer, 64 hex digits>/<serial, hex digits>` | [`super::IssuedCertificate`]: a certificate of a CA that is not ours, since it signed something |
//! | `barred/<organisation>/<name>` | [`super::BarredName`]: a name of such a CA whose certificates were revoked |
//! | `identity/<organisation>/<name>` | [`super::IdentityRecord`] |
//! | `registered/<organisation>` | how many names it has registered |
//! | `look/<organisation>/<look>` | the registered name that looks so |
//! | `registrar/<organisation>/<name>` | [`super::SetRegistrar`] |
//! | `issued/<fingerprint, 32 bytes>` | a certificate that a CA has issued, in DER |
//! | `told/<organisation>/<node>` | when a node told of its refusals last, block time in microseconds |
//! | `carrier/<organisation>/<node's organisation>/<node>` | [`super::CarrierRecord`] |

use super::NAME;
use crate::chaincode::Context;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::msp::ListIssuer;
use ledger_identity::{Identity, looks};
use ledger_storage::state::StateRead;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Where the members stand: written by the execution of the blocks that change them, never by a transaction.
pub(crate) const MEMBERS_KEY: &[u8] = b"msp\0members";
/// Which rules were activated at which heights; a block that writes it may change the rules of the next one.
pub(crate) const RULES_KEY: &[u8] = b"msp\0rules";
/// Keys of the organisations start with this. A write to one changes whom the next block trusts, and the
/// rest of the same block.
pub(crate) const ORGANISATION_KEYS: &[u8] = b"msp\0organisation/";

/// Keys of the newest revocation lists start with this.
pub(crate) const LIST_KEYS: &[u8] = b"msp\0list/";
/// Keys of what follows a list that has ended start with this.
pub(crate) const STALE_KEYS: &[u8] = b"msp\0stale/";

/// Keys of the records of forced recoveries start with this.
pub(crate) const RECOVERY_KEYS: &[u8] = b"msp\0recovery/";

/// The log of who governed.
pub(crate) const CHANGE_KEYS: &[u8] = b"msp\0governed/";

pub(super) const ORGANISATIONS: &str = "organisation/";
pub(super) const NODES: &str = "node/";
pub(super) const IDENTITIES: &str = "identity/";
pub(super) const PROPOSALS: &str = "proposal/";
pub(super) const QUORUMS: &str = "quorum/";
pub(super) const INVITATIONS: &str = "invitation/";
pub(super) const ATTESTATIONS: &str = "attestation/";
pub(super) const CARRIERS: &str = "carrier/";
pub(super) const REVOKED: &[u8] = b"revoked/";
pub(super) const LISTS: &str = "list/";
pub(super) const ACTIVATIONS: &str = "rules";
pub(super) const CERTIFICATE_RULE: &str = "certificates";
pub(super) const NEXT_NODE: &str = "next/node";
pub(super) const NEXT_PROPOSAL: &str = "next/proposal";

/// The full key of a known certificate.
pub(crate) fn certificate_key(fingerprint: &Hash) -> Bytes {
    full(&known_certificate_key(fingerprint))
}

/// The full key of the change at a height.
pub(crate) fn change_key(height: u64) -> Bytes {
    [CHANGE_KEYS, format!("{height:020}").as_bytes()].concat().into()
}

/// The full key of a revocation; `key` is [`ledger_identity::Identity::revocation_key`].
pub(crate) fn revoked_key(key: &[u8]) -> Bytes {
    full(&[REVOKED, key].concat())
}

pub(super) fn organisation_key(name: &str) -> String {
    format!("{ORGANISATIONS}{name}")
}

pub(super) fn former_key(name: &str) -> String {
    format!("former/{name}")
}

pub(super) fn node_key(id: u64) -> String {
    format!("{NODES}{id:020}")
}

pub(super) fn recovery_key(height: u64) -> String {
    format!("recovery/{height:020}")
}

pub(super) fn proposal_key(id: &Hash) -> String {
    format!("{PROPOSALS}{id}")
}

pub(super) fn quota_key(organisation: &str) -> String {
    format!("quota/{organisation}")
}

pub(super) fn quorum_key(chaincode: &str, function: &str) -> String {
    format!("{QUORUMS}{chaincode}/{function}")
}

pub(super) fn invitation_key(name: &str) -> String {
    format!("{INVITATIONS}{name}")
}

pub(super) fn allowance_key(organisation: &str) -> String {
    format!("allowance/{organisation}")
}

pub(super) fn told_key(organisation: &str, node: &str) -> String {
    format!("told/{organisation}/{node}")
}

pub(super) fn joins_key(organisation: &str) -> String {
    format!("joins/{organisation}")
}

pub(super) fn attestation_key(organisation: &str, node: &str) -> String {
    format!("{ATTESTATIONS}{organisation}/{node}")
}

pub(super) fn identity_key(organisation: &str, name: &str) -> String {
    format!("{IDENTITIES}{organisation}/{name}")
}

pub(super) fn registered_key(organisation: &str) -> String {
    format!("registered/{organisation}")
}

/// Where a name stands by each of its looks.
pub(super) fn look_keys(organisation: &str, name: &str) -> Vec<String> {
    looks(name).iter().map(|look| format!("look/{organisation}/{look}")).collect()
}

pub(super) fn registrar_key(organisation: &str, name: &str) -> String {
    format!("registrar/{organisation}/{name}")
}

pub(super) fn issued_key(fingerprint: &Hash) -> Vec<u8> {
    [b"issued/", &fingerprint.0[..]].concat()
}

pub(super) fn carrier_key(organisation: &str, node_organisation: &str, node: &str) -> String {
    format!("{CARRIERS}{organisation}/{node_organisation}/{node}")
}

/// Where the lists of an authority stand.
pub(super) fn lists_of(issuer: &Hash) -> String {
    format!("{LISTS}{issuer}/")
}

pub(super) fn list_key(issuer: &ListIssuer, scope: Option<Hash>) -> String {
    format!("{LISTS}{}", of_key_and_scope(issuer, scope))
}

pub(super) fn listed_key(issuer: &ListIssuer, scope: Option<Hash>) -> String {
    format!("listed/{}", of_key_and_scope(issuer, scope))
}

fn of_key_and_scope(ListIssuer { name, key }: &ListIssuer, scope: Option<Hash>) -> String {
    scope.map_or_else(|| format!("{name}/{key}"), |scope| format!("{name}/{key}/{scope}"))
}

pub(super) fn stale_key(organisation: &str) -> String {
    format!("stale/{organisation}")
}

/// Where the end of a certificate stands; `key` is [`ledger_identity::Identity::revocation_key`].
pub(super) fn end_key(key: &[u8]) -> Vec<u8> {
    [b"end/", key].concat()
}

/// The full key of a certificate's end, and the end itself.
pub(super) fn end_of(identity: &Identity) -> (Bytes, Bytes) {
    (full(&end_key(&identity.revocation_key())), Bytes::copy_from_slice(&identity.not_after.to_be_bytes()))
}

/// Where the certificates of a name stand that have signed something.
pub(super) fn seen_of(organisation: &str, name: &str) -> String {
    format!("seen/{organisation}/{name}/")
}

pub(super) fn barred_key(organisation: &str, name: &str) -> String {
    format!("barred/{organisation}/{name}")
}

/// Where a certificate stands that has signed a transaction.
pub(super) fn known_certificate_key(fingerprint: &Hash) -> Vec<u8> {
    [b"certificate/", &fingerprint.0[..]].concat()
}

/// A key of this chaincode as the world state knows it.
pub(super) fn full(key: &[u8]) -> Bytes {
    [NAME.as_bytes(), b"\0", key].concat().into()
}

/// JSON of an answer, an event or a value.
pub(super) fn json(value: &impl Serialize) -> Result<Bytes, Rejection> {
    serde_json::to_vec(value)
        .map(Bytes::from)
        .map_err(|error| Rejection::new(Code::Internal, format!("an answer cannot be encoded: {error}")))
}

/// Reads the JSON of a value that this chaincode wrote.
pub(super) fn parse<T: DeserializeOwned>(key: &[u8], value: &[u8]) -> Result<T, Rejection> {
    serde_json::from_slice(value).map_err(|error| {
        let key = String::from_utf8_lossy(key).into_owned();
        Rejection::new(Code::Corrupt, format!("value of key {key:?} of chaincode msp cannot be read: {error}"))
            .next("delete the directory state/ while the node is stopped; it is rebuilt from the blocks")
    })
}

/// Reads a key.
pub(super) fn read<T: DeserializeOwned>(ctx: &Context<'_>, key: &str) -> Result<Option<T>, Rejection> {
    ctx.get(key.as_bytes()).map(|value| parse(key.as_bytes(), &value)).transpose()
}

/// Writes a key.
pub(super) fn write(ctx: &mut Context<'_>, key: &str, value: &impl Serialize) -> Result<(), Rejection> {
    let value = json(value)?;
    ctx.put(key.as_bytes(), value);
    Ok(())
}

/// Everything under a prefix, at most `max`, in order of keys.
pub(super) fn list<T: DeserializeOwned>(ctx: &Context<'_>, prefix: &[u8], max: usize) -> Result<Vec<T>, Rejection> {
    ctx.range(prefix, max).iter().map(|(key, value)| parse(key, value)).collect()
}

/// As [`list`], from a state.
pub(super) fn list_state<T: DeserializeOwned>(
    state: &dyn StateRead,
    prefix: &str,
    max: usize,
) -> Result<Vec<T>, Rejection> {
    state.range(&full(prefix.as_bytes()), None, max)?.iter().map(|(key, value)| parse(key, value)).collect()
}

/// As [`read`], from a state.
pub(super) fn read_state<T: DeserializeOwned>(state: &dyn StateRead, key: &str) -> Result<Option<T>, Rejection> {
    state.get(&full(key.as_bytes()))?.map(|value| parse(key.as_bytes(), &value)).transpose()
}

/// Takes the next number of a counter.
pub(super) fn next_number(ctx: &mut Context<'_>, counter: &str) -> Result<u64, Rejection> {
    let number = read::<u64>(ctx, counter)?.unwrap_or(1);
    write(ctx, counter, &number.saturating_add(1))?;
    Ok(number)
}
