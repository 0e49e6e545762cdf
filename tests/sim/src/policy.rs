//! The policies that simulated admins put on the ledger: each as Cedar text for the product, and as a plain function
//! for the oracle. The two were written apart; that they agree is part of what is checked.

/// A policy of the collection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Policy {
    /// The rule of the paper, as an organisation's own policy.
    Attribute,
    /// Any identity of a trusted organisation, with the rights that a policy must name.
    Trusted,
    /// Never this person.
    ForbidFarhad,
    /// A `forbid` whose condition cannot be evaluated: it must deny, not be skipped.
    ErringForbid,
    /// Permits only until some block time (milliseconds since the UNIX epoch).
    Until(u64),
    /// Any identity of a trusted organisation may read, and do nothing else.
    Viewers,
    /// This person reads nothing.
    Blind,
}

/// The use that somebody wants to make of a robot, as far as a policy of the collection tells one from another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Act {
    /// To hold a service, or to publish on it.
    Use,
    /// To read its messages.
    Subscribe,
    /// To end what others do, or to let them go on.
    Govern,
}

/// The content of a single policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Says {
    /// Yes.
    Permit,
    /// No.
    Forbid,
    /// Nothing.
    Nothing,
    /// It cannot be evaluated.
    Error,
}

/// The subject and the object of a policy's question.
pub struct Asked<'a> {
    /// `Org1/Farhad`.
    pub who: &'a str,
    /// Is the organisation one whose attributes the robot trusts?
    pub trusted: bool,
    /// Does the certificate carry what the robot requires?
    pub attribute: bool,
    /// Block time, milliseconds.
    pub time_ms: u64,
    /// The use.
    pub act: Act,
}

impl Policy {
    /// Its id on the ledger.
    pub fn id(self) -> &'static str {
        match self {
            Self::Attribute => "attribute",
            Self::Trusted => "trusted",
            Self::ForbidFarhad => "no-farhad",
            Self::ErringForbid => "erring",
            Self::Until(_) => "until",
            Self::Viewers => "viewers",
            Self::Blind => "blind",
        }
    }

    /// The Cedar text.
    pub fn text(self) -> String {
        let trusted = "resource.trusted.contains(principal.organisation)";
        match self {
            Self::Attribute => format!(
                "permit (principal, action, resource) when {{ {trusted} && principal.hasTag(resource.requiredAttribute) \
                 && principal.getTag(resource.requiredAttribute) == resource.requiredValue }};"
            ),
            Self::Trusted => format!(
                "permit (principal, action, resource) when {{ {trusted} }}; permit (principal, action in \
                 [Action::\"override\", Action::\"confirm\", Action::\"stop\", Action::\"resume\"], resource) when {{ {trusted} }};"
            ),
            Self::ForbidFarhad => "forbid (principal == User::\"Org1/Farhad\", action, resource);".to_owned(),
            // Block time is far above 2, so the product overflows.
            Self::ErringForbid => {
                "forbid (principal, action, resource) when { context.time * 9223372036854775807 == 0 };".to_owned()
            }
            Self::Until(time) => {
                format!("permit (principal, action, resource) when {{ {trusted} && context.time < {time} }};")
            }
            Self::Viewers => {
                format!("permit (principal, action == Action::\"subscribe\", resource) when {{ {trusted} }};")
            }
            Self::Blind => {
                "forbid (principal == User::\"Org1/Nina\", action == Action::\"subscribe\", resource);".to_owned()
            }
        }
    }

    /// The policy with this id and text, if it is one of the collection.
    pub fn read(id: &str, text: &str) -> Option<Self> {
        let until = text.rsplit_once("context.time < ").and_then(|(_, rest)| rest.split_once(' '));
        let until = until.and_then(|(time, _)| time.parse().ok()).map(Self::Until);
        [Self::Attribute, Self::Trusted, Self::ForbidFarhad, Self::ErringForbid, Self::Viewers, Self::Blind]
            .into_iter()
            .chain(until)
            .find(|policy| policy.id() == id && policy.text() == text)
    }

    /// Its content.
    pub fn says(self, asked: &Asked<'_>) -> Says {
        let permit = |holds| if holds { Says::Permit } else { Says::Nothing };
        match self {
            // What a policy must name, these do not.
            Self::Attribute | Self::Until(_) if asked.act == Act::Govern => Says::Nothing,
            Self::Attribute => permit(asked.trusted && asked.attribute),
            Self::Trusted => permit(asked.trusted),
            Self::ForbidFarhad if asked.who == "Org1/Farhad" => Says::Forbid,
            Self::ForbidFarhad => Says::Nothing,
            Self::ErringForbid => Says::Error,
            Self::Until(time) => permit(asked.trusted && asked.time_ms < time),
            Self::Viewers => permit(asked.trusted && asked.act == Act::Subscribe),
            Self::Blind if asked.who == "Org1/Nina" && asked.act == Act::Subscribe => Says::Forbid,
            Self::Blind => Says::Nothing,
        }
    }
}
