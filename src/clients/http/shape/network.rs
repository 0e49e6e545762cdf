//! The network as a new client learns it.

use bytes::Bytes;
use ledger_api::facts::utc;
use ledger_api::v1;
use serde::Serialize;

/// The network.
#[derive(Serialize)]
pub(in crate::clients::http) struct NetworkFacts {
    network: String,
    label: String,
    organisations: Vec<OrganisationFacts>,
    clock: u64,
    clock_utc: Option<String>,
    cut_off: bool,
    carries: Vec<String>,
    rules: u32,
}

/// A member of the network.
#[derive(Serialize)]
struct OrganisationFacts {
    name: String,
    roots: Vec<String>,
    intermediates: Vec<String>,
    nodes: Vec<String>,
    units: Vec<UnitFacts>,
}

/// An organisational unit that stands for a role.
#[derive(Serialize)]
struct UnitFacts {
    unit: String,
    role: String,
    issuer: String,
}

fn digits(certificates: &[Bytes]) -> Vec<String> {
    certificates.iter().map(hex::encode).collect()
}

impl From<v1::NetworkResponse> for NetworkFacts {
    fn from(network: v1::NetworkResponse) -> Self {
        Self {
            network: hex::encode(network.network),
            label: network.label,
            organisations: network.organisations.into_iter().map(OrganisationFacts::from).collect(),
            clock: network.clock,
            clock_utc: utc(network.clock),
            cut_off: network.cut_off,
            carries: network.carries,
            rules: network.rules,
        }
    }
}

impl From<v1::Organisation> for OrganisationFacts {
    fn from(organisation: v1::Organisation) -> Self {
        let units = organisation.units.unwrap_or_default().units;
        let unit = |unit: v1::Unit| UnitFacts { unit: unit.unit, role: unit.role, issuer: hex::encode(unit.issuer) };
        Self {
            name: organisation.name,
            roots: digits(&organisation.roots),
            intermediates: digits(&organisation.intermediates),
            nodes: organisation.addresses,
            units: units.into_iter().map(unit).collect(),
        }
    }
}
