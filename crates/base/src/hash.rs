//! SHA-256 values: one type for hashes of blocks, ids of transactions, digests and fingerprints.
//!
//! ```
//! use ledger_base::hash::Hash;
//!
//! let hash = Hash::of(&[b"ab", b"c"]);
//! assert_eq!(hash, Hash::of(&[b"abc"]));
//! assert_eq!(Hash::from_hex(&hash.to_string()), Some(hash));
//! ```

use ring::digest::{Context as Sha256, SHA256};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;

/// A SHA-256 value; prints and serialises as 64 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Default)]
pub struct Hash(pub [u8; 32]);

impl Hash {
    /// Thirty-two zero bytes, where there is nothing to point to.
    pub const ZERO: Self = Self([0; 32]);

    /// SHA-256 over the concatenation of the parts. The caller makes them unambiguous.
    pub fn of(parts: &[&[u8]]) -> Self {
        let mut sha = Sha256::new(&SHA256);
        for part in parts {
            sha.update(part);
        }
        Self::finish(sha)
    }

    /// The value of a digest that was fed piece by piece. It must be SHA-256.
    pub fn finish(sha: Sha256) -> Self {
        let mut value = [0; 32];
        for (to, from) in value.iter_mut().zip(sha.finish().as_ref()) {
            *to = *from;
        }
        Self(value)
    }

    /// Reads exactly 32 bytes.
    pub fn from_slice(bytes: &[u8]) -> Option<Self> {
        bytes.try_into().ok().map(Self)
    }

    /// Reads 64 hexadecimal digits; colons and a `sha256:` prefix are tolerated, as tools print them so.
    pub fn from_hex(text: &str) -> Option<Self> {
        let text = text.trim().trim_start_matches("sha256:").replace(':', "");
        Self::from_slice(&hex::decode(text).ok()?)
    }
}

impl fmt::Display for Hash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&hex::encode(self.0))
    }
}

impl fmt::Debug for Hash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl AsRef<[u8]> for Hash {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

impl Serialize for Hash {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Hash {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        Self::from_hex(&text).ok_or_else(|| serde::de::Error::custom(format!("found {text:?}, wanted 64 hex digits")))
    }
}
