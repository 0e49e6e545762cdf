//! Everything that can go wrong in the bridge.
//!
//! Each message has the same four lines: what failed, what was found, what was wanted, what to try.

use std::fmt;

use ledger_base::rejection::{Code, Rejection};

/// The result of everything in this crate that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// A failure of the bridge. The kind says who has to act; the text says how.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A topic or node name that ROS 2 does not allow. Fault of the configuration.
    #[error("{0}")]
    Name(Explained),
    /// A message type name that ROS 2 does not allow. Fault of the configuration.
    #[error("{0}")]
    Type(Explained),
    /// A setting outside its range. Fault of the configuration.
    #[error("{0}")]
    Setting(Explained),
    /// Bytes that are no CDR sample, or more of them than allowed. Fault of the sender.
    #[error("{0}")]
    Sample(Explained),
    /// A reader on the graph does not keep up; the sample was not written. Try the next one.
    #[error("{0}")]
    Slow(Explained),
    /// Nobody serves what is called. Start the server, or wait for it.
    #[error("{0}")]
    Unserved(Explained),
    /// The DDS side refused or broke. Often a port or interface of this machine.
    #[error("{0}")]
    Dds(Explained),
    /// The zenoh side refused or broke. Often there is no router.
    #[error("{0}")]
    Zenoh(Explained),
    /// The shared memory side refused or broke.
    #[error("{0}")]
    Shm(Explained),
}

impl Error {
    /// No sample, for this reason.
    pub(crate) fn sample(refused: Rejection) -> Self {
        let hint = refused.advice().to_owned();
        let Rejection { message, found, wanted, .. } = refused;
        Self::Sample(Explained::new(message, found, wanted, hint))
    }

    /// The stable code of the kind.
    fn code(&self) -> Code {
        match self {
            Self::Name(_) | Self::Type(_) => Code::BadName,
            Self::Setting(_) => Code::BadConfiguration,
            Self::Sample(_) => Code::BadArgument,
            Self::Slow(_) | Self::Unserved(_) | Self::Dds(_) | Self::Zenoh(_) | Self::Shm(_) => Code::MiddlewareFailed,
        }
    }
}

impl From<Error> for Rejection {
    fn from(error: Error) -> Self {
        let code = error.code();
        let (Error::Name(explained)
        | Error::Type(explained)
        | Error::Setting(explained)
        | Error::Sample(explained)
        | Error::Slow(explained)
        | Error::Unserved(explained)
        | Error::Dds(explained)
        | Error::Zenoh(explained)
        | Error::Shm(explained)) = error;
        let Explained { what, found, wanted, hint } = explained;
        Self::new(code, what).found(found).wanted(wanted).next(hint)
    }
}

/// The four lines of an error message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Explained {
    /// The failed action.
    pub what: String,
    /// The value that was found.
    pub found: String,
    /// The value that was wanted.
    pub wanted: String,
    /// Advice for the next step; empty if there is none.
    pub hint: String,
}

impl Explained {
    /// Puts the four lines together.
    pub fn new(
        what: impl Into<String>,
        found: impl Into<String>,
        wanted: impl Into<String>,
        hint: impl Into<String>,
    ) -> Self {
        Self { what: what.into(), found: found.into(), wanted: wanted.into(), hint: hint.into() }
    }
}

impl fmt::Display for Explained {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}\n  found   {}\n  wanted  {}", self.what, self.found, self.wanted)?;
        if self.hint.is_empty() { Ok(()) } else { write!(f, "\n  try     {}", self.hint) }
    }
}
