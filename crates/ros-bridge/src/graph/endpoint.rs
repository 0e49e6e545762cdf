//! Endpoints of topics, whatever transport they use.

/// Does an endpoint publish or subscribe?
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// It has a DDS writer.
    Publisher,
    /// It has a DDS reader.
    Subscriber,
}

impl Role {
    /// The word for it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Publisher => "publisher",
            Self::Subscriber => "subscriber",
        }
    }
}
