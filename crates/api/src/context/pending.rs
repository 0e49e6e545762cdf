//! An enrolment that was begun: its key lies on the disk before the one-time secret is sent. A second try with the same
//! key then receives the same certificate, whatever happens afterwards.
//!
//! ```text
//! <home>/contexts/.<CONTEXT>.enrolling-<8 digits of the CA's fingerprint>/key.pem         PKCS#8, readable by its
//! owner only
//!                                                                         enrolment.toml  whose it is
//! ```

use super::{files, home};
use crate::context::files::bad_file;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::{KeyKind, SigningKey};
use ring::rand::SystemRandom;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// File of what is being enrolled.
const SETTINGS: &str = "enrolment.toml";

/// An enrolment that is under way; see the module.
pub struct PendingEnrolment {
    directory: PathBuf,
    key: SigningKey,
    resumed: bool,
}

/// The content of `enrolment.toml`.
#[derive(PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Settings {
    name: String,
    ca_fingerprint: Hash,
}

impl PendingEnrolment {
    /// Goes on with the enrolment of this registered name at this CA that was begun for this context, or begins one:
    /// the key is on the disk when this returns. Without a kind of key it is the one that was begun with, else Ed25519.
    ///
    /// # Errors
    /// [`Code::NoContext`] for a name that no context may have, [`Code::BadFile`] if nothing can be written here,
    /// [`Code::BadArgument`] if one was begun with a key of another kind.
    pub fn begin(
        home: &Path,
        context: &str,
        (name, ca_fingerprint): (&str, Hash),
        kind: Option<KeyKind>,
    ) -> Result<Self, Rejection> {
        home::check_name(context)?;
        let contexts = home.join(home::CONTEXTS);
        let at_ca: String = ca_fingerprint.to_string().chars().take(8).collect();
        let entry = format!(".{context}.enrolling-{at_ca}");
        files::finish_replacement(&contexts, &entry)?;
        let directory = contexts.join(&entry);
        let settings = Settings { name: name.to_owned(), ca_fingerprint };
        if let Some(key) = earlier(&directory, &settings)? {
            if kind.is_some_and(|kind| kind != key.kind()) {
                return Err(Rejection::new(Code::BadArgument, "this enrolment was started with another kind of key")
                    .found(format!("a key of kind {} in {}", key.kind(), directory.display()))
                    .wanted("the same kind, because the certificate may have been issued already")
                    .next("omit --key"));
            }
            return Ok(Self { directory, key, resumed: true });
        }
        let key = SigningKey::generate(kind.unwrap_or(KeyKind::Ed25519), &SystemRandom::new())
            .map_err(|error| Rejection::new(Code::Internal, error.to_string()))?;
        let text = toml::to_string(&settings)
            .map_err(|error| Rejection::new(Code::Internal, format!("{SETTINGS} cannot be encoded: {error}")))?;
        files::create_directories(&contexts)?;
        files::replace_directory(&contexts, &entry, &[(SETTINGS, text), (files::KEY, key.to_pkcs8_pem())])?;
        Ok(Self { directory, key, resumed: false })
    }

    /// The key.
    ///
    /// # Errors
    /// [`Code::Internal`], which no key that was read or made causes.
    pub fn key(&self) -> Result<SigningKey, Rejection> {
        SigningKey::from_pkcs8_der(self.key.to_pkcs8_der())
            .map_err(|error| Rejection::new(Code::Internal, error.to_string()))
    }

    /// Was it begun before, by a try that did not come to its end?
    pub fn resumed(&self) -> bool {
        self.resumed
    }

    /// The certificate is stored with its key: what was begun is over. That a leftover stays does no harm.
    pub fn finish(self) {
        let _leftover = files::remove_directory(&self.directory);
    }
}

/// The key of an earlier try for the same name and CA.
fn earlier(directory: &Path, wanted: &Settings) -> Result<Option<SigningKey>, Rejection> {
    if !directory.is_dir() {
        return Ok(None);
    }
    let path = directory.join(SETTINGS);
    let settings: Settings = toml::from_str(&files::read(&path)?)
        .map_err(|error| bad_file(&path, error.to_string().trim_end().replace('\n', " ")))?;
    if settings != *wanted {
        return Ok(None);
    }
    let path = directory.join(files::KEY);
    let key = SigningKey::from_pkcs8_pem(&files::read_secret(&path)?);
    key.map(Some).map_err(|error| bad_file(&path, error.to_string()))
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::Context;
    use std::fs::{self, Permissions};
    use std::os::unix::fs::PermissionsExt;
    use tempfile::TempDir;

    const CA: Hash = Hash([7; 32]);

    fn begin(home: &Path, kind: Option<KeyKind>) -> Result<PendingEnrolment, Rejection> {
        PendingEnrolment::begin(home, "Salma", ("Salma", CA), kind)
    }

    #[test]
    fn a_second_try_has_the_same_key_and_one_for_somebody_else_another() {
        let home = TempDir::new().unwrap();
        let first = begin(home.path(), None).unwrap();
        let public = first.key().unwrap().public_key();
        assert!(!first.resumed());
        drop(first);
        let second = begin(home.path(), None).unwrap();
        assert!(second.resumed() && second.key().unwrap().public_key() == public);
        assert_eq!(begin(home.path(), Some(KeyKind::P256)).err().unwrap().code, Code::BadArgument);
        let elsewhere = PendingEnrolment::begin(home.path(), "Salma", ("Salma", Hash([8; 32])), None).unwrap();
        assert!(!elsewhere.resumed() && elsewhere.key().unwrap().public_key() != public);
        assert!(Context::list(home.path()).unwrap().is_empty(), "it is no context yet");
        second.finish();
        assert!(!begin(home.path(), None).unwrap().resumed());
    }

    #[test]
    fn the_key_is_readable_by_its_owner_only_and_one_that_others_may_read_is_refused() {
        let home = TempDir::new().unwrap();
        let begun = begin(home.path(), Some(KeyKind::P256)).unwrap();
        let path = begun.directory.join(files::KEY);
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        fs::set_permissions(&path, Permissions::from_mode(0o644)).unwrap();
        assert_eq!(begin(home.path(), None).err().unwrap().code, Code::BadFile);
    }

    #[test]
    fn where_nothing_can_be_written_nothing_is_begun() {
        let place = TempDir::new().unwrap();
        let home = place.path().join("file");
        fs::write(&home, "no directory").unwrap();
        assert_eq!(begin(&home, None).err().unwrap().code, Code::BadFile);
        assert_eq!(
            PendingEnrolment::begin(place.path(), "Sal ma", ("Sal ma", CA), None).err().unwrap().code,
            Code::NoContext
        );
    }
}
