//! `ca backup`, `ca restore` and `ca move`: the CA of an organisation for the safe, back again, and at another node.

use super::{address, carry, own_node, reach};
use crate::confirm::confirm;
use crate::failure::Failure;
use crate::nodes::{carriers, current, nodes};
use crate::output::{Facts, Output};
use crate::session::Session;
use ledger_api::{Client, passphrase, v1};
use ledger_base::durable::SECRET_MODE;
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shell;
use serde::Serialize;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Largest copy, in bytes.
const FILE_BYTES_MAX: usize = 64 * 1024;

/// Write the CA of your organisation to a file, under a passphrase; for admins.
///
/// The file is ordinary PEM: the key encrypted with the passphrase, and the root. It stays good as long as the CA is. The
/// ledger records who took a copy and when. Nothing is overwritten.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl ca backup org1-ca.pem")]
pub(crate) struct Backup {
    /// The file
    file: PathBuf,
    /// A file whose first line is the passphrase; otherwise LEDGERD_PASSPHRASE, otherwise it is asked for
    #[arg(long, value_name = "FILE")]
    passphrase_file: Option<PathBuf>,
}

/// Put the CA of your organisation back from a file of `ca backup`; for admins.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl ca restore org1-ca.pem --node node2")]
pub(crate) struct Restore {
    /// The file
    file: PathBuf,
    /// The node that shall carry the CA: its name, ORGANISATION/NAME, or its id; the one of the context if left out
    #[arg(long, value_name = "NODE")]
    node: Option<String>,
    /// A file whose first line is the passphrase; otherwise LEDGERD_PASSPHRASE, otherwise it is asked for
    #[arg(long, value_name = "FILE")]
    passphrase_file: Option<PathBuf>,
}

/// Let another node carry the CA of your organisation, and remove the key from the one that does; for admins.
///
/// The other one has it before the first one gives it up. If it was interrupted, type it again.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl ca move node2")]
pub(crate) struct Move {
    /// The node that carries it from then on: its name, ORGANISATION/NAME, or its id
    node: String,
    /// The node that gives it up, where several carry it
    #[arg(long, value_name = "NODE")]
    from: Option<String>,
    /// Do not ask whether it is meant
    #[arg(long)]
    i_mean_it: bool,
}

/// A copy in a file.
#[derive(Serialize)]
struct Copied<'a> {
    organisation: String,
    file: &'a Path,
    from: String,
}

impl Facts for Copied<'_> {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self { organisation, file, from } = self;
        writeln!(out, "the CA of {organisation} is in {}, as {from} carries it", file.display())?;
        writeln!(out, "keep file and passphrase apart, and both away from the nodes")?;
        writeln!(out, "to restore: ledgerctl ca restore {}", shell::path(file))
    }
}

impl Backup {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        if fs::symlink_metadata(&self.file).is_ok() {
            return Err(ledger_base::durable::failed("write", &self.file, &io::ErrorKind::AlreadyExists.into()).into());
        }
        let organisation = session.identity()?.organisation;
        let passphrase = passphrase(self.passphrase_file.as_deref(), true)?;
        let (client, from) = reachable(session, &organisation).await?;
        let request = v1::CopyCaRequest { organisation: organisation.clone(), passphrase };
        let copy = client.copy_ca(request).await?;
        ledger_base::durable::create(&self.file, &copy, SECRET_MODE)?;
        ledger_base::durable::sync_directory(self.file.parent().unwrap_or_else(|| Path::new(".")))?;
        output.show(&Copied { organisation, file: &self.file, from })
    }
}

/// A node that carries the CA and answers, with its name.
async fn reachable(session: &Session, organisation: &str) -> Result<(Client, String), Failure> {
    let (nodes, context) = (nodes(session).await?.nodes, current(session).await?);
    let mut refused = Rejection::new(Code::CaElsewhere, format!("no node carries the CA of {organisation}"))
        .next("ledgerctl ca restore FILE, with a copy that was made before");
    for carrier in carriers(session).await?.iter().filter(|carrier| carrier.organisation == organisation) {
        let Some(address) = address(&nodes, carrier) else { continue };
        match reach(&context, &address).await {
            Ok(client) => return Ok((client, carrier.full_name())),
            Err(unreachable) => refused = unreachable,
        }
    }
    Err(refused.into())
}

/// A CA that is back.
#[derive(Serialize)]
struct Restored {
    organisation: String,
    node: String,
}

impl Facts for Restored {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "{} carries the CA of {} from now on", self.node, self.organisation)
    }
}

impl Restore {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let organisation = session.identity()?.organisation;
        let file = ledger_base::durable::read(&self.file, FILE_BYTES_MAX)?.into();
        let node = match self.node {
            Some(node) => node,
            None => session.client.status().await?.node_id.to_string(),
        };
        let target = own_node(session, &organisation, &node).await?;
        let passphrase = passphrase(self.passphrase_file.as_deref(), false)?;
        let client = reach(&current(session).await?, &target.address).await?;
        client.restore_ca(v1::RestoreCaRequest { organisation: organisation.clone(), file, passphrase }).await?;
        output.show(&Restored { organisation, node: target.full_name() })
    }
}

/// A CA that another node carries.
#[derive(Serialize)]
struct Moved {
    organisation: String,
    node: String,
    from: String,
}

impl Facts for Moved {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self { organisation, node, from } = self;
        writeln!(out, "{node} carries the CA of {organisation}; the key is removed from {from}")
    }
}

impl Move {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let organisation = session.identity()?.organisation;
        let target = own_node(session, &organisation, &self.node).await?;
        let from = self.source(session, &organisation, &target.full_name()).await?;
        let source = own_node(session, &organisation, &from).await?;
        let lost =
            [format!("{from} gives up the key of the CA of {organisation}; {} carries it then", target.full_name())];
        confirm("the move of the CA", &lost, self.i_mean_it)?;
        let context = current(session).await?;
        // The ledger still names a node whose disk is lost. So the node itself says whether it has the key.
        let there = reach(&context, &target.address).await?;
        if !there.network().await?.carries.contains(&organisation) {
            carry(session, &self.node).await?;
        }
        reach(&context, &source.address).await?.drop_ca(&organisation).await?;
        output.show(&Moved { organisation, node: target.full_name(), from })
    }

    /// The node that gives the CA up: the one that is named, or the only one besides the target.
    async fn source(&self, session: &Session, organisation: &str, target: &str) -> Result<String, Failure> {
        if let Some(from) = &self.from {
            return Ok(own_node(session, organisation, from).await?.full_name());
        }
        let carriers = carriers(session).await?;
        let others = carriers.iter().filter(|carrier| carrier.organisation == organisation);
        let mut others: Vec<_> = others.map(|carrier| carrier.full_name()).filter(|name| name != target).collect();
        match (others.pop(), others.is_empty()) {
            (Some(only), true) => Ok(only),
            (None, _) => {
                Err(Rejection::new(Code::CaElsewhere, format!("no other node carries the CA of {organisation}"))
                    .found(format!("{target} carries it, or nobody does"))
                    .next("ledgerctl ca status")
                    .into())
            }
            (Some(last), false) => Err(Rejection::new(Code::BadArgument, "several nodes carry the CA")
                .found(format!("{}, {last}", others.join(", ")))
                .wanted("--from NODE: the one that gives it up")
                .into()),
        }
    }
}
