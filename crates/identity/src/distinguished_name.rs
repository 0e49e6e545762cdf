//! Distinguished names of X.509, compared as RFC 5280 section 7.1 says.
//!
//! CAs write one name in several ways: another string type, another case, more white space. Two names are equal here
//! if they say the same after the preparation of RFC 4518. The bytes stay available: what names an issuer on the ledger
//! is the hash of the bytes in its own certificate.

use crate::der::{Element, SEQUENCE, SET, identifier_text};
use crate::identity::{IdentityError, malformed};
use ledger_base::hash::Hash;
use std::borrow::Cow;
use std::cmp::Ordering;
use std::collections::BTreeSet;
use std::fmt;
use std::hash::Hasher;
use unicode_normalization::UnicodeNormalization;

/// Longest name that is read, in bytes of DER.
const NAME_DER_MAX: usize = 4 * 1024;
/// Most attributes of a name.
const ATTRIBUTES_MAX: usize = 64;

/// Content of the object identifier of CN.
pub(crate) const COMMON_NAME: &[u8] = &[0x55, 0x04, 0x03];
/// Content of the object identifier of OU.
pub(crate) const UNIT: &[u8] = &[0x55, 0x04, 0x0b];
/// Content of the object identifier of emailAddress.
pub(crate) const EMAIL: &[u8] = &[0x2a, 0x86, 0x48, 0x86, 0xf7, 0x0d, 0x01, 0x09, 0x01];

/// The kinds of attributes that have a short name.
const SHORT_NAMES: [(&[u8], &str); 14] = [
    (COMMON_NAME, "CN"),
    (&[0x55, 0x04, 0x04], "SN"),
    (&[0x55, 0x04, 0x05], "serialNumber"),
    (&[0x55, 0x04, 0x06], "C"),
    (&[0x55, 0x04, 0x07], "L"),
    (&[0x55, 0x04, 0x08], "ST"),
    (&[0x55, 0x04, 0x09], "street"),
    (&[0x55, 0x04, 0x0a], "O"),
    (UNIT, "OU"),
    (&[0x55, 0x04, 0x0c], "title"),
    (&[0x55, 0x04, 0x2a], "GN"),
    (EMAIL, "Email"),
    (&[0x09, 0x92, 0x26, 0x89, 0x93, 0xf2, 0x2c, 0x64, 0x01, 0x19], "DC"),
    (&[0x09, 0x92, 0x26, 0x89, 0x93, 0xf2, 0x2c, 0x64, 0x01, 0x01], "UID"),
];

/// A distinguished name. Equality, order and hash are those of the prepared content, not of the bytes.
#[derive(Clone, Debug)]
pub struct DistinguishedName {
    der: Vec<u8>,
    /// The relative distinguished names in order, each as the set of its attributes.
    relative: Vec<BTreeSet<Prepared>>,
    attributes: Vec<Attribute>,
}

/// An attribute as it is compared.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
struct Prepared {
    kind: Vec<u8>,
    value: Result<String, Vec<u8>>,
}

/// An attribute as it was written.
#[derive(Clone, Debug)]
struct Attribute {
    kind: Vec<u8>,
    /// None: it is no text.
    text: Option<String>,
    /// Is it in the same relative distinguished name as the one before?
    joined: bool,
}

impl DistinguishedName {
    /// Reads a name in DER.
    ///
    /// # Errors
    /// [`IdentityError::Malformed`].
    pub(crate) fn parse(der: &[u8]) -> Result<Self, IdentityError> {
        let unreadable =
            || malformed("a distinguished name that cannot be read".into(), "a sequence of sets of attributes");
        if der.len() > NAME_DER_MAX {
            return Err(malformed(
                format!("a distinguished name of {} bytes", der.len()),
                "a name of at most 4096 bytes",
            ));
        }
        let (mut relative, mut attributes) = (Vec::new(), Vec::new());
        for set in Element::inside(der, SEQUENCE).ok_or_else(unreadable)? {
            let members = Element::inside(set.whole, SET).filter(|members| !members.is_empty());
            let mut prepared = BTreeSet::new();
            for (place, member) in members.ok_or_else(unreadable)?.into_iter().enumerate() {
                let parts = Element::inside(member.whole, SEQUENCE).ok_or_else(unreadable)?;
                let [kind, value] = parts.as_slice() else { return Err(unreadable()) };
                let (kind, text) = (kind.content.to_vec(), text(value));
                let value = text.as_deref().map(prepare).ok_or_else(|| value.whole.to_vec());
                prepared.insert(Prepared { kind: kind.clone(), value });
                attributes.push(Attribute { kind, text, joined: place > 0 });
            }
            relative.push(prepared);
        }
        if attributes.len() > ATTRIBUTES_MAX {
            return Err(malformed(format!("a distinguished name of {} parts", attributes.len()), "at most 64 parts"));
        }
        Ok(Self { der: der.to_vec(), relative, attributes })
    }

    /// The name in DER, as it was written.
    pub fn der(&self) -> &[u8] {
        &self.der
    }

    /// SHA-256 of the name in DER.
    pub fn hash(&self) -> Hash {
        Hash::of(&[&self.der])
    }

    /// Is it the name of nothing?
    pub(crate) fn is_empty(&self) -> bool {
        self.relative.is_empty()
    }

    /// Does it begin with all of this other name?
    pub(crate) fn is_within(&self, other: &Self) -> bool {
        self.relative.starts_with(&other.relative)
    }

    /// The values of one kind of attribute, as they were written.
    ///
    /// # Errors
    /// [`IdentityError::Malformed`] if one is no text.
    pub(crate) fn values(&self, kind: &[u8]) -> Result<Vec<String>, IdentityError> {
        let values = self.attributes.iter().filter(|attribute| attribute.kind == kind);
        let text = |attribute: &Attribute| {
            let found = || format!("{} in a name that is no text", short_name(kind));
            attribute.text.clone().ok_or_else(|| malformed(found(), "a string of X.520"))
        };
        values.map(text).collect()
    }
}

impl PartialEq for DistinguishedName {
    fn eq(&self, other: &Self) -> bool {
        self.relative == other.relative
    }
}

impl Eq for DistinguishedName {}

impl PartialOrd for DistinguishedName {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for DistinguishedName {
    fn cmp(&self, other: &Self) -> Ordering {
        self.relative.cmp(&other.relative)
    }
}

impl std::hash::Hash for DistinguishedName {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.relative.hash(state);
    }
}

impl fmt::Display for DistinguishedName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, attribute) in self.attributes.iter().enumerate() {
            let separator = match place {
                0 => "",
                _ if attribute.joined => " + ",
                _ => ", ",
            };
            let text = attribute.text.as_deref().unwrap_or("(no text)");
            write!(f, "{separator}{}={text}", short_name(&attribute.kind))?;
        }
        Ok(())
    }
}

fn short_name(kind: &[u8]) -> Cow<'static, str> {
    match SHORT_NAMES.iter().find(|(known, _)| *known == kind) {
        Some((_, name)) => Cow::Borrowed(name),
        None => Cow::Owned(identifier_text(kind)),
    }
}

/// The text of a string type of ASN.1; none for other types and for bytes that are no text.
fn text(value: &Element<'_>) -> Option<String> {
    let bytes = value.content;
    match value.tag {
        // UTF8String, NumericString, PrintableString, IA5String, VisibleString. CAs write more than ASCII into them.
        0x0c | 0x12 | 0x13 | 0x16 | 0x1a => std::str::from_utf8(bytes).ok().map(str::to_owned),
        // T61String. OpenSSL and others read and write Latin-1.
        0x14 => Some(bytes.iter().map(|byte| char::from(*byte)).collect()),
        // BMPString
        0x1e => {
            let (pairs, []) = bytes.as_chunks::<2>() else { return None };
            let units: Vec<u16> = pairs.iter().map(|pair| u16::from_be_bytes(*pair)).collect();
            String::from_utf16(&units).ok()
        }
        // UniversalString
        0x1c => {
            let (fours, []) = bytes.as_chunks::<4>() else { return None };
            fours.iter().map(|four| char::from_u32(u32::from_be_bytes(*four))).collect()
        }
        _ => None,
    }
}

/// A string as it is compared (RFC 4518): without what nobody sees, in one case, normalized, with single spaces between words.
fn prepare(text: &str) -> String {
    let visible = text.chars().filter(|c| !is_unseen(*c));
    let spaced = visible.map(|c| if c.is_whitespace() { ' ' } else { c });
    // Up and down again: the whole of case folding, such as that of the German sharp s.
    let folded: String = spaced.flat_map(char::to_uppercase).flat_map(char::to_lowercase).nfkc().collect();
    let folded: String = folded.chars().flat_map(char::to_lowercase).collect();
    folded.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Control characters and those that RFC 4518 section 2.2 maps to nothing.
fn is_unseen(c: char) -> bool {
    (c.is_control() && !c.is_whitespace())
        || matches!(c, '\u{ad}' | '\u{34f}' | '\u{6dd}' | '\u{70f}' | '\u{1806}' | '\u{180b}'..='\u{180e}')
        || matches!(c, '\u{200b}'..='\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2060}'..='\u{2063}' | '\u{206a}'..='\u{206f}')
        || matches!(c, '\u{fe00}'..='\u{fe0f}' | '\u{feff}' | '\u{fff9}'..='\u{fffc}' | '\u{1d173}'..='\u{1d17a}')
        || matches!(c, '\u{e0001}' | '\u{e0020}'..='\u{e007f}')
}

#[cfg(test)]
mod tests {
    use super::*;

    const UTF8: u8 = 0x0c;
    const PRINTABLE: u8 = 0x13;
    const T61: u8 = 0x14;
    const BMP: u8 = 0x1e;
    const UNIVERSAL: u8 = 0x1c;

    fn tagged(tag: u8, content: &[u8]) -> Vec<u8> {
        [&[tag, u8::try_from(content.len()).unwrap_or_default()], content].concat()
    }

    fn attribute(kind: &[u8], tag: u8, value: &[u8]) -> Vec<u8> {
        tagged(SEQUENCE, &[tagged(0x06, kind), tagged(tag, value)].concat())
    }

    fn name(relative: &[&[Vec<u8>]]) -> Option<DistinguishedName> {
        let sets: Vec<u8> = relative.iter().flat_map(|members| tagged(SET, &members.concat())).collect();
        DistinguishedName::parse(&tagged(SEQUENCE, &sets)).ok()
    }

    fn common(tag: u8, value: &[u8]) -> Option<DistinguishedName> {
        name(&[&[attribute(COMMON_NAME, tag, value)]])
    }

    #[test]
    fn one_name_in_each_string_type_case_and_spacing_is_one_name() {
        let plain = common(UTF8, "Straße 1".as_bytes());
        assert!(plain.is_some());
        let wide: Vec<u8> = "Straße 1".encode_utf16().flat_map(u16::to_be_bytes).collect();
        let widest: Vec<u8> = "Straße 1".chars().flat_map(|c| u32::from(c).to_be_bytes()).collect();
        for same in [
            common(T61, b"Stra\xdfe 1"),
            common(BMP, &wide),
            common(UNIVERSAL, &widest),
            common(PRINTABLE, b"STRASSE 1"),
            common(UTF8, "  strasse \u{a0} 1 ".as_bytes()),
            common(UTF8, "strasse\u{200b} \u{ff11}".as_bytes()),
        ] {
            assert_eq!(same, plain);
        }
        for other in [common(UTF8, b"Strasse 2"), common(UTF8, b"Strasse1"), common(0x04, b"Strasse 1"), name(&[])] {
            assert_ne!(other, plain);
        }
        assert_eq!(common(0x04, b"x"), common(0x04, b"x"));
        assert_ne!(common(0x04, b"x"), common(0x04, b"X"), "what is no text is compared as it is");
    }

    #[test]
    fn the_order_counts_between_relative_names_and_not_inside_one() {
        let (unit, person) = (attribute(UNIT, UTF8, b"u"), attribute(COMMON_NAME, UTF8, b"c"));
        let both = name(&[&[unit.clone(), person.clone()]]);
        assert_eq!(both, name(&[&[person.clone(), unit.clone()]]));
        let row = name(&[std::slice::from_ref(&unit), std::slice::from_ref(&person)]);
        assert_ne!(both, row);
        assert_ne!(row, name(&[std::slice::from_ref(&person), std::slice::from_ref(&unit)]));
        let text = |name: Option<DistinguishedName>| name.map(|name| name.to_string()).unwrap_or_default();
        assert_eq!((text(both.clone()).as_str(), text(row.clone()).as_str()), ("OU=u + CN=c", "OU=u, CN=c"));
        let within = |name: &Option<DistinguishedName>, other: &Option<DistinguishedName>| {
            name.as_ref().zip(other.as_ref()).is_some_and(|(name, other)| name.is_within(other))
        };
        let top = name(&[&[unit]]);
        assert!(within(&row, &top) && within(&row, &row) && within(&row, &name(&[])));
        assert!(!within(&top, &row) && !within(&both, &top));
    }

    #[test]
    fn what_is_no_name_is_refused() {
        assert!(DistinguishedName::parse(&tagged(SEQUENCE, &tagged(SET, &[]))).is_err());
        assert!(DistinguishedName::parse(&tagged(SET, &[])).is_err());
        assert!(DistinguishedName::parse(&[0; NAME_DER_MAX + 1]).is_err());
        let odd = common(BMP, b"odd").map(|name| name.values(COMMON_NAME).is_err());
        assert_eq!(odd, Some(true));
    }
}
