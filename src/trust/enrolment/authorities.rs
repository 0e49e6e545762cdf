//! The CAs that this node carries. Others may come while it runs: taken over from another node, or restored from a copy.

use crate::ordering::directory::Member;
use crate::trust::ca;
use crate::trust::ca::CertificateAuthority;
use ledger::{Ledger, msp};
use ledger_base::rejection::{Code, Rejection};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};

/// In front of the name of an organisation in the file that says that its CA was given up here.
const GIVEN_UP: &str = ".given-up-";

/// The CAs of a node; see the module.
pub(crate) struct Authorities {
    /// The node's data directory.
    data: PathBuf,
    /// Days for which certificates are valid and secrets can be used.
    days: (u32, u32),
    /// By organisation; most nodes carry one or none.
    open: RwLock<BTreeMap<String, Arc<Mutex<CertificateAuthority>>>>,
}

impl Authorities {
    /// Opens all that lie in the node's data directory.
    ///
    /// # Errors
    /// As [`CertificateAuthority::open`], of the first one that cannot be opened.
    pub(crate) fn open(data: &Path, days: (u32, u32)) -> Result<Self, Rejection> {
        let authorities = Self { data: data.to_owned(), days, open: RwLock::default() };
        for organisation in ca::carried(data)? {
            authorities.open_one(&organisation)?;
        }
        Ok(authorities)
    }

    /// The CA of an organisation, if this node carries it.
    pub(crate) fn find(&self, organisation: &str) -> Option<Arc<Mutex<CertificateAuthority>>> {
        self.open.read().unwrap_or_else(PoisonError::into_inner).get(organisation).cloned()
    }

    /// The organisations whose CAs this node carries.
    pub(crate) fn organisations(&self) -> Vec<String> {
        self.open.read().unwrap_or_else(PoisonError::into_inner).keys().cloned().collect()
    }

    /// Where the CA of an organisation lies.
    pub(crate) fn directory(&self, organisation: &str) -> PathBuf {
        self.data.join(ca::DIRECTORY).join(organisation)
    }

    /// The node's data directory.
    pub(super) fn data(&self) -> &Path {
        &self.data
    }

    /// Carries one less.
    pub(super) fn forget(&self, organisation: &str) {
        self.open.write().unwrap_or_else(PoisonError::into_inner).remove(organisation);
    }

    /// Opens what has come since: directories that were not there before.
    ///
    /// # Errors
    /// As [`CertificateAuthority::open`].
    pub(super) fn look(&self) -> Result<(), Rejection> {
        for organisation in ca::carried(&self.data)? {
            if self.find(&organisation).is_none() {
                self.open_one(&organisation)?;
                tracing::info!(organisation, "holding the CA key in the data directory");
            }
        }
        Ok(())
    }

    fn open_one(&self, organisation: &str) -> Result<(), Rejection> {
        let mut authority = CertificateAuthority::open(&self.directory(organisation))?;
        if authority.organisation() != organisation {
            return Err(Rejection::new(
                Code::BadFile,
                format!("{} is not usable", self.directory(organisation).display()),
            )
            .found(format!("the CA of {}", authority.organisation()))
            .wanted("a directory with the name of its organisation"));
        }
        authority.set_days(self.days.0, self.days.1);
        self.add(authority);
        Ok(())
    }

    /// Carries one more.
    pub(super) fn add(&self, mut authority: CertificateAuthority) {
        authority.set_days(self.days.0, self.days.1);
        let mut open = self.open.write().unwrap_or_else(PoisonError::into_inner);
        open.insert(authority.organisation().to_owned(), Arc::new(Mutex::new(authority)));
    }

    /// The ledger may know a node as a carrier of a CA whose directory is gone. Such a node must not start as if
    /// nothing had happened: the organisation counts on it.
    ///
    /// # Errors
    /// [`Code::BadFile`] with the directory and the remedy.
    pub(crate) fn check_carried(&self, ledger: &Ledger, me: &Member) -> Result<(), Rejection> {
        let given_up = self.given_up();
        for carrier in msp::carriers(&**ledger.state())? {
            let own = carrier.node_organisation == me.organisation && carrier.node == me.name;
            let organisation = &carrier.organisation;
            if !own || self.find(organisation).is_some() || given_up.contains(organisation) {
                continue;
            }
            return Err(Rejection::new(Code::BadFile, format!("the CA key of {organisation} is missing"))
                .found(format!("no directory {}", self.directory(organisation).display()))
                .wanted(format!("the CA key that {} holds, according to the ledger", me.full_name()))
                .next(format!(
                    "restore the directory, or: ledgerd ca restore FILE --config FILE; if no backup exists: ledgerd \
                     ca give-up {organisation} --config FILE"
                )));
        }
        Ok(())
    }

    /// The organisations whose CAs the operator has given up here: on the ledger this node may still carry them.
    pub(crate) fn given_up(&self) -> Vec<String> {
        let directory = self.data.join(ca::DIRECTORY);
        let entries = std::fs::read_dir(directory).into_iter().flatten().flatten();
        let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
        names.filter_map(|name| name.strip_prefix(GIVEN_UP).map(str::to_owned)).collect()
    }

    /// The ledger knows that a CA was given up here, or this node carries it again.
    pub(super) fn settle_given_up(&self, organisation: &str) {
        let _gone = std::fs::remove_file(given_up_file(&self.data, organisation));
    }
}

/// Where it stands that the CA of an organisation was given up at this node.
pub(crate) fn given_up_file(data: &Path, organisation: &str) -> PathBuf {
    data.join(ca::DIRECTORY).join(format!("{GIVEN_UP}{organisation}"))
}

/// A CA that panicked half-way has changed nothing: it changes its memory last.
pub(crate) fn lock(authority: &Mutex<CertificateAuthority>) -> MutexGuard<'_, CertificateAuthority> {
    authority.lock().unwrap_or_else(PoisonError::into_inner)
}
