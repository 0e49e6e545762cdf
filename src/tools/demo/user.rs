//! The users of the paper's experiment.

use serde::Serialize;

/// A user. The numbers mark their commands, so that the robot's side can tell whose it got.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub enum User {
    /// Has the attributes for every robot.
    Salma = 1,
    /// Has fewer.
    Farhad = 2,
}

impl User {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Salma, Self::Farhad];

    /// The user's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Salma => "Salma",
            Self::Farhad => "Farhad",
        }
    }

    /// The number that marks the user's commands.
    pub fn mark(self) -> u8 {
        self as u8
    }

    /// The user whose commands carry this mark.
    pub fn marked(mark: f64) -> Option<Self> {
        Self::ALL.into_iter().find(|user| f64::from(user.mark()) == mark)
    }
}
