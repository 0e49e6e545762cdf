//! `context list|use|show|set|refresh|delete`: the identities on this machine.

mod refresh;
mod set;
mod show;

pub(crate) use set::rule;

use crate::context;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table};
use serde::Serialize;
use std::io::{self, Write};

/// Show and select the identities stored on this machine.
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Context {
    List(List),
    Use(Use),
    Show(show::Show),
    Set(set::Set),
    Refresh(refresh::Refresh),
    Delete(Delete),
}

/// List the contexts; an asterisk marks the selected one.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl context list")]
pub(crate) struct List {}

/// Select a context for the following commands; --context and LEDGERCTL_CONTEXT override it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl context use Salma")]
pub(crate) struct Use {
    /// Name of the context
    name: String,
}

/// Delete a context with its key. The certificate stays valid: revoke it if the key may be compromised.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl context delete Salma")]
pub(crate) struct Delete {
    /// Name of the context
    name: String,
}

impl Context {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let home = context::home()?;
        match self {
            Self::List(_) => {
                let names = ledger_api::Context::list(&home)?;
                let in_use = context::name_in_use(global, &home)?;
                output
                    .show(&Contexts(names.into_iter().map(|name| Entry::read(&home, name, in_use.as_ref())).collect()))
            }
            Self::Use(command) => {
                ledger_api::Context::select(&home, &command.name)?;
                output.show(&Done { context: command.name, done: "in use" })
            }
            Self::Show(command) => command.run(global, &home, output),
            Self::Set(command) => command.run(&home, output),
            Self::Refresh(command) => command.run(global, output).await,
            Self::Delete(command) => {
                ledger_api::Context::remove(&home, &command.name)?;
                output.show(&Done { context: command.name, done: "deleted" })
            }
        }
    }
}

#[derive(Serialize)]
struct Done {
    context: String,
    done: &'static str,
}

impl Facts for Done {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "context {} is {}", self.context, self.done)
    }
}

#[derive(Serialize)]
struct Contexts(Vec<Entry>);

/// A context in the list; one that cannot be read is listed with the reason.
#[derive(Serialize)]
struct Entry {
    name: String,
    in_use: bool,
    id: String,
    label: String,
    nodes: Vec<String>,
    fault: String,
}

impl Entry {
    fn read(home: &std::path::Path, name: String, in_use: Option<&String>) -> Self {
        let mut entry = Self {
            in_use: in_use == Some(&name),
            name,
            id: String::new(),
            label: String::new(),
            nodes: Vec::new(),
            fault: String::new(),
        };
        let read = ledger_api::Context::load(home, Some(&entry.name))
            .and_then(|loaded| context::identity(&loaded).map(|identity| (loaded, identity)));
        match read {
            Ok((loaded, identity)) => {
                entry.id = identity.id();
                entry.nodes = loaded.addresses();
                entry.label = loaded.label;
            }
            Err(rejection) => entry.fault = rejection.message,
        }
        entry
    }
}

impl Facts for Contexts {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.0.is_empty() {
            return writeln!(out, "no contexts; `ledgerctl enroll` creates one");
        }
        let mut table = Table::new(["", "NAME", "IDENTITY", "NETWORK", "NODES"]);
        for entry in &self.0 {
            let star = if entry.in_use { "*" } else { "" };
            let identity = if entry.fault.is_empty() { entry.id.clone() } else { format!("damaged: {}", entry.fault) };
            table.row([star.to_owned(), entry.name.clone(), identity, entry.label.clone(), entry.nodes.join(", ")]);
        }
        table.write(out, 0)
    }
}
