//! Puts on the ledger what this node refused before ordering: at most once in a second, and seldom while a flood lasts.

use crate::clients::rejections::Rejections;
use crate::ordering::Ordering;
use crate::ordering::node_transactions::Author;
use ledger::msp::TellRefusals;
use ledger::transaction::Transaction;
use ledger_base::rejection::Code;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::sleep;

/// Shortest time between two tellings. The ledger refuses a node that tells again within a second of block time.
const PAUSE_MIN: Duration = Duration::from_millis(1200);
/// Longest time between them: each telling that follows another one at once doubles it.
const PAUSE_MAX: Duration = Duration::from_secs(10);
/// So much more is gathered before the first telling.
const GATHERED_FOR: Duration = Duration::from_millis(200);
/// So long after its `not_after`, by this node's clock, no block takes a transaction any more, microseconds.
const PAST: u64 = 10_000_000;

/// The task that reports rejections to the ledger.
pub(crate) struct Reporting {
    /// Signs the reports.
    pub author: Arc<Author>,
    /// The rejections.
    pub rejections: Arc<Rejections>,
    /// The node's clock, and its disk.
    pub ordering: Arc<Ordering>,
}

/// A telling that has no verdict yet.
struct Waiting {
    signed: Transaction,
    told: TellRefusals,
}

/// Outcome of a report.
enum Reported {
    OnTheLedger,
    Open,
    /// It is on no ledger, and never will be.
    Lost,
}

impl Reporting {
    /// Tells until the node stops. Nobody waits for it. The last second before a crash is lost.
    pub(crate) async fn run(self) {
        let (mut pause, mut waiting) = (PAUSE_MIN, None);
        loop {
            if waiting.is_none() && self.rejections.gathered().is_empty() {
                pause = PAUSE_MIN;
                self.rejections.news().await;
                sleep(GATHERED_FOR).await;
            }
            waiting = self.step(waiting);
            sleep(pause).await;
            pause = (pause * 2).min(PAUSE_MAX);
        }
    }

    /// Looks after the last telling, or begins another one.
    fn step(&self, waiting: Option<Waiting>) -> Option<Waiting> {
        let open = waiting.and_then(|before| match self.reported(&before) {
            Reported::OnTheLedger => None,
            Reported::Open => Some(before),
            Reported::Lost => {
                self.rejections.gathered().take_back(before.told);
                None
            }
        });
        let waiting = open.or_else(|| self.begin())?;
        // Perhaps the same bytes again: they are executed once.
        if let Err(reason) = self.author.order(&waiting.signed) {
            tracing::debug!(code = reason.code.name(), %reason, "cannot report rejections to the ledger now");
        }
        Some(waiting)
    }

    fn begin(&self) -> Option<Waiting> {
        let has_room = self.ordering.storage.space.check(|| false).is_ok();
        if !has_room {
            return None;
        }
        let told = self.rejections.gathered().take()?;
        match self.author.sign("tell_refusals", &told) {
            Ok(signed) => Some(Waiting { signed, told }),
            Err(reason) => {
                tracing::warn!(code = reason.code.name(), %reason, "cannot sign the rejection report");
                self.rejections.gathered().take_back(told);
                None
            }
        }
    }

    fn reported(&self, waiting: &Waiting) -> Reported {
        let ledger = &self.ordering.storage.ledger;
        match ledger.transaction(&waiting.signed.id()) {
            Ok(Some(record)) if record.result.code() == Code::Ok => Reported::OnTheLedger,
            Ok(Some(record)) => {
                tracing::debug!(code = %record.result.code(), "rejection report failed; sending it again");
                Reported::Lost
            }
            Ok(None) if self.ordering.clock.now() > waiting.signed.body().not_after.saturating_add(PAST) => {
                Reported::Lost
            }
            Ok(None) => Reported::Open,
            Err(reason) => {
                tracing::warn!(code = reason.code.name(), %reason, "cannot check whether the ledger has the rejection \
                                                                    report");
                Reported::Open
            }
        }
    }
}
