//! The keystore of SROS2: a directory with a directory for each enclave. Only names are read, no keys.

use super::policy::path;
use crate::failure::unreadable;
use ledger_base::rejection::{Code, Rejection};
use std::path::Path;

/// Most enclaves of a keystore, and how deep their paths are.
const ENCLAVES_MAX: usize = 256;
const DEPTH_MAX: usize = 16;
/// Every enclave has it.
const CERTIFICATE: &str = "cert.pem";

/// The paths of the enclaves in a keystore, in order.
///
/// # Errors
/// [`Code::BadFile`] if it is no keystore, cannot be read, or has too many enclaves; [`Code::BadName`] if the name of one cannot
/// be a path.
pub(super) fn enclaves(keystore: &Path) -> Result<Vec<String>, Rejection> {
    let top = keystore.join("enclaves");
    if !top.is_dir() {
        return Err(Rejection::new(Code::BadFile, format!("{} is not an SROS2 keystore", keystore.display()))
            .found("no directory \"enclaves\" in it")
            .wanted("a keystore of `ros2 security create_keystore`")
            .next("name the keystore with --keystore, or the enclaves with --enclave"));
    }
    let mut found = Vec::new();
    look(&top, String::new(), 0, &mut found)?;
    found.sort();
    Ok(found)
}

fn look(directory: &Path, name: String, depth: usize, found: &mut Vec<String>) -> Result<(), Rejection> {
    if directory.join(CERTIFICATE).is_file() {
        let name = if name.is_empty() { "/" } else { &name };
        found.push(path(name).map_err(|why| Rejection::new(Code::BadName, why))?);
    }
    if depth > DEPTH_MAX || found.len() > ENCLAVES_MAX {
        return Err(Rejection::new(Code::BadFile, "the keystore has too many enclaves")
            .found(format!("more than {ENCLAVES_MAX}, or deeper than {DEPTH_MAX}, at {}", directory.display()))
            .wanted("the enclaves of one robot")
            .next("name them with --enclave"));
    }
    let failed = |error| unreadable(directory, &error);
    for entry in std::fs::read_dir(directory).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        // Links are not followed: they could lead in a circle.
        if entry.file_type().map_err(failed)?.is_dir() {
            let below = format!("{name}/{}", entry.file_name().to_string_lossy());
            look(&entry.path(), below, depth.saturating_add(1), found)?;
        }
    }
    Ok(())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn the_enclaves_of_a_keystore_are_found_at_any_depth_and_nothing_else_is_one() {
        let place = tempfile::tempdir().unwrap();
        for enclave in ["enclaves", "enclaves/base", "enclaves/arm/left", "private"] {
            std::fs::create_dir_all(place.path().join(enclave)).unwrap();
            std::fs::write(place.path().join(enclave).join(CERTIFICATE), "").unwrap();
        }
        std::os::unix::fs::symlink(place.path(), place.path().join("enclaves/round")).unwrap();
        assert_eq!(enclaves(place.path()).unwrap(), ["/", "/arm/left", "/base"]);
        assert_eq!(enclaves(&place.path().join("private")).unwrap_err().code, Code::BadFile);
        std::fs::create_dir_all(place.path().join("enclaves/two words")).unwrap();
        std::fs::write(place.path().join("enclaves/two words").join(CERTIFICATE), "").unwrap();
        assert_eq!(enclaves(place.path()).unwrap_err().code, Code::BadName);
    }
}
