//! Identities made beside a CA, before its node runs: admins of a network for playing, robots of the demo.

use crate::trust::ca;
use crate::trust::ca::CertificateAuthority;
use ledger::network::{GENESIS_BYTES_MAX, Genesis};
use ledger_api::Context;
use ledger_base::rejection::Rejection;
use ledger_identity::Role;
use ledger_identity::key::KeyKind;
use ledger_identity::msp::{Msp, Msps};
use ledger_storage::layout::GENESIS_FILE;
use rustls_pki_types::CertificateDer;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Issues an identity of an organisation whose CA lies in a node's data directory, with a key made here. It comes as a
/// context named like the identity that connects to `node` (`HOST:PORT`). The node must not be running: it owns its CAs
/// then.
///
/// # Errors
/// As [`CertificateAuthority::issue`]; [`ledger_base::rejection::Code::BadFile`] if the directory is no node's.
pub fn issue(
    data: &Path,
    organisation: &str,
    (name, role): (&str, Role),
    attributes: BTreeMap<String, String>,
    node: &str,
    now: u64,
) -> Result<Context, Rejection> {
    let (genesis, network) =
        Genesis::from_bytes(&ledger_base::durable::read(&data.join(GENESIS_FILE), GENESIS_BYTES_MAX)?)?;
    let mut msps = Msps::new();
    for founder in &genesis.organisations {
        msps.insert(Msp::new(&founder.name, &founder.roots, &founder.intermediates)?)?;
    }
    let mut authority = CertificateAuthority::open(&data.join(ca::DIRECTORY).join(organisation))?;
    let issued = authority.issue(name, role, attributes, KeyKind::Ed25519, now)?;
    let chain = std::iter::once(issued.certificate).chain(issued.chain).map(CertificateDer::from);
    Ok(Context {
        name: name.to_owned(),
        organisation: organisation.to_owned(),
        network,
        label: genesis.label,
        nodes: vec![node.to_owned()],
        chain: chain.collect(),
        key: Arc::new(issued.key),
        msps: Arc::new(msps),
        renew: ledger_api::context::RenewalRule::default(),
        memory: ledger_api::context::Memory::default(),
    })
}
