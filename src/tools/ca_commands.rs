//! An operator's work with a CA at the node's own machine, whether the node runs or not. It makes a secret for an admin
//! who is locked out, or a copy for the safe, and puts that back.

use crate::process::config::Config;
use crate::storage::files::CERTIFICATE_FILE;
use crate::trust::ca::backup::{self, Backup};
use crate::trust::ca::{CertificateAuthority, DIRECTORY, carried};
use crate::trust::enrolment::given_up_file;
use crate::trust::membership::Joined;
use ledger::network::{GENESIS_BYTES_MAX, Genesis};
use ledger_api::passphrase;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shell;
use ledger_identity::certificate::Certificate;
use ledger_storage::layout::GENESIS_FILE;
use rustls_pki_types::CertificateDer;
use rustls_pki_types::pem::PemObject;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Largest file of the node's certificates, in bytes.
const FILE_BYTES_MAX: usize = 64 * 1024;

/// Creates a one-time secret for an admin, at a node that holds the CA key of their organisation.
///
/// For an admin whose certificate has expired or whose key is lost. Needs only this machine's disk; the node may be
/// running or stopped. The secret is valid once the node runs.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct AdminSecret {
    /// Name of the admin.
    #[arg(default_value = "admin")]
    name: String,
    /// The organisation, if the node holds the CA keys of several.
    #[arg(long, value_name = "NAME")]
    organisation: Option<String>,
    /// The node's configuration.
    #[arg(long, value_name = "FILE", default_value = "ledgerd.toml")]
    pub(crate) config: PathBuf,
}

/// Backs up, restores or gives up a CA key that a node holds.
#[derive(Clone, Debug, clap::Subcommand)]
pub(crate) enum Ca {
    /// Writes the key and root certificate of the CA to a file, under a passphrase.
    Backup(Backing),
    /// Restores a CA key from such a file to this node's data directory; a running node detects it.
    Restore(Backing),
    /// Records that this node no longer holds a CA key, because its directory is lost and no backup exists.
    GiveUp {
        /// The organisation.
        organisation: String,
        /// The node's configuration.
        #[arg(long, value_name = "FILE", default_value = "ledgerd.toml")]
        config: PathBuf,
    },
}

/// A backup and its passphrase.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Backing {
    /// File of the backup.
    file: PathBuf,
    /// The organisation, if the node holds the CA keys of several.
    #[arg(long, value_name = "NAME")]
    organisation: Option<String>,
    /// File whose first line is the passphrase; otherwise LEDGERD_PASSPHRASE, otherwise a prompt.
    #[arg(long, value_name = "FILE")]
    passphrase_file: Option<PathBuf>,
    /// The node's configuration.
    #[arg(long, value_name = "FILE", default_value = "ledgerd.toml")]
    config: PathBuf,
}

impl AdminSecret {
    /// Makes the secret; answers with what to tell the operator.
    ///
    /// # Errors
    /// [`Code::NotFound`] if this node carries no such CA, and as [`CertificateAuthority::admin_secret`].
    pub(crate) fn run(&self, config: &Config, now: u64) -> Result<String, Rejection> {
        let own = Own::read(&config.data)?;
        let mut authority = open(&config.data, &own, self.organisation.as_deref())?;
        authority.set_days(config.ca.certificate_days, config.ca.secret_days);
        let secret = authority.admin_secret(&self.name, now)?;
        let (organisation, name) = (authority.organisation(), &self.name);
        let asked = if organisation == own.organisation { name.clone() } else { format!("{organisation}/{name}") };
        let Own { address, fingerprint, .. } = own;
        Ok(format!(
            "admin    {organisation}/{name}, to enrol within {} days\n\nnext, while the node runs:\n  ledgerctl \
             enroll {asked} --node {address} --ca-fingerprint {fingerprint} --secret {secret}\n  (if a context {name} \
             exists: add --force to replace it)",
            config.ca.secret_days
        ))
    }
}

impl Ca {
    /// The node's configuration.
    pub(crate) fn config(&self) -> &Path {
        match self {
            Self::Backup(backing) | Self::Restore(backing) => &backing.config,
            Self::GiveUp { config, .. } => config,
        }
    }

    /// Does it; answers with what to tell the operator.
    ///
    /// # Errors
    /// A reason in words for the operator; nothing is ever overwritten.
    pub(crate) fn run(&self, config: &Config) -> Result<String, Rejection> {
        match self {
            Self::Backup(backing) => backing.write(config),
            Self::Restore(backing) => backing.restore(config),
            Self::GiveUp { organisation, .. } => give_up(&config.data, organisation),
        }
    }
}

impl Backing {
    fn write(&self, config: &Config) -> Result<String, Rejection> {
        let own = Own::read(&config.data)?;
        let authority = open(&config.data, &own, self.organisation.as_deref())?;
        if fs::symlink_metadata(&self.file).is_ok() {
            return Err(ledger_base::durable::failed("write", &self.file, &io::ErrorKind::AlreadyExists.into()));
        }
        backup::write(&authority, &passphrase(self.passphrase_file.as_deref(), true)?, &self.file)?;
        Ok(format!(
            "CA       {}, sha256 {}\nbackup   {}, valid as long as the CA: key and root certificate never \
             change\n\nStore the file and the passphrase separately, and both away from this machine.\nto restore, at \
             any node of {0}:\n  ledgerd ca restore {} --config FILE",
            authority.organisation(),
            authority.fingerprint(),
            self.file.display(),
            shell::path(&self.file),
        ))
    }

    fn restore(&self, config: &Config) -> Result<String, Rejection> {
        let own = Own::read(&config.data)?;
        let Backup { organisation, key, root } = {
            let backup = backup::read(&self.file, &passphrase(self.passphrase_file.as_deref(), false)?)?;
            own.check_root(&backup)?;
            backup
        };
        let directory = config.data.join(DIRECTORY).join(&organisation);
        ledger_base::durable::create_directory(&config.data.join(DIRECTORY))?;
        let authority = CertificateAuthority::install(&directory, &organisation, &key, &root)?;
        let _absent = fs::remove_file(given_up_file(&config.data, &organisation));
        Ok(format!(
            "CA       {organisation}, sha256 {}, restored in {}\n\nA running node detects it within seconds, a \
             stopped one when it starts; ledgerctl ca status shows it.",
            authority.fingerprint(),
            directory.display()
        ))
    }
}

/// The CA of the wanted organisation, else of the node's own, else the only one.
fn open(data: &Path, own: &Own, wanted: Option<&str>) -> Result<CertificateAuthority, Rejection> {
    let names = carried(data)?;
    let chosen = match (wanted, names.as_slice()) {
        (Some(wanted), _) => names.iter().find(|name| *name == wanted),
        (None, [only]) => Some(only),
        (None, _) => names.iter().find(|name| **name == own.organisation),
    };
    let Some(chosen) = chosen else {
        let found = if names.is_empty() { "no CA".to_owned() } else { format!("the CA of {}", names.join(", ")) };
        let wanted = wanted.unwrap_or(&own.organisation);
        return Err(Rejection::new(Code::NotFound, format!("this node does not hold the CA key of {wanted}"))
            .found(format!("{found} in {}", data.join(DIRECTORY).display()))
            .wanted("a node that holds it: ledgerctl ca status")
            .next("run the command on the machine of that node"));
    };
    CertificateAuthority::open(&data.join(DIRECTORY).join(chosen))
}

fn give_up(data: &Path, organisation: &str) -> Result<String, Rejection> {
    Own::read(data)?;
    let directory = data.join(DIRECTORY).join(organisation);
    if organisation.contains('/') || organisation.starts_with('.') {
        return Err(Rejection::new(Code::BadArgument, format!("{organisation:?} is not an organisation"))
            .wanted("the name of the organisation whose CA is lost"));
    }
    if fs::symlink_metadata(&directory).is_ok() {
        return Err(Rejection::new(Code::BadFile, format!("{} exists", directory.display()))
            .found("a CA key that is not lost")
            .wanted("a directory that does not exist")
            .next("move the directory to a safe place first, if this node must no longer hold the CA key"));
    }
    let mark = given_up_file(data, organisation);
    ledger_base::durable::create_directory(&data.join(DIRECTORY))?;
    ledger_base::durable::replace(&mark, b"", ledger_base::durable::SECRET_MODE)?;
    Ok(format!(
        "the CA key of {organisation} is given up at this node; it is recorded on the ledger when the node \
         runs\n\nOther nodes with the key continue to issue certificates: ledgerctl ca status. If there is none, \
         enrolment and renewal end permanently."
    ))
}

/// The node of the data directory.
struct Own {
    organisation: String,
    /// Where clients reach it.
    address: String,
    /// SHA-256 of the root behind its certificate, which clients pin.
    fingerprint: Hash,
    /// Roots that this node knows without its ledger: its own organisation's, and the founders'.
    roots: Vec<Vec<u8>>,
}

impl Own {
    fn read(data: &Path) -> Result<Self, Rejection> {
        let (genesis, _) =
            Genesis::from_bytes(&ledger_base::durable::read(&data.join(GENESIS_FILE), GENESIS_BYTES_MAX)?)?;
        let path = data.join(CERTIFICATE_FILE);
        let bad = |found: String| {
            Rejection::new(Code::BadFile, format!("{} is not usable", path.display()))
                .found(found)
                .wanted("the node's certificate and the root above it")
        };
        let text = ledger_base::durable::read(&path, FILE_BYTES_MAX)?;
        let chain = CertificateDer::pem_slice_iter(&text).collect::<Result<Vec<_>, _>>();
        let chain = chain.map_err(|error| bad(error.to_string()))?;
        let (Some(own), Some(root)) = (chain.first(), chain.last()) else {
            return Err(bad("no certificate".into()));
        };
        let name = Certificate::parse(own)?.name()?.to_owned();
        let joined = Joined::load(data)?;
        let founder = genesis.organisations.iter().find(|founder| founder.roots.iter().any(|known| **known == **root));
        let (organisation, address) = match (joined, founder) {
            (Some(joined), _) => (joined.organisation, joined.address),
            (None, Some(founder)) => {
                let node = genesis.node(&founder.name, &name);
                (founder.name.clone(), node.map(|node| node.address.clone()).unwrap_or_default())
            }
            (None, None) => return Err(bad("a certificate that belongs to no node of this network".into())),
        };
        let founders = genesis.organisations.iter().flat_map(|founder| &founder.roots).map(|root| root.to_vec());
        let roots = std::iter::once(root.to_vec()).chain(founders).collect();
        Ok(Self { organisation, address, fingerprint: Hash::of(&[root]), roots })
    }

    /// A copy of another network's CA is of no use here.
    fn check_root(&self, backup: &Backup) -> Result<(), Rejection> {
        if self.roots.contains(&backup.root) {
            return Ok(());
        }
        Err(Rejection::new(Code::BadFile, "the backup is of another CA")
            .found(format!("the CA of {}, sha256 {}", backup.organisation, backup.fingerprint()))
            .wanted(format!("the CA of {}, sha256 {}", self.organisation, self.fingerprint))
            .next("restore the backup at a node of its own organisation"))
    }
}
