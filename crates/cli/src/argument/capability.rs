//! Attributes of robots and services, `NAME=VALUE` with a type: `kind=crane` is a text, `payload_kg=20` a whole number,
//! `zones=a,b` a set of texts.
//!
//! A comma makes a set, also at the end: `zones=a,` is a set of one. Within quotes anything is a text: `serial="007"`.

use ledger_contract::{Attribute, AttributeChanges, Attributes};
use std::collections::BTreeMap;

/// An attribute with its value; without one it is to be removed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Capability {
    name: String,
    value: Option<Attribute>,
}

impl std::str::FromStr for Capability {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, value) = text
            .split_once('=')
            .ok_or("wanted NAME=VALUE: kind=crane for a text, payload_kg=20 for a number, zones=a,b for a set")?;
        Ok(Self { name: name.to_owned(), value: read(value)? })
    }
}

fn read(value: &str) -> Result<Option<Attribute>, String> {
    if value.is_empty() {
        return Ok(None);
    }
    if let Some(quoted) = value.strip_prefix('"') {
        let text = quoted.strip_suffix('"').ok_or_else(|| format!("{value}: the closing quote is missing"))?;
        return Ok(Some(Attribute::Text(text.to_owned())));
    }
    let digits = value.strip_prefix('-').unwrap_or(value);
    if !digits.is_empty() && digits.bytes().all(|b| b.is_ascii_digit()) {
        let number = value.parse().map_err(|_| format!("{value} is not a 64-bit number; texts are quoted"))?;
        return Ok(Some(Attribute::Number(number)));
    }
    if value.contains(',') {
        let texts = value.split(',').map(str::trim).filter(|text| !text.is_empty());
        if let Some(other) = texts.clone().find(|text| text.contains('=')) {
            return Err(format!("{value}: {other} looks like another attribute: use a separate option for it"));
        }
        return Ok(Some(Attribute::Set(texts.map(str::to_owned).collect())));
    }
    Ok(Some(Attribute::Text(value.to_owned())))
}

/// Changes of attributes, each given once.
pub(crate) fn changes(given: &[Capability]) -> Result<AttributeChanges, String> {
    let mut all = BTreeMap::new();
    for Capability { name, value } in given {
        if all.insert(name.clone(), value.clone()).is_some() {
            return Err(format!("attribute {name} is given twice"));
        }
    }
    Ok(all)
}

/// Attributes of something new, each given once and with a value.
pub(crate) fn attributes(given: &[Capability]) -> Result<Attributes, String> {
    let value = |(name, value): (String, Option<Attribute>)| {
        let value = value.ok_or_else(|| format!("attribute {name} has no value"))?;
        Ok((name, value))
    };
    changes(given)?.into_iter().map(value).collect()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn the_form_of_a_value_says_its_type() {
        let set = |texts: &[&str]| Some(Attribute::Set(texts.iter().map(|&text| text.to_owned()).collect()));
        let text = |text: &str| Some(Attribute::Text(text.to_owned()));
        for (typed, wanted) in [
            ("crane", text("crane")),
            ("20", Some(Attribute::Number(20))),
            ("-3", Some(Attribute::Number(-3))),
            ("a,b", set(&["a", "b"])),
            ("a,", set(&["a"])),
            (",", set(&[])),
            ("\"007\"", text("007")),
            ("\"a,b\"", text("a,b")),
            ("1.5", text("1.5")),
            ("a=b", text("a=b")),
            ("", None),
        ] {
            assert_eq!(read(typed), Ok(wanted), "{typed}");
        }
        assert!(read("\"a").unwrap_err().contains("quote is missing"));
        assert!(read("crane,payload_kg=20").unwrap_err().contains("payload_kg=20 looks like another attribute"));
        assert!(read("9223372036854775808").unwrap_err().contains("texts are quoted"));
    }

    #[test]
    fn each_attribute_is_given_once_and_a_new_one_has_a_value() {
        let given = |texts: &[&str]| texts.iter().map(|text| text.parse().unwrap()).collect::<Vec<Capability>>();
        assert!("kind".parse::<Capability>().is_err());
        assert!(changes(&given(&["kind=a", "kind=b"])).unwrap_err().contains("given twice"));
        assert_eq!(changes(&given(&["kind="])).unwrap().get("kind"), Some(&None));
        assert!(attributes(&given(&["kind="])).unwrap_err().contains("no value"));
    }
}
