//! `context list|use|show|delete`: the identities on this machine.

use crate::cli::Global;
use crate::failure::Failure;
use crate::output::{Facts, Output, Table};
use crate::{context, time};
use ledger::{Hash, Rejection};
use serde::Serialize;
use std::io::{self, Write};
use std::path::PathBuf;

/// See and choose the identities that are stored on this machine.
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Context {
    List(List),
    Use(Use),
    Show(Show),
    Delete(Delete),
}

/// List the contexts; a star marks the one in use.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl context list")]
pub(crate) struct List {}

/// Act as this context from now on, unless --context or LEDGERCTL_CONTEXT says otherwise.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl context use Salma")]
pub(crate) struct Use {
    /// Name of the context
    name: String,
}

/// Show a context.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl context show\n  ledgerctl context show Salma")]
pub(crate) struct Show {
    /// Name of the context; otherwise the one in use
    name: Option<String>,
}

/// Delete a context with its key. The certificate stays valid: revoke it if the key may have been seen.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl context delete Salma")]
pub(crate) struct Delete {
    /// Name of the context
    name: String,
}

impl Context {
    pub(crate) fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
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
            Self::Show(command) => {
                let loaded = match command.name {
                    Some(name) => ledger_api::Context::load(&home, Some(&name))?,
                    None => context::selected(global)?,
                };
                output.show(&Details::of(&loaded, &home)?)
            }
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
                entry.label = loaded.label;
                entry.nodes = loaded.nodes;
            }
            Err(rejection) => entry.fault = rejection.message,
        }
        entry
    }
}

impl Facts for Contexts {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.0.is_empty() {
            return writeln!(out, "no context yet; `ledgerctl enroll` makes one");
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

#[derive(Serialize)]
struct Details {
    name: String,
    id: String,
    not_after: u64,
    network: Hash,
    label: String,
    nodes: Vec<String>,
    directory: PathBuf,
    authorities: Vec<Authority>,
}

#[derive(Serialize)]
struct Authority {
    organisation: String,
    ca_fingerprints: Vec<Hash>,
}

impl Details {
    fn of(loaded: &ledger_api::Context, home: &std::path::Path) -> Result<Self, Rejection> {
        let identity = context::identity(loaded)?;
        let authority = |msp: &ledger::msp::Msp| Authority {
            organisation: msp.organisation().to_owned(),
            ca_fingerprints: msp.roots().map(|root| Hash::of(&[root])).collect(),
        };
        Ok(Self {
            name: loaded.name.clone(),
            id: identity.id(),
            not_after: identity.not_after,
            network: loaded.network,
            label: loaded.label.clone(),
            nodes: loaded.nodes.clone(),
            directory: context::directory(home, &loaded.name),
            authorities: loaded.msps.iter().map(authority).collect(),
        })
    }
}

impl Facts for Details {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::pairs();
        table.pair("context", &self.name);
        table.pair("identity", &self.id);
        table.pair("valid until", time::moment(self.not_after));
        table.pair("network", format!("{} {}", self.label, self.network).trim_start());
        table.pair("nodes", self.nodes.join(", "));
        table.pair("stored in", self.directory.display());
        for authority in &self.authorities {
            for fingerprint in &authority.ca_fingerprints {
                table.pair(&format!("CA of {}", authority.organisation), fingerprint);
            }
        }
        table.write(out, 0)
    }
}
