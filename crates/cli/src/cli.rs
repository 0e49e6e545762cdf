//! The table of commands.

use crate::command::{
    audit, bridge, ca, can, chaincode, completions, console, context, denials, doctor, emergency, enroll, explain,
    fleet, grant, identity, ledger, light, man, message, network, policy, prove, readers, record, replay, robot, share,
    task, top, watch, whoami,
};
use crate::failure::Failure;
use crate::global::Global;
use crate::output::Output;
use clap::{CommandFactory, Parser, Subcommand};
use ledger_base::rejection::{Code, Rejection};

/// The command line of a permissioned ledger for ROS 2 fleets.
#[derive(Debug, Parser)]
#[command(
    name = "ledgerctl",
    version,
    arg_required_else_help = true,
    subcommand_required = true,
    after_help = "\
Exit codes: 0 ok, 1 failure, 2 denied, 3 invalid input, 4 unreachable or no quorum, 5 held by another, 64 usage.

Example:
  ledgerctl acquire Turtlebot4/cmd_vel --for 30s
  ledgerctl robot list -o json
  ledgerctl explain LGR-3005"
)]
pub(crate) struct Cli {
    #[command(flatten)]
    pub(crate) global: Global,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Enroll(enroll::Enroll),
    Whoami(whoami::Whoami),
    #[command(subcommand)]
    Context(context::Context),
    #[command(subcommand)]
    Identity(identity::Identity),
    #[command(subcommand)]
    Ca(ca::Ca),
    #[command(subcommand)]
    Network(network::Network),
    #[command(subcommand)]
    Robot(robot::Robot),
    Acquire(grant::Acquire),
    Renew(grant::Renew),
    Release(grant::Release),
    Queue(grant::Queue),
    Stop(emergency::Stop),
    Resume(emergency::Resume),
    Take(grant::Take),
    Delegate(grant::Delegate),
    Handover(grant::Handover),
    Recall(grant::Recall),
    Confirm(grant::Confirm),
    #[command(subcommand)]
    Task(task::Task),
    Publish(message::Publish),
    Echo(message::Echo),
    Hz(message::Hz),
    Bw(message::Bw),
    Readers(readers::Readers),
    Record(record::Record),
    Replay(replay::Replay),
    #[command(subcommand)]
    Bridge(bridge::Bridge),
    #[command(subcommand)]
    Policy(policy::Policy),
    Share(share::Share),
    Unshare(share::unshare::Unshare),
    Can(can::Can),
    Apply(fleet::Apply),
    Diff(fleet::Diff),
    Export(fleet::Export),
    Console(console::Console),
    Invoke(chaincode::Invoke),
    Query(chaincode::Query),
    Light(light::Light),
    Status(ledger::Status),
    Top(top::Top),
    Watch(watch::Watch),
    Doctor(doctor::Doctor),
    Block(ledger::Block),
    Tx(ledger::Tx),
    Denials(denials::Denials),
    Audit(audit::Audit),
    History(message::History),
    Prove(prove::Prove),
    #[command(subcommand)]
    Ledger(ledger::Ledger),
    Explain(explain::Explain),
    Completions(completions::Completions),
    Man(man::Man),
}

impl Cli {
    /// Runs the command and writes its results to standard output.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|error| Rejection::new(Code::Internal, "cannot start the runtime").found(error.to_string()))?;
        let outcome = runtime.block_on(self.dispatch());
        // Whatever a connection still wants to do must not keep the shell waiting.
        runtime.shutdown_background();
        outcome
    }

    async fn dispatch(self) -> Result<(), Failure> {
        let global = &self.global;
        let output = &mut Output::stdout(global.format());
        let outcome = match self.command {
            Command::Enroll(command) => command.run(global, output).await,
            Command::Whoami(command) => command.run(global, output).await,
            Command::Context(command) => command.run(global, output).await,
            Command::Identity(command) => command.run(global, output).await,
            Command::Ca(command) => command.run(global, output).await,
            Command::Network(command) => command.run(global, output).await,
            Command::Robot(command) => command.run(global, output).await,
            Command::Acquire(command) => command.run(global, output).await,
            Command::Renew(command) => command.run(global, output).await,
            Command::Release(command) => command.run(global, output).await,
            Command::Queue(command) => command.run(global, output).await,
            Command::Stop(command) => command.run(global, output).await,
            Command::Resume(command) => command.run(global, output).await,
            Command::Take(command) => command.run(global, output).await,
            Command::Delegate(command) => command.run(global, output).await,
            Command::Handover(command) => command.run(global, output).await,
            Command::Recall(command) => command.run(global, output).await,
            Command::Confirm(command) => command.run(global, output).await,
            Command::Task(command) => command.run(global, output).await,
            Command::Publish(command) => command.run(global, output).await,
            Command::Echo(command) => command.run(global, output).await,
            Command::Hz(command) => command.run(global, output).await,
            Command::Bw(command) => command.run(global, output).await,
            Command::Readers(command) => command.run(global, output).await,
            Command::Record(command) => command.run(global, output).await,
            Command::Replay(command) => command.run(output).await,
            Command::Bridge(command) => command.run(global, output).await,
            Command::Policy(command) => command.run(global, output).await,
            Command::Share(command) => command.run(global, output).await,
            Command::Unshare(command) => command.run(global, output).await,
            Command::Apply(command) => command.run(global, output).await,
            Command::Diff(command) => command.run(global, output).await,
            Command::Export(command) => command.run(global, output).await,
            Command::Can(command) => command.run(global, output).await,
            Command::Console(command) => command.run(global, output).await,
            Command::Invoke(command) => command.run(global, output).await,
            Command::Query(command) => command.run(global, output).await,
            Command::Light(command) => command.run(global, output).await,
            Command::Status(command) => command.run(global, output).await,
            Command::Top(command) => command.run(global).await,
            Command::Watch(command) => command.run(global, output).await,
            Command::Doctor(command) => command.run(global, output).await,
            Command::Block(command) => command.run(global, output).await,
            Command::Tx(command) => command.run(global, output).await,
            Command::Denials(command) => command.run(global, output).await,
            Command::Audit(command) => command.run(global, output).await,
            Command::History(command) => command.run(global, output).await,
            Command::Prove(command) => command.run(global, output).await,
            Command::Ledger(command) => command.run(output),
            Command::Explain(command) => command.run(output),
            Command::Man(command) => return command.run(Self::command()),
            // For a shell, which shows whatever it is told.
            Command::Completions(command) => return command.run(output),
        };
        global.upkeep.finish(global.format(), || crate::context::selected(global)).await;
        outcome
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::panic, reason = "tests")]
mod tests {
    use super::*;

    /// Every command that has no subcommands, with its path.
    fn leaves(command: &clap::Command, path: &str, found: &mut Vec<(String, clap::Command)>) {
        for sub in command.get_subcommands().filter(|sub| sub.get_name() != "help") {
            let path = format!("{path} {}", sub.get_name());
            if sub.has_subcommands() {
                leaves(sub, &path, found);
            } else {
                found.push((path, sub.clone()));
            }
        }
    }

    /// The words of a shell line up to a pipe or redirection; knows single quotes.
    fn words(line: &str) -> Vec<String> {
        let mut words = vec![String::new()];
        let mut quoted = false;
        for c in line.chars() {
            match c {
                '\'' => quoted = !quoted,
                ' ' if !quoted => words.push(String::new()),
                _ => words.last_mut().unwrap().push(c),
            }
        }
        words.into_iter().filter(|w| !w.is_empty()).take_while(|w| !matches!(w.as_str(), "|" | ">")).collect()
    }

    #[test]
    fn the_table_of_commands_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn every_command_has_help_with_an_example_that_parses() {
        let mut found = Vec::new();
        leaves(&Cli::command(), "ledgerctl", &mut found);
        assert!(found.len() > 25, "{}", found.len());
        for (path, command) in found {
            assert!(command.get_about().is_some(), "{path} says nothing about itself");
            let help = command.get_after_help().unwrap_or_else(|| panic!("{path} has no example")).to_string();
            let examples: Vec<_> = help.lines().filter(|line| line.trim_start().starts_with("ledgerctl ")).collect();
            assert!(!examples.is_empty(), "{path} has no example");
            for example in examples {
                assert!(example.trim_start().starts_with(&path), "{example:?} is no example of {path}");
                Cli::try_parse_from(words(example.trim_start())).unwrap_or_else(|e| panic!("{example}: {e}"));
            }
        }
    }

    #[test]
    fn the_shapes_that_scripts_rely_on_parse() {
        for line in [
            "ledgerctl enroll Salma --node 127.0.0.1:7450 --ca-fingerprint 00 --secret s --key p256",
            "ledgerctl identity register Salma --role admin --attr Husky --attr Turtlebot4=true",
            "ledgerctl robot add T --attr-required T --service /cmd_vel=geometry_msgs/msg/Twist,mode=open",
            "ledgerctl --context Salma -o json acquire Turtlebot4 --for 30s",
            "ledgerctl publish T/cmd_vel --hex 00010000",
            "ledgerctl publish T/cmd_vel --file f",
            "ledgerctl publish T/cmd_vel --stdin",
            "ledgerctl publish T/cmd_vel '{linear: {x: 0.5}}' --msg a/msg/B=f --msg p/msg/C.msg --count 2",
            "ledgerctl echo T/cmd_vel --from 1 --count 2 -o json",
            "ledgerctl invoke inventory add -5 - @f hex:00 -o json --context x",
            "ledgerctl query abac robots",
            "ledgerctl tx 00",
        ] {
            Cli::try_parse_from(words(line)).unwrap_or_else(|error| panic!("{line}: {error}"));
        }
    }

    #[test]
    fn publish_wants_exactly_one_source() {
        for line in ["ledgerctl publish T", "ledgerctl publish T --stdin --hex 00", "ledgerctl publish T {} --hex b"] {
            assert!(Cli::try_parse_from(words(line)).is_err(), "{line}");
        }
    }
}
