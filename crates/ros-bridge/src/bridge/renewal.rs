//! A bridge runs for years, its certificate does not: it is renewed in time, in the context it was loaded from.

use crate::config::{Config, context_of};
use ledger_api::context::{RenewalRule, warning_due};
use ledger_api::{Client, Renewed, renewal_due, wait_by_clock};
use ledger_base::rejection::Rejection;
use std::time::Duration;

/// Time between two looks at the certificate, also after a renewal that failed.
const LOOK: Duration = Duration::from_secs(3600);
/// In microseconds.
const DAY: u64 = 24 * 3600 * 1_000_000;

/// Keeps the client's certificate valid, until dropped. A context that somebody else has renewed is taken over.
pub async fn keep_renewed(config: &Config, client: &Client) {
    loop {
        if let Err(reason) = look(config, client).await {
            tracing::warn!(code = reason.code.name(), %reason, "cannot renew the certificate of the bridge; retrying");
        }
        wait_by_clock(|| client.now(), LOOK).await;
    }
}

async fn look(config: &Config, client: &Client) -> Result<(), Rejection> {
    let mut context = context_of(config)?;
    let certificate = context.certificate()?;
    if context.renew == RenewalRule::Auto && client.now() >= renewal_due(certificate.not_before, certificate.not_after)
    {
        // Through any node of the network: the one that the bridge works through need not reach the CA.
        let asking = Client::connect(&context).await?;
        if let Renewed::Yes(renewed) = context.renew_if_due(&asking).await? {
            context = *renewed;
        }
    }
    let certificate = context.certificate()?;
    let left = certificate.not_after.saturating_sub(client.now()) / DAY;
    if client.now() >= warning_due(certificate.not_before, certificate.not_after) {
        tracing::warn!(
            context = context.name,
            days = left,
            "the certificate of the bridge ends soon: ledgerctl identity renew"
        );
    }
    let current = context.identity()?;
    if current.own().creator != client.creator() {
        client.renew(&current);
        tracing::info!("using the renewed certificate");
    }
    Ok(())
}
