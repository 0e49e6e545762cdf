//! Numbers that reader and writer of datagrams share (§9.4).

/// The first bytes of a datagram.
pub(crate) const MAGIC: [u8; 4] = *b"RTPS";
/// The version of the protocol that is written: major, minor.
pub(crate) const VERSION: [u8; 2] = [2, 5];
/// Bytes of the header of a submessage.
pub(crate) const SUBMESSAGE_HEADER_BYTES: usize = 4;

/// Kinds of submessages (§9.4.5.1.1).
pub(crate) mod kind {
    pub(crate) const PAD: u8 = 0x01;
    pub(crate) const ACKNACK: u8 = 0x06;
    pub(crate) const HEARTBEAT: u8 = 0x07;
    pub(crate) const GAP: u8 = 0x08;
    pub(crate) const INFO_TS: u8 = 0x09;
    pub(crate) const INFO_SRC: u8 = 0x0c;
    pub(crate) const INFO_DST: u8 = 0x0e;
    pub(crate) const NACK_FRAG: u8 = 0x12;
    pub(crate) const HEARTBEAT_FRAG: u8 = 0x13;
    pub(crate) const DATA: u8 = 0x15;
    pub(crate) const DATA_FRAG: u8 = 0x16;
}

/// Flags of submessages. Their meaning depends on the kind.
pub(crate) mod flag {
    /// All: the numbers are little endian.
    pub(crate) const LITTLE_ENDIAN: u8 = 0x01;
    /// INFO_TS: there is no time.
    pub(crate) const NO_TIME: u8 = 0x02;
    /// ACKNACK and HEARTBEAT: no answer is needed.
    pub(crate) const FINAL: u8 = 0x02;
    /// HEARTBEAT: the writer asserts that it is alive.
    pub(crate) const ALIVE: u8 = 0x04;
    /// DATA and DATA_FRAG: a parameter list stands in front of the payload.
    pub(crate) const INLINE_QOS: u8 = 0x02;
    /// DATA: the payload is a sample.
    pub(crate) const DATA: u8 = 0x04;
    /// DATA: the payload is a key.
    pub(crate) const KEY: u8 = 0x08;
    /// DATA: the payload is not in a format of the standard.
    pub(crate) const OTHER_FORMAT: u8 = 0x10;
    /// DATA_FRAG: the payload is a key.
    pub(crate) const FRAGMENT_OF_KEY: u8 = 0x04;
    /// DATA_FRAG: the payload is not in a format of the standard.
    pub(crate) const FRAGMENT_OF_OTHER_FORMAT: u8 = 0x08;
}

/// `octetsToInlineQos` of DATA: from behind this field to the parameters, bytes.
pub(crate) const DATA_TO_INLINE_QOS: u16 = 16;
/// `octetsToInlineQos` of DATA_FRAG.
pub(crate) const DATA_FRAG_TO_INLINE_QOS: u16 = 28;
