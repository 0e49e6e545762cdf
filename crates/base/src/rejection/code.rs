//! Stable codes for everything the system may answer.
//!
//! A code never changes its meaning and is never reused. The number is stored in blocks' results and covered by the
//! state digest. The name is for people and their searches. The class decides how a client reacts (and the exit code of
//! `ledgerctl`). The text behind some classes is the general advice of the code. Each code has a paragraph in
//! `docs/errors.md`, which says the same.

use std::fmt;

/// The kind of answer of a code; decides the exit code of command-line tools.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Class {
    /// It worked.
    Ok,
    /// It failed for a reason that is neither the caller's input nor their rights.
    Failure,
    /// The caller may not do this.
    Denied,
    /// The input is wrong; repeating it unchanged cannot succeed.
    Invalid,
    /// No node answered, or no majority could be reached; repeating it may succeed.
    Unreachable,
    /// Another identity holds the requested service.
    Conflict,
}

impl Class {
    /// The exit code that command-line tools use for this class.
    pub const fn exit_code(self) -> u8 {
        match self {
            Self::Ok => 0,
            Self::Failure => 1,
            Self::Denied => 2,
            Self::Invalid => 3,
            Self::Unreachable => 4,
            Self::Conflict => 5,
        }
    }
}

macro_rules! codes {
    ($($(#[$doc:meta])* $variant:ident = $number:literal $name:literal $class:ident $(, $advice:literal)?;)*) => {
        /// A stable code: `LGR-` and a number of four digits, or [`Code::Ok`].
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[non_exhaustive]
        pub enum Code { $($(#[$doc])* $variant,)* }

        impl Code {
            /// Every code, in ascending order of number.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];

            /// The number that is stored and transmitted.
            pub const fn number(self) -> u16 { match self { $(Self::$variant => $number,)* } }

            /// The name, in capitals, for logs and JSON.
            pub const fn name(self) -> &'static str { match self { $(Self::$variant => $name,)* } }

            /// How a client should react.
            pub const fn class(self) -> Class { match self { $(Self::$variant => Class::$class,)* } }

            /// General advice for the next step, for every rejection with this code; empty if that depends on the case.
            /// The paragraph of the code contains it. It is safe to follow: it loses no data and removes no node.
            pub const fn advice(self) -> &'static str { match self { $(Self::$variant => concat!($($advice)?),)* } }

            /// Does a refusal before ordering with this code promise that the transaction is never executed? The others
            /// speak of a node, not of the transaction; or ask for the certificate, with which it is the same
            /// transaction.
            pub const fn is_final(self) -> bool { self.number() < 4000 && !matches!(self, Self::UnknownCreator) }

            /// The code with this number, if there is one.
            pub const fn from_number(number: u16) -> Option<Self> {
                match number { $($number => Some(Self::$variant),)* _ => None }
            }
        }
    };
}

codes! {
    /// The call was executed.
    Ok = 0 "OK" Ok;

    /// The bytes are not a transaction.
    Malformed = 1001 "MALFORMED" Invalid;
    /// The transaction exceeds a size limit of the network.
    TooLarge = 1002 "TOO_LARGE" Invalid;
    /// The transaction is for another network.
    WrongNetwork = 1003 "WRONG_NETWORK" Invalid;
    /// The signature does not match the body and the creator's key.
    BadSignature = 1004 "BAD_SIGNATURE" Denied;
    /// The creator's certificate is not on the ledger and did not come with the transaction.
    UnknownCreator = 1005 "UNKNOWN_CREATOR" Invalid,
        "send the same transaction again with the certificate attached";
    /// Block time has passed the transaction's `not_after`.
    Expired = 1006 "EXPIRED" Invalid,
        "the command was not executed and will not be; if it is still wanted, send a new one";
    /// `not_after` is beyond the duplicate-detection window.
    NotAfterTooFar = 1007 "NOT_AFTER_TOO_FAR" Invalid,
        "sign it again with an earlier not_after, and check this machine's clock";
    /// A transaction with this id was executed before; its first verdict is final.
    Duplicate = 1008 "DUPLICATE" Invalid;
    /// No chaincode of this name is installed.
    UnknownChaincode = 1009 "UNKNOWN_CHAINCODE" Invalid;
    /// The chaincode has no function of this name.
    UnknownFunction = 1010 "UNKNOWN_FUNCTION" Invalid;
    /// An argument is missing, superfluous or of the wrong type.
    BadArgument = 1011 "BAD_ARGUMENT" Invalid;
    /// The chaincode panicked; nothing it wrote was kept.
    ChaincodePanic = 1012 "CHAINCODE_PANIC" Failure;
    /// The requested thing does not exist.
    NotFound = 1013 "NOT_FOUND" Invalid;
    /// A chaincode called too deep or wrote too much.
    LimitExceeded = 1014 "LIMIT_EXCEEDED" Invalid;
    /// A user's own chaincode refused the call.
    Refused = 1015 "REFUSED" Denied;
    /// This node has dropped the blocks that were asked for.
    Pruned = 1016 "PRUNED" Invalid;
    /// The function is read-only: it must be called as a query.
    QueryOnly = 1017 "QUERY_ONLY" Invalid;
    /// The call exceeds the budget of a call, or the calls of its organisation exceed the budget of a block.
    OverBudget = 1018 "OVER_BUDGET" Invalid;

    /// The certificate is not of an organisation of this network.
    Untrusted = 2001 "UNTRUSTED" Denied;
    /// The certificate is past its validity.
    CertificateExpired = 2002 "CERTIFICATE_EXPIRED" Denied;
    /// The certificate is not valid yet.
    CertificateNotYetValid = 2003 "CERTIFICATE_NOT_YET_VALID" Denied;
    /// The certificate was revoked by its issuer.
    Revoked = 2004 "REVOKED" Denied;
    /// The bytes are not a usable X.509 certificate.
    CertificateMalformed = 2005 "CERTIFICATE_MALFORMED" Invalid;
    /// The identity has another role than the one needed.
    WrongRole = 2006 "WRONG_ROLE" Denied;
    /// The enrolment name or its one-time secret is wrong or was used before.
    EnrolmentRefused = 2007 "ENROLMENT_REFUSED" Denied,
        "ask an admin of the organisation for a new secret: ledgerctl identity register NAME --reissue";
    /// This call needs a client certificate.
    CertificateRequired = 2008 "CERTIFICATE_REQUIRED" Denied,
        "enrol first (ledgerctl enroll), then use the context that it stores";
    /// A name is already registered.
    AlreadyRegistered = 2009 "ALREADY_REGISTERED" Invalid,
        "choose another name";
    /// The ledger has no invitation for this organisation, or the request does not match it.
    NotInvited = 2010 "NOT_INVITED" Denied;
    /// The node is not, or no longer, a member of this network.
    NotAMember = 2011 "NOT_A_MEMBER" Denied,
        "bring it in as a new node: ledgerctl network invite --node NAME";
    /// The node does not hold the CA key of the organisation; other nodes may.
    CaElsewhere = 2012 "CA_ELSEWHERE" Unreachable;
    /// A revocation list that is older than the newest one of its CA, or is not valid now.
    OldList = 2013 "OLD_LIST" Invalid,
        "fetch the newest list from the CA";
    /// The organisation rejects its members: the revocation list of its CA has expired.
    ListStale = 2014 "LIST_STALE" Denied;
    /// The clocks of this machine and of a node differ so much that valid certificates seem expired.
    ClockOff = 2020 "CLOCK_OFF" Failure,
        "set the clock of this machine: timedatectl set-ntp true; if it is right, inform the node's operator";

    /// The caller's certificate lacks an attribute that the robot requires.
    MissingAttribute = 3001 "MISSING_ATTRIBUTE" Denied;
    /// No policy permits this, or one forbids it.
    DeniedByPolicy = 3002 "DENIED_BY_POLICY" Denied;
    /// No robot of this name is registered.
    UnknownRobot = 3003 "UNKNOWN_ROBOT" Invalid;
    /// The robot offers no service on this topic.
    UnknownService = 3004 "UNKNOWN_SERVICE" Invalid;
    /// Another user holds the service.
    Held = 3005 "HELD" Conflict;
    /// The caller holds no grant of this service.
    NotHolder = 3006 "NOT_HOLDER" Denied;
    /// The epoch is older than the newest grant.
    StaleEpoch = 3007 "STALE_EPOCH" Denied;
    /// The sequence number does not increase.
    StaleSequence = 3008 "STALE_SEQUENCE" Invalid,
        "number messages upwards; after a restart, acquire again and continue from next_seq";
    /// Only the organisation that owns the robot may do this.
    NotOwner = 3009 "NOT_OWNER" Denied;
    /// Only an admin may do this.
    NotAdmin = 3010 "NOT_ADMIN" Denied,
        "use the context of such an admin (--context NAME), or ask one";
    /// Something of this name exists already.
    AlreadyExists = 3011 "ALREADY_EXISTS" Invalid;
    /// The message is of another type than the service's.
    WrongType = 3012 "WRONG_TYPE" Invalid;
    /// A policy could not be evaluated; that denies.
    PolicyError = 3013 "POLICY_ERROR" Denied;
    /// The policy text is not acceptable.
    PolicyInvalid = 3014 "POLICY_INVALID" Invalid;
    /// The network needs its last voter, organisation or root certificate.
    LastOne = 3015 "LAST_ONE" Invalid;
    /// The service is in a mode with a rule that this program does not support.
    UnknownMode = 3016 "UNKNOWN_MODE" Invalid,
        "install the version of the nodes on the machine of the bridge, or let the owner set another mode";
    /// A voter does not support the execution rules to be activated.
    RulesNotSpoken = 3017 "RULES_NOT_SPOKEN" Invalid,
        "install the newer release on the nodes that the message names, and start them; ledgerctl network rules shows the \
         rules that every node supports";
    /// The function needs a proposal of this call with enough approvals.
    NeedsApproval = 3018 "NEEDS_APPROVAL" Denied;
    /// The organisation has reached its quota.
    QuotaReached = 3019 "QUOTA_REACHED" Invalid;
    /// The robot is stopped until it is resumed.
    Stopped = 3020 "STOPPED" Conflict;
    /// The queue for this service is full.
    LineFull = 3021 "LINE_FULL" Conflict;
    /// The grant cannot be delegated.
    NotDelegable = 3022 "NOT_DELEGABLE" Conflict;
    /// The policy set in force differs from the one on which the change is based.
    PoliciesChanged = 3023 "POLICIES_CHANGED" Conflict,
        "ledgerctl policy history shows the changes since; repeat your change from the set in force";
    /// Under these policies no known identity could publish to a robot.
    NobodyMayPublish = 3024 "NOBODY_MAY_PUBLISH" Conflict,
        "ledgerctl can --who-could lists the permitted identities; to apply the set anyway, add --i-mean-it to the rejected command";
    /// The readers of a confidential service have changed since its content key was shared.
    ReadersChanged = 3025 "READERS_CHANGED" Conflict,
        "share a new content key and send the message again; ledgerctl and bridges do so automatically";
    /// The settings of a robot differ from those on which the change is based.
    RobotChanged = 3026 "ROBOT_CHANGED" Conflict,
        "ledgerctl robot show NAME shows the current settings; repeat your change from these";

    /// No node answered.
    Unreachable = 4001 "UNREACHABLE" Unreachable,
        "try again, or use another node";
    /// No leader is known, so nothing can be ordered now.
    NoLeader = 4002 "NO_LEADER" Unreachable,
        "repeat the same call shortly, unchanged, or through another node";
    /// A queue is full.
    Overloaded = 4003 "OVERLOADED" Unreachable,
        "send less often; send newer data instead, or the same call again after 100 ms";
    /// No verdict came in time; the outcome is unknown, repeat with the same transaction.
    Timeout = 4004 "TIMEOUT" Unreachable,
        "submit the same transaction again, through this or another node: it is executed once";
    /// The node has not reached the height that was asked for.
    Behind = 4005 "BEHIND" Unreachable,
        "try again, or ask another node";
    /// The node is shutting down.
    ShuttingDown = 4006 "SHUTTING_DOWN" Unreachable;
    /// The clock of the only voter is in doubt, so it orders nothing.
    ClockJumped = 4007 "CLOCK_JUMPED" Unreachable,
        "correct the clock; the node continues automatically. If the clock is right, stop the node and confirm it: \
         ledgerd run --trust-clock --config FILE";
    /// The clock of the node's machine is too far from those of most voters.
    ClockOutOfBounds = 4008 "CLOCK_OUT_OF_BOUNDS" Unreachable,
        "use another node, and set the clock of the machine that the message names: timedatectl set-ntp true";

    /// The disk is full; no calls are accepted.
    DiskFull = 5001 "DISK_FULL" Failure,
        "free disk space on that file system";
    /// Stored bytes are damaged.
    Corrupt = 5002 "CORRUPT" Failure;
    /// The disk failed.
    DiskFailed = 5003 "DISK_FAILED" Failure,
        "check the system log (dmesg); repair or replace the disk, then start again";
    /// The chain does not verify.
    ChainInvalid = 5004 "CHAIN_INVALID" Failure,
        "compare with the same height on a node of another organisation (ledgerctl block N), and keep the directory as evidence";
    /// An internal error; the log has the details.
    Internal = 5005 "INTERNAL" Failure;
    /// The world state of this node differs from that of most others.
    Diverged = 5006 "DIVERGED" Failure,
        "start the node with the program that the other nodes run: it rebuilds its world state from its blocks";
    /// The network executes blocks with rules that this release does not support.
    UnknownRules = 5007 "UNKNOWN_RULES" Failure,
        "install the release of ledgerd that the other nodes of the network run";
    /// The network has another history than this node.
    Forked = 5008 "FORKED" Failure;
    /// A strict certificate contradicts the chain of this node.
    Contradicted = 5009 "CONTRADICTED" Failure;

    /// A topic or type name is not a ROS 2 name.
    BadName = 6001 "BAD_NAME" Invalid,
        "choose a name of the wanted form";
    /// A ROS 2 middleware failed.
    MiddlewareFailed = 6002 "MIDDLEWARE_FAILED" Failure;
    /// A message does not fit its ROS 2 type.
    BadMessage = 6003 "BAD_MESSAGE" Invalid;

    /// The configuration is wrong.
    BadConfiguration = 7001 "BAD_CONFIGURATION" Invalid;
    /// A local file cannot be read or written.
    BadFile = 7002 "BAD_FILE" Invalid;
    /// No context is selected, or no context has this name.
    NoContext = 7003 "NO_CONTEXT" Invalid;
}

impl fmt::Display for Code {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "LGR-{:04}", self.number())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_ascend_and_map_back_to_their_code() {
        for pair in Code::ALL.windows(2) {
            if let [a, b] = pair {
                assert!(a.number() < b.number(), "{a} before {b}");
            }
        }
        for code in Code::ALL {
            assert_eq!(Code::from_number(code.number()), Some(*code));
        }
        assert_eq!(Code::from_number(9999), None);
    }

    #[test]
    fn names_are_unique() {
        let mut names: Vec<_> = Code::ALL.iter().map(|code| code.name()).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), Code::ALL.len());
    }
}
