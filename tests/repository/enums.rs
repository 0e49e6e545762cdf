//! Enums that programs of others read may grow: decision 55.

use crate::sources::{files, read, root};

/// The crates that a client program links.
const CRATES: [&str; 4] = ["api", "base", "contract", "identity"];

/// Enums that are matched without a wildcard on purpose: whoever adds a variant must look at each match.
const EXHAUSTIVE: [&str; 12] = [
    // Each deliberate bug is tried.
    "Mutation",
    // What to do about a refusal, and the exit code.
    "Class",
    // Rights.
    "Role",
    "Usage",
    // Cryptography.
    "KeyKind",
    // The types of values in the schema of policies.
    "Attribute",
    // What a caller chooses.
    "JoinKind",
    "RenewalRule",
    "ServerTrust",
    // What happened to a caller's own request.
    "Refusal",
    "Renewed",
    // Known to this program, or not.
    "Told",
];

#[test]
fn public_enums_that_other_programs_read_may_grow() {
    let mut seen = Vec::new();
    for path in CRATES.iter().flat_map(|name| files(&root().join("crates").join(name).join("src"), ".rs")) {
        let text = read(&path);
        let lines: Vec<&str> = text.lines().map(str::trim).collect();
        for (at, line) in lines.iter().enumerate() {
            let Some(name) = line.strip_prefix("pub enum ").and_then(|rest| rest.split([' ', '<']).next()) else {
                continue;
            };
            let above = lines.iter().take(at).rev().take_while(|line| line.starts_with("#[") || line.starts_with("//"));
            let grows = above.into_iter().any(|line| line.contains("#[non_exhaustive]"));
            // The macro of `contract` gives every enum that it declares the attribute.
            let by_macro = text.contains("\nwords! {");
            let exhaustive = EXHAUSTIVE.contains(&name);
            assert!(grows != exhaustive || by_macro, "{}: {name}: #[non_exhaustive], or a line here", path.display());
            if exhaustive {
                seen.push(name.to_owned());
            }
        }
    }
    for name in EXHAUSTIVE {
        assert!(seen.iter().any(|seen| seen == name), "{name} is no enum of these crates any more");
    }
}
