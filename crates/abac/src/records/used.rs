//! The past use of a service, for rules that remember it: for how long each contender held it within the last hour.

use super::store;
use ledger::Context;
use ledger_base::rejection::Rejection;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// How far back use is remembered (microseconds).
pub(crate) const REMEMBERED_US: u64 = 3_600_000_000;
/// Most spans that are kept for one contender; beyond it the two oldest count as one.
const SPANS_MAX: usize = 32;

/// When somebody held the service, oldest first (block time, microseconds).
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Used(Vec<(u64, u64)>);

impl Used {
    /// How long within the last hour (microseconds).
    fn within(&self, now: u64) -> u64 {
        let since = now.saturating_sub(REMEMBERED_US);
        self.0.iter().map(|(from, to)| to.saturating_sub(*from.max(&since))).sum()
    }

    fn forget(&mut self, now: u64) {
        self.0.retain(|(_, to)| to.saturating_add(REMEMBERED_US) > now);
        while self.0.len() > SPANS_MAX {
            let (from, _) = self.0.remove(0);
            if let Some(oldest) = self.0.first_mut() {
                oldest.0 = from;
            }
        }
    }
}

/// Notes that somebody held the service between these times, and forgets whoever has not held it for an hour.
pub(crate) fn add(ctx: &mut Context<'_>, service: &str, holder: &str, (from, to): (u64, u64)) -> Result<(), Rejection> {
    let (now, own) = (ctx.block_time(), store::used_key(service, holder));
    let mut used: Used = store::read(ctx, &own)?.unwrap_or_default();
    used.0.push((from, to));
    used.forget(now);
    store::write(ctx, &own, &used)?;
    for (key, value) in ctx.range(&store::used_prefix(service), usize::MAX) {
        if store::parse::<Used>(&key, &value)?.within(now) == 0 {
            ctx.delete(&key);
        }
    }
    Ok(())
}

/// How long each one held the service within the last hour (microseconds), without grants that last still.
pub(crate) fn all(ctx: &Context<'_>, service: &str) -> Result<BTreeMap<String, u64>, Rejection> {
    let prefix = store::used_prefix(service);
    let used = ctx.range(&prefix, usize::MAX).into_iter().map(|(key, value)| {
        let holder = String::from_utf8_lossy(key.get(prefix.len()..).unwrap_or_default()).into_owned();
        Ok((holder, store::parse::<Used>(&key, &value)?.within(ctx.block_time())))
    });
    used.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_last_hour_counts_and_little_is_kept() {
        let hour = REMEMBERED_US;
        let mut used = Used(vec![(0, hour / 2), (hour, hour + 10)]);
        assert_eq!(used.within(hour + 10), hour / 2 - 10 + 10);
        assert_eq!(used.within(2 * hour), 10);
        used.forget(2 * hour);
        assert_eq!(used.0, [(hour, hour + 10)]);
        let mut many = Used((0..40).map(|at| (at * 10, at * 10 + 5)).collect());
        many.forget(1000);
        assert_eq!((many.0.len(), many.0.first()), (SPANS_MAX, Some(&(0, 85))));
    }
}
