//! A Fabric MSP directory, as `fabric-ca-client getcainfo` and `cryptogen` leave it.
//!
//! ```text
//! cacerts/            roots                       PEM
//! intermediatecerts/  intermediate authorities    PEM
//! tlscacerts/         authorities of TLS          PEM; read and checked, but they vouch for nobody here
//! crls/               revocation lists            PEM or DER
//! config.yaml         NodeOUs: which unit (OU) is which role
//! ```
//! Nothing else is read: no key, and no `admincerts`. The directory may come from somebody else. So
//! files are few and small, links are not followed, and what cannot be read is refused with its name.

mod node_units;

use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::{CERTIFICATE_BYTES_MAX, Certificate};
use ledger_identity::msp::{Msp, Msps};
use ledger_identity::revocation_list::{LIST_BYTES_MAX, RevocationList};
use ledger_identity::units::Units;
use ledger_identity::{Identity, IdentityError, Role};
use rustls_pki_types::pem::PemObject;
use rustls_pki_types::{CertificateDer, CertificateRevocationListDer};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Most entries of one of the directories.
const ENTRIES_MAX: usize = 64;
/// Largest file of certificates or lists that is read, in bytes: the largest list in base64.
const FILE_BYTES_MAX: usize = 2 * LIST_BYTES_MAX;
/// Most certificates in one file.
const CERTIFICATES_MAX: usize = 8;

const _: () = assert!(FILE_BYTES_MAX >= 2 * CERTIFICATES_MAX * CERTIFICATE_BYTES_MAX, "a file of certificates fits");

/// The content of an MSP directory, checked as the ledger will check it.
#[derive(Debug)]
pub struct MspDirectory {
    /// Roots, DER.
    pub roots: Vec<Vec<u8>>,
    /// Intermediate authorities, DER.
    pub intermediates: Vec<Vec<u8>>,
    /// Which unit is which role.
    pub units: Units,
    /// The newest list of each authority that has one, DER.
    pub lists: Vec<Vec<u8>>,
    /// Hints for its owner, each a warning and the next step.
    pub warnings: Vec<[String; 2]>,
    msp: Msp,
}

impl MspDirectory {
    /// Reads the directory as that of an organisation of this name, at a time in microseconds since the UNIX epoch.
    ///
    /// # Errors
    /// [`Code::BadFile`] with the file and its fault; [`Code::CertificateMalformed`] if the authorities do not fit together, or
    /// one of them could let no one sign in.
    pub fn read(directory: &Path, organisation: &str, at: u64) -> Result<Self, Rejection> {
        let mut warnings = Vec::new();
        let roots = certificates(directory, "cacerts")?;
        if roots.is_empty() {
            return Err(bad(&directory.join("cacerts"), "no certificate")
                .wanted("an MSP directory: its roots are in cacerts/*.pem")
                .next(
                    "ledgerctl network add-org NAME --msp DIR, where DIR is the directory \"msp\" of the organisation",
                ));
        }
        let intermediates = certificates(directory, "intermediatecerts")?;
        if !certificates(directory, "tlscacerts")?.is_empty() {
            warnings.push([
                "the authorities of TLS in tlscacerts vouch for nobody here".to_owned(),
                "nodes of ledgerd have their certificates from the authorities of their organisation".to_owned(),
            ]);
        }
        if !files(directory, "admincerts")?.is_empty() {
            warnings.push([
                "admincerts is not read: only units (OU) name admins".to_owned(),
                "give admins certificates with the unit of AdminOUIdentifier in config.yaml".to_owned(),
            ]);
        }
        let known = [("cacerts", &roots), ("intermediatecerts", &intermediates)];
        let units = units(directory, &known)?;
        if !units.have(Role::Admin) {
            warnings.push([
                "config.yaml names no unit of admins: nobody of this organisation can bring its revocation lists"
                    .to_owned(),
                "enable NodeOUs with an AdminOUIdentifier first, unless that is what you want".to_owned(),
            ]);
        }
        for (path, root) in &roots {
            let alone = Msp::new(organisation, std::slice::from_ref(root), &[] as &[Vec<u8>])?;
            alone.check_entry(None, at).map_err(|error| refused_with(path, error))?;
        }
        let ders = |read: Found| read.into_iter().map(|(_, der)| der).collect::<Vec<_>>();
        let (roots, intermediates) = (ders(roots), ders(intermediates));
        let msp = Msp::new(organisation, &roots, &intermediates)?.with_units(Some(units.clone()))?;
        msp.check_entry(None, at)?;
        let lists = lists(directory, &msp)?;
        Ok(Self { roots, intermediates, units, lists, warnings, msp })
    }

    /// The person whom the network would see, if this directory were its organisation: the first certificate in `signcerts` of a
    /// directory, or in a file.
    ///
    /// # Errors
    /// [`Code::BadFile`], and the reason why the person could not sign in, as a node would give it.
    pub fn person(&self, path: &Path, at: u64) -> Result<Identity, Rejection> {
        let path = if path.is_dir() { signcert(path)? } else { path.to_owned() };
        let chain = chain(&path)?;
        let der = chain.first().map_or(&[][..], Vec::as_slice);
        let mut msps = Msps::new();
        msps.insert(self.msp.clone())?;
        // Issuers that come along do not count on the ledger.
        let person = msps.verify(der, &[], at).map_err(|error| refused_with(&path, error))?;
        for list in &self.lists {
            let (list, issuer) = self.msp.verify_list(list)?;
            if issuer.name.0 == person.issuer && list.serials.contains(&person.serial) {
                return Err(Rejection::new(Code::Revoked, format!("the certificate in {} is revoked", path.display()))
                    .found(format!("serial {} in a list of {}", hex::encode(&person.serial), list.issuer))
                    .wanted("a certificate that its CA still stands for"));
            }
        }
        Ok(person)
    }
}

/// The certificate in the directory of a person.
fn signcert(directory: &Path) -> Result<PathBuf, Rejection> {
    files(directory, "signcerts")?.into_iter().next().ok_or_else(|| {
        bad(&directory.join("signcerts"), "no certificate")
            .wanted("the MSP directory of a person, with the certificate in signcerts/*.pem, or the certificate itself")
    })
}

/// The reason, with the file that it is about.
fn refused_with(path: &Path, error: IdentityError) -> Rejection {
    Rejection::from(error).prefix(format!("{}: ", path.display()))
}

/// A revocation list in PEM or DER.
///
/// # Errors
/// [`Code::BadFile`].
pub fn list(path: &Path) -> Result<Vec<u8>, Rejection> {
    let bytes = read_file(path)?;
    let der = match CertificateRevocationListDer::from_pem_slice(&bytes) {
        Ok(der) => der.as_ref().to_vec(),
        Err(_) => bytes,
    };
    RevocationList::parse(&der).map_err(|error| {
        bad(path, error.to_string())
            .wanted("a revocation list in PEM (\"BEGIN X509 CRL\") or DER")
            .next("take the file that the CA wrote, such as crl.pem of fabric-ca-client gencrl")
    })?;
    Ok(der)
}

/// The certificates of a file in PEM, the first one first; at least one.
///
/// # Errors
/// [`Code::BadFile`].
pub fn chain(path: &Path) -> Result<Vec<Vec<u8>>, Rejection> {
    let bytes = read_file(path)?;
    let wanted = "certificates in PEM (\"BEGIN CERTIFICATE\"), 1 to 8";
    let found = CertificateDer::pem_slice_iter(&bytes).take(CERTIFICATES_MAX + 1).collect::<Result<Vec<_>, _>>();
    let found = found.map_err(|error| bad(path, error.to_string()).wanted(wanted))?;
    if found.is_empty() || found.len() > CERTIFICATES_MAX {
        return Err(bad(path, format!("{} certificates", found.len())).wanted(wanted));
    }
    for der in &found {
        Certificate::parse(der).map_err(|error| bad(path, error.to_string()).wanted(wanted))?;
    }
    Ok(found.iter().map(|der| der.as_ref().to_vec()).collect())
}

fn unreadable(path: &Path, error: &io::Error) -> Rejection {
    Rejection::new(Code::BadFile, format!("cannot read {}", path.display()))
        .found(error.to_string())
        .next("check the path and the rights on it")
}

/// Certificates in DER, each with its file.
type Found = Vec<(PathBuf, Vec<u8>)>;

/// The certificates in one of the directories.
fn certificates(directory: &Path, part: &str) -> Result<Found, Rejection> {
    let mut found: Found = Vec::new();
    for path in files(directory, part)? {
        for der in chain(&path)? {
            if found.iter().all(|(_, known)| *known != der) {
                found.push((path.clone(), der));
            }
        }
    }
    Ok(found)
}

/// The newest list of each key of an authority and each scope; each has to be signed by it.
fn lists(directory: &Path, msp: &Msp) -> Result<Vec<Vec<u8>>, Rejection> {
    let mut newest = BTreeMap::new();
    for path in files(directory, "crls")? {
        let der = list(&path)?;
        let (read, issuer) = msp.verify_list(&der).map_err(|error| {
            bad(&path, error.to_string()).wanted("a revocation list of an authority of this directory")
        })?;
        let scope = (issuer.name, issuer.key, read.scope.point);
        let known = newest.entry(scope).or_insert_with(|| (read.this_update, der.clone()));
        if known.0 < read.this_update {
            *known = (read.this_update, der);
        }
    }
    Ok(newest.into_values().map(|(_, der)| der).collect())
}

/// The units of `config.yaml`; without the file nobody has a role but member.
fn units(directory: &Path, known: &[(&str, &Found)]) -> Result<Units, Rejection> {
    let path = directory.join("config.yaml");
    if fs::symlink_metadata(&path).is_err() {
        return Ok(Units::default());
    }
    let text = ledger_base::text::of_bytes(&read_file(&path)?).map_err(|fault| bad(&path, fault.to_string()))?;
    let authority = |name: &str| {
        let named = |(part, read): &(&str, &Found)| {
            let file = name.strip_prefix(part)?.strip_prefix('/')?;
            let found = read.iter().find(|(path, _)| path.file_name().is_some_and(|known| known == file))?;
            Some(found.1.clone())
        };
        known.iter().find_map(named)
    };
    node_units::read(&text, &authority).map_err(|mut refused| {
        refused.message = format!("cannot use {}", path.display());
        refused
    })
}

/// The files of one of the directories, in the order of their names; none if there is no such directory.
fn files(directory: &Path, part: &str) -> Result<Vec<PathBuf>, Rejection> {
    let directory = directory.join(part);
    match fs::symlink_metadata(&directory) {
        Err(_) => return Ok(Vec::new()),
        Ok(found) if found.is_dir() => {}
        Ok(_) => return Err(bad(&directory, "a file or a link").wanted("a directory")),
    }
    let entries = fs::read_dir(&directory).map_err(|error| unreadable(&directory, &error))?;
    let mut found = Vec::new();
    for entry in entries {
        let path = entry.map_err(|error| unreadable(&directory, &error))?.path();
        let hidden = path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
        if !hidden {
            found.push(path);
        }
        if found.len() > ENTRIES_MAX {
            return Err(bad(&directory, format!("more than {ENTRIES_MAX} entries"))
                .wanted(format!("at most {ENTRIES_MAX} files")));
        }
    }
    found.sort();
    Ok(found)
}

/// The content of a file of limited size, and of nothing that is no file.
fn read_file(path: &Path) -> Result<Vec<u8>, Rejection> {
    let kind = fs::symlink_metadata(path).map_err(|error| unreadable(path, &error))?;
    if !kind.is_file() {
        let found = if kind.is_symlink() { "a link" } else { "no file" };
        return Err(bad(path, found)
            .wanted("a plain file: links are not followed")
            .next("copy the directory with what its links stand for: cp -rL DIR COPY"));
    }
    let mut bytes = Vec::new();
    let limit = FILE_BYTES_MAX as u64 + 1;
    let read = File::open(path).and_then(|file| file.take(limit).read_to_end(&mut bytes));
    read.map_err(|error| unreadable(path, &error))?;
    if bytes.len() > FILE_BYTES_MAX {
        return Err(
            bad(path, format!("more than {FILE_BYTES_MAX} bytes")).wanted(format!("at most {FILE_BYTES_MAX} bytes"))
        );
    }
    Ok(bytes)
}

/// A file that cannot be used, and its fault.
fn bad(path: &Path, found: impl Into<String>) -> Rejection {
    Rejection::new(Code::BadFile, format!("cannot use {}", path.display())).found(found)
}

#[cfg(test)]
mod tests;
