//! The built-in chaincode `msp`: which organisations belong to the network, whose certificates are known, and which
//! are revoked.
//!
//! | function | arguments | who | answer |
//! |---|---|---|---|
//! | `organisations` | | anyone | JSON array of names |
//! | `revoke` | issuer (hex), serial (hex), reason (optional) | an admin of the issuing organisation | JSON [`RevocationRecord`] |
//! | `revocations` | | anyone | JSON array of [`RevocationRecord`] |

use crate::certificate::Certificate;
use crate::chaincode::{Chaincode, Context, Revocation, StateRead};
use crate::code::Code;
use crate::identity::Role;
use crate::members::Membership;
use crate::network::{FoundingOrganisation, Genesis};
use crate::rejection::Rejection;
use crate::{Hash, WriteSet};
use bytes::Bytes;
use serde::{Deserialize, Serialize};

/// Name of the chaincode.
pub const NAME: &str = "msp";
/// Most entries that a list answers with.
const LIST_MAX: usize = 10_000;
/// Most bytes of a reason.
const REASON_BYTES_MAX: usize = 512;

/// A revoked certificate, as it stands on the ledger.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RevocationRecord {
    /// SHA-256 of the issuer's distinguished name.
    pub issuer: Hash,
    /// Serial number in hexadecimal.
    pub serial: String,
    /// Organisation of the issuer.
    pub organisation: String,
    /// Height of the block that revoked it.
    pub height: u64,
    /// Block time of it, microseconds since the UNIX epoch.
    pub time: u64,
    /// Who revoked it.
    pub by: String,
    /// Why; may be empty.
    pub reason: String,
}

/// The chaincode; every node installs it.
pub struct Governance;

impl Chaincode for Governance {
    fn name(&self) -> &'static str {
        NAME
    }

    fn urgent(&self, _function: &str) -> bool {
        true
    }

    fn invoke(&self, ctx: &mut Context<'_>, function: &str, args: &[Bytes]) -> Result<Bytes, Rejection> {
        match (function, args) {
            ("organisations", []) => json(&organisations(ctx)?.iter().map(|o| o.name.as_str()).collect::<Vec<_>>()),
            ("revocations", []) => json(&revocations(ctx)?),
            ("revoke", [issuer, serial]) => revoke(ctx, issuer, serial, b""),
            ("revoke", [issuer, serial, reason]) => revoke(ctx, issuer, serial, reason),
            ("organisations" | "revocations", _) => Err(bad_arguments(function, args.len(), "none")),
            ("revoke", _) => Err(bad_arguments(function, args.len(), "ISSUER SERIAL [REASON]")),
            _ => Err(Rejection::unknown_function(NAME, function, &["organisations", "revoke", "revocations"])),
        }
    }
}

/// The writes of the genesis block.
pub(crate) fn found(genesis: &Genesis) -> Result<WriteSet, Rejection> {
    let ids = |voter| genesis.nodes.iter().filter(move |node| node.voter == voter).map(|node| node.id);
    let members = (Bytes::from_static(MEMBERS_KEY), Some(members_record(&Membership::new(ids(true), ids(false)))?));
    let organisations = genesis
        .organisations
        .iter()
        .map(|organisation| Ok((full(&organisation_key(&organisation.name)), Some(json(organisation)?))));
    organisations.chain([Ok(members)]).collect()
}

/// Where the members stand: written by the execution of the blocks that change them, never by a transaction.
pub(crate) const MEMBERS_KEY: &[u8] = b"msp\0members";

/// Who votes and who follows.
pub(crate) fn read_members(state: &dyn StateRead) -> Result<Membership, Rejection> {
    let record = state.get(MEMBERS_KEY)?;
    record.and_then(|record| serde_json::from_slice(&record).ok()).ok_or_else(|| {
        Rejection::new(Code::Corrupt, "the members on the ledger cannot be read")
            .next("delete the state directory; the node rebuilds it from the blocks")
    })
}

/// The members as they stand under [`MEMBERS_KEY`].
pub(crate) fn members_record(members: &Membership) -> Result<Bytes, Rejection> {
    json(members)
}

/// Keys of the organisations start with this; a block that writes one changes whom the next block trusts.
pub(crate) const ORGANISATION_KEYS: &[u8] = b"msp\0organisation/";

/// Reads an organisation as it is stored under [`ORGANISATION_KEYS`].
pub(crate) fn read_organisation(value: &[u8]) -> Result<FoundingOrganisation, Rejection> {
    serde_json::from_slice(value).map_err(|error| {
        Rejection::new(Code::Corrupt, format!("an organisation on the ledger cannot be read: {error}"))
    })
}

/// The full key of a known certificate.
pub(crate) fn certificate_key(fingerprint: &Hash) -> Bytes {
    full(&[b"certificate/", &fingerprint.0[..]].concat())
}

/// The full key of a revocation; `key` is [`crate::identity::Identity::revocation_key`].
pub(crate) fn revoked_key(key: &[u8]) -> Bytes {
    full(&revocation_key(key))
}

fn full(key: &[u8]) -> Bytes {
    [NAME.as_bytes(), b"\0", key].concat().into()
}

fn organisation_key(name: &str) -> Vec<u8> {
    [b"organisation/", name.as_bytes()].concat()
}

fn revocation_key(key: &[u8]) -> Vec<u8> {
    [b"revoked/", key].concat()
}

fn organisations(ctx: &Context<'_>) -> Result<Vec<FoundingOrganisation>, Rejection> {
    ctx.range(&organisation_key(""), LIST_MAX).iter().map(|(_, value)| read_organisation(value)).collect()
}

fn revocations(ctx: &Context<'_>) -> Result<Vec<RevocationRecord>, Rejection> {
    ctx.range(&revocation_key(b""), LIST_MAX)
        .iter()
        .map(|(_, value)| {
            serde_json::from_slice(value).map_err(|error| {
                Rejection::new(Code::Corrupt, format!("a revocation on the ledger cannot be read: {error}"))
            })
        })
        .collect()
}

fn revoke(ctx: &mut Context<'_>, issuer: &[u8], serial: &[u8], reason: &[u8]) -> Result<Bytes, Rejection> {
    let issuer = std::str::from_utf8(issuer)
        .ok()
        .and_then(Hash::from_hex)
        .ok_or_else(|| bad_argument("ISSUER", "SHA-256 of the issuer's distinguished name, 64 hex digits"))?;
    let serial_text = std::str::from_utf8(serial).map_or_else(|_| String::new(), str::to_ascii_lowercase);
    let serial = hex::decode(&serial_text)
        .ok()
        .filter(|serial| !serial.is_empty() && serial.len() <= 64)
        .ok_or_else(|| bad_argument("SERIAL", "the certificate's serial number, 2 to 128 hex digits"))?;
    let reason = std::str::from_utf8(reason)
        .ok()
        .filter(|reason| reason.len() <= REASON_BYTES_MAX)
        .ok_or_else(|| bad_argument("REASON", "text of at most 512 bytes"))?;

    let organisation = issued_by(ctx, &issuer)?;
    let caller = ctx.submitter()?;
    if caller.role != Role::Admin || caller.organisation != organisation {
        return Err(Rejection::new(
            Code::NotAdmin,
            format!("{} may not revoke certificates of {organisation}", caller.id()),
        )
        .found(format!("role {} of {}", caller.role, caller.organisation))
        .wanted(format!("an admin of {organisation}, which issued it"))
        .next(format!("ask an admin of {organisation}")));
    }
    let revoked = Revocation { issuer: issuer.0, serial };
    let key = revocation_key(&[&revoked.issuer[..], &revoked.serial].concat());
    if let Some(known) = ctx.get(&key) {
        return Ok(known);
    }
    let record = json(&RevocationRecord {
        issuer,
        serial: hex::encode(&revoked.serial),
        organisation,
        height: ctx.height(),
        time: ctx.block_time(),
        by: caller.id(),
        reason: reason.to_owned(),
    })?;
    ctx.put(&key, record.clone());
    ctx.emit("revoked", &hex::encode(&revoked.serial), record.clone());
    ctx.tell_revoked(&revoked)?;
    Ok(record)
}

/// The organisation one of whose authorities has this name.
fn issued_by(ctx: &Context<'_>, issuer: &Hash) -> Result<String, Rejection> {
    let organisations = organisations(ctx)?;
    for organisation in &organisations {
        for der in organisation.roots.iter().chain(&organisation.intermediates) {
            if Certificate::parse(der).is_ok_and(|ca| Hash::of(&[&ca.subject_name]) == *issuer) {
                return Ok(organisation.name.clone());
            }
        }
    }
    let names: Vec<_> = organisations.into_iter().map(|organisation| organisation.name).collect();
    Err(Rejection::new(Code::NotFound, "no organisation has an authority of this name")
        .found(format!("issuer {issuer}"))
        .wanted(format!("SHA-256 of the distinguished name of an authority of {}", names.join(" or "))))
}

fn json(value: &impl Serialize) -> Result<Bytes, Rejection> {
    serde_json::to_vec(value)
        .map(Bytes::from)
        .map_err(|error| Rejection::new(Code::Internal, format!("an answer cannot be written: {error}")))
}

fn bad_arguments(function: &str, found: usize, wanted: &str) -> Rejection {
    Rejection::new(Code::BadArgument, format!("msp {function} is called with the wrong arguments"))
        .found(format!("{found} arguments"))
        .wanted(wanted.to_owned())
}

fn bad_argument(name: &str, wanted: &str) -> Rejection {
    Rejection::new(Code::BadArgument, format!("argument {name} of msp revoke is not usable")).wanted(wanted.to_owned())
}
