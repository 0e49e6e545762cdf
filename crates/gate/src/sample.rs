//! One message as raw CDR.

use bytes::{BufMut, Bytes, BytesMut};

use ledger_base::rejection::{Code, Rejection};

/// Bytes of the encapsulation header in front of every message.
pub const HEADER_BYTES: usize = 4;
/// Largest sample in bytes, header included; a route usually allows less.
pub const SAMPLE_BYTES_MAX: usize = 16 * 1024 * 1024;

/// Representation identifier of plain CDR, big endian.
pub const CDR_BE: [u8; 2] = [0, 0];
/// Representation identifier of plain CDR, little endian: what ROS 2 sends on nearly all machines.
pub const CDR_LE: [u8; 2] = [0, 1];
/// Representation identifier of parameter-list CDR, big endian.
pub const PL_CDR_BE: [u8; 2] = [0, 2];
/// Representation identifier of parameter-list CDR, little endian.
pub const PL_CDR_LE: [u8; 2] = [0, 3];
/// Representation identifiers of XCDR2 (DDS-XTypes 1.3, table 60): of final, appendable and mutable types, each in both byte orders.
pub const XCDR2: [[u8; 2]; 6] = [[0, 6], [0, 7], [0, 8], [0, 9], [0, 0xa], [0, 0xb]];

/// A message exactly as DDS carries it: header and body, never decoded.
///
/// ```text
/// 0      2      4
/// +------+------+----------
/// | id   | opts | body ...
/// +------+------+----------
/// ```
/// `id` names the encoding, and with it the byte order. `opts` is how many bytes of padding are at the end, if the middleware
/// says that. `body` is the CDR of the message. These bytes are the payload on the ledger
/// and in shared memory, so the robot's side publishes what the user's node sent. Cloning is cheap.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sample(Bytes);

impl Sample {
    /// A sample of an encoding and a body; refuses bodies that would exceed [`SAMPLE_BYTES_MAX`].
    ///
    /// # Errors
    /// [`Code::BadArgument`].
    pub fn new(representation_id: [u8; 2], body: &[u8]) -> Result<Self, Rejection> {
        Self::with_options(representation_id, [0, 0], body)
    }

    /// The same with the two bytes of options behind the identifier.
    ///
    /// # Errors
    /// As [`Sample::new`].
    pub fn with_options(representation_id: [u8; 2], options: [u8; 2], body: &[u8]) -> Result<Self, Rejection> {
        let len = body.len().saturating_add(HEADER_BYTES);
        check_len(len, SAMPLE_BYTES_MAX)?;
        let mut wire = BytesMut::with_capacity(len);
        wire.put_slice(&representation_id);
        wire.put_slice(&options);
        wire.put_slice(body);
        Ok(Self(wire.freeze()))
    }

    /// Takes the serialized form, header included. Refuses what is shorter than the header, longer
    /// than `bytes_max`, or of an encoding that no ROS 2 middleware uses for messages.
    ///
    /// # Errors
    /// [`Code::BadArgument`].
    pub fn from_wire(wire: Bytes, bytes_max: usize) -> Result<Self, Rejection> {
        check_len(wire.len(), bytes_max.min(SAMPLE_BYTES_MAX))?;
        let sample = Self(wire);
        match sample.representation_id() {
            CDR_BE | CDR_LE | PL_CDR_BE | PL_CDR_LE => Ok(sample),
            id if XCDR2.contains(&id) => Ok(sample),
            [first, second] => {
                let found = format!("encoding {first:02x} {second:02x}");
                let wanted = "00 00 to 00 03 (CDR, as ROS 2 writes it), or 00 06 to 00 0b (XCDR2)";
                let hint = "send the message with its 4-byte encapsulation header, 00 01 00 00 for little endian";
                Err(refused("sample has an unknown encoding", found).wanted(wanted).next(hint))
            }
        }
    }

    /// The same from borrowed bytes, which are copied once their length is allowed.
    ///
    /// # Errors
    /// [`Code::BadArgument`].
    pub fn copy_from_wire(wire: &[u8], bytes_max: usize) -> Result<Self, Rejection> {
        check_len(wire.len(), bytes_max.min(SAMPLE_BYTES_MAX))?;
        Self::from_wire(Bytes::copy_from_slice(wire), bytes_max)
    }

    /// The serialized form, header included.
    pub fn wire(&self) -> &Bytes {
        &self.0
    }

    /// The first two bytes: which encoding, which byte order.
    pub fn representation_id(&self) -> [u8; 2] {
        match self.0.first_chunk::<2>() {
            Some(id) => *id,
            None => CDR_LE, // unreachable: every constructor checks the length
        }
    }

    /// The bytes of options behind the identifier.
    pub fn options(&self) -> [u8; 2] {
        self.0.get(2..HEADER_BYTES).and_then(|options| options.first_chunk().copied()).unwrap_or_default()
    }

    /// The CDR of the message without its header.
    pub fn body(&self) -> Bytes {
        self.0.slice(HEADER_BYTES.min(self.0.len())..)
    }

    /// The same message with other bytes at a place of its body; none if the body ends before.
    pub(crate) fn with(&self, at: usize, bytes: &[u8]) -> Option<Self> {
        let start = HEADER_BYTES.checked_add(at)?;
        let mut wire = BytesMut::from(&self.0[..]);
        wire.get_mut(start..start.checked_add(bytes.len())?)?.copy_from_slice(bytes);
        Some(Self(wire.freeze()))
    }
}

fn check_len(len: usize, bytes_max: usize) -> Result<(), Rejection> {
    if len < HEADER_BYTES {
        let found = format!("{len} bytes");
        let wanted = format!("at least the {HEADER_BYTES} bytes of the encapsulation header");
        let hint = "send the message as DDS carries it, header included";
        return Err(refused("sample is too short", found).wanted(wanted).next(hint));
    }
    if len > bytes_max {
        let found = format!("{len} bytes");
        let wanted = format!("at most {bytes_max} bytes");
        let hint = "raise the limit in the configuration, or send less (compressed, at a lower resolution)";
        return Err(refused("sample is too large", found).wanted(wanted).next(hint));
    }
    Ok(())
}

fn refused(what: &str, found: String) -> Rejection {
    Rejection::new(Code::BadArgument, what).found(found)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn header_and_body_come_back_byte_for_byte() {
        let sample = Sample::new(CDR_LE, &[1, 2, 3, 4, 5]).unwrap();
        assert_eq!(sample.wire().as_ref(), [0, 1, 0, 0, 1, 2, 3, 4, 5]);
        let again = Sample::from_wire(sample.wire().clone(), 9).unwrap();
        assert_eq!(again, sample);
        assert_eq!(again.body().as_ref(), [1, 2, 3, 4, 5]);
        assert_eq!(again.representation_id(), CDR_LE);
    }

    #[test]
    fn other_bytes_take_their_place_in_the_body_and_reach_no_further() {
        let sample = Sample::new(CDR_LE, &[1, 2, 3]).unwrap();
        assert_eq!(sample.with(1, &[8, 9]), Some(Sample::new(CDR_LE, &[1, 8, 9]).unwrap()));
        assert_eq!((sample.with(2, &[8, 9]), sample.with(usize::MAX, &[8])), (None, None));
    }

    #[test]
    fn an_empty_message_is_a_header_only() {
        let empty = Sample::from_wire(Bytes::from_static(&[0, 0, 0, 0]), 100).unwrap();
        assert!(empty.body().is_empty());
        assert_eq!(empty.representation_id(), CDR_BE);
    }

    #[test]
    fn reserved_options_survive() {
        let wire = Bytes::from_static(&[0, 1, 0, 3, 9, 0, 0, 0]);
        let sample = Sample::from_wire(wire.clone(), 100).unwrap();
        assert_eq!((sample.wire(), sample.options()), (&wire, [0, 3]));
        assert_eq!(Sample::with_options(CDR_LE, [0, 3], &[9, 0, 0, 0]).unwrap(), sample);
    }

    #[test]
    fn every_encoding_of_xcdr2_passes_as_it_is() {
        for id in XCDR2 {
            let wire = Bytes::copy_from_slice(&[id[0], id[1], 0, 2, 7, 7, 0, 0]);
            assert_eq!(Sample::from_wire(wire.clone(), 100).unwrap().wire(), &wire);
        }
    }

    #[test]
    fn less_than_a_header_is_refused() {
        for len in 0..HEADER_BYTES {
            let error = Sample::from_wire(Bytes::from(vec![0; len]), 100).unwrap_err();
            assert!(error.to_string().contains("too short"), "{error}");
        }
    }

    #[test]
    fn more_than_the_limit_is_refused_and_the_limit_named() {
        let wire = Bytes::from(vec![0; 101]);
        let error = Sample::from_wire(wire, 100).unwrap_err().to_string();
        assert!(error.contains("101 bytes") && error.contains("at most 100"), "{error}");
        assert!(Sample::copy_from_wire(&[0; 101], 100).is_err());
        assert!(Sample::new(CDR_LE, &vec![0; SAMPLE_BYTES_MAX]).is_err());
        assert!(Sample::from_wire(Bytes::from(vec![0; SAMPLE_BYTES_MAX + 1]), usize::MAX).is_err());
    }

    #[test]
    fn unknown_encodings_are_refused() {
        for id in [[0, 4], [0, 5], [0, 0xc], [0, 0x11], [1, 0], [0xff, 0xff]] {
            let wire = Bytes::copy_from_slice(&[id[0], id[1], 0, 0, 1]);
            let error = Sample::from_wire(wire, 100).unwrap_err().to_string();
            assert!(error.contains("unknown encoding"), "{error}");
        }
    }
}
