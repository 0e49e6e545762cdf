//! `config.yaml` of an MSP directory: the part `NodeOUs`.
//!
//! It is read event by event, and only where its words are expected. So depth and size are bounded, and a word that would
//! narrow who belongs to the organisation is refused rather than overlooked.

use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use ledger_identity::units::{Unit, Units};
use saphyr_parser::{Event, Parser};
use std::collections::BTreeMap;

/// Longest text that is read, in bytes.
const TEXT_BYTES_MAX: usize = 16 * 1024;
/// How deep maps may lie within each other.
const DEPTH_MAX: usize = 4;

const NODE_UNITS: &str = "NodeOUs";
const ENABLE: &str = "Enable";
const UNIT: &str = "OrganizationalUnitIdentifier";
const CERTIFICATE: &str = "Certificate";

/// The words of Fabric for its kinds of identities, and our roles.
const KINDS: [(&str, Role); 4] = [
    ("ClientOUIdentifier", Role::Member),
    ("AdminOUIdentifier", Role::Admin),
    ("PeerOUIdentifier", Role::Node),
    ("OrdererOUIdentifier", Role::Node),
];

/// The units that a text declares. `authority` answers with the certificate (DER) of a file that the text names.
///
/// # Errors
/// [`Code::BadFile`] without the file.
pub(super) fn read(text: &str, authority: &dyn Fn(&str) -> Option<Vec<u8>>) -> Result<Units, Rejection> {
    let words = words(text)?;
    let value = |path: &[&str]| words.get(&path.join("\0")).map(String::as_str);
    let known = |path: &str| {
        let parts: Vec<&str> = path.split('\0').collect();
        match parts.as_slice() {
            [NODE_UNITS, ENABLE] => true,
            [NODE_UNITS, kind, UNIT | CERTIFICATE] => KINDS.iter().any(|(known, _)| known == kind),
            _ => false,
        }
    };
    if let Some(odd) = words.keys().find(|path| !known(path)) {
        return Err(bad(format!("the setting {:?}", odd.replace('\0', ".")))
            .wanted("NodeOUs alone: Enable, and ClientOUIdentifier, PeerOUIdentifier, AdminOUIdentifier, OrdererOUIdentifier")
            .next("take away what ledgerd would not follow, if its people may come in without it"));
    }
    match value(&[NODE_UNITS, ENABLE]) {
        Some("true" | "True" | "TRUE") => {}
        None | Some("false" | "False" | "FALSE") => return Ok(Units::default()),
        Some(other) => return Err(bad(format!("Enable: {other:?}")).wanted("true or false")),
    }
    let mut units = Vec::new();
    for (kind, role) in KINDS {
        let Some(unit) = value(&[NODE_UNITS, kind, UNIT]).filter(|unit| !unit.is_empty()) else { continue };
        let issuer = match value(&[NODE_UNITS, kind, CERTIFICATE]).filter(|file| !file.is_empty()) {
            None => None,
            Some(file) => Some(authority(file).map(|der| Hash::of(&[&der])).ok_or_else(|| {
                bad(format!("{kind} with the certificate {file:?}"))
                    .wanted("a file that is there, such as cacerts/ca.pem")
            })?),
        };
        units.push(Unit { unit: unit.to_owned(), role, issuer });
    }
    if units.is_empty() {
        return Err(bad("NodeOUs that are enabled and name no unit").wanted("at least ClientOUIdentifier"));
    }
    Ok(Units::new(units)?)
}

/// The scalars of a text by their paths; each name once.
fn words(text: &str) -> Result<BTreeMap<String, String>, Rejection> {
    if text.len() > TEXT_BYTES_MAX {
        return Err(bad(format!("{} bytes", text.len())).wanted(format!("at most {TEXT_BYTES_MAX} bytes")));
    }
    let plain = "maps of names and texts, without lists, anchors and tags";
    let mut words = BTreeMap::new();
    // The names of the maps around, and whether a value is due; a map that begins waits for a name.
    let mut path: Vec<Option<String>> = Vec::new();
    let mut documents = 0;
    for event in Parser::new_from_str(text) {
        let (event, _) =
            event.map_err(|error| bad(format!("{} in line {}", error.info(), error.marker().line())).wanted(plain))?;
        match event {
            Event::MappingStart(0, None) if path.len() < DEPTH_MAX => path.push(None),
            Event::MappingEnd => {
                path.pop();
                if let Some(name) = path.last_mut() {
                    *name = None;
                }
            }
            Event::Scalar(value, _, 0, None) => match path.last_mut() {
                Some(name @ None) => *name = Some(value.into_owned()),
                Some(Some(_)) => {
                    let whole: Vec<&str> = path.iter().flatten().map(String::as_str).collect();
                    if words.insert(whole.join("\0"), value.into_owned()).is_some() {
                        return Err(bad(format!("{} twice", whole.join("."))).wanted("each name once"));
                    }
                    if let Some(name) = path.last_mut() {
                        *name = None;
                    }
                }
                None if value.is_empty() => {}
                None => return Err(bad("a text alone").wanted(plain)),
            },
            Event::DocumentStart(_) if documents > 0 => return Err(bad("several documents").wanted("one")),
            Event::DocumentStart(_) => documents += 1,
            Event::Nothing | Event::StreamStart | Event::StreamEnd | Event::DocumentEnd => {}
            _ => return Err(bad("a list, an anchor, a tag, or maps that lie too deep").wanted(plain)),
        }
    }
    Ok(words)
}

fn bad(found: impl Into<String>) -> Rejection {
    Rejection::new(Code::BadFile, "cannot use config.yaml").found(found)
}
