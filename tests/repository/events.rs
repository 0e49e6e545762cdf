//! Every event that a chaincode of ours emits is among the names that it says it has: who subscribes to another name is
//! refused.

use crate::sources::{code, files, read, root};
use std::collections::BTreeSet;

/// The texts in quotes of the lines from one that holds `start` to the one that holds `end`.
fn quoted(text: &str, start: &str, end: &str) -> BTreeSet<String> {
    let list = text.split_once(start).and_then(|(_, rest)| rest.split_once(end)).map_or("", |(list, _)| list);
    list.split('"').skip(1).step_by(2).map(str::to_owned).collect()
}

#[test]
fn chaincodes_name_every_event_that_they_emit_and_no_other() {
    for (folder, table) in
        [("crates/abac/src", "crates/abac/src/contract.rs"), ("crates/ledger/src/msp", "crates/ledger/src/msp.rs")]
    {
        let named = quoted(&read(&root().join(table)), "const EVENTS:", "];");
        let sources = files(&root().join(folder), ".rs").into_iter().map(|path| read(&path));
        let emitted: BTreeSet<String> = sources
            .flat_map(|text| code(&text).map(str::to_owned).collect::<Vec<_>>())
            .filter_map(|line| Some(line.split_once("ctx.emit(\"")?.1.split_once('"')?.0.to_owned()))
            .collect();
        assert!(!emitted.is_empty(), "{folder} emits nothing");
        assert_eq!(named, emitted, "EVENTS of {table}");
    }
}
