//! The layers of access control: each knows only those below it, and rules are named in their own layer only.

use crate::sources::{code, files, product, read, root};
use std::path::Path;

/// The layers of `crates/abac`, from the lowest: modules that stand side by side, each a file and perhaps a folder.
const LAYERS: [&[&str]; 7] = [
    &["arguments", "fixture", "nearest"],
    &["records"],
    &["rules"],
    &["policy"],
    &["lifecycle"],
    &["calls"],
    &["contract"],
];

/// The crate that declares modes.
const DECLARES: &str = "crates/contract/src/";
/// The names of rules, and of what they do with a contender.
const NAMES: [&str; 6] =
    ["Mode::OPEN", "Mode::EXCLUSIVE", "Mode::LIMITED", "OnConflict::Deny", "OnConflict::Queue", "OnConflict::Preempt"];
/// The layer that knows what they mean.
const KNOWS: &str = "crates/abac/src/rules";

fn height(module: &str) -> Option<usize> {
    LAYERS.iter().position(|layer| layer.contains(&module))
}

/// The module at the top of the crate that a line uses, as in `use crate::rules::Decision;`.
fn used(line: &str) -> Option<&str> {
    let path =
        line.trim_start().strip_prefix("pub(crate) ").unwrap_or(line.trim_start()).strip_prefix("use crate::")?;
    path.split(|c: char| !(c.is_alphanumeric() || c == '_')).next()
}

/// The module at the top of the crate to which a file belongs.
fn module(file: &Path, sources: &Path) -> String {
    let inside = file.strip_prefix(sources).unwrap_or(file);
    let first = inside.components().next().map(|part| part.as_os_str().to_string_lossy().into_owned());
    first.unwrap_or_default().trim_end_matches(".rs").to_owned()
}

#[test]
fn each_layer_of_access_control_knows_only_those_below_it() {
    let sources = root().join("crates/abac/src");
    for path in files(&sources, ".rs") {
        let module = module(&path, &sources);
        if module == "lib" {
            continue;
        }
        let own = height(&module).unwrap_or_else(|| panic!("{} has no layer", path.display()));
        for line in code(&read(&path)) {
            let used = used(line).unwrap_or(&module);
            let below = height(used).unwrap_or_else(|| panic!("{}: {line}: use a module by its path", path.display()));
            assert!(below < own || used == module, "{} may not use {used}: {line}", path.display());
        }
    }
}

#[test]
fn a_rule_is_named_where_it_is_declared_and_in_its_layer_only() {
    let sources = ["crates", "src", "examples"].map(|folder| files(&root().join(folder), ".rs"));
    for path in sources.into_iter().flatten() {
        let relative = path.strip_prefix(root()).unwrap_or(&path).to_string_lossy().into_owned();
        if relative.starts_with(DECLARES) || relative.starts_with(KNOWS) || relative.contains("tests") {
            continue;
        }
        let text = product(&path);
        let named = code(&text).find(|line| NAMES.iter().any(|name| line.contains(name)));
        assert!(named.is_none(), "{relative} names a rule; read the service's capabilities instead: {named:?}");
    }
}

#[test]
fn a_use_is_told_from_a_path_outside_of_the_crate() {
    assert_eq!(used("use crate::rules::{self, Decision};"), Some("rules"));
    assert_eq!(used("    use crate::records::store;"), Some("records"));
    assert_eq!(used("use crate::policy;"), Some("policy"));
    assert_eq!(used("use super::rules;"), None);
    assert_eq!(used("let rules = rules();"), None);
}
