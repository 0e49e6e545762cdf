//! The content of a snapshot: nodes sign its hash.

use crate::state::Tip;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};

/// Most bytes of a chunk; only the last one has fewer.
pub const CHUNK_BYTES_MAX: usize = 1024 * 1024;
/// Most chunks of a snapshot: 32 GiB.
pub const CHUNKS_MAX: usize = 32 * 1024;

const DOMAIN: &[u8; 20] = b"ledgerd snapshot v1\0";
const FIXED_BYTES: usize = DOMAIN.len() + 3 * 32 + 3 * 8 + 4;
const CHUNK_ITEM_BYTES: usize = 36;
/// Most bytes of a manifest: less than gRPC takes in one message.
pub const MANIFEST_BYTES_MAX: usize = FIXED_BYTES + CHUNKS_MAX * CHUNK_ITEM_BYTES;
const _: () = assert!(MANIFEST_BYTES_MAX < 4 * 1024 * 1024);

/// One chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chunk {
    /// SHA-256 of its bytes.
    pub hash: Hash,
    /// How many bytes; at least one.
    pub bytes: u32,
}

/// The content of a snapshot. There is one encoding: `"ledgerd snapshot v1␀"`, network (32), height, term, block time
/// (`u64` each), block hash (32), state digest (32), number of chunks `u32`. For each chunk follow its SHA-256 and its
/// length `u32`; BE.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Manifest {
    /// Name of the network.
    pub network: Hash,
    /// The block after which this is the state, and the state digest then.
    pub tip: Tip,
    /// Its height, as in `tip`.
    pub height: u64,
    /// In order; all but the last are of [`CHUNK_BYTES_MAX`].
    pub chunks: Vec<Chunk>,
}

impl Manifest {
    /// Names the content of the snapshot: SHA-256 of [`to_bytes`](Self::to_bytes).
    pub fn content(&self) -> Hash {
        Hash::of(&[&self.to_bytes()])
    }

    /// The bytes to hash, to store and to send.
    pub fn to_bytes(&self) -> Bytes {
        let mut bytes = Vec::with_capacity(FIXED_BYTES + self.chunks.len() * CHUNK_ITEM_BYTES);
        bytes.extend(DOMAIN);
        bytes.extend(self.network.0);
        for number in [self.tip.height, self.tip.term, self.tip.time] {
            bytes.extend(number.to_be_bytes());
        }
        bytes.extend(self.tip.hash.0);
        bytes.extend(self.tip.digest.0);
        bytes.extend(u32::try_from(self.chunks.len()).unwrap_or(u32::MAX).to_be_bytes());
        for chunk in &self.chunks {
            bytes.extend(chunk.hash.0);
            bytes.extend(chunk.bytes.to_be_bytes());
        }
        bytes.into()
    }

    /// Reads a manifest, which may come from anybody.
    ///
    /// # Errors
    /// [`Code::TooLarge`] beyond [`MANIFEST_BYTES_MAX`], [`Code::Malformed`] if the bytes are none.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        if bytes.len() > MANIFEST_BYTES_MAX {
            return Err(Rejection::new(Code::TooLarge, "the manifest of a snapshot is too large")
                .found(format!("{} bytes", bytes.len()))
                .wanted(format!("at most {MANIFEST_BYTES_MAX} bytes")));
        }
        let malformed =
            |what: &str| Rejection::new(Code::Malformed, format!("the manifest of a snapshot cannot be read: {what}"));
        let mut rest = bytes.strip_prefix(DOMAIN).ok_or_else(|| malformed("it does not start like a manifest"))?;
        let mut fixed = || {
            let network = Hash(take(&mut rest)?);
            let [height, term, time] = [take(&mut rest)?, take(&mut rest)?, take(&mut rest)?].map(u64::from_be_bytes);
            let (hash, digest) = (Hash(take(&mut rest)?), Hash(take(&mut rest)?));
            Some((network, Tip { height, term, time, hash, digest }, u32::from_be_bytes(take(&mut rest)?)))
        };
        let (network, tip, count) = fixed().ok_or_else(|| malformed("it is truncated"))?;
        if rest.len() != count as usize * CHUNK_ITEM_BYTES {
            return Err(malformed("its length does not match its number of chunks"));
        }
        let mut chunks = Vec::with_capacity(count as usize);
        while let (Some(hash), Some(length)) = (take(&mut rest), take(&mut rest)) {
            chunks.push(Chunk { hash: Hash(hash), bytes: u32::from_be_bytes(length) });
        }
        let (last, whole) = chunks.split_last().ok_or_else(|| malformed("it has no chunks"))?;
        let full = CHUNK_BYTES_MAX as u32;
        if last.bytes == 0 || last.bytes > full || whole.iter().any(|chunk| chunk.bytes != full) {
            return Err(malformed("chunks are empty, or not cut every MiB"));
        }
        Ok(Self { network, height: tip.height, tip, chunks })
    }

    /// Bytes of all chunks.
    pub fn bytes(&self) -> u64 {
        self.chunks.iter().map(|chunk| u64::from(chunk.bytes)).sum()
    }
}

fn take<const N: usize>(rest: &mut &[u8]) -> Option<[u8; N]> {
    let (taken, after) = rest.split_first_chunk()?;
    *rest = after;
    Some(*taken)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn manifest(chunks: u32) -> Manifest {
        let tip = Tip { height: 7, term: 3, time: 99, hash: Hash::of(&[b"hash"]), digest: Hash::of(&[b"digest"]) };
        let chunk = |number: u32| Chunk {
            hash: Hash::of(&[&number.to_be_bytes()]),
            bytes: if number + 1 == chunks { 5 } else { CHUNK_BYTES_MAX as u32 },
        };
        Manifest { network: Hash::of(&[b"network"]), height: 7, tip, chunks: (0..chunks).map(chunk).collect() }
    }

    #[test]
    fn a_manifest_is_read_as_it_was_written_and_at_no_cut() {
        let bytes = manifest(3).to_bytes();
        assert_eq!(Manifest::from_bytes(&bytes).unwrap(), manifest(3));
        for cut in 0..bytes.len() {
            assert_eq!(Manifest::from_bytes(bytes.get(..cut).unwrap()).unwrap_err().code, Code::Malformed, "cut {cut}");
        }
        let longer = [&bytes[..], b"x"].concat();
        assert_eq!(Manifest::from_bytes(&longer).unwrap_err().code, Code::Malformed);
    }

    #[test]
    fn every_bit_of_a_manifest_counts() {
        let bytes = manifest(2).to_bytes();
        let content = manifest(2).content();
        for bit in 0..bytes.len() * 8 {
            let mut flipped = bytes.to_vec();
            *flipped.get_mut(bit / 8).unwrap() ^= 1 << (bit % 8);
            if let Ok(read) = Manifest::from_bytes(&flipped) {
                assert_ne!(read.content(), content, "bit {bit}");
            }
        }
    }

    #[test]
    fn hostile_manifests_are_refused_before_anything_is_allocated() {
        assert!(Manifest::from_bytes(&manifest(0).to_bytes()).is_err());
        let mut many = manifest(1).to_bytes().to_vec();
        many.get_mut(FIXED_BYTES - 4..FIXED_BYTES).unwrap().fill(0xff);
        assert_eq!(Manifest::from_bytes(&many).unwrap_err().code, Code::Malformed);
        let mut odd = manifest(2);
        odd.chunks.first_mut().unwrap().bytes -= 1;
        assert_eq!(Manifest::from_bytes(&odd.to_bytes()).unwrap_err().code, Code::Malformed);
        assert_eq!(Manifest::from_bytes(&vec![0; MANIFEST_BYTES_MAX + 1]).unwrap_err().code, Code::TooLarge);
    }
}
