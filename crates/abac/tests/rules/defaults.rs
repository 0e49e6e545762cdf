//! The default policy and the schema of policies belong to the rules: their texts never change under a number.

use ledger::Rules;
use ledger_abac::{DEFAULT_POLICY, SCHEMA};
use ledger_base::hash::Hash;

/// SHA-256 of the default policy and of the schema of the newest rules. Once their number is in a release, other texts need
/// the next one.
const RECORDED: [&str; 2] = [
    "1041b9dc24167c54651b71a756d03d91a499cc82155c63a332ec09580453df01",
    "cd9872c87ef9bccdf21b408459264f364e39d06805a5c250a20f08b5327e2f0b",
];

#[test]
fn the_default_policy_and_the_schema_of_a_released_rules_number_never_change() {
    assert_eq!(Rules::NEWEST.number(), 1);
    assert_eq!([DEFAULT_POLICY, SCHEMA].map(|text| Hash::of(&[text.as_bytes()]).to_string()), RECORDED);
}
