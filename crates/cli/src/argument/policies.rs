//! Policies in files, each named by its file: `night.cedar` is the policy `night`.

use super::bytes;
use crate::words::shell_word;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::PolicyText;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Keys of TOML files that are no policies, and the command that takes the file.
const OTHERS: [(&str, &str); 5] = [
    ("[[case]]", "ledgerctl policy test"),
    ("organisation = ", "ledgerctl apply"),
    ("[robot", "ledgerctl apply"),
    ("[policy", "ledgerctl apply"),
    ("[[share]]", "ledgerctl apply"),
];

/// Reads the text of one file, which may begin with the mark of an editor.
///
/// # Errors
/// [`Code::BadFile`] if it cannot be read or is no text.
pub(crate) fn text(path: &Path) -> Result<String, Rejection> {
    if path.is_dir() {
        return Err(Rejection::new(Code::BadFile, format!("{} is a directory", path.display()))
            .wanted("files with policies in Cedar")
            .next(format!(
                "name its files: {}/*.cedar",
                shell_word(path.display().to_string().trim_end_matches('/'))
            )));
    }
    ledger_base::text::of_bytes(&bytes::from_file(path)?).map_err(|fault| {
        Rejection::new(Code::BadFile, format!("{} is not text", path.display()))
            .found(fault.to_string())
            .wanted("policies in Cedar, in UTF-8")
            .next("give another file")
    })
}

/// The policies of some files; none if no file is given.
///
/// # Errors
/// As [`text`]. [`Code::BadName`] for a file whose name is none for a policy, [`Code::BadFile`] for another kind of file.
pub(crate) fn read(paths: &[PathBuf]) -> Result<Option<Vec<PolicyText>>, Rejection> {
    let mut named = BTreeMap::new();
    let mut policies = Vec::new();
    for path in paths {
        let text = text(path)?;
        check_kind(path, &text)?;
        let id = id_of(path)?;
        if let Some(first) = named.insert(id.clone(), path) {
            return Err(Rejection::new(Code::BadName, format!("two files define the policy {id}"))
                .found(format!("{} and {}", first.display(), path.display()))
                .wanted("files with different names: night.cedar is the policy night")
                .next("rename one of them"));
        }
        policies.push(PolicyText { id, text });
    }
    Ok((!policies.is_empty()).then_some(policies))
}

/// The name of the policy in a file.
fn id_of(path: &Path) -> Result<String, Rejection> {
    let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let fits = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-');
    if !stem.is_empty() && stem.chars().all(fits) {
        return Ok(stem);
    }
    let parts: Vec<&str> = stem.split(|c| !fits(c)).filter(|part| !part.is_empty()).collect();
    let better = if parts.is_empty() { "policy".to_owned() } else { parts.join("-") };
    let renamed = path.with_file_name(format!("{better}.cedar")).display().to_string();
    let before = shell_word(&path.display().to_string());
    Err(Rejection::new(Code::BadName, format!("the name of {} is not a policy name", path.display()))
        .found(format!("{stem:?}"))
        .wanted("letters, digits, '_' and '-' before the ending: night.cedar is the policy night")
        .next(format!("rename it: mv {before} {}", shell_word(&renamed))))
}

/// Rejects files of other kinds, of which the parser of Cedar would say little.
fn check_kind(path: &Path, text: &str) -> Result<(), Rejection> {
    let refused = |found: &str| {
        Rejection::new(Code::BadFile, format!("{} contains no policies", path.display()))
            .found(found.to_owned())
            .wanted("policies in Cedar, such as permit (principal, action, resource);")
    };
    if text.trim().is_empty() {
        return Err(refused("an empty file").next("for no policies of your own: ledgerctl policy apply --built-in"));
    }
    let begins = |key: &str| text.lines().any(|line| line.trim_start().starts_with(key));
    match OTHERS.iter().find(|(key, _)| begins(key)) {
        Some((key, command)) => {
            let path = shell_word(&path.display().to_string());
            Err(refused(&format!("TOML with {key}")).next(format!("{command} {path}")))
        }
        None => Ok(()),
    }
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
        std::fs::write(&path, "\u{feff}permit (principal, action, resource);").unwrap();
        assert_eq!(read(std::slice::from_ref(&path)).unwrap().unwrap()[0].text.len(), 37, "the mark of an editor");
        std::fs::write(&path, b"\xff").unwrap();
        assert_eq!(read(&[path]).unwrap_err().code, Code::BadFile);
    }

    #[test]
    fn a_file_that_is_no_policy_is_rejected_with_what_to_do() {
        let directory = tempfile::tempdir().unwrap();
        let file = |name: &str, text: &str| {
            let path = directory.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(&path, text).unwrap();
            path
        };
        let fine = "permit (principal, action, resource);";
        for (paths, code, advice) in [
            (vec![file("guests (1).cedar", fine)], Code::BadName, "guests-1.cedar"),
            (vec![file(".cedar", fine)], Code::BadName, "cedar.cedar"),
            (vec![file("a/night.cedar", fine), file("b/night.cedar", fine)], Code::BadName, "rename one of them"),
            (vec![file("empty.cedar", " \n")], Code::BadFile, "--built-in"),
            (vec![file("fleet.toml", "[robot.Husky]\n")], Code::BadFile, "ledgerctl apply /"),
            (vec![file("cases.toml", "[[case]]\nwho = \"a\"\n")], Code::BadFile, "ledgerctl policy test /"),
            (vec![directory.path().to_owned()], Code::BadFile, "/*.cedar"),
            (vec![directory.path().join("missing.cedar")], Code::BadFile, "check the path"),
        ] {
            let refused = read(&paths).unwrap_err();
            assert_eq!(refused.code, code, "{refused}");
            assert!(refused.advice().contains(advice), "{advice:?} in {refused}");
        }
    }
}
