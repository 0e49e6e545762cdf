//! The certificate authority of one organisation, as a node carries it: the key that certifies, and what was registered
//! at this machine.
//!
//! | file in `<data>/ca/<Org>/` | content |
//! |---|---|
//! | `ca.pem` | the self-signed root: the organisation's verifying material |
//! | `ca.key` | its private key, PKCS #8, mode 0600 |
//! | `identities.json` | names that were registered at this machine, what is left of their secrets, and their certificates |
//!
//! The right to receive a certificate stands on the ledger ([`ledger::msp`]), where admins register names; so
//! any node that carries the key can issue. `identities.json` has what there was before: the first nodes, the first
//! admin, and secrets made by `ledgerd admin-secret`. It is replaced as a whole and down to the disk before anything is
//! answered, under the lock of the directory. So a running node and a command beside it do not lose each other's
//! changes.

pub(crate) mod backup;
mod issue;
mod place;
mod registry;
mod request;
pub(crate) mod seal;
pub(crate) mod secret;
#[cfg(test)]
mod tests;

pub use issue::DAY;
pub(crate) use place::{carried, check_secret, remove};
pub use registry::{CERTIFICATES_MAX, IDENTITIES_MAX, IssuedCertificate, Registered};
pub use request::REQUEST_BYTES_MAX;
pub(crate) use request::{make as request, public_key};
pub use secret::PRESENTED_BYTES_MAX;

use crate::process::config::{CERTIFICATE_DAYS, SECRET_DAYS};
use issue::Holder;
use ledger::msp::CarryCa;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::{Certificate, encode_attributes};
use ledger_identity::key::{KeyKind, PublicKey, SigningKey};
use ledger_identity::{Identity, Role, check_new_name};
use place::Stamp;
use registry::Registry;
use ring::rand::SystemRandom;
use secret::OneTimeSecret;
use std::collections::BTreeMap;
use std::fs::File;
use std::path::PathBuf;

/// The directory of the CAs that a node carries, in its data directory; one directory for each organisation.
pub const DIRECTORY: &str = "ca";

/// The CA of one organisation.
pub struct CertificateAuthority {
    directory: PathBuf,
    key: SigningKey,
    root: Vec<u8>,
    registry: Registry,
    /// Which file the registry was read from: another process may have replaced it.
    stamp: Stamp,
    /// A change may or may not have reached the disk, so that nothing can be promised any more.
    poisoned: bool,
    /// For how long certificates are valid.
    certificate_days: u32,
    /// For how long secrets can be used that are made here.
    secret_days: u32,
}

/// An identity that was enrolled here, with its private key.
#[derive(Debug)]
pub struct Issued {
    /// The certificate, DER.
    pub certificate: Vec<u8>,
    /// The certificates above it, DER: the root.
    pub chain: Vec<Vec<u8>>,
    /// The private key.
    pub key: SigningKey,
}

impl CertificateAuthority {
    /// Days for which certificates are valid, unless [`CertificateAuthority::set_days`] says otherwise.
    pub const CERTIFICATE_DAYS: u32 = CERTIFICATE_DAYS;
    /// Days for which secrets can be used, unless [`CertificateAuthority::set_days`] says otherwise.
    pub const SECRET_DAYS: u32 = SECRET_DAYS;

    /// Sets for how many days certificates are valid and secrets can be used, from now on.
    pub fn set_days(&mut self, certificates: u32, secrets: u32) {
        (self.certificate_days, self.secret_days) = (certificates, secrets);
    }

    /// The organisation.
    pub fn organisation(&self) -> &str {
        &self.registry.organisation
    }

    /// The root certificate, DER.
    pub fn root(&self) -> &[u8] {
        &self.root
    }

    /// SHA-256 of the root certificate, which clients pin at first contact.
    pub fn fingerprint(&self) -> Hash {
        Hash::of(&[&self.root])
    }

    /// The key.
    pub(crate) fn key(&self) -> &SigningKey {
        &self.key
    }

    /// The names that were registered here, in their order.
    pub fn identities(&self) -> impl Iterator<Item = (&str, &Registered)> {
        self.registry.identities.iter().map(|(name, registered)| (name.as_str(), registered))
    }

    /// One name that was registered here.
    pub fn identity(&self, name: &str) -> Option<&Registered> {
        self.registry.identities.get(name)
    }

    /// The message by which the node `ORGANISATION/NAME` shows a network that it carries this CA.
    pub(crate) fn prove(&self, network: &Hash, node: &str) -> CarryCa {
        CarryCa::prove(network, self.organisation(), node, &self.key)
    }

    /// Registers a name at this machine and answers with the one-time secret with which it may enrol. The secret is not
    /// kept. `now` is in microseconds since the UNIX epoch, here and everywhere in this type.
    ///
    /// # Errors
    /// [`Code::AlreadyRegistered`], [`Code::BadArgument`] for names and attributes that no certificate could hold,
    /// [`Code::LimitExceeded`], a failing disk.
    pub fn register(
        &mut self,
        name: &str,
        role: Role,
        attributes: BTreeMap<String, String>,
        now: u64,
    ) -> Result<String, Rejection> {
        check_new_name(name)?;
        check_attributes(&attributes)?;
        let _turn = self.begin()?;
        self.register_new(name, role, attributes, now)
    }

    fn register_new(
        &mut self,
        name: &str,
        role: Role,
        attributes: BTreeMap<String, String>,
        now: u64,
    ) -> Result<String, Rejection> {
        if let Some(known) = self.identity(name) {
            return Err(Rejection::new(
                Code::AlreadyRegistered,
                format!("{name} is already registered at {}", self.organisation()),
            )
            .found(format!("role {}, certificates: {}", known.role, known.certificates.len()))
            .wanted("an unused name"));
        }
        if self.registry.identities.len() >= IDENTITIES_MAX {
            return Err(Rejection::new(Code::LimitExceeded, "this CA cannot register more names")
                .found(format!("{IDENTITIES_MAX} names"))
                .next("register the others over the network: ledgerctl identity register NAME"));
        }
        let (secret, text) = self.new_secret(now)?;
        let registered =
            Registered { role, attributes, registered: now, secret: Some(secret), certificates: Vec::new() };
        self.change(|registry| registry.identities.insert(name.to_owned(), registered))?;
        Ok(text)
    }

    /// A new secret for a name that was registered here. An older secret of it is void at once.
    ///
    /// # Errors
    /// [`Code::NotFound`], [`Code::BadArgument`], a failing disk.
    pub fn reissue(
        &mut self,
        name: &str,
        attributes: Option<BTreeMap<String, String>>,
        now: u64,
    ) -> Result<String, Rejection> {
        if let Some(attributes) = &attributes {
            check_attributes(attributes)?;
        }
        let _turn = self.begin()?;
        self.reissue_known(name, attributes, now)
    }

    fn reissue_known(
        &mut self,
        name: &str,
        attributes: Option<BTreeMap<String, String>>,
        now: u64,
    ) -> Result<String, Rejection> {
        let organisation = self.organisation();
        let mut registered = self.identity(name).cloned().ok_or_else(|| {
            Rejection::new(Code::NotFound, format!("{name:?} is not registered at {organisation}"))
                .next("register it first")
        })?;
        let (secret, text) = self.new_secret(now)?;
        registered.secret = Some(secret);
        registered.attributes = attributes.unwrap_or(registered.attributes);
        self.change(|registry| registry.identities.insert(name.to_owned(), registered))?;
        Ok(text)
    }

    /// A secret for an admin, whether the name is known here or not: for who is locked out, with access to this disk.
    ///
    /// # Errors
    /// [`Code::AlreadyRegistered`] if the name is registered here for something else; as
    /// [`CertificateAuthority::register`].
    pub fn admin_secret(&mut self, name: &str, now: u64) -> Result<String, Rejection> {
        check_new_name(name)?;
        let _turn = self.begin()?;
        match self.identity(name).map(|known| known.role) {
            None => self.register_new(name, Role::Admin, BTreeMap::new(), now),
            Some(Role::Admin) => self.reissue_known(name, None, now),
            Some(role) => Err(Rejection::new(Code::AlreadyRegistered, format!("{name} is registered already"))
                .found(format!("role {role}"))
                .wanted("a new name, or that of an admin")
                .next("ledgerd admin-secret NAME with another name")),
        }
    }

    /// Does this secret open a registration that was made here, for a key that has not used it or has just done so?
    /// Answers with the moment at which the secret was made.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub(crate) fn opens(&mut self, name: &str, secret: &str, now: u64) -> Result<Option<u64>, Rejection> {
        let _turn = self.begin()?;
        let known = self.identity(name).and_then(|known| known.secret.as_ref());
        Ok(known.filter(|known| known.opens(secret, now)).map(|known| known.made))
    }

    /// Exchanges a one-time secret that was made here and a signing request (PKCS #10, DER) for a certificate (DER). Of
    /// the request only the public key is used; name, role and attributes are as registered. Afterwards the secret is
    /// good for nothing but the same key again, which for some minutes receives the same certificate, in case the
    /// answer was lost.
    ///
    /// # Errors
    /// [`Code::EnrolmentRefused`], alike for an unknown name and a secret that is wrong, used, expired or void;
    /// [`Code::BadArgument`] for a bad request, which leaves the secret usable; a failing disk.
    pub fn enrol(&mut self, name: &str, secret: &str, request: &[u8], now: u64) -> Result<Vec<u8>, Rejection> {
        let _turn = self.begin()?;
        if secret.len() > PRESENTED_BYTES_MAX {
            return Err(Self::refusal());
        }
        let opened = |known: &&Registered| known.secret.as_ref().is_some_and(|known| known.opens(secret, now));
        let Some(mut registered) = self.identity(name).filter(opened).cloned() else { return Err(Self::refusal()) };
        let key = public_key(request)?;
        let Some(secret) = registered.secret.as_mut() else { return Err(Self::refusal()) };
        if secret.is_used() {
            let earlier = secret.received_by(&key, now).and_then(|fingerprint| registered.der(&fingerprint));
            return earlier.map(<[u8]>::to_vec).ok_or_else(Self::refusal);
        }
        let der = self.certify(name, registered.role, &registered.attributes, &key, now)?;
        secret.give(&key, Hash::of(&[&der]), now);
        self.remember(name, registered, der, now)
    }

    /// A new certificate for this node itself, whose own has run out while it was away: it needs one before it can ask
    /// anybody. Of the request only the public key is used; the rest is as in the old one, which the caller has
    /// verified.
    ///
    /// # Errors
    /// [`Code::BadArgument`] for a bad request, a failing disk.
    pub(crate) fn revive(&mut self, node: &Identity, request: &[u8], now: u64) -> Result<Vec<u8>, Rejection> {
        let _turn = self.begin()?;
        let registered = self.identity(&node.name).cloned().unwrap_or_else(|| Registered {
            role: node.role,
            attributes: node.attributes.clone(),
            registered: now,
            secret: None,
            certificates: Vec::new(),
        });
        let key = public_key(request)?;
        let der = self.certify(&node.name, node.role, &node.attributes, &key, now)?;
        self.remember(&node.name, registered, der, now)
    }

    /// Signs a certificate, and does nothing else: who hands it out sees to it that it is recorded before.
    ///
    /// # Errors
    /// [`Code::CertificateExpired`] if the root is not valid now.
    pub(crate) fn certify(
        &self,
        name: &str,
        role: Role,
        attributes: &BTreeMap<String, String>,
        key: &PublicKey,
        now: u64,
    ) -> Result<Vec<u8>, Rejection> {
        let holder = Holder { organisation: self.organisation(), name, role, attributes, key };
        issue::leaf(&self.root, &self.key, &holder, self.certificate_days, now)
    }

    /// Keeps a certificate that was issued by a registration made here.
    fn remember(
        &mut self,
        name: &str,
        mut registered: Registered,
        der: Vec<u8>,
        now: u64,
    ) -> Result<Vec<u8>, Rejection> {
        let certificate = Certificate::parse(&der)?;
        registered.add(
            IssuedCertificate {
                serial: certificate.serial,
                issuer: certificate.issuer_name.hash(),
                fingerprint: Hash::of(&[&der]),
                not_before: certificate.not_before,
                not_after: certificate.not_after,
                der: der.clone(),
            },
            now,
        )?;
        self.change(|registry| registry.identities.insert(name.to_owned(), registered))?;
        Ok(der)
    }

    /// Why enrolment is refused: the same words whatever is wrong, so that nobody learns which names exist.
    pub fn refusal() -> Rejection {
        Rejection::new(Code::EnrolmentRefused, "enrolment is rejected")
            .found("a name and secret that do not match, or a secret that was used, has expired or was cancelled")
            .wanted("a registered name (or ORGANISATION/NAME) and its unused one-time secret")
    }

    /// Registers and enrols at once, with a key made here: for a node's own identity and a founder's first admins. A
    /// name that is registered with this role already receives another certificate, with these attributes.
    ///
    /// # Errors
    /// As [`CertificateAuthority::register`] and [`CertificateAuthority::enrol`].
    pub fn issue(
        &mut self,
        name: &str,
        role: Role,
        attributes: BTreeMap<String, String>,
        kind: KeyKind,
        now: u64,
    ) -> Result<Issued, Rejection> {
        let key = SigningKey::generate(kind, &SystemRandom::new()).map_err(key_failed)?;
        let secret = match self.identity(name) {
            Some(known) if known.role == role => self.reissue(name, Some(attributes), now)?,
            _ => self.register(name, role, attributes, now)?,
        };
        let certificate = self.enrol(name, &secret, &request::make(&key, name)?, now)?;
        Ok(Issued { certificate, chain: vec![self.root.clone()], key })
    }

    fn new_secret(&self, now: u64) -> Result<(OneTimeSecret, String), Rejection> {
        OneTimeSecret::generate(now, now.saturating_add(u64::from(self.secret_days) * DAY))
    }

    /// Takes the lock of the directory, for as long as the answer lives, and reads again what somebody else has
    /// changed.
    fn begin(&mut self) -> Result<File, Rejection> {
        self.check_usable()?;
        let turn = place::lock(&self.directory)?;
        let stamp = Stamp::of(&self.directory)?;
        if stamp != self.stamp {
            self.registry = Registry::load(&self.directory)?;
            self.stamp = stamp;
        }
        Ok(turn)
    }

    /// Reads again what another process has changed.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub(crate) fn refresh(&mut self) -> Result<(), Rejection> {
        self.begin().map(drop)
    }

    /// Changes the registered names on the disk, then in memory; by whoever has the lock.
    fn change<T>(&mut self, change: impl FnOnce(&mut Registry) -> T) -> Result<(), Rejection> {
        let mut changed = self.registry.clone();
        change(&mut changed);
        let staged = changed.stage(&self.directory)?;
        // Until the rename nothing has happened; after it only success says what the disk holds.
        self.poisoned = true;
        staged.publish()?;
        self.stamp = Stamp::of(&self.directory)?;
        self.poisoned = false;
        self.registry = changed;
        Ok(())
    }

    fn check_usable(&self) -> Result<(), Rejection> {
        if !self.poisoned {
            return Ok(());
        }
        Err(Rejection::new(Code::DiskFailed, format!("the CA of {} has stopped", self.organisation()))
            .found("an earlier change that the disk did not confirm"))
    }
}

impl Issued {
    /// The certificate and those above it, in PEM.
    pub fn chain_pem(&self) -> String {
        let chain: Vec<_> = std::iter::once(&self.certificate).chain(&self.chain).collect();
        pem(&chain)
    }
}

/// Certificates in PEM.
pub(crate) fn pem(ders: &[impl AsRef<[u8]>]) -> String {
    let sections: Vec<_> = ders.iter().map(|der| pem::Pem::new("CERTIFICATE", der.as_ref())).collect();
    pem::encode_many_config(&sections, pem::EncodeConfig::new().set_line_ending(pem::LineEnding::LF))
}

fn check_attributes(attributes: &BTreeMap<String, String>) -> Result<(), Rejection> {
    encode_attributes(attributes).map(|_| ()).map_err(|error| bad_argument(&error.to_string()))
}

/// Refuses what a fault says of it, such as `found name "", …, wanted 1 to 128 bytes`.
fn bad_argument(fault: &str) -> Rejection {
    let refused = Rejection::new(Code::BadArgument, "this cannot be registered");
    let parts = fault.strip_prefix("found ").and_then(|rest| rest.rsplit_once(", wanted "));
    match parts {
        Some((found, wanted)) => refused.found(found).wanted(wanted),
        None => refused.found(fault),
    }
}

fn key_failed(error: ledger_identity::key::KeyError) -> Rejection {
    Rejection::new(Code::Internal, error.to_string())
}
