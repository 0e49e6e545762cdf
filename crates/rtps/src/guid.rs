//! Identifiers of participants, endpoints and samples (§8.2.4, §9.3.1).

use std::fmt;

/// Bytes of a [`GuidPrefix`].
pub const PREFIX_BYTES: usize = 12;
/// Bytes of a [`Guid`].
pub const GUID_BYTES: usize = 16;

/// Identifies a participant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct GuidPrefix(pub [u8; PREFIX_BYTES]);

impl fmt::Display for GuidPrefix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl GuidPrefix {
    /// No participant, or every participant as a destination.
    pub const UNKNOWN: Self = Self([0; PREFIX_BYTES]);
}

/// Identifies an endpoint within its participant: a key of three bytes, and a kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct EntityId(pub [u8; 4]);

impl EntityId {
    /// No endpoint, or every matched endpoint as a destination.
    pub const UNKNOWN: Self = Self([0; 4]);
    /// The participant itself.
    pub const PARTICIPANT: Self = Self([0, 0, 1, 0xc1]);
    /// Announces participants (SPDP).
    pub const SPDP_WRITER: Self = Self([0, 1, 0, 0xc2]);
    /// Receives announcements of participants (SPDP).
    pub const SPDP_READER: Self = Self([0, 1, 0, 0xc7]);
    /// Announces writers (SEDP).
    pub const PUBLICATIONS_WRITER: Self = Self([0, 0, 3, 0xc2]);
    /// Receives announcements of writers (SEDP).
    pub const PUBLICATIONS_READER: Self = Self([0, 0, 3, 0xc7]);
    /// Announces readers (SEDP).
    pub const SUBSCRIPTIONS_WRITER: Self = Self([0, 0, 4, 0xc2]);
    /// Receives announcements of readers (SEDP).
    pub const SUBSCRIPTIONS_READER: Self = Self([0, 0, 4, 0xc7]);
    /// Asserts the liveliness of writers (§8.4.13).
    pub const LIVELINESS_WRITER: Self = Self([0, 2, 0, 0xc2]);
    /// Receives the liveliness of writers (§8.4.13).
    pub const LIVELINESS_READER: Self = Self([0, 2, 0, 0xc7]);

    /// A writer of an application with this key, of 24 bits. `keyed`: its topic has keys.
    pub fn writer(key: u32, keyed: bool) -> Self {
        Self::of(key, if keyed { 0x02 } else { 0x03 })
    }

    /// A reader of an application with this key, of 24 bits. `keyed`: its topic has keys.
    pub fn reader(key: u32, keyed: bool) -> Self {
        Self::of(key, if keyed { 0x07 } else { 0x04 })
    }

    fn of(key: u32, kind: u8) -> Self {
        let [_, a, b, c] = key.to_be_bytes();
        Self([a, b, c, kind])
    }

    /// The last byte: what it is (§9.3.1.2).
    pub fn kind(self) -> u8 {
        let [.., kind] = self.0;
        kind
    }

    /// Is it a writer, of an application or built in?
    pub fn is_writer(self) -> bool {
        matches!(self.kind() & 0x3f, 0x02 | 0x03)
    }

    /// Is it a reader, of an application or built in?
    pub fn is_reader(self) -> bool {
        matches!(self.kind() & 0x3f, 0x04 | 0x07)
    }

    /// Are instances of its topic told apart by a key?
    pub fn is_keyed(self) -> bool {
        matches!(self.kind() & 0x3f, 0x02 | 0x07)
    }

    /// Is it one of the endpoints of discovery and liveliness?
    pub fn is_builtin(self) -> bool {
        self.kind() & 0xc0 == 0xc0
    }
}

/// Identifies an endpoint or a participant in the world.
#[derive(Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Guid {
    /// The participant.
    pub prefix: GuidPrefix,
    /// The endpoint in it.
    pub entity: EntityId,
}

impl Guid {
    /// Of an endpoint of a participant.
    pub fn new(prefix: GuidPrefix, entity: EntityId) -> Self {
        Self { prefix, entity }
    }

    /// As it is on the wire.
    pub fn to_bytes(self) -> [u8; GUID_BYTES] {
        let mut bytes = [0; GUID_BYTES];
        let (prefix, entity) = bytes.split_at_mut(PREFIX_BYTES);
        prefix.copy_from_slice(&self.prefix.0);
        entity.copy_from_slice(&self.entity.0);
        bytes
    }

    /// From the wire.
    pub fn from_bytes(bytes: [u8; GUID_BYTES]) -> Self {
        let [a, b, c, d, e, f, g, h, i, j, k, l, entity @ ..] = bytes;
        Self { prefix: GuidPrefix([a, b, c, d, e, f, g, h, i, j, k, l]), entity: EntityId(entity) }
    }
}

impl fmt::Display for Guid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.to_bytes().iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for Guid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// Identifies an implementation of DDS (§9.3.2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct VendorId(pub [u8; 2]);

impl VendorId {
    /// Not assigned: an implementation without a number of its own.
    pub const UNKNOWN: Self = Self([0, 0]);
    /// This implementation. The number is not assigned, and no implementation is known to use it: peers treat it as a foreign vendor.
    /// CycloneDDS 11.0 and Fast DDS 2.14 accept it.
    pub const OWN: Self = Self([1, 0x21]);
    /// Fast DDS.
    pub const FAST_DDS: Self = Self([1, 0x0f]);
    /// CycloneDDS.
    pub const CYCLONE: Self = Self([1, 0x10]);
    /// RustDDS.
    pub const RUST_DDS: Self = Self([1, 0x12]);
}

/// The number of a sample of a writer. The first is 1; 0 is before the first; negative ones are invalid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SequenceNumber(pub i64);

impl SequenceNumber {
    /// Before the first sample.
    pub const ZERO: Self = Self(0);
    /// `SEQUENCENUMBER_UNKNOWN`: high part -1, low part 0.
    pub const UNKNOWN: Self = Self(-1 << 32);

    /// The next one; the last one is followed by itself.
    #[must_use]
    pub fn next(self) -> Self {
        Self(self.0.saturating_add(1))
    }

    /// The one before; none is before the smallest.
    #[must_use]
    pub fn previous(self) -> Self {
        Self(self.0.saturating_sub(1))
    }
}

/// Names a sample of a writer: a reply names its request so (DDS-RPC 7.8).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SampleIdentity {
    /// The writer; a request of Fast DDS names the reader of its replies here.
    pub writer: Guid,
    /// The number of the sample.
    pub sequence: SequenceNumber,
}
