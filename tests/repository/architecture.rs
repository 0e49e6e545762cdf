//! ARCHITECTURE.md is one page, and its map names what is there.

use crate::sources::{files, is_of_tests, manifests, read, root};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Longest map, in lines. Reasons belong into docs/decisions.
const LINES_MAX: usize = 110;

/// Longest decision, in lines.
const DECISION_LINES_MAX: usize = 40;

fn architecture() -> String {
    read(&root().join("ARCHITECTURE.md"))
}

/// The rows of the table whose first cell of the head is this one, as their cells.
fn rows<'a>(text: &'a str, head: &str) -> Vec<Vec<&'a str>> {
    let cells = |line: &'a str| -> Vec<&'a str> { line.trim_matches('|').split('|').map(str::trim).collect() };
    let start = format!("| {head} |");
    let rows: Vec<_> = text
        .lines()
        .skip_while(|line| !line.starts_with(&start))
        .skip(2)
        .take_while(|line| line.starts_with('|'))
        .map(cells)
        .collect();
    assert!(!rows.is_empty(), "ARCHITECTURE.md has no table {start}");
    rows
}

/// The texts in backticks of a cell.
fn quoted(cell: &str) -> Vec<&str> {
    cell.split('`').skip(1).step_by(2).collect()
}

fn cell<'a>(row: &[&'a str], column: usize) -> &'a str {
    row.get(column).copied().unwrap_or_else(|| panic!("{row:?} has no column {column}"))
}

/// Each crate of the workspace as the map names it (`src` is the node), apart from packages of tests alone, with the names of those that it is built from.
fn workspace() -> BTreeMap<String, BTreeSet<String>> {
    let manifests: Vec<(String, Table)> = manifests()
        .iter()
        .filter(|path| !is_of_tests(path))
        .map(|path| {
            let place = path.parent().and_then(|place| place.strip_prefix(root()).ok()).unwrap_or(Path::new(""));
            let place = if place == Path::new("") { Path::new("src") } else { place };
            let manifest = read(path).parse().unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            (place.to_string_lossy().into_owned(), manifest)
        })
        .collect();
    let short = |place: &str| place.rsplit('/').next().unwrap_or_default().to_owned();
    let name = |manifest: &Table| {
        manifest.get("package").and_then(|package| package.get("name")).and_then(Value::as_str).map(str::to_owned)
    };
    let shorts: BTreeMap<String, String> =
        manifests.iter().filter_map(|(place, manifest)| Some((name(manifest)?, short(place)))).collect();
    let uses = |manifest: &Table| {
        let used = manifest.get("dependencies").and_then(Value::as_table).into_iter().flat_map(Table::keys);
        used.filter_map(|used| shorts.get(used).cloned()).collect()
    };
    manifests.iter().map(|(place, manifest)| (place.clone(), uses(manifest))).collect()
}

#[test]
fn the_map_names_every_crate_and_what_it_is_built_from() {
    let text = architecture();
    let mapped: BTreeMap<String, BTreeSet<String>> = rows(&text, "crate")
        .iter()
        .flat_map(|row| {
            let uses: BTreeSet<String> = quoted(cell(row, 1)).into_iter().map(str::to_owned).collect();
            quoted(cell(row, 0)).into_iter().map(move |place| (place.to_owned(), uses.clone()))
        })
        .collect();
    assert_eq!(mapped, workspace(), "left: the table of crates in ARCHITECTURE.md; right: the manifests");
}

#[test]
fn where_to_begin_is_there() {
    for row in rows(&architecture(), "crate") {
        for place in quoted(cell(&row, 0)) {
            for begin in quoted(cell(&row, 3)) {
                let inside = root().join(place);
                assert!(
                    inside.join(begin).exists() || inside.join("src").join(begin).exists(),
                    "ARCHITECTURE.md: {place} has no {begin}"
                );
            }
        }
    }
}

#[test]
fn the_map_names_every_module_of_the_node() {
    let text = architecture();
    let rows = rows(&text, "module of `src`");
    let mapped: BTreeSet<&str> = rows.iter().flat_map(|row| quoted(cell(row, 0))).collect();
    let source = root().join("src");
    for module in &mapped {
        let there = source.join(format!("{module}.rs")).exists() || source.join(module).is_dir();
        assert!(there, "ARCHITECTURE.md names the module `{module}`, which is not there");
    }
    let top: BTreeSet<PathBuf> = files(&source, ".rs")
        .iter()
        .filter_map(|path| {
            path.strip_prefix(&source).ok()?.components().next().map(|top| PathBuf::from(top.as_os_str()))
        })
        .map(|top| top.with_extension(""))
        .collect();
    for module in top {
        let name = module.to_string_lossy();
        let named = mapped.iter().any(|mapped| *mapped == name || mapped.starts_with(&format!("{name}/")));
        assert!(named, "ARCHITECTURE.md does not name the module `{name}`");
    }
}

#[test]
fn the_map_is_one_page() {
    let lines = architecture().lines().count();
    assert!(lines <= LINES_MAX, "ARCHITECTURE.md has {lines} lines of {LINES_MAX}: reasons belong into docs/decisions");
}

#[test]
fn every_decision_has_a_number_of_its_own_three_parts_and_a_line_in_the_index() {
    let folder = root().join("docs/decisions");
    let index = read(&folder.join("README.md"));
    let decisions: Vec<_> = files(&folder, ".md").into_iter().filter(|path| !path.ends_with("README.md")).collect();
    assert!(!decisions.is_empty(), "docs/decisions is empty");
    let mut last = 0;
    for path in &decisions {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let number = name.split('-').next().and_then(|number| number.parse::<u32>().ok()).unwrap_or_default();
        assert!(number > last && name.starts_with(&format!("{number:04}-")), "{name} has no number of its own");
        last = number;
        let text = read(path);
        let title = text.lines().next().unwrap_or_default();
        let title = title.strip_prefix("# ").unwrap_or_else(|| panic!("{name} has no title"));
        assert!(title.starts_with(&format!("{number}. ")), "{name}: {title}");
        assert!(index.contains(&format!("- [{title}]({name})")), "docs/decisions/README.md lacks [{title}]({name})");
        let parts: Vec<_> = text.lines().filter_map(|line| line.strip_prefix("## ")).collect();
        assert_eq!(parts, ["Context", "Decision", "Consequences"], "{name}");
        let lines = text.lines().count();
        assert!(lines <= DECISION_LINES_MAX, "{name} has {lines} lines of {DECISION_LINES_MAX}");
    }
}
