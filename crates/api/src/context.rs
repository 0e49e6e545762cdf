//! Contexts: who this machine is on which network, as `ledgerctl enroll` stores it.
//!
//! ```text
//! <home>/current                       name of the selected context
//! <home>/.lock                         locked while contexts are read or changed
//! <home>/contexts/<NAME>/context.toml  name, organisation, network, label, nodes, renew
//!                        certificate.pem  the own certificate, then its issuers
//!                        key.pem          PKCS#8, readable by its owner only
//!                        msps.json        all organisations of the network with their roots
//!                        reading.key      reads confidential services, readable by its owner only; made when it is needed
//!                        nodes.json       what was learnt since: the nodes, the one that served last, other roots
//! <home>/contexts/.<NAME>.renewing     locked by whoever renews the certificate
//! ```
//! `<home>` is `$LEDGERD_HOME`, else `$XDG_CONFIG_HOME/ledgerd`, else `~/.config/ledgerd`.

mod files;
mod home;
mod known;
mod lock;
mod organisations;
mod pending;
mod reading;
mod renewal;

pub use home::home;
pub use known::{ADDRESS_BYTES_MAX, KNOWN_NODES_MAX, KnownNode, Memory};
pub use pending::PendingEnrolment;
pub use renewal::{RenewalRule, WARNING_DAYS, renewal_due, warning_due};

pub(crate) use files::{bad_file, unwritable};
pub(crate) use home::renewing;

use crate::connect::{self, Credentials};
use crate::tls::{ServerTrust, TlsIdentity, Trusted};
use crate::v1;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::Certificate;
use ledger_identity::key::SigningKey;
use ledger_identity::msp::Msps;
use ledger_identity::units::Units;
use lock::Lock;
use rustls_pki_types::CertificateDer;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;

/// Longest name of a context, in bytes.
pub const CONTEXT_NAME_BYTES_MAX: usize = ledger_identity::NEW_NAME_BYTES_MAX;

/// The identity of this machine on a network, and the way to reach it.
#[derive(Clone, Debug)]
pub struct Context {
    /// Name of the context: the name of its directory.
    pub name: String,
    /// Organisation of the identity.
    pub organisation: String,
    /// Name of the network: the hash of its genesis.
    pub network: Hash,
    /// Name of the network for people.
    pub label: String,
    /// Addresses (`HOST:PORT`) of nodes, the preferred one first.
    pub nodes: Vec<String>,
    /// The own certificate, then its issuers.
    pub chain: Vec<CertificateDer<'static>>,
    /// The private key of the own certificate.
    pub key: Arc<SigningKey>,
    /// All organisations of the network, as they were at enrolment.
    pub msps: Arc<Msps>,
    /// Is the certificate renewed at use?
    pub renew: RenewalRule,
    /// The network as it was learnt since.
    pub memory: Memory,
}

/// The content of `context.toml`.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Settings {
    name: String,
    organisation: String,
    network: Hash,
    #[serde(default)]
    label: String,
    nodes: Vec<String>,
    #[serde(default, skip_serializing_if = "RenewalRule::is_default")]
    renew: RenewalRule,
}

impl Context {
    /// Reads the context of this name; without a name, the selected one.
    ///
    /// # Errors
    /// [`Code::NoContext`] if there is none, with the nearest name; [`Code::BadFile`] with the file and its fault.
    pub fn load(home: &Path, name: Option<&str>) -> Result<Self, Rejection> {
        let _whole = Lock::shared(home);
        Self::read(home, name)
    }

    /// As [`Context::load`], under a lock that is held already.
    fn read(home: &Path, name: Option<&str>) -> Result<Self, Rejection> {
        let name = match name {
            Some(name) => name.to_owned(),
            None => Self::current(home)?.ok_or_else(|| home::none_selected(home))?,
        };
        let directory = home::directory_of(home, &name)?;
        let path = directory.join(files::SETTINGS);
        let text = files::read(&path)?;
        let settings: Settings =
            toml::from_str(&text).map_err(|error| bad_file(&path, error.to_string().trim_end().replace('\n', " ")))?;
        if settings.name != name || settings.nodes.is_empty() {
            return Err(bad_file(&path, format!("name {:?} and {} nodes", settings.name, settings.nodes.len()))
                .wanted(format!("name = {name:?}, the name of its directory, and at least one node")));
        }
        let chain_path = directory.join(files::CERTIFICATE);
        let chain = files::certificates(&chain_path, &files::read(&chain_path)?)?;
        let key_path = directory.join(files::KEY);
        let key = SigningKey::from_pkcs8_pem(&files::read_secret(&key_path)?)
            .map_err(|error| bad_file(&key_path, error.to_string()))?;
        let msps_path = directory.join(files::MSPS);
        let msps =
            organisations::from_json(&files::read(&msps_path)?).map_err(|reason| bad_file(&msps_path, reason))?;
        // That the key belongs to the certificate is known here, not at the first connection.
        let key = Arc::new(key);
        TlsIdentity::new(chain.clone(), Arc::clone(&key)).map_err(|error| bad_file(&chain_path, error.to_string()))?;
        let Settings { name, organisation, network, label, nodes, renew } = settings;
        let memory = Memory::read(&directory);
        Ok(Self { name, organisation, network, label, nodes, chain, key, msps: Arc::new(msps), renew, memory })
    }

    /// Writes the context below `home`, replacing one of the same name: all of it or nothing, and the key is never
    /// readable by others. The first context that is stored becomes the selected one.
    ///
    /// # Errors
    /// [`Code::BadFile`] if something cannot be written, [`Code::NoContext`] if the name is not usable.
    pub fn save(&self, home: &Path) -> Result<(), Rejection> {
        home::check_name(&self.name)?;
        files::create_directories(&home.join(home::CONTEXTS))?;
        let _alone = Lock::exclusive(home)?;
        self.write(home)
    }

    /// Changes a stored context as it is now, whatever other programs do meanwhile.
    ///
    /// # Errors
    /// As [`Context::load`] and [`Context::save`], and what `change` says; then nothing is changed.
    pub fn change(
        home: &Path,
        name: &str,
        change: impl FnOnce(&mut Self) -> Result<(), Rejection>,
    ) -> Result<Self, Rejection> {
        home::directory_of(home, name)?;
        let _alone = Lock::exclusive(home)?;
        let mut context = Self::read(home, Some(name))?;
        change(&mut context)?;
        context.write(home)?;
        Ok(context)
    }

    /// As [`Context::save`], under a lock that is held already.
    fn write(&self, home: &Path) -> Result<(), Rejection> {
        let settings = Settings {
            name: self.name.clone(),
            organisation: self.organisation.clone(),
            network: self.network,
            label: self.label.clone(),
            nodes: self.nodes.clone(),
            renew: self.renew,
        };
        let settings = toml::to_string(&settings)
            .map_err(|error| Rejection::new(Code::Internal, format!("context.toml cannot be encoded: {error}")))?;
        let mut content = vec![
            (files::SETTINGS, settings),
            (files::CERTIFICATE, files::pem(&self.chain)),
            (files::KEY, self.key.to_pkcs8_pem()),
            (files::MSPS, organisations::to_json(&self.msps)?),
        ];
        content.extend(self.memory.to_json()?.map(|known| (files::NODES, known)));
        content.extend(reading::kept(home, &self.name)?);
        files::replace_directory(&home.join(home::CONTEXTS), &self.name, &content)?;
        if Self::current(home)?.is_none() {
            Self::select_alone(home, &self.name)?;
        }
        Ok(())
    }

    /// The needs of connections as this identity.
    ///
    /// # Errors
    /// [`Code::BadFile`] if certificate and key do not belong together.
    pub fn credentials(&self) -> Result<Credentials, Rejection> {
        self.credentials_with(&self.trusted())
    }

    pub(crate) fn credentials_with(&self, trusted: &Arc<Trusted>) -> Result<Credentials, Rejection> {
        let credentials = Credentials::new(self.network, self.identity()?, ServerTrust::Learnt(Arc::clone(trusted)))?;
        Ok(credentials.of(&self.organisation))
    }

    /// The organisations whose nodes are talked to.
    pub(crate) fn trusted(&self) -> Arc<Trusted> {
        Arc::new(Trusted::new(Arc::clone(&self.msps), self.learnt_organisations().cloned()))
    }

    /// Certificate and key, as connections and signatures need them.
    ///
    /// # Errors
    /// [`Code::BadFile`] if certificate and key do not belong together.
    pub fn identity(&self) -> Result<TlsIdentity, Rejection> {
        TlsIdentity::new(self.chain.clone(), Arc::clone(&self.key))
            .map_err(|error| Rejection::new(Code::BadFile, format!("context {:?}: {error}", self.name)))
    }

    /// The content of the own certificate: name, role, attributes, validity. Nothing of it is verified.
    ///
    /// # Errors
    /// [`Code::CertificateMalformed`].
    pub fn certificate(&self) -> Result<Certificate, Rejection> {
        Ok(Certificate::parse(self.chain.first().map(AsRef::as_ref).unwrap_or_default())?)
    }

    /// Advice to its owner once the certificate has expired.
    pub fn way_back(&self) -> String {
        match self.certificate() {
            Ok(own) => connect::way_back(&own, Some(&self.organisation)),
            Err(refused) => refused.advice().to_owned(),
        }
    }

    /// SHA-256 of the first root of an organisation: what `ledgerctl enroll --ca-fingerprint` wants.
    pub fn ca_fingerprint(&self, organisation: &str) -> Option<Hash> {
        let msp = self.msps.get(organisation).or_else(|| self.learnt_organisations()?.get(organisation));
        msp?.roots().next().map(|root| Hash::of(&[root]))
    }
}

/// The units of an organisation, as a node describes them to clients.
pub fn units_on_the_wire(units: &Units) -> v1::Units {
    organisations::units_to_wire(units)
}

/// The organisations of a network, as a node describes them.
///
/// # Errors
/// [`Code::CertificateMalformed`] if a root is not usable.
pub fn msps_of(organisations: &[v1::Organisation]) -> Result<Msps, Rejection> {
    organisations::from_wire(organisations)
}
