//! The organisations of a network as a file and as a message.

use super::files;
use crate::v1;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use ledger_identity::msp::{Msp, Msps};
use ledger_identity::units::{Unit, Units};
use rustls_pki_types::CertificateDer;
use rustls_pki_types::pem::PemObject;
use serde::{Deserialize, Serialize};

/// Most organisations that are read.
const ORGANISATIONS_MAX: usize = 256;

/// One organisation in `msps.json`; certificates are PEM texts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Stored {
    organisation: String,
    roots: Vec<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    intermediates: Vec<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    units: Option<Units>,
}

/// The organisations as they are stored.
pub(super) fn store(msps: &Msps) -> Vec<Stored> {
    let pem = |der: &[u8]| files::pem(&[CertificateDer::from(der)]);
    let stored = msps.iter().map(|msp| Stored {
        organisation: msp.organisation().to_owned(),
        roots: msp.roots().map(pem).collect(),
        intermediates: msp.intermediates().map(pem).collect(),
        units: msp.units().cloned(),
    });
    stored.collect()
}

pub(super) fn to_json(msps: &Msps) -> Result<String, Rejection> {
    pretty(&store(msps), files::MSPS)
}

/// A file as JSON that people can read.
pub(super) fn pretty(content: &impl Serialize, file: &str) -> Result<String, Rejection> {
    serde_json::to_string_pretty(content)
        .map_err(|error| Rejection::new(Code::Internal, format!("{file} cannot be encoded: {error}")))
}

/// Reads `msps.json`; the error is the reason alone.
pub(super) fn from_json(text: &str) -> Result<Msps, String> {
    let stored: Vec<Stored> = serde_json::from_str(text).map_err(|error| error.to_string())?;
    read(&stored)
}

/// Organisations that were stored; the error is the reason alone.
pub(super) fn read(stored: &[Stored]) -> Result<Msps, String> {
    if stored.len() > ORGANISATIONS_MAX {
        return Err(format!("{} organisations, more than {ORGANISATIONS_MAX}", stored.len()));
    }
    let ders = |texts: &[String]| {
        texts.iter().map(|text| CertificateDer::from_pem_slice(text.as_bytes())).collect::<Result<Vec<_>, _>>()
    };
    let mut msps = Msps::new();
    for Stored { organisation, roots, intermediates, units } in stored {
        let wrong = |error: String| format!("organisation {organisation:?}: {error}");
        let roots = ders(roots).map_err(|error| wrong(error.to_string()))?;
        let intermediates = ders(intermediates).map_err(|error| wrong(error.to_string()))?;
        let msp = Msp::new(organisation, &roots, &intermediates).and_then(|msp| msp.with_units(units.clone()));
        let msp = msp.map_err(|error| wrong(error.to_string()))?;
        msps.insert(msp).map_err(|error| wrong(error.to_string()))?;
    }
    Ok(msps)
}

pub(super) fn from_wire(organisations: &[v1::Organisation]) -> Result<Msps, Rejection> {
    if organisations.len() > ORGANISATIONS_MAX {
        return Err(Rejection::new(Code::TooLarge, "the network has too many organisations")
            .found(organisations.len().to_string())
            .wanted(format!("at most {ORGANISATIONS_MAX}")));
    }
    let mut msps = Msps::new();
    for organisation in organisations {
        let units = organisation.units.as_ref().map(units_from_wire).transpose()?;
        let msp = Msp::new(&organisation.name, &organisation.roots, &organisation.intermediates)?;
        msps.insert(msp.with_units(units)?)?;
    }
    Ok(msps)
}

pub(super) fn units_to_wire(units: &Units) -> v1::Units {
    let unit = |unit: &Unit| v1::Unit {
        unit: unit.unit.clone(),
        role: unit.role.to_string(),
        issuer: unit.issuer.as_ref().map_or_else(Bytes::new, |issuer| Bytes::copy_from_slice(&issuer.0)),
    };
    v1::Units { units: units.iter().map(unit).collect() }
}

fn units_from_wire(units: &v1::Units) -> Result<Units, Rejection> {
    let unit = |found: &v1::Unit| {
        let wrong = |found: String| {
            Rejection::new(Code::Malformed, "an organisational unit of an organisation cannot be read").found(found)
        };
        let role = Role::from_unit(&found.role).filter(|role| role.as_str() == found.role);
        let issuer = match &found.issuer[..] {
            [] => None,
            bytes => Some(Hash::from_slice(bytes).ok_or_else(|| wrong(format!("an issuer of {} bytes", bytes.len())))?),
        };
        let role = role.ok_or_else(|| wrong(format!("the role {:?}", found.role)))?;
        Ok(Unit { unit: found.unit.clone(), role, issuer })
    };
    Ok(Units::new(units.units.iter().map(unit).collect::<Result<_, Rejection>>()?)?)
}
