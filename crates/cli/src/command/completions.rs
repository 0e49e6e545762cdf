//! `completions`: what a shell needs to complete our commands.

use crate::complete;
use crate::failure::Failure;
use crate::output::Output;
use clap_complete::Shell;
use clap_complete::env::Shells;

/// Print the script with which a shell completes commands and names.
///
/// The shell runs ledgerctl as you type, so contexts, robots, services, users, nodes, codes and roles are current. If
/// no node answers within a second, only commands and options are completed.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl completions bash > ~/.local/share/bash-completion/completions/ledgerctl
  ledgerctl completions zsh > ~/.zfunc/_ledgerctl
  ledgerctl completions fish > ~/.config/fish/completions/ledgerctl.fish")]
pub(crate) struct Completions {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

impl Completions {
    pub(crate) fn run(&self, output: &mut Output) -> Result<(), Failure> {
        let mut script = Vec::new();
        let shells = Shells::builtins();
        if let Some(shell) = shells.completer(&self.shell.to_string()) {
            let name = env!("CARGO_PKG_NAME");
            shell.write_registration(complete::VARIABLE, name, name, name, &mut script)?;
        }
        output.raw(&script)
    }
}
