//! Renewal of the certificate of a stored context, by one program at a time.

use super::Renewal;
use crate::client::Client;
use crate::context::{Context, RenewalRule, bad_file, home, renewal_due, renewing, unwritable};
use ledger_base::rejection::Rejection;
use std::fs::{File, OpenOptions};
use std::io::Read;
use std::os::unix::fs::{FileExt, OpenOptionsExt};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::time::sleep;

/// A renewal that failed is not tried at every command.
const RETRY_AFTER: Duration = Duration::from_secs(600);
/// The reason of a try that has not come to its end.
const CUT_SHORT: &str = "the previous renewal was interrupted";
/// Bytes of a reason that are read.
const REASON_MAX: u64 = 4096;
/// How long one who was asked to renew waits for another one who does.
const OTHER_WAITS_MAX: Duration = Duration::from_secs(20);
/// Between two looks.
const LOOK: Duration = Duration::from_millis(20);

/// The outcome of an automatic renewal.
#[derive(Debug)]
pub enum Renewed {
    /// It was not due, is switched off, or another program does it.
    No,
    /// It has failed minutes ago, and is not tried again yet: why it failed.
    Failed(String),
    /// The context has a new certificate.
    Yes(Box<Context>),
}

impl Context {
    /// Renews the certificate of a stored context, if its last third has begun and nothing speaks against it. `client`
    /// is connected as this context, and by its clock it is judged.
    ///
    /// # Errors
    /// Why it could not be renewed; the present certificate stays in use, and the next try is minutes away.
    pub async fn renew_if_due(&self, client: &Client) -> Result<Renewed, Rejection> {
        let certificate = self.certificate()?;
        let due = renewal_due(certificate.not_before, certificate.not_after);
        let Some(home) = self.home().filter(|_| self.renew == RenewalRule::Auto && client.now() >= due) else {
            return Ok(Renewed::No);
        };
        let Some(turn) = Turn::take(&renewing(&home, &self.name))? else { return Ok(Renewed::No) };
        let stored = Self::load(&home, Some(&self.name))?;
        if stored.chain.first() != self.chain.first() {
            return Ok(Renewed::Yes(Box::new(stored)));
        }
        if let Some(reason) = turn.failed_lately() {
            return Ok(Renewed::Failed(reason));
        }
        // Until it has succeeded: a command that ends meanwhile must not make the next one wait as long.
        turn.failed(CUT_SHORT);
        match stored.ask(client, &home).await {
            Ok(renewed) => {
                turn.succeeded();
                Ok(Renewed::Yes(Box::new(renewed)))
            }
            Err(reason) => {
                turn.failed(&reason.message);
                Err(reason)
            }
        }
    }

    /// Renews the certificate of a stored context now, with a new key, and stores it. `client` is connected as this
    /// context. If another program is at it, what that one gets is the answer.
    ///
    /// # Errors
    /// As [`Renewal::finish`], what the CA says, and [`Code::BadFile`](ledger_base::rejection::Code::BadFile) before anything
    /// is asked for if the context cannot be changed.
    pub async fn renew(&self, client: &Client) -> Result<Self, Rejection> {
        let home = match self.home() {
            Some(home) => home,
            None => home()?,
        };
        let path = renewing(&home, &self.name);
        let deadline = Instant::now() + OTHER_WAITS_MAX;
        let turn = loop {
            match Turn::take(&path)? {
                Some(turn) => break turn,
                None if Instant::now() >= deadline => {
                    return Err(bad_file(&path, "a lock that another program holds")
                        .wanted("one renewal at a time")
                        .next(format!("wait for that program, or end it: fuser {}", path.display())));
                }
                None => sleep(LOOK).await,
            }
        };
        let stored = Self::load(&home, Some(&self.name))?;
        if stored.chain.first() != self.chain.first() {
            return Ok(stored);
        }
        let renewed = stored.ask(client, &home).await?;
        turn.succeeded();
        Ok(renewed)
    }

    async fn ask(&self, client: &Client, home: &Path) -> Result<Self, Rejection> {
        let renewal = Renewal::begin(&self.identity()?)?;
        let msps = self.learnt_organisations().unwrap_or(&self.msps);
        let certificate = client.certify(renewal.request()).await?;
        let renewed = renewal.finish_at(&certificate, msps, client.now())?.own();
        Self::change(home, &self.name, |context| {
            context.chain.clone_from(&renewed.chain);
            context.key = Arc::clone(&renewed.key);
            Ok(())
        })
    }
}

/// The right to renew a context. The system takes it back with the process, however that ends.
struct Turn {
    file: File,
}

impl Turn {
    /// None if somebody else has it.
    fn take(path: &Path) -> Result<Option<Self>, Rejection> {
        let file = OpenOptions::new().create(true).truncate(false).read(true).write(true).mode(0o600).open(path);
        let file = file.map_err(|error| unwritable(path, &error))?;
        Ok(file.try_lock().is_ok().then_some(Self { file }))
    }

    /// Why the last try failed, if that was not long ago. The file is empty after a try that succeeded.
    fn failed_lately(&self) -> Option<String> {
        let age = self.file.metadata().ok()?.modified().ok()?.elapsed().ok()?;
        let mut reason = String::new();
        (&self.file).take(REASON_MAX).read_to_string(&mut reason).ok()?;
        (age < RETRY_AFTER && !reason.is_empty()).then_some(reason)
    }

    fn failed(&self, reason: &str) {
        let _unnoted = self.file.set_len(0).and_then(|()| self.file.write_all_at(reason.as_bytes(), 0));
    }

    fn succeeded(&self) {
        let _unnoted = self.file.set_len(0);
    }
}
