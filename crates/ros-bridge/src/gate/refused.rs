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
    /// No CDR of ROS 2.
    BadPayload,
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
    /// The epoch belongs to no grant that was shown.
    UnknownEpoch,
    /// The creator does not hold the service.
    NotHolder,
    /// The sequence number does not increase: a replay, or out of order.
    StaleSequence,
    /// Older than the service allows.
    TooOld,
    /// The signer's own limit of time has passed, or lies further ahead than the ledger accepts.
    Expired,
    /// Block time is far ahead of the robot's clock: one of them is wrong.
    FromFuture,
    /// From before the last stop, or before the gate was opened: it may have passed then.
    BeforeStop,
    /// More publishers at once than the gate can tell apart.
    TooManyPublishers,
    /// The service is not known now.
    NoService,
    /// A grant that its holder did not sign for.
    UnprovenGrant,
}

impl Refused {
    /// The name that is counted.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Malformed => "malformed",
            Self::WrongNetwork => "wrong_network",
            Self::WrongCall => "wrong_call",
            Self::TooLarge => "too_large",
            Self::BadPayload => "bad_payload",
            Self::UnknownCreator => "unknown_creator",
            Self::Untrusted => "untrusted",
            Self::Revoked => "revoked",
            Self::BadSignature => "bad_signature",
            Self::NotOwner => "not_owner",
            Self::StaleEpoch => "stale_epoch",
            Self::UnknownEpoch => "unknown_epoch",
            Self::NotHolder => "not_holder",
            Self::StaleSequence => "stale_sequence",
            Self::TooOld => "too_old",
            Self::Expired => "expired",
            Self::FromFuture => "from_future",
            Self::BeforeStop => "before_stop",
            Self::TooManyPublishers => "too_many_publishers",
            Self::NoService => "no_service",
            Self::UnprovenGrant => "unproven_grant",
        }
    }
}
