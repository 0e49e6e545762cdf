//! Where contexts lie, which there are, and which is selected.

use super::CONTEXT_NAME_BYTES_MAX;
use super::Context;
use super::files::{self, bad_file};
use super::lock::Lock;
use ledger_base::rejection::{Code, Rejection};
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Directory of the contexts below the home.
pub(super) const CONTEXTS: &str = "contexts";
/// File that names the selected context.
const CURRENT: &str = "current";

/// The directory of this user's contexts: `$LEDGERD_HOME`, else `$XDG_CONFIG_HOME/ledgerd`, else `~/.config/ledgerd`.
///
/// # Errors
/// [`Code::BadFile`] if none of `LEDGERD_HOME`, `XDG_CONFIG_HOME` and `HOME` is set.
pub fn home() -> Result<PathBuf, Rejection> {
    let set = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    set("LEDGERD_HOME")
        .or_else(|| set("XDG_CONFIG_HOME").map(|path| path.join("ledgerd")))
        .or_else(|| set("HOME").map(|path| path.join(".config").join("ledgerd")))
        .ok_or_else(|| {
            Rejection::new(Code::BadFile, "no directory for contexts")
                .found("LEDGERD_HOME, XDG_CONFIG_HOME and HOME are not set")
                .wanted("one of these variables")
                .next("set LEDGERD_HOME to a directory")
        })
}

impl Context {
    /// The names of all stored contexts, in order.
    ///
    /// # Errors
    /// [`Code::BadFile`] if the directory cannot be read; a missing one is empty.
    pub fn list(home: &Path) -> Result<Vec<String>, Rejection> {
        let path = home.join(CONTEXTS);
        let entries = match fs::read_dir(&path) {
            Ok(entries) => entries,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
            Err(error) => return Err(bad_file(&path, error.to_string())),
        };
        let mut names: Vec<_> = entries
            .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
            .filter_map(|name| files::finished_name(&name).map(str::to_owned))
            .filter(|name| check_name(name).is_ok())
            .collect();
        names.sort_unstable();
        names.dedup();
        Ok(names)
    }

    /// The name of the selected context, if one is selected.
    ///
    /// # Errors
    /// [`Code::BadFile`] if the file cannot be read.
    pub fn current(home: &Path) -> Result<Option<String>, Rejection> {
        let path = home.join(CURRENT);
        if !path.exists() {
            return Ok(None);
        }
        let name = files::read(&path)?.trim().to_owned();
        Ok(Some(name).filter(|name| !name.is_empty()))
    }

    /// Selects the context that commands use without `--context`.
    ///
    /// # Errors
    /// [`Code::NoContext`] if there is none of this name, [`Code::BadFile`].
    pub fn select(home: &Path, name: &str) -> Result<(), Rejection> {
        let _alone = Lock::exclusive(home)?;
        Self::select_alone(home, name)
    }

    /// As [`Context::select`], under a lock that is held already.
    pub(super) fn select_alone(home: &Path, name: &str) -> Result<(), Rejection> {
        directory_of(home, name)?;
        files::replace_file(home, CURRENT, &format!("{name}\n"))
    }

    /// Removes a context with its key; if it was selected, none is afterwards.
    ///
    /// # Errors
    /// [`Code::NoContext`] if there is none of this name, [`Code::BadFile`].
    pub fn remove(home: &Path, name: &str) -> Result<(), Rejection> {
        let directory = directory_of(home, name)?;
        let _alone = Lock::exclusive(home)?;
        if Self::current(home)?.as_deref() == Some(name) {
            let path = home.join(CURRENT);
            fs::remove_file(&path).map_err(|error| bad_file(&path, error.to_string()))?;
        }
        // Gone in one step: a command that reads it now must not see the half of it.
        let leaving = directory.with_file_name(format!(".{name}.new"));
        let _leftover = fs::remove_dir_all(&leaving);
        let removed = fs::rename(&directory, &leaving).and_then(|()| fs::remove_dir_all(&leaving));
        removed.map_err(|error| bad_file(&directory, error.to_string()))?;
        let _renewed = fs::remove_file(renewing(home, name));
        Ok(())
    }
}

/// The file that whoever renews the certificate of a context holds locked.
pub(crate) fn renewing(home: &Path, name: &str) -> PathBuf {
    home.join(CONTEXTS).join(format!(".{name}.renewing"))
}

/// The directory of an existing context.
pub(super) fn directory_of(home: &Path, name: &str) -> Result<PathBuf, Rejection> {
    check_name(name)?;
    let contexts = home.join(CONTEXTS);
    files::finish_replacement(&contexts, name)?;
    let directory = contexts.join(name);
    if directory.is_dir() { Ok(directory) } else { Err(unknown(home, name)) }
}

/// A context may have every name that an identity can be registered with, and no other.
pub(super) fn check_name(name: &str) -> Result<(), Rejection> {
    if ledger_identity::check_new_name(name).is_ok() {
        return Ok(());
    }
    let shown: String = name.chars().take(CONTEXT_NAME_BYTES_MAX).collect();
    Err(Rejection::new(Code::NoContext, "the name of the context is not usable")
        .found(format!("{shown:?}"))
        .wanted(format!("1 to {CONTEXT_NAME_BYTES_MAX} bytes of letters, digits, \"-\", \"_\" and \".\""))
        .next("choose another name"))
}

/// There are contexts, but none is selected; or there are none.
pub(super) fn none_selected(home: &Path) -> Rejection {
    let names = Context::list(home).unwrap_or_default();
    let refused = Rejection::new(Code::NoContext, "no context is selected").found(listed(home, &names));
    match names.first() {
        Some(first) => refused
            .wanted("a selected context")
            .next(format!("add --context {first}, or: ledgerctl context use {first}")),
        None => refused
            .wanted("the context of an enrolled identity")
            .next("ledgerctl enroll NAME --node HOST:PORT --ca-fingerprint SHA256 --secret S"),
    }
}

fn unknown(home: &Path, name: &str) -> Rejection {
    let names = Context::list(home).unwrap_or_default();
    let otherwise = match names.is_empty() {
        true => "ledgerctl enroll NAME --node HOST:PORT --ca-fingerprint SHA256 --secret S",
        false => "ledgerctl context list",
    };
    let next = ledger_base::nearest::did_you_mean(name, names.iter().map(String::as_str), otherwise);
    Rejection::new(Code::NoContext, format!("there is no context {name:?}"))
        .found(listed(home, &names))
        .wanted("the name of a stored context")
        .next(next)
}

fn listed(home: &Path, names: &[String]) -> String {
    match names {
        [] => format!("no contexts in {}", home.join(CONTEXTS).display()),
        names => format!("contexts {}", names.join(", ")),
    }
}
