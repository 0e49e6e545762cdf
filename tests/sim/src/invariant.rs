//! The invariants of every moment, whatever happens: one file each, with its source.
//!
//! Each invariant is a small state machine that is told what the nodes do and compares it with what it was told
//! before. It sees all nodes at once, which no node does. [`Invariants`] passes on what the world observes.

mod acknowledged;
mod answered_is_seen;
mod certified;
mod chain_agreement;
mod committed;
mod denied_by_default;
mod election_safety;
mod epochs_grow;
mod exactly_once;
mod fair_share;
mod gate;
mod grant_exclusivity;
mod honest_leaders;
mod in_order;
mod informed_votes;
mod keeps_time;
mod leader_completeness;
mod log_matching;
mod members;
mod nobody_is_overtaken;
mod refused_is_final;
mod revoked;
mod rules_by_height;
mod snapshot_trust;
mod state_agreement;
mod stops_last;

pub use acknowledged::AcknowledgedIsDurable;
pub use answered_is_seen::AnsweredIsSeen;
pub use certified::CertificatesAreTrue;
pub use chain_agreement::ChainAgreement;
pub use committed::CommittedIsImmutable;
pub use denied_by_default::DeniedByDefault;
pub use election_safety::ElectionSafety;
pub use epochs_grow::EpochsGrow;
pub use exactly_once::ExactlyOnce;
pub use fair_share::FairShare;
pub use gate::{GateKeepsTheRules, Passed};
pub use grant_exclusivity::GrantExclusivity;
pub use honest_leaders::HonestLeadersStay;
pub use in_order::{Call, InOrder};
pub use informed_votes::VotesAreInformed;
pub use keeps_time::BlockTimeKeepsToTheClocks;
pub use leader_completeness::LeaderCompleteness;
pub use log_matching::LogMatching;
pub use members::MembersFollowTheLedger;
pub use nobody_is_overtaken::NobodyIsOvertaken;
pub use refused_is_final::RefusedIsFinal;
pub use revoked::RevokedStaysRevoked;
pub use rules_by_height::RulesByHeight;
pub use snapshot_trust::SnapshotsAreAttested;
pub use state_agreement::StateAgreement;
pub use stops_last::StopsLast;

use crate::people::People;
use bytes::Bytes;
use ledger::Outcome;
use ledger::transaction::Transaction;
use serde::Deserialize;
use std::fmt;
use std::sync::Arc;

/// A promise that was broken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// Which one, e.g. `election safety`.
    pub invariant: &'static str,
    /// The violation that was found.
    pub what: String,
}

impl Violation {
    /// A broken promise.
    pub fn new(invariant: &'static str, what: impl Into<String>) -> Self {
        Self { invariant, what: what.into() }
    }
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.invariant, self.what)
    }
}

/// The answer of a check.
pub type Check = Result<(), Violation>;

/// A block that a node has executed, with its transactions read once for all invariants.
pub struct Executed<'a> {
    /// The node.
    pub node: u64,
    /// The outcome.
    pub outcome: &'a Outcome,
    /// Its transactions; none where the bytes are not one.
    pub transactions: &'a [Option<Transaction>],
}

/// Is it a service of one of these robots, given as JSON?
fn is_of(service: &str, robots: &[Bytes]) -> bool {
    #[derive(Deserialize)]
    struct Robot {
        name: String,
    }
    let name = |robot: &Bytes| serde_json::from_slice::<Robot>(robot).unwrap().name;
    robots.iter().any(|robot| service.split('/').next() == Some(name(robot).as_str()))
}

/// All invariants.
pub struct Invariants {
    /// At most one leader a term, one vote a term.
    pub election_safety: ElectionSafety,
    /// Logs that agree at one place agree before it.
    pub log_matching: LogMatching,
    /// A new leader has everything that was committed.
    pub leader_completeness: LeaderCompleteness,
    /// One chain.
    pub chain_agreement: ChainAgreement,
    /// One state at each height.
    pub state_agreement: StateAgreement,
    /// A transaction is executed once.
    pub exactly_once: ExactlyOnce,
    /// Promised entries are on disks.
    pub acknowledged: AcknowledgedIsDurable,
    /// At most as many holders as the mode allows.
    pub grant_exclusivity: GrantExclusivity,
    /// A grant from a line goes to whose turn it is.
    pub overtaken: NobodyIsOvertaken,
    /// A robot that is stopped stays stopped.
    pub stops_last: StopsLast,
    /// Epochs never come twice.
    pub epochs_grow: EpochsGrow,
    /// A caller without a right has no success.
    pub denied_by_default: DeniedByDefault,
    /// A revoked identity does nothing any more.
    pub revoked: RevokedStaysRevoked,
    /// Committed entries do not change.
    pub committed: CommittedIsImmutable,
    /// A transaction that was refused for good is not executed.
    pub refused_is_final: RefusedIsFinal,
    /// A block has the rules of its height.
    pub rules_by_height: RulesByHeight,
    /// Every later call sees the answers that were given.
    pub answered_is_seen: AnsweredIsSeen,
    /// A flood keeps nobody out.
    pub fair_share: FairShare,
    /// No later call overtakes an earlier one.
    pub in_order: InOrder,
    /// Nobody goes on from a snapshot that too few attest.
    pub snapshot_trust: SnapshotsAreAttested,
    /// Nobody votes without knowing whether it has lost blocks.
    pub informed_votes: VotesAreInformed,
    /// Complaints depose liars only.
    pub honest_leaders: HonestLeadersStay,
    /// Members come and go by transactions.
    pub members: MembersFollowTheLedger,
    /// Certificates say what was executed.
    pub certified: CertificatesAreTrue,
    /// No block is further ahead than a majority allows.
    pub keeps_time: BlockTimeKeepsToTheClocks,
    /// A robot's gate passes what the certified state allows.
    pub gate: GateKeepsTheRules,
}

impl Invariants {
    /// Before anything has happened.
    pub fn new(people: &Arc<People>) -> Self {
        Self {
            election_safety: ElectionSafety::default(),
            log_matching: LogMatching::default(),
            leader_completeness: LeaderCompleteness::default(),
            chain_agreement: ChainAgreement::default(),
            state_agreement: StateAgreement::default(),
            exactly_once: ExactlyOnce::default(),
            acknowledged: AcknowledgedIsDurable::default(),
            grant_exclusivity: GrantExclusivity::default(),
            overtaken: NobodyIsOvertaken::new(Arc::clone(people)),
            stops_last: StopsLast::default(),
            epochs_grow: EpochsGrow::default(),
            denied_by_default: DeniedByDefault::new(Arc::clone(people)),
            revoked: RevokedStaysRevoked::new(Arc::clone(people)),
            committed: CommittedIsImmutable::default(),
            refused_is_final: RefusedIsFinal::default(),
            rules_by_height: RulesByHeight::default(),
            answered_is_seen: AnsweredIsSeen::default(),
            fair_share: FairShare,
            in_order: InOrder::default(),
            snapshot_trust: SnapshotsAreAttested::default(),
            informed_votes: VotesAreInformed::default(),
            honest_leaders: HonestLeadersStay::default(),
            members: MembersFollowTheLedger::default(),
            certified: CertificatesAreTrue::default(),
            keeps_time: BlockTimeKeepsToTheClocks::default(),
            gate: GateKeepsTheRules::new(Arc::clone(people), crate::robot::STALE_AFTER),
        }
    }

    /// A node has executed a block; `first` if no node had before.
    ///
    /// # Errors
    /// The promise that this breaks.
    pub fn executed(&mut self, executed: &Executed<'_>, first: bool) -> Check {
        self.chain_agreement.executed(executed)?;
        self.state_agreement.executed(executed)?;
        if first {
            self.exactly_once.executed(executed)?;
            self.refused_is_final.executed(executed)?;
            self.epochs_grow.executed(executed)?;
            self.denied_by_default.executed(executed)?;
            self.revoked.executed(executed)?;
            self.grant_exclusivity.executed(executed)?;
            self.overtaken.executed(executed)?;
            self.stops_last.executed(executed)?;
            self.snapshot_trust.executed(executed);
        }
        Ok(())
    }
}
