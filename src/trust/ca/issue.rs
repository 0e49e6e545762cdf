//! The certificates that a CA signs: its own root, and those of identities.

use super::request::{failed, signer};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use ledger_identity::certificate::{ATTRIBUTES_OID, Certificate, encode_attributes};
use ledger_identity::key::{PublicKey, SigningKey};
use rcgen::{
    BasicConstraints, CertificateParams, CustomExtension, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa,
    Issuer, KeyUsagePurpose, SanType, SerialNumber, SubjectPublicKeyInfo, date_time_ymd,
};
use ring::rand::{SecureRandom, SystemRandom};
use rustls_pki_types::CertificateDer;
use std::collections::BTreeMap;
use std::time::Duration;

/// Microseconds of a day.
pub const DAY: u64 = 24 * 3600 * 1_000_000;
/// How far a certificate starts in the past: clocks of other machines may be slow.
const START_BEFORE: u64 = 5 * 60 * 1_000_000;
/// For how long a root is valid.
const ROOT_DAYS: u64 = 3653;
/// The last second that X.509 can name: the end of the year 9999.
const SECONDS_MAX: u64 = 253_402_300_799;

/// The content of a certificate about its holder.
pub(super) struct Holder<'a> {
    pub(super) organisation: &'a str,
    pub(super) name: &'a str,
    pub(super) role: Role,
    pub(super) attributes: &'a BTreeMap<String, String>,
    pub(super) key: &'a PublicKey,
}

/// The self-signed root of an organisation, in DER.
pub(super) fn root(organisation: &str, key: &SigningKey, now: u64) -> Result<Vec<u8>, Rejection> {
    let mut params = params(now.saturating_sub(START_BEFORE), now.saturating_add(ROOT_DAYS * DAY))?;
    params.distinguished_name.push(DnType::OrganizationName, organisation);
    params.distinguished_name.push(DnType::CommonName, format!("{organisation}-ca"));
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(1));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    let root = signer(key).and_then(|signer| params.self_signed(&signer));
    Ok(root.map_err(|error| failed("the root certificate", &error))?.der().to_vec())
}

/// The certificate of an identity, in DER, valid for that many days but no longer than the root.
pub(super) fn leaf(
    root_der: &[u8],
    key: &SigningKey,
    holder: &Holder<'_>,
    days: u32,
    now: u64,
) -> Result<Vec<u8>, Rejection> {
    let root = Certificate::parse(root_der)?;
    if now < root.not_before || now > root.not_after {
        return Err(Rejection::new(
            Code::CertificateExpired,
            format!("the CA of {} is not valid at this time", holder.organisation),
        )
        .next(
            "check this node's clock; if it is right, create a new CA: docs/operations.md, \"The CA of an \
               organisation\"",
        ));
    }
    let not_before = now.saturating_sub(START_BEFORE).max(root.not_before);
    let not_after = now.saturating_add(u64::from(days) * DAY).min(root.not_after);
    let mut params = params(not_before, not_after)?;
    params.distinguished_name.push(DnType::OrganizationName, holder.organisation);
    params.distinguished_name.push(DnType::OrganizationalUnitName, holder.role.as_str());
    params.distinguished_name.push(DnType::CommonName, holder.name);
    params.is_ca = IsCa::ExplicitNoCa;
    params.use_authority_key_identifier_extension = true;
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
    if holder.role == Role::Node {
        params.extended_key_usages.push(ExtendedKeyUsagePurpose::ServerAuth);
        params.subject_alt_names = host_name(holder.name).into_iter().collect();
    }
    if !holder.attributes.is_empty() {
        let content = encode_attributes(holder.attributes)?;
        params.custom_extensions = vec![CustomExtension::from_oid_content(ATTRIBUTES_OID, content)];
    }
    let leaf = signer(key).and_then(|signer| {
        let issuer = Issuer::from_ca_cert_der(&CertificateDer::from(root_der), signer)?;
        params.signed_by(&SubjectPublicKeyInfo::from_der(&holder.key.to_spki())?, &issuer)
    });
    Ok(leaf.map_err(|error| failed("a certificate", &error))?.der().to_vec())
}

/// The common parts of both: an empty subject, a random serial number and a validity.
fn params(not_before: u64, not_after: u64) -> Result<CertificateParams, Rejection> {
    let mut params = CertificateParams::default();
    params.distinguished_name = DistinguishedName::new();
    params.serial_number = Some(SerialNumber::from_slice(&serial()?));
    let [first, last] = [not_before, not_after].map(|at| {
        let seconds = (at / 1_000_000).min(SECONDS_MAX);
        date_time_ymd(1970, 1, 1) + Duration::from_secs(seconds)
    });
    params.not_before = first;
    params.not_after = last;
    Ok(params)
}

/// 16 random bytes, of which 126 bits are random: positive, and always of the same length.
fn serial() -> Result<[u8; 16], Rejection> {
    let mut serial = [0; 16];
    SystemRandom::new()
        .fill(&mut serial)
        .map_err(|_| Rejection::new(Code::Internal, "the system's source of randomness failed: no serial number"))?;
    if let Some(first) = serial.first_mut() {
        *first = (*first & 0x3f) | 0x40;
    }
    Ok(serial)
}

/// The node's name as a host name, so that TLS clients of other languages can name the server they expect.
fn host_name(name: &str) -> Option<SanType> {
    let label = |label: &str| {
        (1..=63).contains(&label.len()) && label.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'-')
    };
    name.split('.').all(label).then(|| name.to_owned().try_into().ok().map(SanType::DnsName)).flatten()
}
