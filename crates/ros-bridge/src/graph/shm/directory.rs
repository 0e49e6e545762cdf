//! The directory of shared memory. It belongs to this user alone, so that no other user takes its name first or reads in it.

use std::{
    fs::{self, DirBuilder, Metadata},
    io,
    os::unix::fs::{DirBuilderExt, MetadataExt},
    path::{Path, PathBuf},
};

use iceoryx2::prelude::{Config, Path as IoxPath, SemanticString};

use crate::error::{Error, Explained, Result};

/// The variable that names the directory of a user's session.
const RUN: &str = "XDG_RUNTIME_DIR";
/// The directory that programs share without such a session; [`PathBuf::with_file_name`] adds the user.
const SHARED: &str = "/tmp";
/// The bits by which others than the owner write.
const OTHERS_WRITE: u32 = 0o022;
/// In such a directory each user renames and removes its own entries only.
const STICKY: u32 = 0o1000;
/// The user that owns the machine.
const ROOT: u32 = 0;

/// The configuration of iceoryx2, with a directory of this user. A `root-path` of iceoryx2's own configuration files counts.
/// Otherwise it is `iceoryx2` in `XDG_RUNTIME_DIR`, or `/tmp/iceoryx2-UID` without this variable.
///
/// # Errors
/// [`Error::Shm`] if another user owns the directory or may write in it, if it is a link, or if it cannot be made.
pub fn config() -> Result<Config> {
    let mut config = Config::global_config().clone();
    let user = rustix::process::geteuid().as_raw();
    let configured = std_path(config.global.root_path());
    let directory = match configured == std_path(Config::default().global.root_path()) {
        true => own(std::env::var_os(RUN).map(PathBuf::from), user),
        false => configured,
    };
    make_private(&directory, user)?;
    let path = IoxPath::new(directory.as_os_str().as_encoded_bytes()).map_err(|error| {
        unusable(&directory, format!("a path that iceoryx2 does not take: {error:?}"), "choose a shorter path")
    })?;
    config.global.set_root_path(&path);
    tracing::debug!(directory = %directory.display(), "shared memory");
    Ok(config)
}

fn std_path(path: &IoxPath) -> PathBuf {
    PathBuf::from(String::from_utf8_lossy(path.as_bytes()).into_owned())
}

/// The directory of a user, in that of its session if there is one.
fn own(run: Option<PathBuf>, user: u32) -> PathBuf {
    match run.filter(|run| run.is_absolute()) {
        Some(run) => run.join("iceoryx2"),
        None => Path::new(SHARED).join(format!("iceoryx2-{user}")),
    }
}

/// Makes the directory if it does not exist. Rejects one in which another user may change something.
fn make_private(directory: &Path, user: u32) -> Result<()> {
    let read = |error: io::Error| unusable(directory, error.to_string(), "make it, or correct the rights on it");
    let foreign = |metadata: &Metadata| metadata.uid() != user && metadata.uid() != ROOT;
    let parent = directory.parent().unwrap_or(Path::new("/"));
    let (entry, target) = (fs::symlink_metadata(parent).map_err(read)?, fs::metadata(parent).map_err(read)?);
    let is_open = target.mode() & OTHERS_WRITE != 0 && target.mode() & STICKY == 0;
    if is_open || foreign(&entry) || foreign(&target) {
        let found = format!("others may replace it in {}: {}", parent.display(), rights(&target));
        return Err(unusable(directory, found, "set XDG_RUNTIME_DIR to a directory of this user"));
    }
    match DirBuilder::new().mode(0o700).create(directory) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(read(error)),
        Ok(()) | Err(_) => {}
    }
    let made = fs::symlink_metadata(directory).map_err(read)?;
    if made.is_symlink() || !made.is_dir() {
        let what = if made.is_symlink() { "a link" } else { "no directory" };
        return Err(unusable(directory, format!("{what}: {}", rights(&made)), "remove it"));
    }
    if made.uid() != user {
        return Err(unusable(
            directory,
            format!("a directory of another user: {}", rights(&made)),
            "remove it as that user or as root",
        ));
    }
    if made.mode() & OTHERS_WRITE != 0 {
        let next = format!("chmod 700 {}", directory.display());
        return Err(unusable(directory, format!("others may write in it: {}", rights(&made)), &next));
    }
    Ok(())
}

/// The owner and the mode.
fn rights(metadata: &Metadata) -> String {
    format!("owner {}, mode {:o}", metadata.uid(), metadata.mode() & 0o7777)
}

fn unusable(directory: &Path, found: String, next: &str) -> Error {
    let what = format!("shared memory in {} is not safe to use", directory.display());
    let wanted = "a directory of this user, which is no link and in which no other user writes";
    Error::Shm(Explained::new(what, found, wanted, next))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::panic, reason = "tests")]
mod tests {
    use std::os::unix::fs::{PermissionsExt, symlink};

    use super::*;

    fn user() -> u32 {
        rustix::process::geteuid().as_raw()
    }

    fn set_mode(path: &Path, mode: u32) {
        fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
    }

    fn found(directory: &Path, user: u32) -> String {
        match make_private(directory, user) {
            Err(Error::Shm(explained)) => explained.found,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn the_directory_is_that_of_the_session_or_named_by_the_user() {
        assert_eq!(own(Some("/run/user/1000".into()), 1000), Path::new("/run/user/1000/iceoryx2"));
        for none in [None, Some(PathBuf::new()), Some("run".into())] {
            assert_eq!(own(none, 1000), Path::new("/tmp/iceoryx2-1000"));
        }
    }

    #[test]
    fn a_directory_is_made_for_its_user_alone_and_used_again() {
        let place = tempfile::tempdir().unwrap();
        let directory = place.path().join("iceoryx2");
        make_private(&directory, user()).unwrap();
        assert_eq!(fs::metadata(&directory).unwrap().mode() & 0o777, 0o700);
        make_private(&directory, user()).unwrap();
    }

    #[test]
    fn a_directory_of_another_user_a_link_and_one_in_which_others_write_are_rejected() {
        let place = tempfile::tempdir().unwrap();
        let at = |name: &str| place.path().join(name);
        for name in ["own", "open"] {
            fs::create_dir(at(name)).unwrap();
        }
        set_mode(&at("own"), 0o755);
        make_private(&at("own"), user()).unwrap();
        symlink(at("own"), at("link")).unwrap();
        assert!(found(&at("link"), user()).starts_with("a link"));
        fs::write(at("file"), b"").unwrap();
        assert!(found(&at("file"), user()).starts_with("no directory"));
        set_mode(&at("open"), 0o1777);
        assert!(found(&at("open"), user()).starts_with("others may write in it"));
        // The same directory, in a parent that all users share, for another user.
        set_mode(&at("open"), 0o1777);
        let shared = at("open").join("iceoryx2");
        make_private(&shared, user()).unwrap();
        set_mode(&at("open"), 0o777);
        assert!(found(&shared, user()).starts_with("others may replace it"));
    }

    #[test]
    fn the_owner_decides_and_not_the_right_to_write() {
        // Root owns /tmp, and may write in it: this user owns nothing else there.
        let stranger = user() + 1;
        let place = tempfile::Builder::new().permissions(fs::Permissions::from_mode(0o1777)).tempdir().unwrap();
        let directory = place.path().join("iceoryx2");
        make_private(&directory, user()).unwrap();
        let refused = found(&directory, stranger);
        let wanted = if user() == ROOT { "a directory of another user" } else { "others may replace it" };
        assert!(refused.starts_with(wanted), "{refused}");
    }
}
