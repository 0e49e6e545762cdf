//! The secret half of the key with which an identity reads confidential services. It is made on this machine when it is first
//! needed, serves all services, and stays when the certificate is renewed: what it opens it goes on opening.

use super::Context;
use super::files::{self, bad_file};
use super::home;
use super::lock::Lock;
use ledger_base::rejection::{Code, Rejection};
use ring::rand::{SecureRandom, SystemRandom};
use std::path::Path;

/// Its length, in bytes.
const SECRET_BYTES: usize = 32;

impl Context {
    /// The secret half of the reading key of a stored context, in bytes. It opens all that this identity may read.
    ///
    /// # Errors
    /// [`Code::BadFile`] if the context is not stored, or the file cannot be read or written.
    pub fn reading_secret(&self) -> Result<Vec<u8>, Rejection> {
        let directory = self.memory.directory().ok_or_else(|| {
            Rejection::new(Code::BadFile, format!("context {:?} cannot store a reading key", self.name))
                .found("a context that is not stored")
                .wanted("a stored context")
                .next("enrol, and use the context that this stores")
        })?;
        if let Some(secret) = stored(directory)? {
            return Ok(secret);
        }
        // Another program may make one, or write the directory anew.
        let _alone = match self.home() {
            Some(home) => Some(Lock::exclusive(&home)?),
            None => None,
        };
        if let Some(secret) = stored(directory)? {
            return Ok(secret);
        }
        let mut secret = vec![0; SECRET_BYTES];
        SystemRandom::new()
            .fill(&mut secret)
            .map_err(|_| Rejection::new(Code::Internal, "the operating system provides no randomness"))?;
        files::replace_file_in(directory, files::READING, &hex::encode(&secret))?;
        Ok(secret)
    }
}

/// The reading key in the directory of a context, as the file has it, to be kept when the directory is written anew.
pub(super) fn kept(home: &Path, name: &str) -> Result<Option<(&'static str, String)>, Rejection> {
    let directory = home.join(home::CONTEXTS).join(name);
    Ok(stored(&directory)?.map(|secret| (files::READING, hex::encode(secret))))
}

fn stored(directory: &Path) -> Result<Option<Vec<u8>>, Rejection> {
    let path = directory.join(files::READING);
    if !path.exists() {
        return Ok(None);
    }
    let text = files::read_secret(&path)?;
    match hex::decode(text.trim()) {
        Ok(secret) if secret.len() == SECRET_BYTES => Ok(Some(secret)),
        // Its content is a secret: only its length is told.
        _ => Err(bad_file(&path, format!("{} characters", text.trim().len()))
            .wanted(format!("{} hexadecimal digits", 2 * SECRET_BYTES))
            .next("restore the file; without it a new key is created, which cannot decrypt earlier messages")),
    }
}
