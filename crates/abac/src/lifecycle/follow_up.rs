//! Follow-ups of a change of state. Changes return them; [settling](super::settle::settle) carries them out.

use crate::records::grant::Holding;
use crate::records::principal::Principal;
use ledger_contract::{LeftReason, Reason};

/// Something that follows from a change.
pub(crate) enum FollowUp {
    /// A grant ends.
    End(Box<Ending>),
    /// A grant that serves this task was given.
    TaskRuns(u64),
    /// The grant that served a task has ended.
    TaskGrantEnded {
        /// Number of the task.
        id: u64,
        /// Why the grant ended.
        reason: Reason,
    },
    /// A task has lost its place in the queue, and got no grant.
    TaskLeftQueue {
        /// Number of the task.
        id: u64,
        /// Why.
        reason: LeftReason,
    },
}

/// The end of a grant.
pub(crate) struct Ending {
    /// The grant as it is until then.
    pub(crate) holding: Holding,
    /// Why it ends.
    pub(crate) reason: Reason,
    /// The id of the next holder, if there is one.
    pub(crate) by: Option<String>,
    /// Does the robot keep moving, because another grant follows in this block?
    pub(crate) goes_on: bool,
    /// May it be reported by a later block, if this one has no room for more events? It ends now all the same.
    pub(crate) may_wait: bool,
}

impl Ending {
    /// The end of a grant, reported now.
    pub(crate) fn of(holding: &Holding, reason: Reason) -> FollowUp {
        Self { holding: holding.clone(), reason, by: None, goes_on: false, may_wait: false }.into()
    }

    /// The end of one of many grants, reported when there is room.
    pub(crate) fn of_many(holding: Holding, reason: Reason) -> FollowUp {
        Self { holding, reason, by: None, goes_on: false, may_wait: true }.into()
    }

    /// A grant ends because this contender takes its place.
    pub(crate) fn for_other(holding: &Holding, reason: Reason, by: &Principal) -> FollowUp {
        let by = matches!(reason, Reason::Preempted | Reason::Overridden).then(|| by.id());
        Self { holding: holding.clone(), reason, by, goes_on: false, may_wait: false }.into()
    }

    /// A grant ends because another one follows it in this block; the robot keeps moving between them, or stops.
    pub(crate) fn passed_on(holding: &Holding, reason: Reason, to: &str, goes_on: bool) -> FollowUp {
        Self { holding: holding.clone(), reason, by: Some(to.to_owned()), goes_on, may_wait: false }.into()
    }
}

impl From<Ending> for FollowUp {
    fn from(ending: Ending) -> Self {
        Self::End(Box::new(ending))
    }
}
