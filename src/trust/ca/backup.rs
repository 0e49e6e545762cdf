//! A copy of a CA for the safe: its key under a passphrase, and its root, in one PEM file.
//!
//! The key is PKCS #8 encrypted as PKCS #5 says (PBES2: scrypt, AES-256-CBC), which `openssl pkey -in FILE` reads too.
//! The registry is on the ledger, and key and root never change: a copy that was made once stays good.

use super::place::ROOT_BYTES_MAX;
use super::{CertificateAuthority, pem as certificates};
use ledger_base::durable::SECRET_MODE;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::Certificate;
use ledger_identity::key::{KEY_BYTES_MAX, SigningKey};
use pkcs8::pkcs5::EncryptionScheme;
use pkcs8::pkcs5::pbes2::{Kdf, ScryptParams};
use pkcs8::{EncryptedPrivateKeyInfoRef, PrivateKeyInfoRef};
use std::path::Path;

/// Shortest passphrase, in characters.
pub(crate) const PASSPHRASE_CHARS_MIN: usize = 12;
/// Largest backup that is read, in bytes.
const BACKUP_BYTES_MAX: usize = ROOT_BYTES_MAX + 4 * KEY_BYTES_MAX;
/// Most memory that trying a passphrase may take, in bytes; our own copies take 16 MiB.
const SCRYPT_MEMORY_MAX: u64 = 128 * 1024 * 1024;
/// How often at most.
const SCRYPT_PARALLEL_MAX: u16 = 4;
const KEY_SECTION: &str = "ENCRYPTED PRIVATE KEY";
const ROOT_SECTION: &str = "CERTIFICATE";
/// In front of the organisation's name, in a line before the sections.
const ORGANISATION: &str = "ledgerd CA of ";

/// The content of a backup.
pub(crate) struct Backup {
    /// The organisation of the CA.
    pub(crate) organisation: String,
    /// Its key.
    pub(crate) key: SigningKey,
    /// Its root, DER.
    pub(crate) root: Vec<u8>,
}

/// Writes a backup to a file that must not exist yet, readable by its owner only.
///
/// # Errors
/// [`Code::BadArgument`] for a short passphrase, [`Code::BadFile`] if the file exists, a failing disk.
pub(crate) fn write(authority: &CertificateAuthority, passphrase: &str, path: &Path) -> Result<(), Rejection> {
    ledger_base::durable::create(path, text(authority, passphrase)?.as_bytes(), SECRET_MODE)?;
    ledger_base::durable::sync_directory(path.parent().unwrap_or_else(|| Path::new(".")))
}

/// The content of a backup's file.
///
/// # Errors
/// [`Code::BadArgument`] for a short passphrase.
pub(crate) fn text(authority: &CertificateAuthority, passphrase: &str) -> Result<String, Rejection> {
    let found = passphrase.chars().count();
    if found < PASSPHRASE_CHARS_MIN {
        return Err(Rejection::new(Code::BadArgument, "the passphrase is too short")
            .found(format!("{found} characters"))
            .wanted(format!("at least {PASSPHRASE_CHARS_MIN}: anyone with the file can try passphrases without limit"))
            .next("four or five random words are easy to write down"));
    }
    let failed = |error: pkcs8::Error| Rejection::new(Code::Internal, format!("the key cannot be encrypted: {error}"));
    let key = PrivateKeyInfoRef::try_from(authority.key().to_pkcs8_der()).map_err(failed)?;
    let encrypted = key.encrypt(passphrase).map_err(failed)?;
    let section = pem::Pem::new(KEY_SECTION, encrypted.as_bytes());
    let key = pem::encode_config(&section, pem::EncodeConfig::new().set_line_ending(pem::LineEnding::LF));
    Ok(format!("{ORGANISATION}{}\n{key}{}", authority.organisation(), certificates(&[authority.root()])))
}

/// Reads a backup.
///
/// # Errors
/// [`Code::BadFile`] if it is none, or the passphrase is another.
pub(crate) fn read(path: &Path, passphrase: &str) -> Result<Backup, Rejection> {
    parse(&path.display().to_string(), &ledger_base::durable::read(path, BACKUP_BYTES_MAX)?, passphrase)
}

/// As [`read`], of the content of a file that is called so.
///
/// # Errors
/// As [`read`].
pub(crate) fn parse(name: &str, content: &[u8], passphrase: &str) -> Result<Backup, Rejection> {
    let bad = |found: String| {
        Rejection::new(Code::BadFile, format!("{name} is not usable"))
            .found(found)
            .wanted("a file of ca backup, and its passphrase")
    };
    if content.len() > BACKUP_BYTES_MAX {
        return Err(bad(format!("{} bytes", content.len())));
    }
    let text = String::from_utf8(content.to_vec()).map_err(|_| bad("bytes that are not text".into()))?;
    let organisation = text
        .lines()
        .find_map(|line| line.strip_prefix(ORGANISATION))
        .ok_or_else(|| bad("a file without the name of an organisation".into()))?;
    let sections = pem::parse_many(&text).map_err(|error| bad(error.to_string()))?;
    let section = |tag: &str| {
        let found = sections.iter().find(|section| section.tag() == tag);
        found.map(pem::Pem::contents).ok_or_else(|| bad(format!("no section {tag:?}")))
    };
    let (encrypted, root) = (section(KEY_SECTION)?, section(ROOT_SECTION)?.to_vec());
    let encrypted = EncryptedPrivateKeyInfoRef::try_from(encrypted).map_err(|error| bad(error.to_string()))?;
    check_cost(&encrypted.encryption_algorithm).map_err(&bad)?;
    let key = encrypted.decrypt(passphrase).map_err(|_| bad("another passphrase, or a damaged file".into()))?;
    let key = SigningKey::from_pkcs8_der(key.as_bytes()).map_err(|error| bad(error.to_string()))?;
    if Certificate::parse(&root)?.public_key_info != key.public_key().to_spki() {
        return Err(bad("the certificate of another key".into()));
    }
    Ok(Backup { organisation: organisation.trim().to_owned(), key, root })
}

/// The file says what decrypting costs, and anybody may have written it: that is bounded before it is tried.
fn check_cost(scheme: &EncryptionScheme) -> Result<(), String> {
    let EncryptionScheme::Pbes2(parameters) = scheme else { return Err("a key that is not encrypted by PBES2".into()) };
    match &parameters.kdf {
        Kdf::Scrypt(ScryptParams { cost_parameter, block_size, parallelization, .. }) => {
            let memory = cost_parameter.saturating_mul(128).saturating_mul(u64::from(*block_size));
            match memory <= SCRYPT_MEMORY_MAX && *parallelization <= SCRYPT_PARALLEL_MAX {
                true => Ok(()),
                false => Err(format!(
                    "a key whose passphrase needs {memory} bytes, {parallelization} times, per \
                                      attempt"
                )),
            }
        }
        _ => Err("a key whose passphrase is not derived with scrypt".into()),
    }
}

impl Backup {
    /// SHA-256 of the root.
    pub(crate) fn fingerprint(&self) -> Hash {
        Hash::of(&[&self.root])
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use ledger_identity::key::KeyKind;
    use tempfile::TempDir;

    const NOW: u64 = 1_800_000_000_000_000;
    const PASSPHRASE: &str = "four plain words here";

    #[test]
    fn a_backup_gives_back_key_and_root_and_only_for_its_passphrase() {
        let place = TempDir::new().unwrap();
        for kind in [KeyKind::Ed25519, KeyKind::P256] {
            let directory = place.path().join(kind.to_string()).join("Org1");
            let ca = CertificateAuthority::create(&directory, "Org1", kind, NOW).unwrap();
            let file = place.path().join(format!("{kind}.pem"));
            write(&ca, PASSPHRASE, &file).unwrap();
            let back = read(&file, PASSPHRASE).unwrap();
            assert_eq!((back.organisation.as_str(), back.root.as_slice()), ("Org1", ca.root()));
            assert_eq!(back.key.to_pkcs8_der(), ca.key().to_pkcs8_der());
            assert_eq!(read(&file, "four plain words").err().unwrap().code, Code::BadFile);
            assert_eq!(write(&ca, PASSPHRASE, &file).unwrap_err().code, Code::BadFile, "it is never overwritten");
            assert_eq!(write(&ca, "short", &place.path().join("other")).unwrap_err().code, Code::BadArgument);
            let whole = std::fs::read(&file).unwrap();
            let cut = place.path().join("cut");
            for length in (0..whole.len() - 2).step_by(97) {
                std::fs::write(&cut, whole.get(..length).unwrap()).unwrap();
                assert!(read(&cut, PASSPHRASE).is_err(), "cut at {length}");
            }
        }
    }

    #[test]
    fn a_copy_that_would_cost_much_to_try_is_refused_before_it_is_tried() {
        let scheme = |log_n, r, p| {
            let parameters = pkcs8::pkcs5::pbes2::Parameters::generate_scrypt_aes256cbc(
                pkcs8::pkcs5::scrypt::Params::new(log_n, r, p).unwrap(),
                &[7; 16],
                [7; 16],
            );
            EncryptionScheme::Pbes2(parameters.unwrap())
        };
        assert_eq!(check_cost(&scheme(14, 8, 1)), Ok(()));
        for costly in [scheme(18, 8, 1), scheme(30, 8, 1), scheme(14, 8, 64)] {
            assert!(check_cost(&costly).is_err());
        }
    }
}
