//! Calls that this node refused before ordering: counted by code, and the last ones kept for an admin to see.

use ledger::Refusal;
use ledger_api::v1::Denial;
use ledger_rejection::Rejection;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Mutex, PoisonError};

/// Refusals kept; a flood of the same one takes one place.
const KEPT_MAX: usize = 1000;
/// Bytes of a subject that are kept.
const SUBJECT_BYTES_MAX: usize = 256;

/// Refusals of this node since it started.
#[derive(Default)]
pub(crate) struct Denials {
    kept: Mutex<Kept>,
}

#[derive(Default)]
struct Kept {
    latest: VecDeque<Denial>,
    counts: BTreeMap<u32, u64>,
}

impl Denials {
    /// Takes down a refusal at the node's time, microseconds.
    pub(crate) fn record(&self, now: u64, refusal: &Refusal) {
        let body = refusal.transaction.as_ref().map(ledger::transaction::Transaction::body);
        let subject = body.and_then(|body| body.args.first()).filter(|arg| arg.len() <= SUBJECT_BYTES_MAX);
        self.count(Denial {
            time: now,
            who: refusal.who.clone().unwrap_or_default(),
            chaincode: body.map(|body| body.chaincode.clone()).unwrap_or_default(),
            function: body.map(|body| body.function.clone()).unwrap_or_default(),
            subject: subject.map(|arg| String::from_utf8_lossy(arg).into_owned()).unwrap_or_default(),
            verdict: Some((&refusal.rejection).into()),
            count: 1,
        });
    }

    /// Takes down that a subscription was refused, or ended because of this, at the node's time, microseconds.
    pub(crate) fn record_subscription(&self, now: u64, who: String, chaincode: &str, subject: &str, why: &Rejection) {
        self.count(Denial {
            time: now,
            who,
            chaincode: chaincode.to_owned(),
            function: "subscribe".to_owned(),
            subject: Some(subject).filter(|subject| subject.len() <= SUBJECT_BYTES_MAX).unwrap_or_default().to_owned(),
            verdict: Some(why.into()),
            count: 1,
        });
    }

    fn count(&self, denial: Denial) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let code = denial.verdict.as_ref().map_or(0, |verdict| verdict.code);
        *kept.counts.entry(code).or_default() += 1;
        let now = denial.time;
        if let Some(last) = kept.latest.iter_mut().rev().take(8).find(|last| alike(last, &denial)) {
            last.count += 1;
            last.time = now;
            last.verdict = denial.verdict;
            return;
        }
        if kept.latest.len() == KEPT_MAX {
            kept.latest.pop_front();
        }
        kept.latest.push_back(denial);
    }

    /// The last refusals, newest first.
    pub(crate) fn latest(&self, limit: usize) -> Vec<Denial> {
        let kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.latest.iter().rev().take(limit).cloned().collect()
    }

    /// How many refusals there were, by number of the code.
    pub(crate) fn counts(&self) -> BTreeMap<u32, u64> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner).counts.clone()
    }
}

fn alike(a: &Denial, b: &Denial) -> bool {
    let code = |denial: &Denial| denial.verdict.as_ref().map(|verdict| verdict.code);
    (&a.who, &a.chaincode, &a.function, &a.subject, code(a)) == (&b.who, &b.chaincode, &b.function, &b.subject, code(b))
}
