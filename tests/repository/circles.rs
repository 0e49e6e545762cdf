//! No circle inside a crate: ARCHITECTURE.md, "Crates".
//!
//! At every level of a crate the rooms are the sibling modules: `x.rs` with everything below `x/`. A room leads to its
//! sibling if a line of code in it names a path into that sibling. A parent and its own children are one room.

use crate::sources::{files, manifests, read, root};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// A module as its path below the root of its crate: `["policy", "decider"]`. The root itself is empty.
type Module = Vec<String>;

/// From a room to its siblings, with the first name that ties each pair: `decider.rs names policy::refusal::explain`.
type Arrows = BTreeMap<(Module, Module), String>;

/// The module that a file below `src` defines.
fn module(file: &Path, src: &Path) -> Module {
    let inside = file.strip_prefix(src).unwrap_or(file).with_extension("");
    let mut parts: Module = inside.iter().map(|part| part.to_string_lossy().into_owned()).collect();
    if parts.last().is_some_and(|last| ["mod", "lib", "main"].contains(&last.as_str())) {
        parts.pop();
    }
    parts
}

/// Everything but comments, strings, and modules of tests.
fn code_without_tests(text: &str) -> String {
    let text = text.split("\nmod tests {").next().unwrap_or_default();
    let mut code = String::new();
    let mut rest = text;
    while let Some(at) = rest.find(['/', '"']) {
        let (before, from) = rest.split_at(at);
        code.push_str(before);
        rest = if from.starts_with("//") {
            from.find('\n').map_or("", |end| &from[end..])
        } else if let Some(string) = from.strip_prefix('"') {
            // A quotation mark as a character is no string.
            match before.ends_with('\'') {
                true => string,
                false => end_of_string(string),
            }
        } else {
            code.push('/');
            &from[1..]
        };
    }
    code.push_str(rest);
    code
}

/// The text behind the string whose opening mark was just passed.
fn end_of_string(text: &str) -> &str {
    let mut escaped = false;
    for (at, c) in text.char_indices() {
        match c {
            '"' if !escaped => return &text[at + 1..],
            _ => escaped = c == '\\' && !escaped,
        }
    }
    ""
}

/// The paths that begin with `crate::`, `super::` or `self::`, with groups in braces written out.
fn paths(code: &str) -> Vec<Vec<String>> {
    let mut found = Vec::new();
    for start in ["crate::", "super::", "self::"] {
        for (at, _) in code.match_indices(start) {
            let before = code[..at].chars().next_back();
            if before.is_none_or(|c| !(c.is_alphanumeric() || "_:$".contains(c))) {
                expand(&code[at..], &mut Vec::new(), &mut found);
            }
        }
    }
    found
}

/// Reads one path or group at the start of the text; returns what follows it.
fn expand<'a>(text: &'a str, prefix: &mut Vec<String>, found: &mut Vec<Vec<String>>) -> &'a str {
    let text = text.trim_start();
    if let Some(mut inside) = text.strip_prefix('{') {
        loop {
            inside = inside.trim_start();
            if let Some(rest) = inside.strip_prefix('}') {
                return rest;
            }
            let depth = prefix.len();
            let rest = expand(inside, prefix, found);
            prefix.truncate(depth);
            if rest.len() == inside.len() {
                return rest;
            }
            let rest = rest.trim_start();
            inside = rest.strip_prefix(',').unwrap_or(rest);
        }
    }
    let end = text.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(text.len());
    let (name, rest) = text.split_at(end);
    if name.is_empty() {
        return text.strip_prefix('*').unwrap_or(text);
    }
    let depth = prefix.len();
    prefix.push(name.to_owned());
    let after = match rest.strip_prefix("::").filter(|after| !after.starts_with('<')) {
        Some(after) => expand(after, prefix, found),
        None => rest,
    };
    found.push(prefix.clone());
    prefix.truncate(depth);
    // A name in a group may be taken under another one.
    let renamed = after.trim_start();
    match renamed.strip_prefix("as ") {
        Some(new) if depth > 0 => new.trim_start_matches(|c: char| c.is_alphanumeric() || c == '_' || c == ' '),
        _ => after,
    }
}

/// The absolute path below the crate's root that a path in a module means.
fn absolute(path: &[String], from: &Module) -> Vec<String> {
    let mut at = from.clone();
    let mut rest = path;
    match path.first().map(String::as_str) {
        Some("crate") => {
            at.clear();
            rest = &path[1..];
        }
        Some("self") => rest = &path[1..],
        _ => {}
    }
    while rest.first().is_some_and(|first| first == "super") {
        at.pop();
        rest = &rest[1..];
    }
    at.extend(rest.iter().cloned());
    at
}

/// The arrows between the rooms of a crate, at every level.
fn arrows(src: &Path) -> Arrows {
    let sources: Vec<(Module, String)> = files(src, ".rs")
        .into_iter()
        .filter(|path| !path.iter().any(|part| part == "tests" || part == "tests.rs"))
        .map(|path| (module(&path, src), code_without_tests(&read(&path))))
        .collect();
    let modules: BTreeSet<&Module> = sources.iter().map(|(module, _)| module).collect();
    let is_module = |path: &[String]| modules.iter().any(|module| module.starts_with(path));
    let reexports: BTreeMap<&Module, Reexports> =
        sources.iter().map(|(module, code)| (module, Reexports::of(code, module, is_module))).collect();
    let mut found = Arrows::new();
    for (from, code) in &sources {
        for path in paths(code) {
            let mut to = absolute(&path, from);
            // A name that a parent hands on stands where the parent has it from.
            for _ in 0..8 {
                let depth = (0..=to.len()).rev().find(|depth| is_module(&to[..*depth])).unwrap_or_default();
                let (module, names) = to.split_at(depth);
                let source = names.first().and_then(|name| reexports.get(&module.to_vec())?.source(name));
                match source {
                    Some(source) if !source.is_empty() => {
                        to = source.iter().chain(names.iter().skip(1)).cloned().collect();
                    }
                    _ => break,
                }
            }
            let depth = (0..=to.len()).rev().find(|depth| is_module(&to[..*depth])).unwrap_or_default();
            let shared = from.iter().zip(&to).take_while(|(one, other)| one == other).count();
            // Into the sibling's tree: neither the parent's own items nor what stands below this module.
            if shared < depth && shared < from.len() {
                let (room, sibling) = (from[..=shared].to_vec(), to[..=shared].to_vec());
                let tie = format!("{} names {}", from.join("::"), to.join("::"));
                found.entry((room, sibling)).or_insert(tie);
            }
        }
    }
    found
}

/// The names that a module re-exports, and where each is defined.
struct Reexports(BTreeMap<String, Vec<String>>);

impl Reexports {
    fn of(code: &str, module: &Module, is_module: impl Fn(&[String]) -> bool) -> Self {
        let mut names = BTreeMap::new();
        for (at, _) in code.match_indices("pub ").chain(code.match_indices("pub(")) {
            let line = code[at..].split(';').next().unwrap_or_default();
            let Some((visibility, used)) = line.split_once("use ") else { continue };
            if visibility.contains(|c: char| !(c.is_alphanumeric() || "() :_".contains(c)))
                || visibility.contains("fn ")
            {
                continue;
            }
            let mut paths = Vec::new();
            expand(used, &mut Vec::new(), &mut paths);
            for path in paths {
                let Some(name) = path.last().cloned() else { continue };
                let relative = !["crate", "super", "self"].contains(&path[0].as_str());
                let place = absolute(&path, module);
                // Another crate's item is nobody's in here.
                let foreign = relative && !is_module(&place[..place.len() - 1]);
                if !foreign && place.last() == Some(&name) {
                    names.insert(name, place);
                }
            }
        }
        Self(names)
    }

    fn source(&self, name: &str) -> Option<&Vec<String>> {
        self.0.get(name)
    }
}

/// The circles of some arrows, each as its rooms and the names that tie them.
fn circles(arrows: &Arrows) -> Vec<String> {
    let mut reach: BTreeMap<&Module, BTreeSet<&Module>> = BTreeMap::new();
    for (from, to) in arrows.keys() {
        reach.entry(from).or_default().insert(to);
    }
    loop {
        let before: usize = reach.values().map(BTreeSet::len).sum();
        let further: Vec<(&Module, BTreeSet<&Module>)> = reach
            .iter()
            .map(|(from, to)| (*from, to.iter().filter_map(|to| reach.get(to)).flatten().copied().collect()))
            .collect();
        for (from, to) in further {
            reach.entry(from).or_default().extend(to);
        }
        if reach.values().map(BTreeSet::len).sum::<usize>() == before {
            break;
        }
    }
    let leads = |from: &Module, to: &Module| reach.get(from).is_some_and(|reached| reached.contains(to));
    let mut ties: BTreeMap<BTreeSet<&Module>, Vec<&String>> = BTreeMap::new();
    for ((from, to), tie) in arrows {
        if leads(to, from) {
            let circle = reach.keys().copied().filter(|room| leads(from, room) && leads(room, from)).collect();
            ties.entry(circle).or_default().push(tie);
        }
    }
    ties.into_iter()
        .map(|(circle, ties)| {
            let rooms: Vec<String> = circle.into_iter().map(|room| room.join("::")).collect();
            let ties: Vec<String> = ties.into_iter().map(|tie| format!("    {tie}")).collect();
            format!("{} are one circle:\n{}", rooms.join(", "), ties.join("\n"))
        })
        .collect()
}

#[test]
fn no_crate_has_a_circle_inside() {
    let mut found = Vec::new();
    for manifest in manifests() {
        let src = manifest.parent().unwrap_or(root()).join("src");
        if src.is_dir() {
            let place = src.strip_prefix(root()).unwrap_or(&src).display().to_string();
            found.extend(circles(&arrows(&src)).into_iter().map(|circle| format!("{place}: {circle}")));
        }
    }
    assert!(found.is_empty(), "move what both need down, into a file of its own:\n{}", found.join("\n"));
}

/// Most folders in the `src` of the node and of the bridge: a newcomer sees them at one look.
const FOLDERS_MAX: usize = 8;
/// Most files beside them.
const FILES_MAX: usize = 8;

#[test]
fn the_node_and_the_bridge_have_few_folders_and_few_files_at_the_top() {
    for place in ["src", "crates/ros-bridge/src"] {
        let src = root().join(place);
        let sources = files(&src, ".rs");
        let top: BTreeSet<_> = sources.iter().filter_map(|path| path.strip_prefix(&src).ok()?.iter().next()).collect();
        let (top_files, folders): (Vec<_>, Vec<_>) = top.into_iter().partition(|name| src.join(name).is_file());
        assert!(folders.len() <= FOLDERS_MAX, "{place} has {} folders of {FOLDERS_MAX}: {folders:?}", folders.len());
        // The face of a folder belongs to it.
        let alone =
            |name: &&&std::ffi::OsStr| !folders.iter().any(|folder| *folder == Path::new(name).with_extension(""));
        let alone: Vec<_> = top_files.iter().filter(alone).collect();
        assert!(alone.len() <= FILES_MAX, "{place} has {} files of {FILES_MAX}: {alone:?}", alone.len());
    }
}

#[test]
fn the_paths_of_a_file_are_read_with_groups_and_renames_and_without_comments_strings_and_tests() {
    let code = code_without_tests(
        "use crate::{a::B, c::{self, D as E}};\n// crate::no\nlet text = \"crate::no \\\" crate::no\";\nlet quote = '\"'; super::f();\n\
         $crate::no; ledger_crate::no;\n#[cfg(test)]\n#[expect(clippy::panic)]\nmod tests {\n use crate::no; }",
    );
    let found: BTreeSet<String> = paths(&code).iter().map(|path| path.join("::")).collect();
    for wanted in ["crate::a::B", "crate::c::self", "crate::c::D", "super::f"] {
        assert!(found.contains(wanted), "{wanted}: {found:?}");
    }
    assert!(!found.iter().any(|path| path.ends_with("no")), "{found:?}");
}

#[test]
fn a_path_is_followed_from_the_module_that_has_it() {
    let module: Module = ["peers", "sync"].map(str::to_owned).into();
    let at =
        |path: &[&str]| absolute(&path.iter().map(|part| (*part).to_owned()).collect::<Vec<_>>(), &module).join("::");
    assert_eq!(at(&["crate", "trust", "ca"]), "trust::ca");
    assert_eq!(at(&["super", "service", "X"]), "peers::service::X");
    assert_eq!(at(&["super", "super", "X"]), "X");
    assert_eq!(at(&["self", "ask", "X"]), "peers::sync::ask::X");
}

#[test]
fn a_circle_is_found_and_named_and_a_chain_is_not() {
    let tied = |pairs: &[(&str, &str)]| -> Arrows {
        let room = |name: &str| vec![name.to_owned()];
        pairs.iter().map(|(from, to)| ((room(from), room(to)), format!("{from} names {to}::X"))).collect()
    };
    assert_eq!(circles(&tied(&[("a", "b"), ("b", "c"), ("a", "c")])), Vec::<String>::new());
    let found = circles(&tied(&[("a", "b"), ("b", "c"), ("c", "a"), ("c", "d")]));
    assert_eq!(found, ["a, b, c are one circle:\n    a names b::X\n    b names c::X\n    c names a::X"]);
}
