//! Policies in files, each named by its file: `night.cedar` is the policy `night`.

use super::bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::PolicyText;
use std::path::{Path, PathBuf};

/// Reads the text of one file.
///
/// # Errors
/// [`Code::BadFile`] if it cannot be read or is no text.
pub(crate) fn text(path: &Path) -> Result<String, Rejection> {
    let bytes = bytes::from_file(path)?;
    String::from_utf8(bytes.to_vec()).map_err(|fault| {
        Rejection::new(Code::BadFile, format!("{} is not text", path.display()))
            .found(format!("bytes that are not UTF-8 at byte {}", fault.utf8_error().valid_up_to()))
            .wanted("policies in Cedar, in UTF-8")
            .next("give another file")
    })
}

/// The policies of some files; none if no file is given.
///
/// # Errors
/// As [`text`].
pub(crate) fn read(paths: &[PathBuf]) -> Result<Option<Vec<PolicyText>>, Rejection> {
    let policy = |path: &PathBuf| {
        let id = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        Ok(PolicyText { id, text: text(path)? })
    };
    let policies = paths.iter().map(policy).collect::<Result<Vec<_>, Rejection>>()?;
    Ok((!policies.is_empty()).then_some(policies))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_policy_has_the_name_of_its_file() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("night.cedar");
        std::fs::write(&path, "permit (principal, action, resource);").unwrap();
        let read_it = read(std::slice::from_ref(&path)).unwrap().unwrap();
        assert_eq!((read_it[0].id.as_str(), read_it[0].text.len()), ("night", 37));
        assert_eq!(read(&[]).unwrap(), None);
        std::fs::write(&path, b"\xff").unwrap();
        assert_eq!(read(&[path]).unwrap_err().code, Code::BadFile);
    }
}
