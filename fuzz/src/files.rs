//! The files of an MSP directory in one row of bytes.

use std::fs;
use tempfile::TempDir;

/// The places of the kinds.
const PLACES: [&str; 6] = ["cacerts", "intermediatecerts", "tlscacerts", "crls", "admincerts", ""];
/// Kinds of what is in PEM.
const LABELS: [&str; 6] = ["CERTIFICATE", "CERTIFICATE", "CERTIFICATE", "X509 CRL", "CERTIFICATE", "X509 CRL"];
/// Most files that are looked at.
const FILES_MAX: usize = 12;
/// The bit that asks for PEM.
const AS_PEM: u8 = 0x80;

/// One file: its kind, and its content.
pub struct File<'a>(pub u8, pub &'a [u8]);

impl<'a> File<'a> {
    /// The files in these bytes.
    pub fn all(mut bytes: &'a [u8]) -> Vec<Self> {
        std::iter::from_fn(|| Self::next(&mut bytes)).take(FILES_MAX).collect()
    }

    fn next(bytes: &mut &'a [u8]) -> Option<Self> {
        let kind = *bytes.split_off_first()?;
        let length = u16::from_be_bytes(*bytes.split_off(..2)?.as_array()?);
        let length = usize::from(length).min(bytes.len());
        Some(Self(kind, bytes.split_off(..length)?))
    }

    /// The bytes in which it is found again.
    pub fn to_bytes(&self) -> Vec<u8> {
        let length = u16::try_from(self.1.len()).unwrap_or(u16::MAX);
        [&[self.0], &length.to_be_bytes()[..], &self.1[..usize::from(length)]].concat()
    }

    fn content(&self, kind: usize) -> Vec<u8> {
        match self.0 & AS_PEM {
            0 => self.1.to_vec(),
            _ => pem::encode(&pem::Pem::new(LABELS[kind], self.1)).into_bytes(),
        }
    }
}

/// A directory with these files.
///
/// # Panics
/// If the disk does not take them.
pub fn write(files: &[File<'_>]) -> TempDir {
    let directory = tempfile::tempdir().expect("a directory for the files");
    for (number, file) in files.iter().enumerate() {
        let kind = usize::from(file.0 & !AS_PEM) % PLACES.len();
        let place = directory.path().join(PLACES[kind]);
        let name = if PLACES[kind].is_empty() { "config.yaml".to_owned() } else { format!("{number}.pem") };
        fs::create_dir_all(&place).expect("a directory");
        fs::write(place.join(name), file.content(kind)).expect("a file");
    }
    directory
}
