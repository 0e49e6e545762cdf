//! The table of kinds: each is a file of its own, and a line here.

use super::{actions, kind::Kind, services, topics};

/// Every kind.
pub(crate) static KINDS: [&Kind; 6] = [
    &topics::to_ledger::KIND,
    &topics::from_ledger::KIND,
    &services::server::KIND,
    &services::client::KIND,
    &actions::server::KIND,
    &actions::client::KIND,
];

/// The kind of that name.
pub(crate) fn named(name: &str) -> Option<&'static Kind> {
    KINDS.into_iter().find(|kind| kind.name == name)
}

/// The names of all kinds as the configuration wants them.
pub(crate) fn names() -> String {
    KINDS.map(|kind| format!("\"{}\"", kind.name)).join(" or ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn each_kind_has_a_name_of_its_own_and_no_key_twice() {
        let mut seen = BTreeSet::new();
        for kind in KINDS {
            assert!(seen.insert(kind.name), "{kind:?} twice");
            let keys: BTreeSet<_> = kind.keys.iter().collect();
            assert_eq!(keys.len(), kind.keys.len(), "{kind:?} has a key twice");
        }
        let all = r#""to_ledger" or "from_ledger" or "service_server" or "service_client" or "action_server" or "action_client""#;
        assert_eq!(names(), all);
    }
}
