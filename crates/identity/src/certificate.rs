//! Reading X.509 certificates, within limits. Reading is not trusting: see [`crate::msp`].
//!
//! Attributes are in the format of Fabric's CA: an extension that is not critical, OID 1.2.3.4.5.6.7.8.1, whose
//! content is raw JSON `{"attrs":{"name":"value"}}` and not nested in another DER string.

mod attributes;

pub use attributes::{ATTRIBUTES_BYTES_MAX, ATTRIBUTES_MAX, ATTRIBUTES_OID, encode_attributes};

use crate::der;
use crate::distinguished_name::{COMMON_NAME, DistinguishedName, EMAIL, UNIT};
use crate::identity::{IdentityError, Role, at_most, check_name, check_validity, malformed, printable};
use crate::name_constraints::{GeneralName, NameConstraints};
use crate::signature::Signed;
use std::collections::{BTreeMap, BTreeSet};
use x509_parser::certificate::X509Certificate;
use x509_parser::error::X509Error;
use x509_parser::oid_registry::{
    OID_X509_EXT_BASIC_CONSTRAINTS, OID_X509_EXT_CERTIFICATE_POLICIES, OID_X509_EXT_CRL_DISTRIBUTION_POINTS,
    OID_X509_EXT_EXTENDED_KEY_USAGE, OID_X509_EXT_KEY_USAGE, OID_X509_EXT_NAME_CONSTRAINTS,
    OID_X509_EXT_SUBJECT_ALT_NAME, Oid,
};
use x509_parser::prelude::{FromDer, X509Version};
use x509_parser::time::ASN1Time;

/// Largest certificate that is read, in bytes of DER.
pub const CERTIFICATE_BYTES_MAX: usize = 16 * 1024;

/// Largest serial number, in bytes: 20 of RFC 5280 and the padding byte of a positive INTEGER.
const SERIAL_BYTES_MAX: usize = 21;

/// Most values of one kind (CN, OU) that a subject may hold.
const SUBJECT_VALUES_MAX: usize = 16;

/// The use of a certificate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Usage {
    /// To sign transactions and to call others.
    Client,
    /// To be called: the TLS server's side.
    Server,
}

/// The content of a certificate; nothing of it is verified.
#[derive(Clone, Debug)]
pub struct Certificate {
    /// The subject, for people.
    pub subject: String,
    /// The issuer, for people.
    pub issuer: String,
    /// The subject's distinguished name.
    pub subject_name: DistinguishedName,
    /// The issuer's distinguished name.
    pub issuer_name: DistinguishedName,
    /// The serial number: the content of a DER INTEGER that is not negative.
    pub serial: Vec<u8>,
    /// Start of validity, in microseconds since the UNIX epoch.
    pub not_before: u64,
    /// Last valid microsecond since the UNIX epoch. X.509 counts in seconds and includes the last one whole.
    pub not_after: u64,
    /// The SubjectPublicKeyInfo in DER.
    pub public_key_info: Vec<u8>,
    /// The values of CN in the subject.
    common_names: Vec<String>,
    /// The values of OU in the subject, from one RDN or several.
    units: Vec<String>,
    /// The content of the attribute extension.
    attributes: Option<Vec<u8>>,
    /// CA:TRUE.
    is_authority: bool,
    /// How many authorities may stand between this one and an identity.
    path_length_max: Option<u32>,
    /// The key usage extension, if there is one.
    key_usage: Option<KeyUsage>,
    /// The extended key usage extension, if there is one.
    extended_key_usage: Option<ExtendedKeyUsage>,
    /// The names of the subject: the distinguished one, and those of the extension.
    names: Vec<GeneralName>,
    /// The names that it may certify.
    name_constraints: Option<NameConstraints>,
    /// A critical extension that is not known here.
    unknown_critical: Option<String>,
    /// The part that its issuer has signed, and the signature.
    signed: Signed,
}

/// Critical extensions that are followed, or ask for nothing that could be left out. Policies count only for a verifier that
/// wants some. Lists are read from the ledger, wherever a certificate says that they are.
const KNOWN_CRITICAL: [Oid<'_>; 7] = [
    OID_X509_EXT_KEY_USAGE,
    OID_X509_EXT_SUBJECT_ALT_NAME,
    OID_X509_EXT_BASIC_CONSTRAINTS,
    OID_X509_EXT_NAME_CONSTRAINTS,
    OID_X509_EXT_EXTENDED_KEY_USAGE,
    OID_X509_EXT_CERTIFICATE_POLICIES,
    OID_X509_EXT_CRL_DISTRIBUTION_POINTS,
];

#[derive(Clone, Copy, Debug)]
struct KeyUsage {
    digital_signature: bool,
    sign_certificates: bool,
    sign_lists: bool,
}

#[derive(Clone, Copy, Debug)]
struct ExtendedKeyUsage {
    any: bool,
    client: bool,
    server: bool,
}

impl Certificate {
    /// Reads one certificate in DER and nothing after it.
    ///
    /// # Errors
    /// [`IdentityError::TooLarge`] before anything is parsed; [`IdentityError::Malformed`] with the reason.
    pub fn parse(der: &[u8]) -> Result<Self, IdentityError> {
        at_most("bytes of certificate", der.len(), CERTIFICATE_BYTES_MAX)?;
        let wanted = "an X.509 version 3 certificate in DER";
        let (rest, parsed) = X509Certificate::from_der(der).map_err(|error| malformed(error.to_string(), wanted))?;
        if !rest.is_empty() {
            return Err(malformed(format!("{} bytes after it", rest.len()), "a certificate and nothing after it"));
        }
        if !der::is_strict(der) {
            return Err(malformed("an encoding that is not DER".into(), wanted));
        }
        if parsed.version() != X509Version::V3 {
            return Err(malformed(format!("a certificate of version {}", parsed.version()), wanted));
        }
        let signed = Signed::of(der).ok_or_else(|| {
            malformed("a signature in another form".into(), "one algorithm inside and outside, and whole bytes")
        })?;
        Self::from_parsed(&parsed, signed)
    }

    fn from_parsed(parsed: &X509Certificate<'_>, signed: Signed) -> Result<Self, IdentityError> {
        let extension = |error: X509Error| malformed(error.to_string(), "each extension once, in its form");
        // x509-parser keeps an extension that it cannot read as an error inside, and its accessors would then say
        // "absent". A key usage or a CA flag that cannot be read must not pass as none.
        if let Some(bad) = parsed.extensions().iter().find(|found| found.parsed_extension().error().is_some()) {
            return Err(malformed(format!("an unreadable extension {}", bad.oid), "each extension once, in its form"));
        }
        let mut once = BTreeSet::new();
        if let Some(twice) = parsed.extensions().iter().find(|found| !once.insert(found.oid.as_bytes())) {
            return Err(malformed(format!("the extension {} twice", twice.oid), "each extension once, in its form"));
        }
        let content =
            |oid: &Oid<'_>| parsed.extensions().iter().find(|found| found.oid == *oid).map(|found| found.value);
        let unknown = |oid: &Oid<'_>| !KNOWN_CRITICAL.contains(oid);
        let unknown_critical = parsed.extensions().iter().find(|found| found.critical && unknown(&found.oid));
        let basic = parsed.basic_constraints().map_err(extension)?;
        let usage = parsed.key_usage().map_err(extension)?;
        let extended = parsed.extended_key_usage().map_err(extension)?;
        let oid = Oid::from(ATTRIBUTES_OID)
            .map_err(|_| malformed("the attribute OID".into(), "an object identifier that can be encoded"))?;
        let attributes = parsed.get_extension_unique(&oid).map_err(extension)?;
        let subject_name = DistinguishedName::parse(parsed.subject().as_raw())?;
        let issuer_name = DistinguishedName::parse(parsed.issuer().as_raw())?;
        let mut names: Vec<_> = subject_name.values(EMAIL)?.into_iter().map(GeneralName::Email).collect();
        if !subject_name.is_empty() {
            names.push(GeneralName::Directory(subject_name.clone()));
        }
        if let Some(content) = content(&OID_X509_EXT_SUBJECT_ALT_NAME) {
            names.extend(GeneralName::all(content)?);
        }
        if parsed.validity().not_before > parsed.validity().not_after {
            return Err(malformed("an end of validity before its start".into(), "a time in which it is valid"));
        }
        Ok(Self {
            subject: name_text(&subject_name),
            issuer: name_text(&issuer_name),
            serial: serial_number(parsed.raw_serial())?,
            not_before: microseconds(parsed.validity().not_before),
            not_after: microseconds(parsed.validity().not_after).saturating_add(999_999),
            public_key_info: parsed.public_key().raw.to_vec(),
            common_names: values(&subject_name, COMMON_NAME)?,
            units: values(&subject_name, UNIT)?,
            subject_name,
            issuer_name,
            attributes: attributes.map(|found| found.value.to_vec()),
            is_authority: basic.as_ref().is_some_and(|found| found.value.ca),
            path_length_max: basic.and_then(|found| found.value.path_len_constraint),
            key_usage: usage.map(|found| KeyUsage {
                digital_signature: found.value.digital_signature(),
                sign_certificates: found.value.key_cert_sign(),
                sign_lists: found.value.crl_sign(),
            }),
            extended_key_usage: extended.map(|found| ExtendedKeyUsage {
                any: found.value.any,
                client: found.value.client_auth,
                server: found.value.server_auth,
            }),
            names,
            name_constraints: content(&OID_X509_EXT_NAME_CONSTRAINTS).map(NameConstraints::read).transpose()?,
            unknown_critical: unknown_critical.map(|found| found.oid.to_id_string()),
            signed,
        })
    }

    /// The one common name of the subject.
    ///
    /// # Errors
    /// [`IdentityError::Malformed`] if there is none or several, [`IdentityError::BadName`].
    pub fn name(&self) -> Result<&str, IdentityError> {
        let [name] = self.common_names.as_slice() else {
            let found = format!("{} common names in {}", self.common_names.len(), self.subject);
            return Err(malformed(found, "exactly one common name (CN)"));
        };
        check_name(name)?;
        Ok(name)
    }

    /// The role that the organisational units name; [`Role::Member`] if none of them names one.
    ///
    /// # Errors
    /// [`IdentityError::Malformed`] if they name two different roles: nobody could tell which one was meant.
    pub fn role(&self) -> Result<Role, IdentityError> {
        let mut roles = self.units.iter().filter_map(|unit| Role::from_unit(unit));
        let role = roles.next().unwrap_or(Role::Member);
        match roles.find(|other| *other != role) {
            None => Ok(role),
            Some(other) => Err(malformed(format!("the roles {role} and {other}"), "one role in the subject's OU")),
        }
    }

    /// The values of OU in the subject.
    pub fn units(&self) -> &[String] {
        &self.units
    }

    /// The attributes of the extension; none if there is no extension.
    ///
    /// # Errors
    /// [`IdentityError::Malformed`] and [`IdentityError::TooLarge`].
    pub fn attributes(&self) -> Result<BTreeMap<String, String>, IdentityError> {
        self.attributes.as_deref().map_or_else(|| Ok(BTreeMap::new()), attributes::decode)
    }

    /// Checks the time, in microseconds since the UNIX epoch.
    pub(crate) fn check_validity(&self, at: u64) -> Result<(), IdentityError> {
        check_validity(|| self.subject.clone(), self.not_before, self.not_after, at)
    }

    /// Checks that this may issue certificates.
    pub(crate) fn check_authority(&self) -> Result<(), IdentityError> {
        let refuse =
            |found, wanted| Err(IdentityError::NotAnAuthority { subject: printable(&self.subject), found, wanted });
        if !self.is_authority {
            return refuse("no CA:TRUE", "the basic constraint CA:TRUE");
        }
        match self.key_usage {
            Some(usage) if !usage.sign_certificates => refuse("a key usage without keyCertSign", "keyCertSign"),
            _ => Ok(()),
        }
    }

    /// Checks that this may sign revocation lists.
    pub(crate) fn check_signs_lists(&self) -> Result<(), IdentityError> {
        match self.key_usage {
            Some(usage) if !usage.sign_lists => Err(IdentityError::WrongUsage {
                subject: printable(&self.subject),
                found: "a key usage without cRLSign".into(),
                wanted: "cRLSign, or no key usage",
            }),
            _ => Ok(()),
        }
    }

    /// Checks that this is the certificate of an identity, and was issued for this use. Certificates without key
    /// usage or extended key usage are accepted, as Fabric's users have none of the latter.
    pub(crate) fn check_holder(&self, usage: Usage) -> Result<(), IdentityError> {
        let refuse = |found: &str, wanted| {
            Err(IdentityError::WrongUsage { subject: printable(&self.subject), found: found.into(), wanted })
        };
        if self.is_authority {
            return Err(IdentityError::Authority { subject: printable(&self.subject) });
        }
        if self.key_usage.is_some_and(|found| !found.digital_signature) {
            return refuse("a key usage without digitalSignature", "digitalSignature");
        }
        match (self.extended_key_usage, usage) {
            (Some(found), Usage::Client) if !found.any && !found.client => {
                refuse("an extended key usage without clientAuth", "clientAuth, or no extended key usage")
            }
            (Some(found), Usage::Server) if !found.any && !found.server => {
                refuse("an extended key usage without serverAuth", "serverAuth, or no extended key usage")
            }
            _ => Ok(()),
        }
    }

    /// Checks that an extended key usage, if there is one, allows this use to those whom this authority certifies.
    pub(crate) fn allows(&self, usage: Usage) -> bool {
        self.extended_key_usage
            .is_none_or(|found| found.any || if usage == Usage::Client { found.client } else { found.server })
    }

    /// How many authorities may stand between this one and an identity.
    pub(crate) fn path_length_max(&self) -> Option<u32> {
        self.path_length_max
    }

    /// Has it the name of its issuer? Such an authority does not count in the length of a path.
    pub(crate) fn is_self_issued(&self) -> bool {
        self.subject_name == self.issuer_name
    }

    /// The part that its issuer has signed, and the signature.
    pub(crate) fn signed(&self) -> &Signed {
        &self.signed
    }

    /// The object identifier of a critical extension that is not known here.
    pub(crate) fn unknown_critical(&self) -> Option<&str> {
        self.unknown_critical.as_deref()
    }

    /// Checks that this authority may certify the names of that one; answers with what is wrong.
    pub(crate) fn check_names(&self, of: &Self) -> Result<(), String> {
        self.name_constraints.as_ref().map_or(Ok(()), |constraints| constraints.check(of.names.iter()))
    }
}

/// A distinguished name for people, cut so that messages stay short.
pub(crate) fn name_text(name: &DistinguishedName) -> String {
    name.to_string().chars().take(256).collect()
}

/// A time of X.509 in microseconds since the UNIX epoch; a time before 1970 is 1970.
pub(crate) fn microseconds(time: ASN1Time) -> u64 {
    u64::try_from(time.timestamp()).unwrap_or(0).saturating_mul(1_000_000)
}

/// The serial number, if it is an INTEGER in its shortest form and not negative. Then its bytes are unique for the
/// number, and a revocation cannot be evaded by writing it differently.
pub(crate) fn serial_number(bytes: &[u8]) -> Result<Vec<u8>, IdentityError> {
    at_most("bytes of serial number", bytes.len(), SERIAL_BYTES_MAX)?;
    match bytes {
        [] | [0x80..=0xff, ..] | [0, 0..=0x7f, ..] => {
            let found = format!("serial number {}", hex::encode(bytes));
            Err(malformed(found, "an INTEGER that is not negative, in its shortest form"))
        }
        _ => Ok(bytes.to_vec()),
    }
}

fn values(name: &DistinguishedName, kind: &[u8]) -> Result<Vec<String>, IdentityError> {
    let values = name.values(kind)?;
    at_most("values of one kind in the subject", values.len(), SUBJECT_VALUES_MAX)?;
    Ok(values)
}
