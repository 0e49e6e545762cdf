//! Calls that this node refused before ordering: counted by code, the last ones kept for an admin to see, and gathered for the
//! ledger.

mod gathered;

pub(crate) use gathered::Gathered;

use gathered::One;
use ledger::Refusal;
use ledger::transaction::Transaction;
use ledger_api::v1::Denial;
use ledger_base::rejection::Rejection;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// Refusals kept; a flood of the same one takes one place.
const KEPT_MAX: usize = 1000;
/// Bytes of a subject that are kept.
const SUBJECT_BYTES_MAX: usize = 256;
/// Codes from here on say nothing about a call, only about the node.
const OF_THE_NODE: u16 = 4000;

/// Refusals of this node since it started.
#[derive(Default)]
pub(crate) struct Rejections {
    kept: Mutex<Kept>,
    gathered: Mutex<Gathered>,
    /// Told when something was gathered.
    news: Notify,
}

#[derive(Default)]
struct Kept {
    latest: VecDeque<Denial>,
    counts: BTreeMap<u32, u64>,
}

impl Rejections {
    /// Takes down a refusal at the node's time, microseconds.
    pub(crate) fn record(&self, now: u64, refusal: &Refusal) {
        let body = refusal.transaction.as_ref().map(Transaction::body);
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
        let sample = refusal.transaction.as_ref().map(Transaction::id);
        let (function, subject) = match body {
            Some(body) => (body.function.clone(), body.args.first().map(|arg| named(arg)).unwrap_or_default()),
            None => Default::default(),
        };
        let who = refusal.who.clone().unwrap_or_default();
        let chaincode = body.map(|body| body.chaincode.clone()).unwrap_or_default();
        self.gather(One { who, chaincode, function, subject, time: now, sample, ..One::default() }, &refusal.rejection);
    }

    /// Takes down that a subscription was refused, or ended because of this, at the node's time, microseconds.
    pub(crate) fn record_subscription(&self, now: u64, who: String, chaincode: &str, subject: &str, why: &Rejection) {
        let one = One {
            who: who.clone(),
            chaincode: chaincode.to_owned(),
            function: "subscribe".to_owned(),
            subject: named(subject.as_bytes()),
            time: now,
            ..One::default()
        };
        self.gather(one, why);
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

    /// Gathers one for the ledger, unless it is this node's own trouble.
    fn gather(&self, one: One, why: &Rejection) {
        if why.code.number() >= OF_THE_NODE {
            return;
        }
        let code = why.code.number().into();
        self.gathered().add(One { code, why: why.message.clone(), found: why.found.clone(), ..one });
        self.news.notify_one();
    }

    /// The refusals that are not on the ledger yet.
    pub(crate) fn gathered(&self) -> MutexGuard<'_, Gathered> {
        self.gathered.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until something is gathered.
    pub(crate) async fn news(&self) {
        self.news.notified().await;
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
        if kept.latest.len() >= KEPT_MAX {
            forget_one(&mut kept.latest);
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

/// Forgets the oldest refusal of the identity that has the most, so that a flood of one displaces no refusal of another.
fn forget_one(latest: &mut VecDeque<Denial>) {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    latest.iter().for_each(|denial| *counts.entry(&denial.who).or_default() += 1);
    let most = counts.into_iter().max_by_key(|(_, count)| *count).map(|(who, _)| who.to_owned());
    if let Some(at) = latest.iter().position(|denial| most.as_ref() == Some(&denial.who)) {
        latest.remove(at);
    }
}

/// An argument as the name of something; empty if it is none, such as the description of a robot.
fn named(argument: &[u8]) -> String {
    let text = std::str::from_utf8(argument).unwrap_or_default();
    let fits = text.len() <= SUBJECT_BYTES_MAX && text.chars().all(|c| c.is_alphanumeric() || "/_-.:*".contains(c));
    if fits { text.to_owned() } else { String::new() }
}

fn alike(a: &Denial, b: &Denial) -> bool {
    let code = |denial: &Denial| denial.verdict.as_ref().map(|verdict| verdict.code);
    (&a.who, &a.chaincode, &a.function, &a.subject, code(a)) == (&b.who, &b.chaincode, &b.function, &b.subject, code(b))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_base::rejection::Code;

    #[test]
    fn a_flood_of_one_identity_displaces_no_refusal_of_another_one() {
        let rejections = Rejections::default();
        let why = Rejection::new(Code::DeniedByPolicy, "no");
        rejections.record_subscription(0, "Org1/Thief".into(), "abac", "Husky/cmd_vel", &why);
        for at in 0..2 * KEPT_MAX as u64 {
            rejections.record_subscription(at, "Org2/Accomplice".into(), "abac", &format!("Robot{at}/cmd_vel"), &why);
        }
        let latest = rejections.latest(KEPT_MAX);
        assert_eq!(latest.len(), KEPT_MAX);
        assert_eq!(latest.last().unwrap().who, "Org1/Thief");
    }
}
