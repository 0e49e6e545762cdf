//! The fields of records.

use std::collections::BTreeMap;

/// The content of a record that is being written.
#[derive(Clone, Debug, Default)]
pub(super) struct Content(pub(super) Vec<u8>);

impl Content {
    pub(super) fn u8(mut self, number: u8) -> Self {
        self.0.push(number);
        self
    }

    pub(super) fn u16(mut self, number: u16) -> Self {
        self.0.extend(number.to_le_bytes());
        self
    }

    pub(super) fn u32(mut self, number: u32) -> Self {
        self.0.extend(number.to_le_bytes());
        self
    }

    pub(super) fn u64(mut self, number: u64) -> Self {
        self.0.extend(number.to_le_bytes());
        self
    }

    /// Bytes behind their length.
    pub(super) fn bytes(self, bytes: &[u8]) -> Self {
        // Nothing that is written is as long as that: messages and names are bounded.
        let mut content = self.u32(u32::try_from(bytes.len()).unwrap_or(u32::MAX));
        content.0.extend(bytes);
        content
    }

    pub(super) fn text(self, text: &str) -> Self {
        self.bytes(text.as_bytes())
    }

    pub(super) fn texts(self, map: &BTreeMap<String, String>) -> Self {
        let inner = map.iter().fold(Self::default(), |content, (key, value)| content.text(key).text(value));
        self.bytes(&inner.0)
    }

    pub(super) fn counts(self, map: impl IntoIterator<Item = (u16, u64)>) -> Self {
        let inner = map.into_iter().fold(Self::default(), |content, (key, value)| content.u16(key).u64(value));
        self.bytes(&inner.0)
    }
}

/// The content of a record that is being read. Every reader gives none where the bytes end before.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fields<'a>(pub(super) &'a [u8]);

impl<'a> Fields<'a> {
    pub(super) fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*taken)
    }

    pub(super) fn u8(&mut self) -> Option<u8> {
        self.array().map(u8::from_le_bytes)
    }

    pub(super) fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    /// Bytes behind their length.
    pub(super) fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = usize::try_from(self.u32()?).ok()?;
        self.take(length)
    }

    pub(super) fn text(&mut self) -> Option<String> {
        std::str::from_utf8(self.bytes()?).ok().map(str::to_owned)
    }

    pub(super) fn texts(&mut self) -> Option<BTreeMap<String, String>> {
        let mut inner = Fields(self.bytes()?);
        let mut map = BTreeMap::new();
        while !inner.0.is_empty() {
            map.insert(inner.text()?, inner.text()?);
        }
        Some(map)
    }
}
