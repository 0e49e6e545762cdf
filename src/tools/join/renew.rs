//! `ledgerd renew`: another key and certificate for a node whose certificate is valid, before its renewal is due.

use super::again::{organisations, own};
use crate::process::clock::wall;
use crate::process::config::Config;
use crate::storage::files::{CERTIFICATE_FILE, KEY_FILE};
use crate::trust::membership::{Joined, unreadable_file};
use crate::trust::renewal::{store, validity};
use ledger::network::{GENESIS_BYTES_MAX, Genesis};
use ledger_api::tls::{ServerTrust, TlsIdentity};
use ledger_api::{Credentials, Renewal};
use ledger_base::moment::rfc3339;
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::layout::GENESIS_FILE;
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;

/// The arguments of `ledgerd renew`.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct RenewOptions {
    /// The node's configuration.
    #[arg(long, value_name = "FILE", default_value = "ledgerd.toml")]
    pub(crate) config: PathBuf,
    /// A node that holds the CA key, or that can name one; may be given several times. This node and those through
    /// which it joined are asked in any case.
    #[arg(long, value_name = "HOST:PORT")]
    node: Vec<String>,
}

/// Replaces key and certificate of the node, which may run; answers with the text for the user.
///
/// # Errors
/// [`Code::CertificateExpired`] if the certificate has ended; the answer of the node that holds the CA key, or
/// [`Code::Unreachable`] if none answers.
pub(crate) async fn renew(options: &RenewOptions, config: &Config) -> Result<String, Rejection> {
    let data = &config.data;
    let genesis = ledger_base::durable::read(&data.join(GENESIS_FILE), GENESIS_BYTES_MAX)
        .map_err(|refused| unreadable_file(config, refused))?;
    let (genesis, network) = Genesis::from_bytes(&genesis)?;
    let joined = Joined::load(data)?;
    let present = TlsIdentity::from_pem_files(&data.join(CERTIFICATE_FILE), &data.join(KEY_FILE))
        .map_err(|error| unreadable_file(config, Rejection::new(Code::BadFile, error.to_string())))?;
    let (_, not_after) = validity(&present)?;
    if wall() > not_after {
        return Err(Rejection::new(Code::CertificateExpired, "the certificate of this node has expired")
            .found(rfc3339(not_after))
            .wanted("a valid certificate: it authenticates the request for the next one")
            .next("start the node: ledgerd run renews the certificate or prints how to proceed"));
    }
    let msps = Arc::new(organisations(&genesis, &present, joined.as_ref(), data)?);
    let me = own(&present, &msps)?;
    let named = options.node.iter().cloned();
    let itself = joined.iter().map(|joined| joined.address.clone()).chain([config.member.address.clone()]);
    let itself = itself.chain(genesis.node(&me.organisation, &me.name).map(|founder| founder.address.clone()));
    let let_in = joined.iter().flat_map(|joined| joined.bootstrap.iter().cloned());
    let founders = genesis.nodes.iter().map(|node| node.address.clone());
    let mut known = BTreeSet::new();
    let mut doors: Vec<String> = named.chain(itself).chain(let_in).chain(founders).collect();
    doors.retain(|door| !door.is_empty() && known.insert(door.clone()));
    let credentials = Credentials::new(network, present.clone(), ServerTrust::Roots(Arc::clone(&msps)))?;
    let renewal = Renewal::begin(&present)?;
    let renewed = renewal.ask(&doors, &credentials, &msps).await.map_err(|refused| match refused.code {
        Code::Unreachable => refused.next("start a node that holds the CA key of the organisation (ledgerctl ca status), or name it: --node HOST:PORT"),
        _ => refused,
    })?;
    store(data, &present, &renewed)?;
    let (_, until) = validity(&renewed)?;
    Ok(format!(
        "node {} has a new key and certificate, valid until {}\n\nnext, if it runs: systemctl reload ledgerd, or \
         SIGHUP to its process\nThe previous certificate stays valid until {}.",
        me.id(),
        rfc3339(until),
        rfc3339(not_after)
    ))
}
