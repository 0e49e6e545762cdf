//! The contexts of `ledgerd dev` have fixed names, so they belong to one run at a time: the one that holds the lock.
//!
//! The lock is the system's, and ends with the process however that ends. The next run replaces the remains of a run
//! that was killed. Nobody touches the files of a run that lives.

use super::{LABEL, ORGANISATIONS, context_name};
use ledger_api::Context;
use ledger_base::rejection::{Code, Rejection};
use std::fs::{DirBuilder, File, OpenOptions};
use std::io::{Read, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::Path;

/// The file that is locked, beside the directory of the contexts. It says who holds it.
const FILE: &str = ".dev.lock";
/// Most bytes of it that are read.
const HOLDER_BYTES_MAX: u64 = 1024;

/// The right to make, replace and remove the contexts of a network for playing.
pub(super) struct Ownership {
    file: File,
}

impl Ownership {
    /// Takes it, before anything is touched.
    ///
    /// # Errors
    /// [`Code::AlreadyExists`] if another run has it, or a context of somebody else has one of the names;
    /// [`Code::BadFile`] if the home cannot be written.
    pub(super) fn take(home: &Path) -> Result<Self, Rejection> {
        let path = home.join(FILE);
        let failed = |error: std::io::Error| {
            Rejection::new(Code::BadFile, format!("cannot write {}", path.display()))
                .found(error.to_string())
                .wanted("a writable place for the contexts of the network")
                .next("check its owner and its free space, or choose another place: LEDGERD_HOME=DIR ledgerd dev")
        };
        DirBuilder::new().recursive(true).mode(0o700).create(home).map_err(failed)?;
        let file = OpenOptions::new().create(true).truncate(false).read(true).write(true).mode(0o600).open(&path);
        let file = file.map_err(failed)?;
        if file.try_lock().is_err() {
            return Err(taken(&file, home));
        }
        for organisation in ORGANISATIONS {
            check_name(home, &context_name(organisation))?;
        }
        Ok(Self { file })
    }

    /// Says in the file who holds it, for whoever is refused. That it cannot be written is no reason to stop.
    pub(super) fn sign(&mut self, address: &str, data: &Path) {
        let text = format!("process {}, at {address}, data in {}", std::process::id(), data.display());
        let _unsigned = self.file.set_len(0).and_then(|()| self.file.write_all(text.as_bytes()));
    }
}

fn taken(file: &File, home: &Path) -> Rejection {
    let mut holder = String::new();
    let _unknown = file.take(HOLDER_BYTES_MAX).read_to_string(&mut holder);
    let holder = if holder.is_empty() { "a process that has just started".to_owned() } else { holder };
    let names = ORGANISATIONS.map(context_name).join(" and ");
    Rejection::new(Code::AlreadyExists, format!("another ledgerd dev is running, and uses the contexts {names}"))
        .found(holder)
        .wanted(format!("at most one for the contexts in {}", home.display()))
        .next(
            "use that one, end it with Ctrl-C, or choose another place: LEDGERD_HOME=DIR ledgerd dev --listen \
               127.0.0.1:0",
        )
}

/// A context of this name is missing, or of a network for playing.
fn check_name(home: &Path, name: &str) -> Result<(), Rejection> {
    let known = Context::list(home)?.iter().any(|known| known == name);
    let context = if known { Context::load(home, Some(name))? } else { return Ok(()) };
    if context.label == LABEL {
        return Ok(());
    }
    Err(Rejection::new(Code::AlreadyExists, format!("the context {name:?} was not created by ledgerd dev"))
        .found(format!("an identity of {} on network {:?}", context.organisation, context.label))
        .wanted("an unused name: its key would be lost")
        .next(format!(
            "choose another place: LEDGERD_HOME=DIR ledgerd dev; or delete the context if its key is not needed: \
             ledgerctl context delete {name}"
        )))
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn one_run_at_a_time_owns_the_contexts_and_the_next_one_is_told_who() {
        let home = tempfile::tempdir().unwrap();
        let mut first = Ownership::take(home.path()).unwrap();
        first.sign("127.0.0.1:7450", Path::new("/tmp/data"));
        let refused = Ownership::take(home.path()).err().unwrap();
        assert_eq!(refused.code, Code::AlreadyExists);
        assert!(refused.found.contains("at 127.0.0.1:7450, data in /tmp/data"), "{refused}");
        drop(first);
        assert!(Ownership::take(home.path()).is_ok());
    }

    #[test]
    fn a_home_that_cannot_be_written_is_named() {
        let place = tempfile::tempdir().unwrap();
        let file = place.path().join("home");
        std::fs::write(&file, "").unwrap();
        let refused = Ownership::take(&file).err().unwrap();
        assert!(refused.code == Code::BadFile && refused.advice().contains("LEDGERD_HOME"), "{refused}");
    }
}
