//! Identities made beside a CA, before its node runs: admins of a network for playing, robots of the demo.

use super::GENESIS_FILE;
use crate::ca::{self, CertificateAuthority};
use ledger::identity::Role;
use ledger::key::KeyKind;
use ledger::msp::{Msp, Msps};
use ledger::network::Genesis;
use ledger::{Code, Rejection};
use ledger_api::Context;
use rustls_pki_types::CertificateDer;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Issues an identity of an organisation whose CA lies in a node's data directory, with a key made here, as a context
/// named like the identity that connects to `node` (`HOST:PORT`). The node must not be running: it owns its CAs then.
///
/// # Errors
/// As [`CertificateAuthority::issue`]; [`Code::BadFile`] if the directory is no node's.
pub fn issue(
    data: &Path,
    organisation: &str,
    (name, role): (&str, Role),
    attributes: BTreeMap<String, String>,
    node: &str,
    now: u64,
) -> Result<Context, Rejection> {
    let path = data.join(GENESIS_FILE);
    let document = std::fs::read(&path)
        .map_err(|error| Rejection::new(Code::BadFile, format!("cannot read {}: {error}", path.display())))?;
    let (genesis, network) = Genesis::from_bytes(&document)?;
    let mut msps = Msps::new();
    for founder in &genesis.organisations {
        msps.insert(Msp::new(&founder.name, &founder.roots, &founder.intermediates)?)?;
    }
    let mut authority = CertificateAuthority::open(&data.join(ca::DIRECTORY).join(organisation))?;
    let issued = authority.issue(name, role, attributes, KeyKind::Ed25519, now)?;
    let chain = std::iter::once(issued.certificate).chain(issued.chain).map(|der| CertificateDer::from(der.to_vec()));
    Ok(Context {
        name: name.to_owned(),
        organisation: organisation.to_owned(),
        network,
        label: genesis.label,
        nodes: vec![node.to_owned()],
        chain: chain.collect(),
        key: Arc::new(issued.key),
        msps: Arc::new(msps),
    })
}
