//! `ledgerd backup` and `ledgerd restore`: a verified copy of a node for the safe, and the way back from it.
//!
//! A backup is an archive (all committed blocks, alone verifiable) with the node's papers and a manifest beside it. It never
//! holds the key of a CA, which has a copy of its own under a passphrase.
//!
//! A copy is older than what it was copied from: as a voter it would have forgotten votes and acknowledgements. So a directory
//! that is restored carries a mark, and a node does not start from it. `ledgerd rejoin` gives it a new number; where nothing
//! of the network is left, `ledgerd recover --force-single` makes it the beginning of what follows.

mod restore;
mod settings;

pub(crate) use restore::{CopiedBlocks, RestoreOptions, restore};

use crate::node::NodeBuilder;
use crate::process::clock::wall;
use crate::process::config::Config;
use crate::storage::files::JOINED_FILE;
use crate::storage::files::{CERTIFICATE_FILE, KEY_FILE, refuse_restored};
use crate::tools::verify::verified;
use crate::trust::membership::Joined;
use ledger::network::Genesis;
use ledger::verify::Report;
use ledger_base::durable::{PUBLIC_MODE, SECRET_MODE, create_directory, read, replace};
use ledger_base::hash::Hash;
use ledger_base::progress::{Progress, Step};
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shell;
use ledger_identity::certificate::Certificate;
use ledger_storage::archive::{Extent, Reached, archive};
use ledger_storage::layout::GENESIS_FILE;
use rustls_pki_types::CertificateDer;
use rustls_pki_types::pem::PemObject;
use serde::{Deserialize, Serialize};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

/// The file that makes a directory a backup; it is written last.
const MANIFEST_FILE: &str = "backup.json";
/// The node's configuration, in a backup.
const CONFIG_FILE: &str = "ledgerd.toml";
/// Files of the node in a backup beside its blocks, and who may read them.
const PAPERS: [(&str, u32); 3] = [(CERTIFICATE_FILE, PUBLIC_MODE), (KEY_FILE, SECRET_MODE), (JOINED_FILE, PUBLIC_MODE)];
/// Largest of these files, in bytes.
const FILE_BYTES_MAX: usize = 1024 * 1024;
/// The version of backups.
const VERSION: u32 = 1;

/// The arguments of `ledgerd backup`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerd backup /backup/node1 --config ledgerd.toml")]
pub(crate) struct BackupOptions {
    /// Directory of the backup: a new one, or an earlier backup of this node, which is updated.
    #[arg(value_name = "DIR")]
    directory: PathBuf,
    /// The node's configuration.
    #[arg(long, value_name = "FILE", default_value = "ledgerd.toml")]
    pub(crate) config: PathBuf,
}

/// The content of a backup.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Manifest {
    /// See [`VERSION`].
    version: u32,
    /// The network.
    network: Hash,
    /// The node, `ORGANISATION/NAME`.
    node: String,
    /// Height of the newest block.
    height: u64,
    /// Its hash.
    block_hash: Hash,
    /// The state digest after it.
    state_digest: Hash,
    /// When it was made, microseconds since the UNIX epoch.
    made: u64,
    /// The release that made it.
    program: String,
}

impl Manifest {
    fn read(directory: &Path) -> Result<Self, Rejection> {
        let path = directory.join(MANIFEST_FILE);
        let bad = |found: String| {
            Rejection::new(Code::BadFile, format!("{} is not a backup of a node", directory.display()))
                .found(found)
                .wanted(format!("a directory that ledgerd backup has finished, with {MANIFEST_FILE}"))
        };
        let bytes = read(&path, FILE_BYTES_MAX).map_err(|fault| bad(fault.message))?;
        let manifest: Self = serde_json::from_slice(&bytes).map_err(|error| bad(error.to_string()))?;
        if manifest.version != VERSION {
            return Err(bad(format!("a backup of version {}", manifest.version)).wanted(format!("version {VERSION}")));
        }
        Ok(manifest)
    }
}

/// Makes a backup of a node, which may run; answers with what to tell the operator.
///
/// # Errors
/// [`Code::BadFile`] if one of the directories cannot be used, or is of something else; a damaged block, with file and byte;
/// [`Code::DiskFull`]. Then the directory is no backup.
pub(crate) fn backup(builder: &NodeBuilder, options: &BackupOptions, config: &Config) -> Result<String, Rejection> {
    let (data, to) = (&config.data, &options.directory);
    refuse_restored(config)?;
    let (network, node) = own(data)?;
    prepare(to, network, &node)?;
    let mut progress = Progress::new(true);
    let mut tell = |Reached { segments, of_segments, bytes }| {
        progress.tell(Step { count: bytes, at: segments, of: Some(of_segments) }, |rate| {
            format!("copying blocks: segment {segments} of {of_segments}, {:.0} MB a second", rate / 1e6)
        });
    };
    let copied = archive((data, to), Extent::Committed, &Genesis::network_of, &mut tell);
    progress.clear();
    copied?;
    for (name, mode) in PAPERS.into_iter().filter(|(name, _)| data.join(name).exists()) {
        replace(&to.join(name), &read(&data.join(name), FILE_BYTES_MAX)?, mode)?;
    }
    replace(&to.join(CONFIG_FILE), &read(&config.file, FILE_BYTES_MAX)?, PUBLIC_MODE)?;
    let Report { height, block_hash, state_digest, transactions, .. } = verified(builder, to, None, true)?;
    let program = env!("CARGO_PKG_VERSION").to_owned();
    let manifest =
        Manifest { version: VERSION, network, node, height, block_hash, state_digest, made: wall(), program };
    let bytes =
        serde_json::to_vec_pretty(&manifest).map_err(|error| Rejection::new(Code::Internal, error.to_string()))?;
    replace(&to.join(MANIFEST_FILE), &bytes, PUBLIC_MODE)?;
    let mut told = format!(
        "backup   {}, node {} of network {network}\nholds    blocks up to {height}, every signature verified, \
         {transactions} transactions executed again\nsecret   it contains the private key of this node: restrict \
         access to it\n",
        to.display(),
        manifest.node
    );
    for organisation in crate::trust::ca::carried(data)? {
        told += &format!(
            "CA       the CA key of {organisation} is not included: ledgerctl ca backup FILE makes a backup under a \
             passphrase\n"
        );
    }
    // A directory that the operator has made keeps its mode.
    if fs::metadata(to).is_ok_and(|found| found.permissions().mode() & 0o077 != 0) {
        told += &format!("warning  other users can read it: chmod 700 {}\n", shell::path(to));
    }
    Ok(format!("{told}\nto restore:\n  ledgerd restore {} --config {}", shell::path(to), shell::path(&config.file)))
}

/// The network and the name of the node whose data directory this is.
fn own(data: &Path) -> Result<(Hash, String), Rejection> {
    let genesis = read(&data.join(GENESIS_FILE), FILE_BYTES_MAX)?;
    let (genesis, network) = Genesis::from_bytes(&genesis)?;
    let path = data.join(CERTIFICATE_FILE);
    let bad = |found: String| {
        Rejection::new(Code::BadFile, format!("{} is not usable", path.display()))
            .found(found)
            .wanted("the certificate of a node, and the root above it")
    };
    let text = read(&path, FILE_BYTES_MAX)?;
    let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&text).collect();
    let chain = chain.map_err(|error| bad(error.to_string()))?;
    let (Some(own), Some(root)) = (chain.first(), chain.last()) else {
        return Err(bad("no certificate".into()));
    };
    let name = Certificate::parse(own)?.name()?.to_owned();
    let joined = Joined::load(data)?.map(|joined| joined.organisation);
    let founder = || genesis.organisations.iter().find(|founder| founder.roots.iter().any(|known| **known == **root));
    let organisation = joined.or_else(|| founder().map(|founder| founder.name.clone()));
    let organisation =
        organisation.ok_or_else(|| bad("a certificate that belongs to no node of this network".into()))?;
    Ok((network, format!("{organisation}/{name}")))
}

/// Sees to it that a directory is empty, or an earlier backup of this node; until the new one is whole, it is none.
fn prepare(to: &Path, network: Hash, node: &str) -> Result<(), Rejection> {
    create_directory(to)?;
    let mut entries = fs::read_dir(to).map_err(|error| ledger_base::durable::failed("read", to, &error))?;
    if entries.next().is_none() {
        return begin(to, network, node);
    }
    let begun = read(&to.join(BEGUN_FILE), FILE_BYTES_MAX).unwrap_or_default();
    if begun != begun_by(network, node).as_bytes() {
        return Err(Rejection::new(Code::BadFile, format!("{} is in use", to.display()))
            .found("a directory that is not empty, and is not a backup of this node")
            .wanted(format!("an empty directory, or a backup of node {node} of network {network}"))
            .next("choose another directory"));
    }
    match fs::remove_file(to.join(MANIFEST_FILE)) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(ledger_base::durable::failed("remove", &to.join(MANIFEST_FILE), &error))
        }
        _ => ledger_base::durable::sync_directory(to),
    }
}

/// The file that says whose backup a directory is, from its first moment on.
const BEGUN_FILE: &str = "backup.of";

fn begin(to: &Path, network: Hash, node: &str) -> Result<(), Rejection> {
    replace(&to.join(BEGUN_FILE), begun_by(network, node).as_bytes(), PUBLIC_MODE)
}

fn begun_by(network: Hash, node: &str) -> String {
    format!("{node} {network}\n")
}
