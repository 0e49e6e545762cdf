//! Organisations with words of their own for roles, as a Fabric organisation has them.

use crate::authority::{Ca, NONE, NOW, attributes, ca_params, network, params, with_attributes};
use ledger_base::hash::Hash;
use ledger_identity::msp::{Msp, Msps};
use ledger_identity::units::{UNITS_MAX, Unit, Units};
use ledger_identity::{IdentityError, Role};
use rcgen::DnType;

fn unit(unit: &str, role: Role) -> Unit {
    Unit { unit: unit.to_owned(), role, issuer: None }
}

/// The four words of Fabric, as its `config.yaml` usually has them.
fn fabric() -> Units {
    let words = [("client", Role::Member), ("admin", Role::Admin), ("peer", Role::Node), ("orderer", Role::Node)];
    Units::new(words.map(|(word, role)| unit(word, role)).to_vec()).unwrap()
}

fn with_units(ca: &Ca, units: Units) -> Msps {
    network([ca.msp("Org3").with_units(Some(units)).unwrap()])
}

fn role(network: &Msps, ca: &Ca, unit: Option<&str>) -> Result<Role, IdentityError> {
    network.verify(&ca.issue(&params("Salma", unit)), NONE, NOW).map(|identity| identity.role)
}

#[test]
fn the_units_that_an_organisation_declares_name_roles_and_no_other_word_does() {
    let ca = Ca::new("ca.org3");
    let network = with_units(&ca, fabric());
    for (word, wanted) in [("client", Role::Member), ("admin", Role::Admin), ("peer", Role::Node)] {
        assert_eq!(role(&network, &ca, Some(word)), Ok(wanted), "{word}");
    }
    for word in [None, Some("member"), Some("robot"), Some("node"), Some("Admin"), Some("department1")] {
        let refused = role(&network, &ca, word).unwrap_err().to_string();
        assert!(refused.contains("no role in the units"), "{word:?}: {refused}");
    }
    let renamed = with_units(&ca, Units::new(vec![unit("boss", Role::Admin), unit("admin", Role::Member)]).unwrap());
    assert_eq!(role(&renamed, &ca, Some("boss")), Ok(Role::Admin));
    assert_eq!(role(&renamed, &ca, Some("admin")), Ok(Role::Member), "the word of others means what it says here");
}

#[test]
fn without_units_everybody_is_a_member_and_two_roles_at_once_are_none() {
    let ca = Ca::new("ca.org3");
    let none = with_units(&ca, Units::default());
    assert_eq!(role(&none, &ca, Some("admin")), Ok(Role::Member));
    let mut both = params("Salma", Some("client"));
    both.distinguished_name.push(DnType::from_oid(&[2, 5, 4, 11]), "admin");
    let both = ca.issue(&both);
    // rcgen keeps one value of a kind; a certificate of Fabric with two units is among the fixtures.
    let _ = with_units(&ca, fabric()).verify(&both, NONE, NOW);
    let two: Vec<_> = [unit("client", Role::Member), unit("client", Role::Admin)].into();
    let refused = role(&with_units(&ca, Units::new(two).unwrap()), &ca, Some("client")).unwrap_err();
    assert!(refused.to_string().contains("the roles member and admin"), "{refused}");
}

#[test]
fn a_unit_counts_only_from_the_authority_that_it_is_bound_to() {
    let (root, other) = (Ca::new("ca.org3"), Ca::new("other.org3"));
    let below = root.below(ca_params("intermediate.org3"));
    let bound = |ca: &Ca| {
        let units = Units::new(vec![
            Unit { issuer: Some(Hash::of(&[&ca.der()])), ..unit("admin", Role::Admin) },
            unit("client", Role::Member),
        ]);
        let msp = Msp::new("Org3", &[root.der(), other.der()], &[below.der()]).unwrap();
        network([msp.with_units(Some(units.unwrap())).unwrap()])
    };
    for (named, network) in [(&root, bound(&root)), (&below, bound(&below)), (&other, bound(&other))] {
        for ca in [&root, &below, &other] {
            let named = named.der() == ca.der();
            assert_eq!(role(&network, ca, Some("admin")).is_ok(), named);
            assert_eq!(role(&network, ca, Some("client")), Ok(Role::Member));
        }
    }
}

#[test]
fn units_are_few_and_short() {
    for bad in [vec![unit("", Role::Admin)], vec![unit(&"x".repeat(65), Role::Admin)]] {
        assert!(Units::new(bad).is_err());
    }
    assert!(Units::new(vec![unit("x", Role::Admin); UNITS_MAX + 1]).is_err());
    let read: Units = serde_json::from_str(r#"[{"unit":"","role":"admin"}]"#).unwrap();
    let ca = Ca::new("ca.org3");
    assert!(ca.msp("Org3").with_units(Some(read)).is_err(), "units that were read are checked, too");
}

#[test]
fn attributes_come_from_the_extension_alone_and_those_of_fabric_mean_nothing_by_themselves() {
    let ca = Ca::new("ca.org3");
    let network = with_units(&ca, fabric());
    let said = attributes(&[("hf.Type", "admin"), ("hf.Registrar.Roles", "*"), ("Husky", "true")]);
    let identity = network.verify(&ca.issue(&with_attributes(params("Salma", Some("client")), &said)), NONE, NOW);
    let identity = identity.unwrap();
    assert_eq!(identity.role, Role::Member, "an attribute is no role");
    assert_eq!(identity.attributes.len(), 3);
    let plain = network.verify(&ca.issue(&params("Salma", Some("client"))), NONE, NOW).unwrap();
    assert!(plain.attributes.is_empty());
}
