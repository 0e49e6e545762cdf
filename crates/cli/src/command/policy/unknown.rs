//! Names in policies that the network does not know today: a slip, or somebody who comes later.

use super::meaning::check;
use crate::output::printable;
use crate::session::Session;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{PolicyText, UnknownName};

/// Names that are expected later.
#[derive(Clone, Debug, Default, clap::Args)]
pub(in crate::command) struct Expected {
    /// Accept this name, although the network does not know it yet: Org1/Farhad
    #[arg(long, value_name = "NAME")]
    expect: Vec<String>,
}

impl Expected {
    /// Looks the names of these policies up.
    ///
    /// # Errors
    /// [`Code::PolicyInvalid`] if the network does not know one of them today, and it is not expected.
    pub(in crate::command) async fn check(&self, session: &Session, policies: &[PolicyText]) -> Result<(), Rejection> {
        let mut unknown = Vec::new();
        for policy in policies {
            let checked = check(session, &policy.text).await?;
            unknown.extend(checked.unknown.into_iter().map(|name| (policy.id.clone(), name)));
        }
        unknown.retain(|(_, name)| !self.expect.contains(&name.name));
        refused(&unknown).map_or(Ok(()), Err)
    }
}

/// The rejection of names that nobody expects; none without such names.
fn refused(unknown: &[(String, UnknownName)]) -> Option<Rejection> {
    let (_, first) = unknown.first()?;
    let told: Vec<String> = unknown.iter().map(|(policy, name)| format!("{} in {policy}", shown(name))).collect();
    Some(
        Rejection::new(Code::PolicyInvalid, "a policy names something that the network does not have")
            .found(told.join("; "))
            .wanted("names of the network, as in robot list and identity list")
            .next(format!("correct it, or if it will exist later: --expect '{}'", first.name)),
    )
}

/// A name as policies have it, and the one that was probably meant.
pub(in crate::command) fn shown(UnknownName { kind, name, near, .. }: &UnknownName) -> String {
    let near = if near.is_empty() { String::new() } else { format!(" ({near})") };
    format!("{kind}::\"{}\"{}", printable(name), printable(&near))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn unknown_names_are_refused_with_what_was_probably_meant_and_the_way_to_expect_them() {
        assert_eq!(refused(&[]), None);
        let name = |kind: &str, name: &str, near: &str| {
            let name = UnknownName { line: 1, kind: kind.into(), name: name.into(), near: near.into() };
            ("night".to_owned(), name)
        };
        let slips = [name("Robot", "Turtelbot4", "did you mean \"Turtlebot4\"?"), name("User", "Org1/Late", "")];
        let refused = refused(&slips).unwrap();
        assert_eq!(
            refused.found,
            "Robot::\"Turtelbot4\" (did you mean \"Turtlebot4\"?) in night; User::\"Org1/Late\" in night"
        );
        assert!(refused.advice().contains("--expect 'Turtelbot4'"), "{refused}");
    }
}
