//! Strict DER: elements of short tags and definite lengths in their shortest form.
//!
//! The parsers of certificates and lists accept more than DER. A second encoding of one content would have another
//! fingerprint, so bytes are checked here first.

/// How deep elements may be nested: a certificate needs 9.
const DEPTH_MAX: usize = 24;

const BOOLEAN: u8 = 0x01;
const INTEGER: u8 = 0x02;
const BIT_STRING: u8 = 0x03;
const NULL: u8 = 0x05;
const OBJECT_IDENTIFIER: u8 = 0x06;
pub(crate) const SEQUENCE: u8 = 0x30;
pub(crate) const SET: u8 = 0x31;

/// One element.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Element<'a> {
    /// The identifier octet: class, form and number.
    pub(crate) tag: u8,
    pub(crate) content: &'a [u8],
    /// With tag and length.
    pub(crate) whole: &'a [u8],
}

impl<'a> Element<'a> {
    /// The first element of these bytes, and the bytes behind it.
    pub(crate) fn first(bytes: &'a [u8]) -> Option<(Self, &'a [u8])> {
        let [tag, length, behind @ ..] = bytes else { return None };
        // A number above 30 takes several octets; nothing in certificates and lists has one.
        if tag & 0x1f == 0x1f {
            return None;
        }
        let (length, behind) = match *length {
            short @ 0..=0x7f => (usize::from(short), behind),
            long @ 0x81..=0x83 => {
                let (octets, behind) = behind.split_at_checked(usize::from(long - 0x80))?;
                let length = octets.iter().fold(0, |length, octet| (length << 8) | usize::from(*octet));
                let shortest = octets.first() != Some(&0) && length >= 0x80;
                shortest.then_some((length, behind))?
            }
            _ => return None,
        };
        let (content, rest) = behind.split_at_checked(length)?;
        let whole = bytes.get(..bytes.len() - rest.len())?;
        Some((Self { tag: *tag, content, whole }, rest))
    }

    /// The elements that these bytes consist of.
    pub(crate) fn all(mut bytes: &'a [u8]) -> Option<Vec<Self>> {
        let mut elements = Vec::new();
        while !bytes.is_empty() {
            let (element, rest) = Self::first(bytes)?;
            elements.push(element);
            bytes = rest;
        }
        Some(elements)
    }

    /// The elements inside the one that these bytes consist of, if it has this tag.
    pub(crate) fn inside(bytes: &'a [u8], tag: u8) -> Option<Vec<Self>> {
        match Self::first(bytes)? {
            (element, []) if element.tag == tag => Self::all(element.content),
            _ => None,
        }
    }

    fn is_strict(&self, depth: usize) -> bool {
        let is_constructed = self.tag & 0x20 != 0;
        match (self.tag, self.content) {
            (SEQUENCE | SET, content) => all_strict(content, depth),
            // Strings in parts belong to BER.
            (tag, _) if tag & 0xc0 == 0 && is_constructed => false,
            (_, content) if is_constructed => all_strict(content, depth),
            (BOOLEAN, content) => matches!(content, [0 | 0xff]),
            (INTEGER, [] | [0, 0..=0x7f, ..] | [0xff, 0x80..=0xff, ..]) => false,
            (BIT_STRING, content) => bits_are_strict(content),
            (NULL, content) => content.is_empty(),
            (OBJECT_IDENTIFIER, content) => content.last().is_some_and(|last| *last < 0x80),
            _ => true,
        }
    }
}

/// Do these bytes consist of one element, strict throughout? The content of octet strings is not looked at.
pub(crate) fn is_strict(bytes: &[u8]) -> bool {
    matches!(Element::first(bytes), Some((element, [])) if element.is_strict(DEPTH_MAX))
}

fn all_strict(content: &[u8], depth: usize) -> bool {
    let Some(depth) = depth.checked_sub(1) else { return false };
    Element::all(content).is_some_and(|elements| elements.iter().all(|element| element.is_strict(depth)))
}

/// Unused bits of a BIT STRING are zero, and there are at most seven.
fn bits_are_strict(content: &[u8]) -> bool {
    match content {
        [0, ..] => true,
        [unused @ 1..=7, .., last] => last.trailing_zeros() >= u32::from(*unused),
        _ => false,
    }
}

/// An object identifier as people write it, from its content.
pub(crate) fn identifier_text(content: &[u8]) -> String {
    let mut numbers: Vec<u64> = Vec::new();
    let mut number: u64 = 0;
    for octet in content {
        number = number.saturating_mul(128).saturating_add(u64::from(octet & 0x7f));
        if octet & 0x80 == 0 {
            if numbers.is_empty() {
                let root = (number / 40).min(2);
                numbers.push(root);
                number -= root * 40;
            }
            numbers.push(number);
            number = 0;
        }
    }
    numbers.iter().map(u64::to_string).collect::<Vec<_>>().join(".")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_encoding_is_strict_and_the_others_are_not() {
        for strict in
            ["3000", "3003020100", "0101ff", "02020080", "0303078080", "30060500a0020500", "0400", "0603551d0f"]
        {
            assert!(is_strict(&hex::decode(strict).unwrap_or_default()), "{strict}");
        }
        for lax in [
            "",
            "30",
            "3001",
            "308100",
            "30810100",
            "3080000000",
            "010101",
            "0101",
            "0200",
            "02020001",
            "0202ff80",
            "0300",
            "030108",
            "03020101",
            "050100",
            "2403040100",
            "1f0100",
            "0601",
            "060180",
            "30820003020100",
            "300000",
        ] {
            assert!(!is_strict(&hex::decode(lax).unwrap_or_default()), "{lax}");
        }
        let deep = (0..40).fold(vec![0x05, 0x00], |inner, _| {
            let length = u8::try_from(inner.len()).unwrap_or_default();
            [&[SEQUENCE, length], inner.as_slice()].concat()
        });
        assert!(!is_strict(&deep), "nested too deep");
    }

    #[test]
    fn an_object_identifier_is_written_as_people_do() {
        assert_eq!(identifier_text(&[0x55, 0x1d, 0x0f]), "2.5.29.15");
        assert_eq!(identifier_text(&[0x2a, 0x86, 0x48, 0xce, 0x3d, 0x04, 0x03, 0x02]), "1.2.840.10045.4.3.2");
        assert_eq!(identifier_text(&[]), "");
    }
}
