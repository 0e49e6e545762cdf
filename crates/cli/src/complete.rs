//! The words that a shell completes: commands and options from the table of commands, and names from this machine and the network.
//!
//! The script of `ledgerctl completions SHELL` runs this program again with [`VARIABLE`] set. Nothing that fails is told: a line
//! that is being typed must stay readable, so without an answer in time there are no names.

mod names;

use clap::{Arg, Command};
use clap_complete::CompleteEnv;
use clap_complete::engine::ArgValueCandidates;
use names::Names;

/// Set by the script of a shell, to its name.
pub(crate) const VARIABLE: &str = "LEDGERCTL_COMPLETE";

/// Answers a shell and ends the process, if one asks. The arguments in the table of commands then know the names that they stand
/// for.
pub(crate) fn answer(commands: impl Fn() -> Command) {
    CompleteEnv::with_factory(|| named(commands(), "")).var(VARIABLE).complete();
}

fn named(command: Command, group: &str) -> Command {
    let own = command.get_name().to_owned();
    let with_names = |arg: Arg| match names_of(group, &own, &arg) {
        Some(names) => arg.add(ArgValueCandidates::new(move || names::candidates(names))),
        None => arg,
    };
    command.mut_args(with_names).mut_subcommands(|sub| named(sub, &own))
}

/// The names that an argument of a command stands for.
fn names_of(group: &str, command: &str, arg: &Arg) -> Option<Names> {
    let shown = arg.get_value_names().and_then(|names| names.first()).map(|name| name.to_string()).unwrap_or_default();
    match (group, command, arg.get_id().as_str()) {
        (_, "enroll" | "register" | "add" | "add-org", "name" | "context") => None,
        (_, _, "context") | ("context", _, "name") => Some(Names::Contexts),
        (_, _, "service" | "services") if command != "add" && command != "set" => Some(Names::Services),
        _ if matches!(shown.as_str(), "ROBOT/TOPIC" | "ROBOT[/TOPIC]") => Some(Names::Services),
        (_, _, "robot") | ("robot", _, "name") => Some(Names::Robots),
        _ if shown == "ROBOT" => Some(Names::Robots),
        ("identity", _, "name") => Some(Names::Users),
        (_, _, "who" | "user") | (_, "delegate" | "handover", "to") => Some(Names::Users),
        (_, _, "role") => Some(Names::Roles),
        (_, _, "code") => Some(Names::Codes),
        ("network" | "ca", _, "node") if command != "invite" => Some(Names::Nodes),
        _ => None,
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::cli::Cli;
    use clap::CommandFactory;

    fn of(path: &[&str], id: &str) -> Option<Names> {
        let mut command = Cli::command();
        command.build();
        let (mut found, mut group) = (&command, "");
        for name in path {
            group = found.get_name();
            found = found.find_subcommand(name).unwrap();
        }
        let arg = found.get_arguments().find(|arg| arg.get_id() == id).unwrap();
        names_of(group, found.get_name(), arg)
    }

    #[test]
    fn arguments_stand_for_the_names_that_people_would_type() {
        for (path, id, wanted) in [
            (&["acquire"][..], "service", Some(Names::Services)),
            (&["acquire"], "context", Some(Names::Contexts)),
            (&["context", "use"], "name", Some(Names::Contexts)),
            (&["robot", "show"], "name", Some(Names::Robots)),
            (&["robot", "add"], "name", None),
            (&["stop"], "robot", Some(Names::Robots)),
            (&["identity", "revoke"], "name", Some(Names::Users)),
            (&["identity", "register"], "name", None),
            (&["identity", "register"], "role", Some(Names::Roles)),
            (&["explain"], "code", Some(Names::Codes)),
            (&["audit"], "code", Some(Names::Codes)),
            (&["audit"], "user", Some(Names::Users)),
            (&["network", "promote"], "node", Some(Names::Nodes)),
        ] {
            assert_eq!(of(path, id), wanted, "{path:?} {id}");
        }
    }
}
