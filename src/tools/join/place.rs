//! The directory of a node that joins: beside the data directory until the network has accepted the node.

use crate::storage::files::JOINED_FILE;
use crate::storage::files::{CERTIFICATE_FILE, KEY_FILE};
use crate::trust::membership::Joined;
use ledger::network::{GENESIS_BYTES_MAX, Genesis};
use ledger_api::renewal_due;
use ledger_api::tls::TlsIdentity;
use ledger_api::token::JoinToken;
use ledger_base::durable::PUBLIC_MODE;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::Certificate;
use ledger_identity::msp::{Msp, Msps, Usage};
use ledger_storage::disk::RealDisk;
use ledger_storage::layout::{BLOCKS_DIRECTORY, GENESIS_FILE};
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// While a node joins: its number before.
const BEFORE_FILE: &str = "before";
/// Largest such file, in bytes.
const NUMBER_BYTES_MAX: usize = 32;

/// The end of the name of a directory in which a node is prepared; digits follow.
const STAGED: &str = ".joining-";
/// The entries that a file system of its own may hold from the beginning.
const LOST_AND_FOUND: &str = "lost+found";

/// Where a node's files are while it joins, and where they go.
pub(super) struct JoinDirectory {
    /// The directory that is in use now.
    current: PathBuf,
    data: PathBuf,
}

impl JoinDirectory {
    /// The data directory if it exists, else the directory that an earlier try left, else a new one.
    pub(super) fn open(data: &Path, token: &JoinToken) -> Result<Self, Rejection> {
        // Another token for the same node goes on with the same key, a token for another node does not.
        let whose = Hash::of(&[&token.network.0, token.organisation.as_bytes(), b"/", token.node.as_bytes()]);
        let staged = format!("{STAGED}{}", hex::encode(whose.0.get(..4).unwrap_or_default()));
        let current = if fs::symlink_metadata(data).is_ok() {
            let inside = data.join(&staged);
            if inside.exists() && data.join(JOINED_FILE).exists() {
                move_out(&inside, data)?;
            }
            if !is_free(data) {
                return Ok(Self { current: data.to_owned(), data: data.to_owned() });
            }
            inside
        } else {
            let mut beside = data.as_os_str().to_owned();
            beside.push(staged);
            PathBuf::from(beside)
        };
        ledger_base::durable::create_directory(&current)?;
        Ok(Self { current, data: data.to_owned() })
    }

    /// Is this the data directory of a node already?
    pub(super) fn is_joined(&self) -> bool {
        self.current == self.data
    }

    /// Does a node run with this data directory?
    pub(super) fn is_running(&self) -> bool {
        let opened = RealDisk::open_read_only(self.data.join(BLOCKS_DIRECTORY));
        opened.is_err_and(|error| error.kind() == ErrorKind::ResourceBusy)
    }

    pub(super) fn path(&self, file: &str) -> PathBuf {
        self.current.join(file)
    }

    pub(super) fn directory(&self) -> &Path {
        &self.current
    }

    pub(super) fn keep_genesis(&self, document: &[u8]) -> Result<(), Rejection> {
        ledger_base::durable::replace(&self.path(GENESIS_FILE), document, PUBLIC_MODE)
    }

    /// The node's certificate and key, if both are there and belong together.
    pub(super) fn identity(&self) -> Option<TlsIdentity> {
        TlsIdentity::from_pem_files(&self.path(CERTIFICATE_FILE), &self.path(KEY_FILE)).ok()
    }

    /// The number that the ledger had for a node of this name before this join asked for one, 0 for none: noted at the
    /// first call, where it is `present`.
    pub(super) fn id_before(&self, present: u64) -> Result<u64, Rejection> {
        let path = self.path(BEFORE_FILE);
        if fs::symlink_metadata(&path).is_ok() {
            let noted = ledger_base::durable::read(&path, NUMBER_BYTES_MAX)?;
            return String::from_utf8_lossy(&noted).trim().parse().map_err(|_| {
                Rejection::new(Code::BadFile, format!("{} contains no number", path.display()))
                    .next(format!("remove {} and join again", self.current.display()))
            });
        }
        ledger_base::durable::replace(&path, present.to_string().as_bytes(), PUBLIC_MODE)?;
        Ok(present)
    }

    /// The node has joined: all that is prepared becomes its data directory.
    pub(super) fn finish(&self, joined: &Joined) -> Result<(), Rejection> {
        ledger_base::durable::replace(&self.path(JOINED_FILE), &joined.to_bytes()?, PUBLIC_MODE)?;
        if self.current.parent() == Some(&self.data) {
            return move_out(&self.current, &self.data);
        }
        if fs::symlink_metadata(&self.data).is_ok() {
            return Err(ledger_base::durable::failed("make directory", &self.data, &ErrorKind::AlreadyExists.into()));
        }
        ledger_base::durable::rename(&self.current, &self.data)?;
        forget_noted(&self.data);
        Ok(())
    }

    /// The node of the data directory, which must be the token's; with the network's label.
    pub(super) fn joined(&self, token: &JoinToken) -> Result<(Joined, String), Rejection> {
        let other = |found: String| {
            Rejection::new(Code::BadFile, format!("{} exists already", self.data.display()))
                .found(found)
                .wanted(format!(
                    "a directory that does not exist yet, or that of {}/{}",
                    token.organisation, token.node
                ))
                .next("choose another directory with --data or the setting data; existing data are never overwritten")
        };
        let document = ledger_base::durable::read(&self.path(GENESIS_FILE), GENESIS_BYTES_MAX)
            .map_err(|_| other("files that are not a node's data".into()))?;
        let (genesis, network) = Genesis::from_bytes(&document)?;
        if network != token.network {
            return Err(other(format!("a node of network {network}")));
        }
        let Some(identity) = self.identity() else { return Err(other("no certificate with its key".into())) };
        let own = identity.own();
        let mut msps = Msps::new();
        msps.insert(Msp::new(&token.organisation, own.chain.get(1..).unwrap_or_default(), &[] as &[&[u8]])?)?;
        let end = Certificate::parse(own.certificate())?.not_after;
        let found = msps.verify_for(Usage::Server, own.certificate(), &[], end)?;
        if found.name != token.node {
            return Err(other(format!("the data of node {}", found.name)));
        }
        let founder = genesis.node(&token.organisation, &token.node);
        let joined = match (Joined::load(&self.data)?, founder) {
            (Some(joined), _) if joined.organisation == token.organisation => joined,
            (None, Some(founder)) => Joined {
                network,
                id: founder.id,
                organisation: founder.organisation.clone(),
                name: founder.name.clone(),
                address: founder.address.clone(),
                bootstrap: token.addresses.clone(),
                ca: token.ca,
            },
            _ => return Err(other("the data of another organisation's node".into())),
        };
        Ok((joined, genesis.label))
    }

    /// Has the last third of the certificate's life begun, or is it over?
    pub(super) fn renewal_due(&self, now: u64) -> Result<bool, Rejection> {
        let Some(identity) = self.identity() else { return Ok(true) };
        let certificate = Certificate::parse(identity.own().certificate())?;
        Ok(now >= renewal_due(certificate.not_before, certificate.not_after))
    }
}

/// The number is of no use any more; that it stays after a crash does no harm.
fn forget_noted(directory: &Path) {
    let _ = fs::remove_file(directory.join(BEFORE_FILE));
}

/// May a node be put here: is it a directory with nothing in it but what joins leave? A new disk is mounted so.
fn is_free(data: &Path) -> bool {
    let Ok(entries) = fs::read_dir(data) else { return false };
    entries.filter_map(Result::ok).all(|entry| {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        name == LOST_AND_FOUND || name.starts_with(STAGED)
    })
}

/// Moves what was prepared inside of the data directory to its place. `node.json` goes first: with it there, the next
/// try moves the rest; `genesis.json` last: without it no node starts.
fn move_out(inside: &Path, data: &Path) -> Result<(), Rejection> {
    let failed = |error: std::io::Error| ledger_base::durable::failed("move", inside, &error);
    let mut names = Vec::new();
    for entry in fs::read_dir(inside).map_err(failed)? {
        names.push(entry.map_err(failed)?.file_name());
    }
    names.sort_by_key(|name| match name.to_str() {
        Some(JOINED_FILE) => 0,
        Some(GENESIS_FILE) => 2,
        _ => 1,
    });
    for name in names {
        ledger_base::durable::rename(&inside.join(&name), &data.join(&name))?;
    }
    fs::remove_dir(inside).map_err(failed)?;
    forget_noted(data);
    ledger_base::durable::sync_directory(data)
}
