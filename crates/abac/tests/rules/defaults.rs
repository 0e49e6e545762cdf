//! The default policy and the schema of policies belong to the rules: their texts never change under a number.

use ledger::Rules;
use ledger_abac::{default_policy, schema};
use ledger_base::hash::Hash;

const POLICY_OF_2: &str = "72a547fb3e5c8e2dbeae2e79333f414015bf103dcac3da5da3ec0b357971ad88";
const SCHEMA_OF_2: &str = "c10da142de09974cdfc6e4d7c3d82650e57d1ea749c74aaac851c3adb3925185";

const POLICY_OF_3: &str = "3053678ecd77babfc42d918b8105d8bebc621c141aa0ea6ae1df1a9c2d229921";
const SCHEMA_OF_3: &str = "cec4631e1ecdea6b109974c5974b3ff627c86e37284e88292acde2af9c5a8fe8";

/// For each rules number: SHA-256 of its default policy and of its schema. A line of a released number stays as it is.
const RECORDED: [(u32, &str, &str); 2] = [(2, POLICY_OF_2, SCHEMA_OF_2), (3, POLICY_OF_3, SCHEMA_OF_3)];

#[test]
fn the_default_policy_and_the_schema_of_a_released_rules_number_never_change() {
    let texts =
        |rules: Rules| [default_policy(rules), schema(rules)].map(|text| Hash::of(&[text.as_bytes()]).to_string());
    let found: Vec<_> = Rules::all().map(|rules| (rules.number(), texts(rules))).collect();
    let recorded: Vec<_> =
        RECORDED.iter().map(|(number, policy, schema)| (*number, [*policy, *schema].map(str::to_owned))).collect();
    assert_eq!(found, recorded);
}
