//! Attributes that owners give to robots and services: what they may be, and how they change.
//!
//! A decision looks at all attributes of a robot and of one of its services, so their bytes are bounded together.

use crate::arguments::shown;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Attribute, AttributeChanges, Attributes};
use std::collections::BTreeSet;

/// Most bytes of names and values of the attributes of a robot.
pub(crate) const OF_ROBOT_BYTES_MAX: usize = 4096;

/// Most bytes of names and values of the attributes of a service.
pub(crate) const OF_SERVICE_BYTES_MAX: usize = 1024;

/// Longest name, in bytes.
const NAME_BYTES_MAX: usize = 64;

/// Longest text, in bytes.
const TEXT_BYTES_MAX: usize = 256;

/// Most texts of a set.
const SET_MAX: usize = 64;

/// Bytes that a number counts as.
const NUMBER_BYTES: usize = 8;

/// The attributes of a description, checked; none if it names none.
pub(crate) fn described(attributes: Option<Attributes>, bytes_max: usize) -> Result<Attributes, Rejection> {
    let Some(attributes) = attributes else { return Ok(Attributes::new()) };
    let checked = attributes.into_iter().map(|(name, value)| {
        check_name(&name)?;
        let value = check_value(&name, value)?;
        Ok((name, value))
    });
    let attributes: Attributes = checked.collect::<Result<_, Rejection>>()?;
    let bytes: usize = attributes.iter().map(|(name, value)| name.len() + bytes_of(value)).sum();
    if bytes <= bytes_max {
        return Ok(attributes);
    }
    Err(Rejection::new(Code::LimitExceeded, "the attributes together are too large")
        .found(format!("{bytes} bytes of names and values"))
        .wanted(format!("at most {bytes_max} bytes"))
        .next("remove attributes that no policy uses"))
}

/// Gives some attributes other values, or removes them.
pub(crate) fn change(
    attributes: &mut Attributes,
    changes: &AttributeChanges,
    bytes_max: usize,
) -> Result<(), Rejection> {
    let mut after = attributes.clone();
    for (name, value) in changes {
        match value {
            Some(value) => drop(after.insert(name.clone(), value.clone())),
            None if after.remove(name).is_some() => {}
            None => {
                let known: Vec<&str> = attributes.keys().map(String::as_str).collect();
                return Err(Rejection::new(Code::NotFound, "there is no attribute of this name to remove")
                    .found(shown(name))
                    .wanted(if known.is_empty() { "no attribute: it has none".to_owned() } else { known.join(", ") })
                    .next("ledgerctl robot show NAME"));
            }
        }
    }
    *attributes = described(Some(after), bytes_max)?;
    Ok(())
}

/// Tells each attribute that is different: its name, and its values before and after.
pub(crate) fn differences(before: &Attributes, after: &Attributes, mut note: impl FnMut(&str, String, String)) {
    let names: BTreeSet<&String> = before.keys().chain(after.keys()).collect();
    for name in names {
        let (before, after) = (before.get(name), after.get(name));
        if before != after {
            // A text and a number may look alike.
            let told = |value: Option<&Attribute>| match value {
                Some(Attribute::Text(text)) => format!("{text:?}"),
                Some(Attribute::Set(texts)) => format!("{texts:?}"),
                Some(Attribute::Number(number)) => number.to_string(),
                None => String::new(),
            };
            note(&format!("attribute {name}"), told(before), told(after));
        }
    }
}

fn bytes_of(value: &Attribute) -> usize {
    match value {
        Attribute::Number(_) => NUMBER_BYTES,
        Attribute::Text(text) => text.len(),
        Attribute::Set(texts) => texts.iter().map(String::len).sum(),
    }
}

fn check_name(name: &str) -> Result<(), Rejection> {
    let allowed = |b: u8| b.is_ascii_alphanumeric() || b == b'_';
    if (1..=NAME_BYTES_MAX).contains(&name.len()) && name.bytes().all(allowed) {
        return Ok(());
    }
    Err(Rejection::new(Code::BadName, "the name of an attribute is not usable")
        .found(shown(name))
        .wanted(format!("1 to {NAME_BYTES_MAX} letters, digits and \"_\", e.g. payload_kg")))
}

/// A usable value; a set sorted, each text once.
fn check_value(name: &str, value: Attribute) -> Result<Attribute, Rejection> {
    let refused = |found: String, wanted: String| {
        Err(Rejection::new(Code::BadArgument, format!("the value of the attribute {name} is not usable"))
            .found(found)
            .wanted(wanted)
            .next("use a shorter value, or several attributes"))
    };
    let texts = match &value {
        Attribute::Number(_) => return Ok(value),
        Attribute::Text(text) => std::slice::from_ref(text),
        Attribute::Set(texts) => texts.as_slice(),
    };
    if texts.len() > SET_MAX {
        return refused(format!("{} texts", texts.len()), format!("at most {SET_MAX}"));
    }
    let usable = |text: &&String| text.len() <= TEXT_BYTES_MAX && !text.chars().any(char::is_control);
    if let Some(bad) = texts.iter().find(|text| !usable(text)) {
        return refused(shown(bad), format!("at most {TEXT_BYTES_MAX} bytes without control characters"));
    }
    Ok(match value {
        Attribute::Set(texts) => Attribute::Set(texts.into_iter().collect::<BTreeSet<_>>().into_iter().collect()),
        other => other,
    })
}
