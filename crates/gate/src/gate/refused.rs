//! Why the gate let something not pass.

/// The rule that a message broke. The name is what is counted and logged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// The bytes are no transaction, or its arguments are not those of `set`.
    Malformed,
    /// Signed for another network.
    WrongNetwork,
    /// A call of something else than `abac set` of this service.
    WrongCall,
    /// More bytes than the route takes.
    TooLarge,
    /// No CDR of ROS 2, or none of the service's type where a limit needs to read it.
    BadPayload,
    /// Encrypted for others than this reader, or under a content key that has not come here.
    NoKey,
    /// Not encrypted although the service is confidential, or encrypted for another place, or changed.
    Unreadable,
    /// A speed that is not a finite number, or above [`crate::speed::NUMBER_MAX`] where no maximum is set.
    BadSpeed,
    /// Neither the gate has seen the creator's certificate, nor does it come along.
    UnknownCreator,
    /// The certificate is of no organisation of this network, or not valid at that time.
    Untrusted,
    /// The certificate was revoked.
    Revoked,
    /// The signature is not the creator's.
    BadSignature,
    /// Only the owner publishes on a feed.
    NotOwner,
    /// The epoch is older than the newest grant.
    StaleEpoch,
    /// The epoch belongs to no grant that voters have signed.
    UnknownEpoch,
    /// The creator does not hold the service.
    NotHolder,
    /// The sequence number does not increase: a replay, or out of order.
    StaleSequence,
    /// More messages than the grant of its creator allows in that time.
    TooFast,
    /// Older than the service or the grant of its creator allows.
    TooOld,
    /// The signer's own limit of time has passed, or lies further ahead than the ledger accepts.
    Expired,
    /// It names a block that the gate's node has not reported: one of the two nodes lies.
    UnknownBlock,
    /// Block time is far ahead of the robot's clock: one of them is wrong.
    FromFuture,
    /// From before the last stop, or before the gate was opened: it may have passed then.
    BeforeStop,
    /// More publishers at once than the gate can tell apart.
    TooManyPublishers,
    /// The robot is stopped until somebody resumes it.
    Stopped,
    /// The service is not known now.
    NoService,
    /// For too long no majority of the voters has said who holds the robot.
    Stale,
}

impl Refused {
    /// May the next answer of the voters change that? Then the message waits for it.
    pub const fn may_pass_later(self) -> bool {
        matches!(
            self,
            Self::NoService | Self::Stopped | Self::Stale | Self::UnknownEpoch | Self::Untrusted | Self::FromFuture
        )
    }

    /// Does it end what came before, too? Then the robot is stopped until the next command that passes. It is of a publisher
    /// that may command the robot.
    pub const fn stops(self) -> bool {
        matches!(self, Self::BadSpeed)
    }

    /// The name that is counted.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Malformed => "malformed",
            Self::WrongNetwork => "wrong_network",
            Self::WrongCall => "wrong_call",
            Self::TooLarge => "too_large",
            Self::BadPayload => "bad_payload",
            Self::NoKey => "no_key",
            Self::Unreadable => "unreadable",
            Self::BadSpeed => "bad_speed",
            Self::UnknownCreator => "unknown_creator",
            Self::Untrusted => "untrusted",
            Self::Revoked => "revoked",
            Self::BadSignature => "bad_signature",
            Self::NotOwner => "not_owner",
            Self::StaleEpoch => "stale_epoch",
            Self::UnknownEpoch => "unknown_epoch",
            Self::NotHolder => "not_holder",
            Self::StaleSequence => "stale_sequence",
            Self::TooFast => "too_fast",
            Self::TooOld => "too_old",
            Self::Expired => "expired",
            Self::UnknownBlock => "unknown_block",
            Self::FromFuture => "from_future",
            Self::BeforeStop => "before_stop",
            Self::TooManyPublishers => "too_many_publishers",
            Self::Stopped => "stopped",
            Self::NoService => "no_service",
            Self::Stale => "stale",
        }
    }

    /// The rule in words, for people.
    pub const fn meaning(self) -> &'static str {
        match self {
            Self::Malformed => "the bytes are not a call of set",
            Self::WrongNetwork => "it was signed for another network",
            Self::WrongCall => "it calls another function",
            Self::TooLarge => "it is larger than sample_bytes_max of this route",
            Self::BadPayload => "it is not CDR of ROS 2, or not of the service's type",
            Self::NoKey => "it is not for this reader: its content key is for others, or was not received yet",
            Self::Unreadable => "it is not encrypted for this place, as messages of a confidential service are",
            Self::BadSpeed => "it asks for a speed that is not a finite number, or above 10000 where no maximum is set",
            Self::UnknownCreator => "the certificate of its creator is unknown",
            Self::Untrusted => {
                "the certificate of its creator belongs to no organisation of this network, or is not \
                                valid now"
            }
            Self::Revoked => "the certificate of its creator was revoked",
            Self::BadSignature => "its signature is not its creator's",
            Self::NotOwner => "only the owner of the robot publishes on a feed",
            Self::StaleEpoch => "it belongs to a grant that has ended",
            Self::UnknownEpoch => "it belongs to a grant that the voters do not have",
            Self::NotHolder => "its creator does not hold the service",
            Self::StaleSequence => "a later message of its creator was delivered",
            Self::TooFast => "it is one more than max_rate of its creator's grant allows",
            Self::TooOld => {
                "it is older than the service, its grant or max_age_ms permits; if that persists, compare the clocks"
            }
            Self::Expired => "the time limit of its signer has passed",
            Self::UnknownBlock => {
                "it names a block that this node does not have: the signer's node or this one has another chain"
            }
            Self::FromFuture => "its time is ahead of this machine's clock; compare the clocks",
            Self::BeforeStop => "it is from before the last stop",
            Self::TooManyPublishers => "more publishers than the gate can tell apart",
            Self::Stopped => "the robot is stopped until it is resumed",
            Self::NoService => "the service is unknown",
            Self::Stale => "no majority of the voters confirms who holds the robot",
        }
    }
}
