//! The actions that policies decide about, and their objects.

use crate::records::robot::Robot;
use crate::records::target::Target;

/// The actions that only a permit gives whose scope names them.
pub(super) const NAMED_RIGHTS: [&str; 4] = ["override", "confirm", "stop", "resume"];

/// A use of a service; each is an action of the schema.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Action {
    Acquire,
    Publish,
    Subscribe,
    /// Taking it whatever its rule says.
    Override,
    /// Agreeing that somebody else acquires it.
    Confirm,
}

/// An action on a whole robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RobotAction {
    Stop,
    Resume,
}

/// The object of a question.
#[derive(Clone, Copy)]
pub(crate) enum Object<'a> {
    Service(&'a Target, Action),
    Robot(&'a Robot, RobotAction),
    /// An action that somebody may do by rule, unless a `forbid` names it.
    ByRule(&'a Robot, RobotAction),
}

impl<'a> Object<'a> {
    pub(super) fn robot(self) -> &'a Robot {
        match self {
            Self::Service(target, _) => &target.robot,
            Self::Robot(robot, _) | Self::ByRule(robot, _) => robot,
        }
    }

    /// The action as policies name it.
    pub(crate) fn action(self) -> &'static str {
        match self {
            Self::Service(_, action) => action.name(),
            Self::Robot(_, action) | Self::ByRule(_, action) => action.name(),
        }
    }

    /// Is it permitted by rule?
    pub(super) const fn is_by_rule(self) -> bool {
        matches!(self, Self::ByRule(..))
    }
}

impl Action {
    /// The uses that need a decision again and again.
    pub(crate) const ALL: [Self; 3] = [Self::Acquire, Self::Publish, Self::Subscribe];

    /// May an admin of the owner do it always, without a policy?
    pub(crate) const fn is_of_owner(&self) -> bool {
        matches!(self, Self::Override | Self::Confirm)
    }

    /// As policies name it.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Acquire => "acquire",
            Self::Publish => "publish",
            Self::Subscribe => "subscribe",
            Self::Override => "override",
            Self::Confirm => "confirm",
        }
    }
}

impl RobotAction {
    /// As policies name it.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Stop => "stop",
            Self::Resume => "resume",
        }
    }
}
