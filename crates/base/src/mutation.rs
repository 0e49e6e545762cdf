//! Deliberate bugs, to check that the simulation (`tests/sim`) would notice them. Each is a fault that a change could
//! bring in without any unit test failing.
//!
//! The switches are compiled in where debug assertions of this crate are on: in a development build, and in the profile `tests`
//! of `./test`. In a release [`active`] is a constant `false` and the compiler takes the bugs out; `packaging/check-release` looks
//! at a program for the switches.

use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};

/// A deliberate bug.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Mutation {
    /// The log is written and not synced.
    NoFsync = 1,
    /// A leader takes its own disk for the majority.
    AcknowledgeBeforeMajority,
    /// A new grant gets the epoch of the one before.
    ReuseAnEpoch,
    /// A grant that ends another's gets the epoch of that one.
    PreemptWithoutANewEpoch,
    /// A grant that is passed on keeps its epoch.
    PassOnWithoutANewEpoch,
    /// A free place goes to whoever asks, though others in line precede.
    SkipTheLine,
    /// A node that opens its state forgets which robots are stopped.
    ForgetAStop,
    /// A contender that confirms itself counts.
    CountTheRequester,
    /// A task begins although somebody else holds the service.
    RunBesideAHolder,
    /// A task that was interrupted waits again although its submitter did not want that.
    AlwaysWaitAgain,
    /// One more reads a service than its owner allows.
    OnePlaceTooMany,
    /// Somebody whom policies permit to read needs no place.
    ReadWithoutAPlace,
    /// A revoked certificate is accepted.
    SkipTheRevocationCheck,
    /// A `forbid` that cannot be evaluated is skipped.
    AcceptAnErringForbid,
    /// The vote is not written to the disk.
    ForgetTheVote,
    /// A node that has caught up says that it holds one block more than it does.
    CatchUpOffByOne,
    /// A lease is measured by the node's wall clock.
    WallClockLease,
    /// The writes of a block go into the state digest in any order.
    UnsortedDigest,
    /// Entries that a start reads from the log are not checked again.
    NoRecheckAfterRestart,
    /// A gateway refuses without knowing whether its state is current.
    RefuseOnAnOldState,
    /// A gateway refuses a repetition as if no other copy could be on its way.
    RefuseARetry,
    /// A client is answered with the verdict on a copy that somebody else forged.
    AnswerWithAForgedCopy,
    /// A client that waits while another node begins to lead is forgotten.
    ForgetAWaiter,
    /// A node takes its own state for current without asking the leader.
    AnswerAMinorityRead,
    /// A snapshot is believed that one organisation attests.
    BelieveOneOrganisation,
    /// A gateway looks at messages before what ends or hands over control.
    DataOvertakesControl,
    /// A later call about a subject is decided while an earlier one is held.
    OvertakeWhatIsHeld,
    /// One identity may use a gateway alone.
    IgnoreTheShare,
    /// A client whose verdict does not come is never told so.
    ForgetADeadline,
    /// A node that catches up takes blocks that nobody confirms.
    TakeUnconfirmedBlocks,
    /// A node votes before it knows whether it has lost blocks.
    VoteBeforeTheAnswers,
    /// A node that was removed keeps its vote.
    KeepARemovedVoter,
    /// The first block after a snapshot is executed twice.
    ApplyTwiceAfterASnapshot,
    /// A node executes the block at which newer rules begin by the older ones.
    OlderRulesAtTheActivation,
    /// Every member may send every message of the ordering protocol.
    BelieveAnybody,
    /// A voter that says that it was elected need not show it.
    FollowWithoutMandate,
    /// The signature of a node that does not vote counts for a certificate.
    CountALearner,
    /// The signature of a voter counts twice for a certificate.
    CountAVoterTwice,
    /// A voter's statement about other results of a block counts for its certificate.
    CountOtherResults,
    /// A voter acknowledges a block of any time.
    AcknowledgeAnyTime,
    /// A leader takes the time of its blocks from its own clock alone.
    OrderByOneClock,
    /// A robot believes its node that somebody has been granted a service.
    BelieveAGrant,
    /// A robot does not compare epochs.
    IgnoreEpochs,
    /// A robot goes on without an answer of the voters for as long as its node talks.
    IgnoreStaleness,
    /// The approval of the one who proposed a set of policies counts twice.
    CountTheProposerTwice,
    /// A revocation list is taken that was made before the one that the ledger has.
    TakeAnOlderList,
    /// A message is taken under a content key from before a reader was taken out.
    KeepAnOldContentKey,
    /// A content key is taken that was wrapped for others than those who may read.
    ShareWithAnybody,
    /// A stop that a robot was notified of ends with the next answer of the voters, whatever becomes of it.
    ForgetAnOpenStop,
    /// A strict certificate needs more than half of the voters, however many of them are in one hand.
    ForgetTheHands,
    /// A node takes a proof of misbehaviour without looking at its signatures.
    BelieveAnyProof,
    /// A node does not send a proof of misbehaviour to other nodes.
    KeepAProofForItself,
    /// A node still follows one that it has proved to lie.
    FollowALiar,
    /// A node stops for the certificate of another block without counting who has signed it.
    StopForAnyCertificate,
    /// A node leaves a block that its own strict certificate covers.
    DropACertifiedBlock,
    /// A vote for a handover is given without the signature of the leader.
    HonourAnyTransfer,
    /// A voter's complaint deposes a leader alone.
    BelieveOneComplaint,
    /// A voter does not complain about a leader that withholds calls.
    NeverComplain,
    /// A follower appends to its log whatever the leader sends, although the block before is another one.
    AppendToAnyLog,
    /// A leader counts an acknowledgement without looking at which log it is about.
    CountAnyLog,
    /// An organisation takes the vote of its own node although certificates are not strict any more then.
    DemoteFreely,
}

/// Are the switches in this build?
pub const COMPILED_IN: bool = cfg!(debug_assertions);

static ACTIVE: AtomicU8 = AtomicU8::new(0);
static WALL_CLOCK: AtomicU64 = AtomicU64::new(0);

/// Is this bug turned on? A constant where the switches are not compiled in.
#[inline]
pub fn active(mutation: Mutation) -> bool {
    COMPILED_IN && ACTIVE.load(Ordering::Relaxed) == mutation as u8
}

/// Turns a bug on in the whole process, and any other off. No effect where the switches are not compiled in.
pub fn turn_on(mutation: Option<Mutation>) {
    ACTIVE.store(mutation.map_or(0, |mutation| mutation as u8), Ordering::Relaxed);
}

/// Sets the clock of [`Mutation::WallClockLease`], microseconds since the UNIX epoch.
pub fn set_wall_clock(now: u64) {
    WALL_CLOCK.store(now, Ordering::Relaxed);
}

/// The clock by which a lease is measured: block time.
#[inline]
pub fn lease_clock(block_time: u64) -> u64 {
    if active(Mutation::WallClockLease) { WALL_CLOCK.load(Ordering::Relaxed) } else { block_time }
}

/// The error of the machine's wall clock that a test wishes, microseconds; 0 in a release. It is the number of milliseconds in the
/// environment variable `LEDGERD_TEST_CLOCK_AHEAD_MS`.
pub fn clock_error() -> i64 {
    static ERROR: std::sync::OnceLock<i64> = std::sync::OnceLock::new();
    if !COMPILED_IN {
        return 0;
    }
    let wished = || std::env::var("LEDGERD_TEST_CLOCK_AHEAD_MS").ok()?.parse::<i64>().ok()?.checked_mul(1000);
    *ERROR.get_or_init(|| wished().unwrap_or_default())
}

/// For how long the machine was suspended, as a test wishes, microseconds; 0 in a release. The file that the environment variable
/// `LEDGERD_TEST_SUSPENDED` names has it in milliseconds, and may change at any time. Clocks go on while a machine is suspended, timers do
/// not.
pub fn suspended() -> u64 {
    static FILE: std::sync::OnceLock<Option<std::path::PathBuf>> = std::sync::OnceLock::new();
    if !COMPILED_IN {
        return 0;
    }
    let file = FILE.get_or_init(|| std::env::var_os("LEDGERD_TEST_SUSPENDED").map(std::path::PathBuf::from));
    let read =
        |file: &std::path::PathBuf| std::fs::read_to_string(file).ok()?.trim().parse::<u64>().ok()?.checked_mul(1000);
    file.as_ref().and_then(read).unwrap_or_default()
}

/// Withholds this node control calls while it leads, as a test wishes? Never in a release. It does if the environment variable
/// `LEDGERD_TEST_WITHHOLDS_CONTROL` is set.
pub fn withholds_control() -> bool {
    static WITHHOLDS: std::sync::OnceLock<bool> = std::sync::OnceLock::new();
    COMPILED_IN && *WITHHOLDS.get_or_init(|| std::env::var_os("LEDGERD_TEST_WITHHOLDS_CONTROL").is_some())
}
