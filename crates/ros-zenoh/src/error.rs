//! Failures of a session.

/// A failure of zenoh, or of a peer that does not keep up.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The session does not open, or refuses a declaration.
    #[error("{0}")]
    Zenoh(String),
    /// The session has ended.
    #[error("the zenoh session has ended")]
    Ended,
    /// Too many calls wait for replies.
    #[error("{0} calls wait for replies")]
    Busy(usize),
    /// The request has a reply already, was given up, or its client has left.
    #[error("the request is not waiting for a reply")]
    NotWaiting,
}

/// Anything of zenoh that failed.
pub(crate) fn failed(error: impl std::fmt::Display) -> Error {
    Error::Zenoh(error.to_string())
}
