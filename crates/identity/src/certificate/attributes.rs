//! The attribute extension: JSON `{"attrs":{"name":"value"}}`, read strictly.

use crate::identity::{IdentityError, at_most, malformed};
use serde::de::{Error as _, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// The object identifier of the extension, as Fabric's CA uses it.
pub const ATTRIBUTES_OID: &[u64] = &[1, 2, 3, 4, 5, 6, 7, 8, 1];

/// Most attributes of one certificate.
pub const ATTRIBUTES_MAX: usize = 64;

/// Largest content of the extension, in bytes of JSON.
pub const ATTRIBUTES_BYTES_MAX: usize = 4 * 1024;

/// The form of the JSON.
#[derive(Serialize)]
struct Written<'a> {
    attrs: &'a BTreeMap<String, String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Read {
    attrs: Attributes,
}

struct Attributes(BTreeMap<String, String>);

/// The content of the extension for these attributes, for a CA to sign.
///
/// # Errors
/// [`IdentityError::TooLarge`] if a node would refuse to read it.
pub fn encode_attributes(attributes: &BTreeMap<String, String>) -> Result<Vec<u8>, IdentityError> {
    at_most("attributes", attributes.len(), ATTRIBUTES_MAX)?;
    if attributes.contains_key("") {
        return Err(malformed("an attribute without a name".into(), "a name for each attribute"));
    }
    let json = serde_json::to_vec(&Written { attrs: attributes })
        .map_err(|error| malformed(error.to_string(), "attributes that can be written as JSON"))?;
    at_most("bytes of attributes", json.len(), ATTRIBUTES_BYTES_MAX)?;
    Ok(json)
}

pub(super) fn decode(json: &[u8]) -> Result<BTreeMap<String, String>, IdentityError> {
    at_most("bytes of attributes", json.len(), ATTRIBUTES_BYTES_MAX)?;
    let read: Read = serde_json::from_slice(json).map_err(|error| {
        malformed(format!("attributes with {error}"), "JSON {\"attrs\":{\"name\":\"value\"}}, each name once")
    })?;
    Ok(read.attrs.0)
}

/// A map that is read entry by entry: serde's own would silently keep the last of two equal names.
impl<'de> Deserialize<'de> for Attributes {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries;

        impl<'de> Visitor<'de> for Entries {
            type Value = Attributes;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object of strings")
            }

            fn visit_map<M: MapAccess<'de>>(self, mut map: M) -> Result<Attributes, M::Error> {
                let mut attributes = BTreeMap::new();
                while let Some((name, value)) = map.next_entry::<String, String>()? {
                    if name.is_empty() {
                        return Err(M::Error::custom("an empty name"));
                    }
                    if attributes.len() == ATTRIBUTES_MAX {
                        return Err(M::Error::custom(format!("more than {ATTRIBUTES_MAX} names")));
                    }
                    if let Some(first) = attributes.insert(name, value) {
                        return Err(M::Error::custom(format!("a name given twice, first as {first:?}")));
                    }
                }
                Ok(Attributes(attributes))
            }
        }

        deserializer.deserialize_map(Entries)
    }
}
