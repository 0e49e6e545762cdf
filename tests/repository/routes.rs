//! Kinds of routes: each is a file and its line in one table, and nothing else of the bridge names one.

use std::path::Path;

use crate::sources::{code, files, product, read, root};

const SOURCES: &str = "crates/ros-bridge/src";
const ROUTES: &str = "crates/ros-bridge/src/routes";
const TABLE: &str = "crates/ros-bridge/src/routes/kinds.rs";

/// The modules in the table of kinds as paths of files, as in `&services::client::KIND`.
fn modules() -> Vec<String> {
    let table = read(&root().join(TABLE));
    let paths = table.split(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':'));
    paths.filter_map(|path| path.strip_suffix("::KIND")).map(|path| path.replace("::", "/")).collect()
}

/// The text of a field of the kind that a file declares.
fn declared(module: &str, field: &str) -> String {
    let text = product(&root().join(ROUTES).join(format!("{module}.rs")));
    let kind = text.split_once("static KIND: Kind = Kind {").unwrap_or_else(|| panic!("{module} declares no kind")).1;
    let after = kind.split_once(&format!("{field}: \"")).unwrap_or_else(|| panic!("{module} has no {field}")).1;
    after.split_once('"').map(|(value, _)| value.to_owned()).unwrap_or_default()
}

#[test]
fn every_file_that_declares_a_kind_of_route_is_in_the_table() {
    let files = files(&root().join(ROUTES), ".rs");
    let declare = files.iter().filter(|path| product(path).contains("static KIND: Kind"));
    let routes = root().join(ROUTES);
    let module = |path: &Path| Some(path.strip_prefix(&routes).ok()?.with_extension("").to_str()?.to_owned());
    let mut declared: Vec<_> = declare.filter_map(|path| module(path)).collect();
    let mut listed = modules();
    declared.sort_unstable();
    listed.sort_unstable();
    assert_eq!(declared, listed);
}

#[test]
fn a_kind_of_route_is_named_in_its_own_file_and_in_the_table_only() {
    for module in modules() {
        let (name, own) = (declared(&module, "name"), format!("{ROUTES}/{module}"));
        let own_path = module.replace('/', "::");
        for path in files(&root().join(SOURCES), ".rs") {
            let relative = path.strip_prefix(root()).unwrap_or(&path).to_string_lossy().into_owned();
            if relative.starts_with(&own) || relative == TABLE || relative.ends_with("tests.rs") {
                continue;
            }
            let text = product(&path);
            let declaration = format!("mod {name};");
            let named = code(&text).find(|line| {
                !line.ends_with(&declaration)
                    && (line.contains(&name) || line.contains(&own_path) || line.contains("kind.name =="))
            });
            assert!(named.is_none(), "{relative} names a kind of route; read what the kind says of itself: {named:?}");
        }
    }
}

#[test]
fn the_settings_of_bridges_name_every_kind_of_route_and_its_right() {
    let document = read(&root().join("docs/bridge.md"));
    for module in modules() {
        let (name, right) = (declared(&module, "name"), declared(&module, "right"));
        let mut rows = document.lines().filter(|line| line.starts_with(&format!("| `{name}` |"))).peekable();
        assert!(rows.peek().is_some(), "docs/bridge.md, table of directions: there is no row for {name}");
        for row in rows {
            assert!(
                row.contains(&format!("`{right}`")),
                "docs/bridge.md, direction {name}: {right} is missing in {row}"
            );
        }
    }
}
