//! The nodes that hold the keys of CAs, by the ledger.

use crate::ordering::directory::Member;
use ledger::Ledger;
use ledger::msp;
use ledger_base::rejection::Rejection;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// For how long what was read is used: a status is asked for every second.
const READ_EVERY: Duration = Duration::from_secs(2);

/// The key of an organisation's CA.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct CaKey {
    /// The organisation.
    pub(crate) organisation: String,
    /// Full names of the nodes that hold it.
    pub(crate) holders: Vec<String>,
    /// An admin has taken a copy, as the ledger knows.
    pub(crate) has_copy: bool,
    /// End of the last valid certificate of an admin, microseconds; 0 if there is none, or if a node holds the key.
    pub(crate) admins_until: u64,
}

/// The keys that a node reports about: that of its organisation, and those of organisations without a node, which no other node would
/// report. An organisation whose CA is another software registers no names on the ledger, and is left out.
#[derive(Default)]
pub(crate) struct CaKeys {
    read: Mutex<Option<(Instant, Arc<[CaKey]>)>>,
}

impl CaKeys {
    /// The keys, as they were at most two seconds ago.
    ///
    /// # Errors
    /// A fault of the store.
    pub(crate) fn of(
        &self,
        ledger: &Ledger,
        members: &[Member],
        own: &str,
        now: u64,
    ) -> Result<Arc<[CaKey]>, Rejection> {
        let mut known = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((at, keys)) = &*known
            && at.elapsed() < READ_EVERY
        {
            return Ok(Arc::clone(keys));
        }
        let keys: Arc<[CaKey]> = read(ledger, members, own, now)?.into();
        *known = Some((Instant::now(), Arc::clone(&keys)));
        Ok(keys)
    }
}

fn read(ledger: &Ledger, members: &[Member], own: &str, now: u64) -> Result<Vec<CaKey>, Rejection> {
    let state = ledger.state();
    let carriers = msp::carriers(&**state)?;
    let has_node = |name: &str| members.iter().any(|member| member.organisation == name && member.wanted.is_some());
    let mut keys = Vec::new();
    for organisation in msp::organisations(&**state)?.into_iter().map(|organisation| organisation.name) {
        if (organisation != own && has_node(&organisation)) || !msp::has_registry(&**state, &organisation)? {
            continue;
        }
        let own: Vec<_> = carriers.iter().filter(|carrier| carrier.organisation == organisation).collect();
        let is_member =
            |name: &String| members.iter().any(|member| member.wanted.is_some() && member.full_name() == *name);
        let holders: Vec<String> = own.iter().map(|carrier| carrier.full_name()).filter(is_member).collect();
        let admins_until = if holders.is_empty() { msp::admins_until(&**state, &organisation, now)? } else { 0 };
        keys.push(CaKey {
            has_copy: own.iter().any(|carrier| carrier.copied.is_some()),
            organisation,
            holders,
            admins_until,
        });
    }
    Ok(keys)
}
