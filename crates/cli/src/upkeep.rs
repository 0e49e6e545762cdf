//! Upkeep of a context beside the command that uses it: it renews the certificate in time, and warns of a wrong clock.
//!
//! None of it keeps a command waiting: it begins when the command is connected, goes on beside it, and has a moment
//! more when the command is done.

use crate::output::{Format, warn};
use crate::time;
use ledger_api::context::{RenewalRule, warning_due};
use ledger_api::{Client, Context, Renewed};
use ledger_base::rejection::Rejection;
use std::cell::RefCell;
use std::time::Duration;
use tokio::task::JoinHandle;
use tokio::time::timeout;

/// How long a renewal may go on after the command is done.
const RENEWAL_MAX: Duration = Duration::from_secs(3);
/// Clocks that differ by more, in microseconds, are spoken of.
const CLOCK_OFF: u64 = 5 * 60 * 1_000_000;

/// The work beside one command.
#[derive(Debug, Default)]
pub(crate) struct Upkeep {
    begun: RefCell<Option<JoinHandle<()>>>,
}

impl Upkeep {
    /// Begins, once for a command, as the context that it is connected as.
    pub(crate) fn begin(&self, format: Format, context: &Context, client: &Client) {
        let mut begun = self.begun.borrow_mut();
        if begun.is_none() {
            let (context, client) = (context.clone(), client.clone());
            *begun = Some(tokio::spawn(async move { look_after(format, &context, &client).await }));
        }
    }

    /// Ends with the command. One that was not connected looks at the certificate of the selected context all the same.
    pub(crate) async fn finish(&self, format: Format, selected: impl FnOnce() -> Result<Context, Rejection>) {
        let begun = self.begun.borrow_mut().take();
        let done = match begun {
            Some(begun) => timeout(RENEWAL_MAX, begun).await.is_ok(),
            None => false,
        };
        if !done && let Ok(context) = selected() {
            warn_of_end(format, &context, time::now(), None);
        }
    }
}

async fn look_after(format: Format, context: &Context, client: &Client) {
    let (here, there) = (time::now(), client.now());
    if here.abs_diff(there) > CLOCK_OFF {
        let way = if here > there { "ahead of" } else { "behind" };
        let message = format!("the clock of this machine is {} {way} the network's", time::span(here.abs_diff(there)));
        warn(format, &message, "set it: timedatectl set-ntp true");
    }
    match context.renew_if_due(client).await {
        Ok(Renewed::Yes(renewed)) => warn_of_end(format, &renewed, there, None),
        Ok(Renewed::No) => warn_of_end(format, context, there, None),
        Ok(Renewed::Failed(reason)) => warn_of_end(format, context, there, Some(&reason)),
        Err(reason) => warn_of_end(format, context, there, Some(&reason.message)),
    }
}

/// Warns of the end of a certificate, if it is near, or of a renewal that failed.
fn warn_of_end(format: Format, context: &Context, now: u64, failed: Option<&str>) {
    let Ok(own) = context.certificate() else { return };
    let name = &context.name;
    let id = format!("{}/{}", context.organisation, own.name().unwrap_or(name));
    let ends = format!("{} ({})", time::moment(own.not_after), time::relative(own.not_after, now));
    let again = match context.renew {
        RenewalRule::Auto => format!("ledgerctl identity renew --context {name}"),
        // It may be of a CA that is another software.
        RenewalRule::Never => format!(
            "ledgerctl identity renew --context {name}; or, if another CA issued it, get a new one there and run \
             ledgerctl identity import --force"
        ),
    };
    match failed {
        _ if now > own.not_after => {
            warn(format, &format!("the certificate of {id} has expired: {ends}"), &context.way_back());
        }
        Some(reason) => {
            let message = format!("the certificate of {id} ends {ends} and could not be renewed: {reason}");
            warn(format, &message, &format!("{again}, once that is fixed"));
        }
        None if now >= warning_due(own.not_before, own.not_after) => {
            warn(format, &format!("the certificate of {id} ends {ends}"), &again);
        }
        None => {}
    }
}
