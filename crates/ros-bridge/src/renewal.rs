//! A bridge runs for years, its certificate does not: it is renewed in time, in the context it was loaded from.

use crate::bridge::{context_of, home_of};
use crate::config::Config;
use ledger::Rejection;
use ledger::certificate::Certificate;
use ledger_api::{Client, renewal_due};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Time between two looks at the certificate, also after a renewal that failed.
const LOOK: Duration = Duration::from_secs(3600);

/// Keeps the client's certificate valid, until dropped. A context that somebody else has renewed is taken over.
pub async fn keep_renewed(config: &Config, client: &Client) {
    loop {
        if let Err(reason) = look(config, client).await {
            tracing::warn!(%reason, "the bridge's certificate cannot be renewed; trying on");
        }
        tokio::time::sleep(LOOK).await;
    }
}

async fn look(config: &Config, client: &Client) -> Result<(), Rejection> {
    let mut context = context_of(config)?;
    let own = context.identity()?;
    let certificate = Certificate::parse(own.own().certificate())?;
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let now = u64::try_from(now.as_micros()).unwrap_or(u64::MAX);
    if now >= renewal_due(certificate.not_before, certificate.not_after) {
        context = context.renewed().await?;
        context.save(&home_of(config)?)?;
    }
    let current = context.identity()?;
    if current.own().creator != client.creator() {
        client.renew(&current);
        tracing::info!("the bridge goes on with a renewed certificate");
    }
    Ok(())
}
