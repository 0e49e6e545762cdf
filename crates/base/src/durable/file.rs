//! Files: created, replaced, read.

use super::directory::rename_on;
use super::failed;
use super::medium::{Medium, Real};
use crate::rejection::{Code, Rejection};
use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::{Path, PathBuf};

/// New content of a file, on the disk beside the old one.
#[derive(Debug)]
#[must_use = "nothing has changed until it is published"]
pub struct Staged {
    from: PathBuf,
    to: PathBuf,
}

impl Staged {
    /// Puts the new content in the place of the old.
    ///
    /// # Errors
    /// The file, and what the system says. Then nobody knows which of the two a crash leaves.
    pub fn publish(self) -> Result<(), Rejection> {
        self.publish_on(&Real)
    }

    fn publish_on(self, medium: &impl Medium) -> Result<(), Rejection> {
        rename_on(medium, &self.from, &self.to)
    }
}

/// Replaces a file, or makes it: [`stage`], then [`Staged::publish`].
///
/// # Errors
/// As these two.
pub fn replace(path: &Path, content: &[u8], mode: u32) -> Result<(), Rejection> {
    stage(path, content, mode)?.publish()
}

/// Writes the new content of a file beside it, down to the disk.
///
/// # Errors
/// The file, and what the system says. Then nothing has changed.
pub fn stage(path: &Path, content: &[u8], mode: u32) -> Result<Staged, Rejection> {
    stage_from(path, &mut &*content, mode)
}

/// As [`stage`], with content that is read piece by piece.
///
/// # Errors
/// As [`stage`].
pub fn stage_from(path: &Path, content: &mut dyn Read, mode: u32) -> Result<Staged, Rejection> {
    stage_on(&Real, path, content, mode)
}

fn stage_on(medium: &impl Medium, path: &Path, content: &mut dyn Read, mode: u32) -> Result<Staged, Rejection> {
    let mut from = path.as_os_str().to_owned();
    from.push(".new");
    let from = PathBuf::from(from);
    // What a crash left behind may have another mode.
    match medium.remove(&from) {
        Err(error) if error.kind() != ErrorKind::NotFound => return Err(failed("remove", &from, &error)),
        _ => {}
    }
    create_on(medium, &from, content, mode).inspect_err(|_| {
        let _ = medium.remove(&from);
    })?;
    Ok(Staged { from, to: path.to_owned() })
}

/// Writes a file that must not exist yet, down to the disk; its directory is left to [`sync_directory`].
///
/// [`sync_directory`]: ledger_base::sync_directory
///
/// # Errors
/// The file, and what the system says.
pub fn create(path: &Path, content: &[u8], mode: u32) -> Result<(), Rejection> {
    create_on(&Real, path, &mut &*content, mode)
}

fn create_on(medium: &impl Medium, path: &Path, content: &mut dyn Read, mode: u32) -> Result<(), Rejection> {
    let written = medium.create_new(path, mode).and_then(|mut file| {
        io::copy(content, &mut file)?;
        medium.sync(&file)
    });
    written.map_err(|error| failed("write", path, &error))
}

/// Reads a file of at most that many bytes.
///
/// # Errors
/// The file, and what the system says or how large it may be.
pub fn read(path: &Path, bytes_max: usize) -> Result<Vec<u8>, Rejection> {
    let read = |error: io::Error| failed("read", path, &error);
    let file = File::open(path).map_err(read)?;
    let mut content = Vec::new();
    let limit = u64::try_from(bytes_max).unwrap_or(u64::MAX).saturating_add(1);
    file.take(limit).read_to_end(&mut content).map_err(read)?;
    if content.len() > bytes_max {
        return Err(Rejection::new(Code::BadFile, format!("{} is too large", path.display()))
            .wanted(format!("at most {bytes_max} bytes")));
    }
    Ok(content)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::super::medium::forgetful::Forgetful;
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    const PATH: &str = "/data/node.json";

    fn replace_on(medium: &Forgetful, content: &[u8]) -> Result<(), Rejection> {
        stage_on(medium, Path::new(PATH), &mut &*content, 0o600)?.publish_on(medium)
    }

    #[test]
    fn what_was_replaced_is_there_after_a_crash() {
        let disk = Forgetful::default();
        replace_on(&disk, b"old").unwrap();
        assert_eq!(disk.after_a_crash(PATH).as_deref(), Some(&b"old"[..]));
        replace_on(&disk, b"new").unwrap();
        assert_eq!(disk.after_a_crash(PATH).as_deref(), Some(&b"new"[..]));
    }

    #[test]
    fn a_crash_at_any_step_leaves_the_old_content_or_the_new() {
        let disk = Forgetful::default();
        replace_on(&disk, b"old").unwrap();
        disk.forget_history();
        replace_on(&disk, b"new").unwrap();
        let seen = disk.after_each_step(PATH);
        assert!(seen.iter().all(|content| matches!(content.as_deref(), Some(b"old" | b"new"))), "{seen:?}");
    }

    #[test]
    fn a_file_that_moves_to_another_directory_is_gone_from_the_first_after_a_crash() {
        let disk = Forgetful::default();
        replace_on(&disk, b"here").unwrap();
        rename_on(&disk, Path::new(PATH), Path::new("/aside/node.json")).unwrap();
        assert_eq!(disk.after_a_crash(PATH), None);
        assert_eq!(disk.after_a_crash("/aside/node.json").as_deref(), Some(&b"here"[..]));
    }

    #[test]
    fn a_file_has_the_mode_that_was_asked_for_whatever_was_left_behind() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("node.key");
        std::fs::write(place.path().join("node.key.new"), "left behind").unwrap();
        for mode in [0o644, 0o600] {
            replace(&path, b"content", mode).unwrap();
            assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, mode);
        }
    }

    #[test]
    fn errors_name_the_file() {
        let place = tempfile::tempdir().unwrap();
        let (missing, large) = (place.path().join("no/file"), place.path().join("large"));
        for refused in [replace(&missing, b"", 0o600).unwrap_err(), read(&missing, 1).unwrap_err()] {
            assert!(refused.message.contains(missing.to_str().unwrap()), "{refused}");
        }
        create(&large, b"two", 0o600).unwrap();
        let again = create(&large, b"two", 0o600).unwrap_err();
        for refused in [read(&large, 2).unwrap_err(), again, super::super::rename(&missing, &large).unwrap_err()] {
            assert!(refused.message.contains(place.path().to_str().unwrap()), "{refused}");
        }
    }
}
