//! The certificate of a node that joins: from the CA of its organisation, or from one that is founded here.

use super::place::JoinDirectory;
use crate::process::config::Config;
use crate::storage::files::{CERTIFICATE_FILE, KEY_FILE};
use crate::tools::setup::NODE_KEY;
use crate::trust::ca;
use crate::trust::ca::{CertificateAuthority, pem};
use crate::trust::renewal;
use bytes::Bytes;
use ledger::msp::JoinOrganisation;
use ledger::network::FoundingOrganisation;
use ledger_api::Enrolment;
use ledger_api::tls::TlsIdentity;
use ledger_api::token::JoinToken;
use ledger_base::durable::{PUBLIC_MODE, SECRET_MODE};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use ledger_identity::key::{KEY_BYTES_MAX, KeyKind, SigningKey};
use ring::rand::SystemRandom;
use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

/// A node of an organisation of the network: its CA certifies the key for the token's secret. The same key may come
/// again with the same secret, because an answer can be lost.
pub(super) async fn enrolled(
    place: &JoinDirectory,
    token: &JoinToken,
    enrolment: &Enrolment,
) -> Result<TlsIdentity, Rejection> {
    if let Some(identity) = place.identity() {
        return Ok(identity);
    }
    let identity = enrol(token, enrolment, key(place)?).await?;
    write_certificate(place, &identity)?;
    Ok(identity)
}

/// A node that is there already receives another certificate, for a new key.
pub(super) async fn replaced(place: &JoinDirectory, token: &JoinToken, enrolment: &Enrolment) -> Result<(), Rejection> {
    let Some(before) = place.identity() else {
        let identity = enrol(token, enrolment, key(place)?).await?;
        return write_certificate(place, &identity);
    };
    let after = enrol(token, enrolment, new_key()?).await?;
    renewal::store(place.directory(), &before, &after)
}

async fn enrol(token: &JoinToken, enrolment: &Enrolment, key: SigningKey) -> Result<TlsIdentity, Rejection> {
    let name = format!("{}/{}", token.organisation, token.node);
    let enrolled = enrolment.enrol_key(&name, &token.secret, key).await.map_err(|refused| match refused.code {
        Code::EnrolmentRefused => refused.next(format!(
            "ask an admin of {} for a new token: ledgerctl network invite --node {}",
            token.organisation, token.node
        )),
        _ => refused,
    })?;
    // Behind the certificate goes the root, so that clients can pin it.
    let root = enrolled.msps.get(&token.organisation).and_then(|msp| msp.roots().next().map(<[u8]>::to_vec));
    let chain = enrolled.chain.into_iter().chain(root.map(Into::into));
    TlsIdentity::new(chain.collect(), enrolled.key).map_err(|error| Rejection::new(Code::BadFile, error.to_string()))
}

/// The first node of a new organisation: its CA is founded here. Until there is a certificate nobody has seen the CA,
/// so that one of which a crash left a part is founded anew.
pub(super) fn founded(
    place: &JoinDirectory,
    token: &JoinToken,
    config: &Config,
    now: u64,
) -> Result<TlsIdentity, Rejection> {
    if let Some(identity) = place.identity() {
        return Ok(identity);
    }
    let directory = authority(place.path(ca::DIRECTORY), token);
    if fs::symlink_metadata(&directory).is_ok() {
        fs::remove_dir_all(&directory).map_err(|error| ledger_base::durable::failed("remove", &directory, &error))?;
    }
    let mut authority = CertificateAuthority::create(&directory, &token.organisation, KeyKind::Ed25519, now)?;
    authority.set_days(config.ca.certificate_days, config.ca.secret_days);
    let key = key(place)?;
    let secret = authority.register(&token.node, Role::Node, BTreeMap::new(), now)?;
    let certificate = authority.enrol(&token.node, &secret, &ca::request(&key, &token.node)?, now)?;
    let chain = vec![certificate.into(), authority.root().to_vec().into()];
    let identity =
        TlsIdentity::new(chain, key.into()).map_err(|error| Rejection::new(Code::Internal, error.to_string()))?;
    write_certificate(place, &identity)?;
    Ok(identity)
}

/// The request of the new organisation, signed with the key of its invitation.
pub(super) fn signed_join(place: &JoinDirectory, token: &JoinToken, address: &str) -> Result<Bytes, Rejection> {
    let seed = hex::decode(&token.secret).ok().and_then(|seed| seed.try_into().ok()).ok_or_else(|| {
        Rejection::new(Code::BadArgument, "the token's secret is not usable")
            .wanted("64 hexadecimal digits")
            .next("copy the token again, or ask for a new one")
    })?;
    let key = SigningKey::from_seed(&seed).map_err(|error| Rejection::new(Code::Internal, error.to_string()))?;
    let authority = CertificateAuthority::open(&authority(place.path(ca::DIRECTORY), token))?;
    let organisation = FoundingOrganisation::below(&token.organisation, Bytes::copy_from_slice(authority.root()));
    let join = JoinOrganisation::sign(&token.network, organisation, &token.node, address, &key);
    serde_json::to_vec(&join).map(Bytes::from).map_err(|error| Rejection::new(Code::Internal, error.to_string()))
}

/// The CA's fingerprint and a one-time secret for the first admin; none if the admin has enrolled.
pub(super) fn admin_secret(
    token: &JoinToken,
    admin: &str,
    config: &Config,
    now: u64,
) -> Result<Option<(Hash, String)>, Rejection> {
    let mut authority = CertificateAuthority::open(&authority(config.data.join(ca::DIRECTORY), token))?;
    authority.set_days(config.ca.certificate_days, config.ca.secret_days);
    let secret = match authority.identity(admin) {
        None => authority.register(admin, Role::Admin, BTreeMap::new(), now)?,
        Some(known) if known.certificates.is_empty() => authority.reissue(admin, None, now)?,
        Some(_) => return Ok(None),
    };
    Ok(Some((authority.fingerprint(), secret)))
}

fn authority(authorities: PathBuf, token: &JoinToken) -> PathBuf {
    authorities.join(&token.organisation)
}

/// The node's key: the one of an earlier try, or a new one.
fn key(place: &JoinDirectory) -> Result<SigningKey, Rejection> {
    let path = place.path(KEY_FILE);
    if fs::symlink_metadata(&path).is_ok() {
        let text = ledger_base::durable::read(&path, KEY_BYTES_MAX)?;
        return SigningKey::from_pkcs8_pem(&String::from_utf8_lossy(&text))
            .map_err(|error| Rejection::new(Code::BadFile, format!("{}: {error}", path.display())));
    }
    let key = new_key()?;
    ledger_base::durable::replace(&path, key.to_pkcs8_pem().as_bytes(), SECRET_MODE)?;
    Ok(key)
}

fn new_key() -> Result<SigningKey, Rejection> {
    SigningKey::generate(NODE_KEY, &SystemRandom::new())
        .map_err(|error| Rejection::new(Code::Internal, error.to_string()))
}

fn write_certificate(place: &JoinDirectory, identity: &TlsIdentity) -> Result<(), Rejection> {
    ledger_base::durable::replace(&place.path(CERTIFICATE_FILE), pem(&identity.own().chain).as_bytes(), PUBLIC_MODE)
}
