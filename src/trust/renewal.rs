//! The node's own certificate is renewed before it runs out: at the CA if the node carries it, else at the nodes of its
//! organisation. New connections show the new one, those that are open stay, and nobody is asked.
//!
//! Others know the node by its organisation and name, so that a renewal changes nothing on the ledger.

mod endings;

use crate::process::clock::wall;
use crate::storage::files::{CERTIFICATE_FILE, KEY_FILE};
use crate::trust::ca::{check_secret, pem};
use crate::trust::enrolment::{Authorities, EnrolmentService, lock};
use endings::Endings;
use ledger::Ledger;
use ledger_api::tls::{ServerTrust, TlsIdentity, TrustSource};
use ledger_api::{Credentials, Renewal, renewal_due, wait_by_clock};
use ledger_base::durable::{PUBLIC_MODE, SECRET_MODE};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_identity::certificate::Certificate;
use ledger_identity::msp::{Msps, Usage};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// A day, microseconds.
const DAY: u64 = 86_400_000_000;
/// Longest time between two looks at the certificate.
const LOOK_MAX: Duration = Duration::from_secs(3600);
/// Pause after a renewal that failed: a tenth of what is left, within these bounds.
const RETRY_PAUSE: (Duration, Duration) = (Duration::from_secs(5), LOOK_MAX);

/// The task that keeps a node's certificate fresh.
pub(crate) struct Renewer {
    /// The node's data directory.
    pub data: PathBuf,
    /// Its certificate and key, shared with all that shows them.
    pub identity: TlsIdentity,
    /// The ledger, for whom it trusts.
    pub ledger: Arc<Ledger>,
    /// The nodes that are accepted.
    pub trust: Arc<dyn TrustSource>,
    /// The CAs in this node.
    pub enrolment: EnrolmentService,
    /// `HOST:PORT` of the other nodes of the own organisation, asked for at each renewal.
    pub others: Box<dyn Fn() -> Vec<String> + Send + Sync>,
}

impl Renewer {
    /// Renews whenever it is time. Never ends.
    pub(crate) async fn keep(self) {
        let (mut failed, mut endings) = (false, Endings::default());
        loop {
            endings.look(self.identity.own().certificate(), &self.ledger, wall());
            let pause = match validity(&self.identity) {
                Ok((not_before, not_after)) => {
                    let now = wall();
                    match renewal_due(not_before, not_after).checked_sub(now).filter(|early| *early > 0) {
                        Some(early) => Duration::from_micros(early).min(LOOK_MAX),
                        None => self.try_renewal(not_after.saturating_sub(now), &mut failed).await,
                    }
                }
                Err(reason) => {
                    tracing::error!(code = reason.code.name(), %reason, "cannot read the node certificate");
                    LOOK_MAX
                }
            };
            wait_by_clock(wall, pause).await;
        }
    }

    /// Renews once; answers with the time to wait before the next look. `left` in microseconds.
    async fn try_renewal(&self, left: u64, failed: &mut bool) -> Duration {
        match self.renew().await {
            Ok(not_after) => {
                let until = format!("{} days", not_after.saturating_sub(wall()) / DAY);
                // The end of an outage has the level of the outage.
                match std::mem::take(failed) {
                    true => tracing::warn!(until, "node certificate renewed after earlier failures"),
                    false => tracing::info!(until, "node certificate renewed"),
                }
                RETRY_PAUSE.0
            }
            Err(reason) => {
                *failed = true;
                let days = left / DAY;
                tracing::warn!(code = reason.code.name(), %reason, "cannot renew the node certificate, which expires \
                                                                    in {days} days; retrying");
                Duration::from_micros(left / 10).clamp(RETRY_PAUSE.0, RETRY_PAUSE.1)
            }
        }
    }

    async fn renew(&self) -> Result<u64, Rejection> {
        if wall() > validity(&self.identity)?.1 {
            // It has ended while the machine was suspended: the ledger accepts no call of this node.
            revive(&self.data, &self.identity, self.enrolment.authorities(), &self.ledger.msps())?;
            return Ok(validity(&self.identity)?.1);
        }
        let renewal = Renewal::begin(&self.identity)?;
        let msps = self.ledger.msps();
        let own = own_identity(&self.identity, &msps)?;
        let renewed = if self.enrolment.carries(&own.organisation) {
            let answer = self.enrolment.renew_for(Arc::new(own), renewal.request()).await?;
            renewal.finish_at(&answer.certificate, &msps, wall())?
        } else {
            let trust = ServerTrust::Network(Arc::clone(&self.trust));
            let credentials = Credentials::new(self.ledger.network(), self.identity.clone(), trust)?;
            renewal.ask(&(self.others)(), &credentials, &msps).await?
        };
        store(&self.data, &self.identity, &renewed)?;
        self.identity.renew(&renewed);
        Ok(validity(&renewed)?.1)
    }
}

/// Takes the certificate and the key in the data directory, if somebody has put others there; true if they are others.
///
/// # Errors
/// [`Code::BadFile`] if they cannot be used, or are those of another identity; the fault of the certificate.
pub(crate) fn read_again(data: &Path, identity: &TlsIdentity, msps: &Msps) -> Result<bool, Rejection> {
    let (certificate, key) = (data.join(CERTIFICATE_FILE), data.join(KEY_FILE));
    check_secret(&key, "if others may have read it, replace the key, and revoke its certificate")?;
    let lies_there = TlsIdentity::from_pem_files(&certificate, &key)
        .map_err(|error| Rejection::new(Code::BadFile, error.to_string()).next("restore the file from a copy"))?;
    if lies_there.own().certificate() == identity.own().certificate() {
        return Ok(false);
    }
    let (before, after) = (own_identity(identity, msps)?, own_identity(&lies_there, msps)?);
    after.check_validity(wall())?;
    if before.id() != after.id() || before.role != after.role {
        return Err(Rejection::new(Code::BadFile, format!("{} is of another identity", certificate.display()))
            .found(format!("{} {}", after.role, after.id()))
            .wanted(format!("{} {}", before.role, before.id())));
    }
    identity.renew(&lies_there);
    Ok(true)
}

/// Sees to it that the certificate is valid when the node starts, or its machine wakes. One that ran out meanwhile is replaced if the node carries the CA of its organisation.
///
/// # Errors
/// [`Code::CertificateExpired`] with the way back if the CA is elsewhere.
pub(crate) fn revive(
    data: &Path,
    identity: &TlsIdentity,
    authorities: &Authorities,
    msps: &Msps,
) -> Result<(), Rejection> {
    let (_, not_after) = validity(identity)?;
    let now = wall();
    if now <= not_after {
        return Ok(());
    }
    let own = own_identity(identity, msps)?;
    let Some(authority) = authorities.find(&own.organisation) else {
        let Identity { organisation, name, .. } = &own;
        return Err(Rejection::new(
            Code::CertificateExpired,
            format!("the certificate of node {} expired while the node was stopped", own.id()),
        )
        .found(format!("a validity that ended {} days ago", (now - not_after) / 86_400_000_000))
        .wanted("a node that runs in the last third of its certificate's validity, and renews it")
        .next(format!(
            "an admin of {organisation} runs ledgerctl network invite --node {name}; then run here: ledgerd join \
             TOKEN --config FILE, which keeps the data"
        )));
    };
    let renewal = Renewal::begin(identity)?;
    let certificate = lock(&authority).revive(&own, &renewal.request(), now)?;
    let renewed = renewal.finish_at(&certificate, msps, now)?;
    store(data, identity, &renewed)?;
    identity.renew(&renewed);
    tracing::warn!("node certificate had expired; renewed by the CA key of this node");
    Ok(())
}

/// Replaces certificate and key on the disk. A crash at any moment leaves a pair that fits: while the certificate
/// changes, the key file holds both keys, and the one of the certificate is taken.
pub(crate) fn store(data: &Path, before: &TlsIdentity, after: &TlsIdentity) -> Result<(), Rejection> {
    let (before, after) = (before.own(), after.own());
    let (certificate, key) = (data.join(CERTIFICATE_FILE), data.join(KEY_FILE));
    let [old_key, new_key] = [&before, &after].map(|own| own.key.to_pkcs8_pem());
    ledger_base::durable::replace(&key, format!("{old_key}{new_key}").as_bytes(), SECRET_MODE)?;
    ledger_base::durable::replace(&certificate, pem(&after.chain).as_bytes(), PUBLIC_MODE)?;
    ledger_base::durable::replace(&key, new_key.as_bytes(), SECRET_MODE)
}

/// First and last valid moment of the certificate, microseconds since the UNIX epoch.
pub(crate) fn validity(identity: &TlsIdentity) -> Result<(u64, u64), Rejection> {
    let certificate = Certificate::parse(identity.own().certificate())?;
    Ok((certificate.not_before, certificate.not_after))
}

/// The identity of the node: verified as of the last moment of its certificate, which may be over.
fn own_identity(identity: &TlsIdentity, msps: &Msps) -> Result<Identity, Rejection> {
    let own = identity.own();
    let presented = own.chain.get(1..).unwrap_or_default();
    let (_, not_after) = validity(identity)?;
    Ok(msps.verify_for(Usage::Server, own.certificate(), presented, not_after.min(wall()))?)
}
