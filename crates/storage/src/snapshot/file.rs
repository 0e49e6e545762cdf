//! The file of a snapshot.

use super::manifest::{CHUNK_BYTES_MAX, MANIFEST_BYTES_MAX, Manifest};
use super::{damaged, failed};
use crate::disk::{DiskFile, open_to_read};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use std::path::Path;
use std::sync::Arc;

const MAGIC: &[u8; 8] = b"LEDGRSNP";
const END_MAGIC: &[u8; 8] = b"LEDGREND";
const VERSION: u32 = 1;
/// Bytes before the first chunk.
pub(super) const HEAD_BYTES: u64 = 16;
/// Bytes after the manifest.
const END_BYTES: usize = 16;

/// Name of the file of a height.
pub(super) fn name(height: u64) -> String {
    format!("{height:020}.snap")
}

/// The height in a name.
pub(super) fn height(found: &str) -> Option<u64> {
    let height = found.strip_suffix(".snap")?.parse().ok()?;
    (name(height) == found).then_some(height)
}

/// The first bytes of a file.
pub(super) fn head() -> Vec<u8> {
    [&MAGIC[..], &VERSION.to_be_bytes(), &[0; 4]].concat()
}

/// The bytes after the last chunk.
pub(super) fn end(manifest: &Manifest) -> Vec<u8> {
    let mut bytes = manifest.to_bytes().to_vec();
    let (length, crc) = (u32::try_from(bytes.len()).unwrap_or(u32::MAX), crc32c::crc32c(&bytes));
    bytes.extend(length.to_be_bytes());
    bytes.extend(crc.to_be_bytes());
    bytes.extend(END_MAGIC);
    bytes
}

/// A complete snapshot in a file. Every chunk is compared with the manifest when it is read.
pub struct Snapshot {
    file: Arc<dyn DiskFile>,
    name: String,
    manifest: Manifest,
    content: Hash,
}

impl Snapshot {
    /// Opens a file, wherever it is.
    ///
    /// # Errors
    /// [`Code::BadFile`] if it cannot be opened, [`Code::Corrupt`] if it is no whole snapshot.
    pub fn open(path: &Path) -> Result<Self, Rejection> {
        let file = open_to_read(path)
            .map_err(|error| Rejection::new(Code::BadFile, format!("cannot open {}: {error}", path.display())))?;
        Self::read(file, &path.display().to_string())
    }

    /// Reads the manifest of a file.
    pub(super) fn read(file: Arc<dyn DiskFile>, name: &str) -> Result<Self, Rejection> {
        let wrong = |what: &str| damaged(name, what);
        let length = file.len().map_err(|error| failed("read", name, &error))?;
        let read = |offset: u64, bytes: usize| {
            let mut buffer = vec![0; bytes];
            match file.read_at(&mut buffer, offset) {
                Ok(read) if read == bytes => Ok(buffer),
                Ok(_) => Err(wrong("it is too short")),
                Err(error) => Err(failed("read", name, &error)),
            }
        };
        if read(0, HEAD_BYTES as usize)? != head() {
            return Err(wrong("it does not start like a snapshot of this version"));
        }
        let end_at = length.checked_sub(END_BYTES as u64).ok_or_else(|| wrong("it is too short"))?;
        let end_bytes = read(end_at, END_BYTES)?;
        let bytes = end_bytes.first_chunk().map_or(0, |length| u32::from_be_bytes(*length));
        let manifest_at = end_at.checked_sub(u64::from(bytes)).filter(|_| bytes as usize <= MANIFEST_BYTES_MAX);
        let stored = read(manifest_at.ok_or_else(|| wrong("it does not end like a snapshot"))?, bytes as usize)?;
        let manifest = Manifest::from_bytes(&stored).map_err(|fault| wrong(&fault.message))?;
        if end(&manifest) != [stored.as_slice(), &end_bytes].concat() {
            return Err(wrong("its manifest is damaged"));
        }
        if manifest_at != Some(HEAD_BYTES + manifest.bytes()) {
            return Err(wrong("its length does not match its manifest"));
        }
        let content = manifest.content();
        Ok(Self { file, name: name.to_owned(), manifest, content })
    }

    /// Name of its file, for messages.
    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// Its manifest.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Names its content: what nodes sign.
    pub fn content(&self) -> Hash {
        self.content
    }

    /// The chunk of a number, from 0.
    ///
    /// # Errors
    /// [`Code::NotFound`] if there is none, [`Code::Corrupt`] if it is not what the manifest says.
    pub fn chunk(&self, number: usize) -> Result<Bytes, Rejection> {
        read_chunk(&*self.file, &self.name, &self.manifest, number)?
            .ok_or_else(|| damaged(&self.name, &format!("chunk {number} does not match the manifest")))
    }
}

/// A chunk of a file that may not be complete; none if it is not there as the manifest says.
pub(super) fn read_chunk(
    file: &dyn DiskFile,
    name: &str,
    manifest: &Manifest,
    number: usize,
) -> Result<Option<Bytes>, Rejection> {
    let chunk = manifest.chunks.get(number).ok_or_else(|| {
        Rejection::new(Code::NotFound, format!("the snapshot has no chunk {number}"))
            .wanted(format!("a number below {}", manifest.chunks.len()))
    })?;
    let mut bytes = vec![0; chunk.bytes as usize];
    let read = file.read_at(&mut bytes, offset(number)).map_err(|error| failed("read", name, &error))?;
    Ok((read == bytes.len() && Hash::of(&[&bytes]) == chunk.hash).then(|| bytes.into()))
}

/// Where a chunk begins.
pub(super) fn offset(number: usize) -> u64 {
    HEAD_BYTES + number as u64 * CHUNK_BYTES_MAX as u64
}
