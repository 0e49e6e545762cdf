//! Access to a path in words: its owner and mode, and the user of this process.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// The owner and the mode of a path, or of the nearest directory above it that can be looked at, and the user of this process:
/// `/data is of user 997, group 997, mode 0700; this process is user 1000`.
pub fn access(path: &Path) -> String {
    let seen = path.ancestors().find_map(|path| fs::metadata(path).ok().map(|metadata| (path, metadata)));
    let own = fs::metadata("/proc/self").map(|own| format!("; this process is user {}", own.uid())).unwrap_or_default();
    match seen {
        Some((path, metadata)) => format!(
            "{} is of user {}, group {}, mode {:04o}{own}",
            path.display(),
            metadata.uid(),
            metadata.gid(),
            metadata.mode() & 0o7777
        ),
        None => format!("{} cannot be looked at{own}", path.display()),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn owner_and_mode_of_the_nearest_directory_are_named() {
        let place = tempfile::tempdir().unwrap();
        fs::set_permissions(place.path(), fs::Permissions::from_mode(0o710)).unwrap();
        let uid = fs::metadata(place.path()).unwrap().uid();
        let told = access(&place.path().join("a/b"));
        let wanted = format!("{} is of user {uid}, group ", place.path().display());
        assert!(told.starts_with(&wanted) && told.contains("mode 0710; this process is user "), "{told}");
    }
}
