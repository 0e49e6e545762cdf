//! A data directory from a backup, marked so that no voter comes back that has forgotten its votes.

use super::settings::differences;
use super::{CONFIG_FILE, FILE_BYTES_MAX, Manifest, PAPERS, own};
use crate::node::NodeBuilder;
use crate::process::config::Config;
use crate::process::terminal::{asked, eprint_line};
use crate::storage::files::RESTORED_FILE;
use crate::storage::files::{CERTIFICATE_FILE, KEY_FILE};
use crate::tools::verify::verified;
use ledger_api::tls::TlsIdentity;
use ledger_base::durable::{PUBLIC_MODE, create_directory, read, rename, replace, sync_directory};
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shell;
use ledger_storage::layout::{BLOCKS_DIRECTORY, GENESIS_FILE, SNAPSHOTS_DIRECTORY};
use std::fs::{self, DirBuilder, File};
use std::io::ErrorKind;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

/// Most directories of restores that were interrupted, which are all kept.
const UNFINISHED_MAX: u32 = 100;

/// The arguments of `ledgerd restore`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerd restore /backup/node1 --config ledgerd.toml")]
pub(crate) struct RestoreOptions {
    /// The backup.
    #[arg(value_name = "DIR")]
    directory: PathBuf,
    /// The node's configuration. If it does not exist, the one in the backup is shown, and used if you confirm.
    #[arg(long, value_name = "FILE", default_value = "ledgerd.toml")]
    pub(crate) config: PathBuf,
    /// Use the configuration in the backup without confirmation.
    #[arg(long)]
    take_config: bool,
}

impl RestoreOptions {
    /// The text of the backup's configuration, if there is none here and the operator agrees to it.
    ///
    /// # Errors
    /// [`Code::BadFile`] if the backup has none; [`Code::LastOne`] if it is not agreed to, or there is no terminal to ask at.
    pub(crate) fn config_of_backup(&self) -> Result<Option<String>, Rejection> {
        if fs::symlink_metadata(&self.config).is_ok() {
            return Ok(None);
        }
        let text = self.backed_up()?;
        let mut shown = vec![format!("{} does not exist. The backup has these settings:", self.config.display())];
        shown.extend(
            text.lines()
                .filter(|line| !line.trim().is_empty() && !line.starts_with('#'))
                .map(|line| format!("  {line}")),
        );
        if let Ok(config) = Config::parse(&text, &self.config) {
            shown.push(format!(
                "The node would store its data in {}, and listen on {}.",
                config.data.display(),
                config.listen
            ));
        }
        if self.take_config {
            shown.iter().for_each(|line| eprint_line(line));
            return Ok(Some(text));
        }
        let refused = |wanted: &str| {
            Rejection::new(Code::LastOne, "the configuration of the backup was not used")
                .found(shown.join("\n"))
                .wanted(wanted)
                .next("write a configuration for this machine and name it with --config, or confirm with --take-config")
        };
        match asked(&shown, "use these settings? type yes: ") {
            Some(true) => Ok(Some(text)),
            Some(false) => Err(refused("yes")),
            None => Err(refused("a terminal, for the confirmation of these settings")),
        }
    }

    /// The configuration in the backup. A directory without a manifest is no backup, whatever else is in it.
    fn backed_up(&self) -> Result<String, Rejection> {
        let _whole = Manifest::read(&self.directory)?;
        let text = read(&self.directory.join(CONFIG_FILE), FILE_BYTES_MAX)?;
        Ok(String::from_utf8_lossy(&text).into_owned())
    }
}

/// Makes the data directory of a node from a backup; answers with what to tell the operator.
///
/// # Errors
/// [`Code::BadFile`] if the directory is no whole backup, or the data directory is in use; [`Code::BadConfiguration`] if it is
/// of another node; the fault of the blocks, with file and byte. Then nothing was restored.
///
/// `taken` is the text of the configuration if it is that of the backup. It is put in its place when all the rest is right.
pub(crate) fn restore(
    builder: &NodeBuilder,
    options: &RestoreOptions,
    config: &Config,
    taken: Option<&str>,
) -> Result<String, Rejection> {
    let from = &options.directory;
    let manifest = Manifest::read(from)?;
    check_node(config, &manifest)?;
    check_free(&config.data)?;
    check_papers(from, &manifest)?;
    let report = verified(builder, from, None, true)?;
    if (report.height, report.block_hash, report.state_digest)
        != (manifest.height, manifest.block_hash, manifest.state_digest)
    {
        return Err(Rejection::new(Code::ChainInvalid, format!("{} was changed since it was made", from.display()))
            .found(format!("block {} {}, state digest {}", report.height, report.block_hash, report.state_digest))
            .wanted(format!(
                "block {} {}, state digest {}",
                manifest.height, manifest.block_hash, manifest.state_digest
            ))
            .next("use another backup"));
    }
    let mut notes = String::new();
    match taken {
        Some(text) => provide(&options.config, text)?,
        None => notes += &other_settings(&options.config, &options.backed_up()?),
    }
    if let Some(kept) = place(from, &config.data)? {
        notes += &format!(
            "kept     {}, possibly left by an earlier restore: remove it if nothing in it is needed\n",
            kept.display()
        );
    }
    let file = shell::path(&config.file);
    Ok(format!(
        "node     {}, restored in {} with the blocks up to {}\n{notes}It does not start in this state: it may have \
         voted and confirmed blocks since the backup was made.\n\nnext, if another node of the network runs:\n  \
         ledgerd rejoin --config {file}\nnext, if all the others are permanently lost:\n  ledgerd recover \
         --force-single --config {file}",
        manifest.node,
        config.data.display(),
        manifest.height
    ))
}

fn check_node(config: &Config, manifest: &Manifest) -> Result<(), Rejection> {
    let (network, wanted) = (manifest.network.to_string(), &config.member);
    let same = |wanted: &str, found: &str| wanted.is_empty() || wanted == found;
    if same(&wanted.network, &network) && same(&wanted.node, &manifest.node) {
        return Ok(());
    }
    Err(Rejection::new(Code::BadConfiguration, "the backup is of another node")
        .found(format!("node {} of network {network}", manifest.node))
        .wanted(format!(
            "node {} of network {}, as [member] of {} says",
            wanted.node,
            wanted.network,
            config.file.display()
        ))
        .next("use a separate configuration for each node, or name the right backup"))
}

/// The certificate and the key are whole, belong together, and are those of the node that the manifest names.
fn check_papers(from: &Path, manifest: &Manifest) -> Result<(), Rejection> {
    let bad = |found: String| {
        Rejection::new(Code::BadFile, format!("{} is not a usable backup", from.display()))
            .found(found)
            .wanted(format!("the certificate and the key of node {}", manifest.node))
            .next("use another backup")
    };
    let (network, node) = own(from).map_err(|fault| bad(fault.to_string()))?;
    if network != manifest.network || node != manifest.node {
        return Err(bad(format!("those of node {node} of network {network}")));
    }
    match TlsIdentity::from_pem_files(&from.join(CERTIFICATE_FILE), &from.join(KEY_FILE)) {
        Ok(_) => Ok(()),
        Err(error) => Err(bad(error.to_string())),
    }
}

/// Nothing is ever overwritten.
fn check_free(data: &Path) -> Result<(), Rejection> {
    let found = match fs::read_dir(data) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        Err(error) => error.to_string(),
        Ok(mut entries) => match entries.next() {
            None => return Ok(()),
            Some(_) => "a directory with files in it".to_owned(),
        },
    };
    Err(Rejection::new(Code::BadFile, format!("{} is in use", data.display()))
        .found(found)
        .wanted("no directory, or an empty one")
        .next("move it away first, if it contains anything that is needed"))
}

/// Puts the configuration in its place.
fn provide(path: &Path, text: &str) -> Result<(), Rejection> {
    if let Some(parent) = path.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        create_directory(parent)?;
    }
    replace(path, text.as_bytes(), PUBLIC_MODE)
}

/// The settings of the configuration that is used and in which the backup has others, a line each; empty if there are none.
fn other_settings(path: &Path, backup: &str) -> String {
    let here = read(path, FILE_BYTES_MAX).unwrap_or_default();
    let differ = differences(&String::from_utf8_lossy(&here), backup);
    if differ.is_empty() {
        return String::new();
    }
    let lines: String = differ.iter().map(|line| format!("  {line}\n")).collect();
    format!("settings {} is used; it differs from the configuration in the backup:\n{lines}", path.display())
}

/// Makes a directory beside the data directory, and never uses one that is there; with the first one that was there.
fn fresh(data: &Path) -> Result<(PathBuf, Option<PathBuf>), Rejection> {
    let name = data.file_name().unwrap_or_default().to_string_lossy().into_owned();
    if let Some(parent) = data.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        create_directory(parent)?;
    }
    let mut kept = None;
    for number in 0..UNFINISHED_MAX {
        let end = if number == 0 { String::new() } else { format!("-{number}") };
        let directory = data.with_file_name(format!("{name}.restoring{end}"));
        match DirBuilder::new().mode(0o700).create(&directory) {
            Ok(()) => return Ok((directory, kept)),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => kept = kept.or(Some(directory)),
            Err(error) => return Err(ledger_base::durable::failed("make", &directory, &error)),
        }
    }
    Err(Rejection::new(Code::BadFile, format!("too many unfinished restores next to {}", data.display()))
        .found(format!("{UNFINISHED_MAX} directories {name}.restoring"))
        .wanted("fewer directories left by earlier restores")
        .next("remove them if they contain nothing that is needed"))
}

/// Copies what a node starts from: all of it or nothing, whatever crashes. Answers with a directory of that kind that was there before
/// and was kept.
fn place(from: &Path, data: &Path) -> Result<Option<PathBuf>, Rejection> {
    let (unfinished, kept) = fresh(data)?;
    let placed = fill(from, &unfinished).and_then(|()| match fs::remove_dir(data) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(ledger_base::durable::failed("remove", data, &error)),
        _ => rename(&unfinished, data),
    });
    match placed {
        Ok(()) => Ok(kept),
        Err(fault) => {
            // It is ours. If it cannot be removed, the next restore keeps it and says so.
            let _left = fs::remove_dir_all(&unfinished);
            Err(fault)
        }
    }
}

fn fill(from: &Path, unfinished: &Path) -> Result<(), Rejection> {
    copy(from, unfinished, GENESIS_FILE)?;
    for (name, _) in PAPERS.into_iter().filter(|(name, _)| from.join(name).exists()) {
        copy(from, unfinished, name)?;
    }
    for directory in [BLOCKS_DIRECTORY, SNAPSHOTS_DIRECTORY] {
        copy_directory(&from.join(directory), &unfinished.join(directory))?;
    }
    fs::copy(from.join(super::MANIFEST_FILE), unfinished.join(RESTORED_FILE))
        .and_then(|_| File::open(unfinished.join(RESTORED_FILE))?.sync_all())
        .map_err(|error| ledger_base::durable::failed("write", &unfinished.join(RESTORED_FILE), &error))?;
    sync_directory(unfinished)
}

/// The verified blocks of a backup, for a node that comes back under a new number.
pub(crate) struct CopiedBlocks<'a>(&'a Path);

impl<'a> CopiedBlocks<'a> {
    /// Verifies the backup of any node of the same network.
    ///
    /// # Errors
    /// [`Code::WrongNetwork`] if it is of another network; the fault of its blocks, with file and byte.
    pub(crate) fn verify(builder: &NodeBuilder, from: &'a Path, data: &Path) -> Result<Self, Rejection> {
        let [theirs, ours] = [from, data].map(|place| read(&place.join(GENESIS_FILE), FILE_BYTES_MAX));
        if theirs? != ours? {
            return Err(Rejection::new(Code::WrongNetwork, format!("{} is of another network", from.display()))
                .found("another genesis.json")
                .wanted("a backup of a node of this network"));
        }
        verified(builder, from, None, true)?;
        Ok(Self(from))
    }

    /// Copies them into a data directory that has none.
    ///
    /// # Errors
    /// A failing disk.
    pub(crate) fn put(self, data: &Path) -> Result<(), Rejection> {
        for directory in [BLOCKS_DIRECTORY, SNAPSHOTS_DIRECTORY] {
            copy_directory(&self.0.join(directory), &data.join(directory))?;
        }
        sync_directory(data)
    }
}

/// Copies a file with its mode, down to the disk.
fn copy(from: &Path, to: &Path, name: &str) -> Result<(), Rejection> {
    let target = to.join(name);
    fs::copy(from.join(name), &target)
        .and_then(|_| File::open(&target)?.sync_all())
        .map_err(|error| ledger_base::durable::failed("copy", &from.join(name), &error))
}

fn copy_directory(from: &Path, to: &Path) -> Result<(), Rejection> {
    let failed = |error: std::io::Error| ledger_base::durable::failed("read", from, &error);
    let entries = match fs::read_dir(from) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        entries => entries.map_err(failed)?,
    };
    create_directory(to)?;
    for entry in entries {
        let entry = entry.map_err(failed)?;
        if entry.file_type().map_err(failed)?.is_file() {
            copy(from, to, &entry.file_name().to_string_lossy())?;
        }
    }
    sync_directory(to)
}
