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

/// Back up the CA key of your organisation to a file, under a passphrase; for admins.
///
/// The file is PEM: the encrypted key and the root certificate. It remains valid as long as the CA does. The ledger
/// records who made the backup and when. Existing files are not overwritten.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl ca backup org1-ca.pem")]
pub(crate) struct Backup {
    /// File of the backup
    file: PathBuf,
    /// File whose first line is the passphrase; otherwise LEDGERD_PASSPHRASE, otherwise a prompt
    #[arg(long, value_name = "FILE")]
    passphrase_file: Option<PathBuf>,
}

/// Restore the CA key of your organisation from a file of `ca backup`; for admins.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl ca restore org1-ca.pem --node node2")]
pub(crate) struct Restore {
    /// File of the backup
    file: PathBuf,
    /// Node that receives the CA key: its name, ORGANISATION/NAME, or its id; by default the node of the context
    #[arg(long, value_name = "NODE")]
    node: Option<String>,
    /// File whose first line is the passphrase; otherwise LEDGERD_PASSPHRASE, otherwise a prompt
    #[arg(long, value_name = "FILE")]
    passphrase_file: Option<PathBuf>,
}

/// Move the CA key of your organisation to another node, and remove it from the node that holds it; for admins.
///
/// The new node has the key before the old one removes it. If interrupted, run the command again.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl ca move node2")]
pub(crate) struct Move {
    /// Node that receives the CA key: its name, ORGANISATION/NAME, or its id
    node: String,
    /// Node that removes the key, if several hold it
    #[arg(long, value_name = "NODE")]
    from: Option<String>,
    /// Do not ask for confirmation
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
        writeln!(out, "the CA key of {organisation} is backed up in {}; {from} still holds it", file.display())?;
        writeln!(out, "store the file and the passphrase separately, and both away from the nodes")?;
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
    let mut refused = Rejection::new(Code::CaElsewhere, format!("no node holds the CA key of {organisation}"))
        .next("restore it from an earlier backup: ledgerctl ca restore FILE");
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
        writeln!(out, "{} holds the CA key of {} from now on", self.node, self.organisation)
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
        writeln!(out, "{node} holds the CA key of {organisation}; the key is removed from {from}")
    }
}

impl Move {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let organisation = session.identity()?.organisation;
        let target = own_node(session, &organisation, &self.node).await?;
        let from = self.source(session, &organisation, &target.full_name()).await?;
        let source = own_node(session, &organisation, &from).await?;
        let lost = [format!("{from} removes the CA key of {organisation}; {} then holds it", target.full_name())];
        confirm("moving the CA key", &lost, self.i_mean_it)?;
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
                Err(Rejection::new(Code::CaElsewhere, format!("no other node holds the CA key of {organisation}"))
                    .found(format!("{target} holds it, or no node does"))
                    .next("ledgerctl ca status")
                    .into())
            }
            (Some(last), false) => Err(Rejection::new(Code::BadArgument, "several nodes hold the CA key")
                .found(format!("{}, {last}", others.join(", ")))
                .wanted("--from NODE: the node that removes the key")
                .into()),
        }
    }
}
