//! The default policy and the schema of policies belong to the rules: their texts never change under a number.

use ledger::Rules;
use ledger_abac::{DEFAULT_POLICY, SCHEMA};
use ledger_base::hash::Hash;

/// SHA-256 of the default policy and of the schema of the newest rules. Once their number is in a release, other texts need
/// the next one.
const RECORDED: [&str; 2] = [
    "3053678ecd77babfc42d918b8105d8bebc621c141aa0ea6ae1df1a9c2d229921",
    "cec4631e1ecdea6b109974c5974b3ff627c86e37284e88292acde2af9c5a8fe8",
];

#[test]
fn the_default_policy_and_the_schema_of_a_released_rules_number_never_change() {
    assert_eq!(Rules::NEWEST.number(), 1);
    assert_eq!([DEFAULT_POLICY, SCHEMA].map(|text| Hash::of(&[text.as_bytes()]).to_string()), RECORDED);
}
