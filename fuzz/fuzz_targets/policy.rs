//! A policy is refused, or decides: `check`, `can` and `policy` take the same text, and none of them panics.
#![no_main]

use ledger_fuzz::fleet::Fleet;
use libfuzzer_sys::fuzz_target;
use std::sync::LazyLock;

static FLEET: LazyLock<Fleet> = LazyLock::new(Fleet::new);

fuzz_target!(|text: &str| {
    // A text is a share of these terms, or none of any.
    let terms = ledger_contract::ShareEntry::of("Org2", "p", text).and_then(|share| share.terms);
    assert!(terms.is_none_or(|terms| terms.text() == text), "terms of another text");
    let faults = FLEET.check(text);
    let decided = FLEET.can(text);
    let put = FLEET.put(text);
    // Limits and annotations refuse more than the language does; nothing that it refuses is put.
    assert!(faults.is_none() || put.is_err(), "{faults:?}");
    assert!(put.is_err() || decided.is_ok(), "a policy that is put decides: {decided:?}");
});
