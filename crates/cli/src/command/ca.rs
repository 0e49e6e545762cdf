//! `ca carry|status|forget|move`: which nodes carry the CA of your organisation; `ca backup|restore`: its copy for the safe.

mod copy;

use crate::confirm::confirm;
use crate::failure::Failure;
use crate::global::Global;
use crate::nodes::{carriers, current, find, nodes};
use crate::output::{Facts, Output, Table};
use crate::session::{MSP, Session};
use crate::time;
use bytes::Bytes;
use ledger::msp::{CarrierRecord, NodeRecord, NodeRole, UncarryCa};
use ledger_api::{Client, Context, Options, v1};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use serde::Serialize;
use std::io::{self, Write};
use std::time::Duration;

/// How long a node may take to show that it is there.
const ANSWER_TIME_MAX: Duration = Duration::from_secs(2);

/// Show and change which nodes hold the CA key of your organisation.
///
/// A node with the CA key enrols and renews. Registration and revocation need no CA key: they work through any node.
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Ca {
    Status(Status),
    Carry(Carry),
    Forget(Forget),
    Backup(copy::Backup),
    Restore(copy::Restore),
    Move(copy::Move),
}

/// Show which nodes hold the CA key of your organisation, and which of them answer.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl ca status")]
pub(crate) struct Status {}

/// Copy the CA key to another node of your organisation; for admins.
///
/// The key is transferred from a node that holds it, encrypted for the other node; this command cannot read it. If
/// interrupted, run the command again.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl ca carry node2")]
pub(crate) struct Carry {
    /// The node: its name, ORGANISATION/NAME, or its id
    node: String,
}

/// Record that a node no longer holds the CA key, because its disk is lost; for admins.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl ca forget node1")]
pub(crate) struct Forget {
    /// The node: its name, or ORGANISATION/NAME
    node: String,
    /// Do not ask if no other node holds the CA key
    #[arg(long)]
    i_mean_it: bool,
}

impl Ca {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = &Session::open(global).await?;
        match self {
            Self::Status(_) => status(session, output).await,
            Self::Carry(command) => command.run(session, output).await,
            Self::Forget(command) => command.run(session, output).await,
            Self::Backup(command) => command.run(session, output).await,
            Self::Restore(command) => command.run(session, output).await,
            Self::Move(command) => command.run(session, output).await,
        }
    }
}

/// The place where somebody of an organisation enrols, and the fingerprint of the CA behind that node. It is the
/// address of a node that carries its CA: the one that we are connected to, if it does.
pub(crate) async fn door(session: &Session, organisation: &str) -> Result<(String, Hash), Rejection> {
    let status = session.client.status().await?;
    let nodes = nodes(session).await?.nodes;
    let carriers = carriers(session).await?;
    let carries = |node: &&NodeRecord| {
        let this = |c: &CarrierRecord| {
            c.organisation == organisation && c.node_organisation == node.organisation && c.node == node.name
        };
        node.role != NodeRole::Removed && carriers.iter().any(this)
    };
    // The disk of another carrier may be lost, and the ledger still name it.
    let is_away = |id: u64| !status.peers.iter().any(|peer| peer.node_id == id && peer.connected);
    match nodes.iter().filter(carries).min_by_key(|node| (node.id != status.node_id, is_away(node.id))) {
        Some(node) if node.id != status.node_id => {
            Ok((node.address.clone(), session.ca_fingerprint(&node.organisation)?))
        }
        // Of no use to somebody who enrols if nobody carries the CA: then they are told so.
        _ => Ok((session.client.node().to_string(), session.ca_fingerprint(&status.organisation)?)),
    }
}

/// A node that carries the CA.
#[derive(Serialize)]
struct Carrier {
    node: String,
    address: String,
    since: u64,
    answers: bool,
}

#[derive(Serialize)]
struct Carriers {
    organisation: String,
    carriers: Vec<Carrier>,
}

impl Facts for Carriers {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self { organisation, carriers } = self;
        if !carriers.is_empty() {
            let mut table = Table::new(["NODE", "ADDRESS", "HOLDS THE CA KEY SINCE", "ANSWERS"]);
            for carrier in carriers {
                table.row([
                    carrier.node.clone(),
                    carrier.address.clone(),
                    time::moment(carrier.since),
                    if carrier.answers { "yes" } else { "no" }.to_owned(),
                ]);
            }
            table.write(out, 0)?;
        }
        match carriers.as_slice() {
            [] => writeln!(
                out,
                "no node holds the CA key of {organisation}: enrolment and renewal do not work\nrestore it from a \
                 backup: ledgerctl ca restore FILE"
            ),
            [only] => writeln!(
                out,
                "only {} holds the CA key: without that node, enrolment and renewal do not work; if its disk is lost, \
                 only a backup restores them\ncopy the key to another node: ledgerctl ca carry NODE\nmake a backup \
                 under a passphrase: ledgerctl ca backup FILE",
                only.node
            ),
            _ => Ok(()),
        }
    }
}

async fn status(session: &Session, output: &mut Output) -> Result<(), Failure> {
    let organisation = session.identity()?.organisation;
    let nodes = nodes(session).await?.nodes;
    let context = current(session).await?;
    let mut shown = Vec::new();
    for carrier in carriers(session).await?.into_iter().filter(|carrier| carrier.organisation == organisation) {
        let address = address(&nodes, &carrier).unwrap_or_default();
        let answers = matches!(tokio::time::timeout(ANSWER_TIME_MAX, reach(&context, &address)).await, Ok(Ok(_)));
        shown.push(Carrier { node: carrier.full_name(), address, since: carrier.since, answers });
    }
    output.show(&Carriers { organisation, carriers: shown })
}

fn address(nodes: &[NodeRecord], carrier: &CarrierRecord) -> Option<String> {
    let of = |node: &&NodeRecord| {
        node.role != NodeRole::Removed && node.organisation == carrier.node_organisation && node.name == carrier.node
    };
    nodes.iter().find(of).map(|node| node.address.clone())
}

/// A connection to one node and no other.
async fn reach(context: &Context, address: &str) -> Result<Client, Rejection> {
    Client::connect_with(vec![address.to_owned()], context.credentials()?, Options::default()).await
}

/// A node that carries the CA from now on.
#[derive(Serialize)]
struct Carried {
    organisation: String,
    node: String,
    from: String,
}

impl Facts for Carried {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "{} holds the CA key of {}, as does {}", self.node, self.organisation, self.from)
    }
}

impl Carry {
    async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        output.show(&carry(session, &self.node).await?)
    }
}

/// The node of the caller's organisation that is meant.
async fn own_node(session: &Session, organisation: &str, node: &str) -> Result<NodeRecord, Failure> {
    let nodes = nodes(session).await?.nodes;
    // Another organisation may have a node of this name.
    let own: Vec<_> = nodes.iter().filter(|node| node.organisation == organisation).cloned().collect();
    let target = find(&own, node).or_else(|_| find(&nodes, node))?;
    if target.organisation == organisation {
        return Ok(target.clone());
    }
    Err(Rejection::new(Code::WrongRole, format!("{} may not hold this CA key", target.full_name()))
        .found(format!("a node of {}", target.organisation))
        .wanted(format!("a node of {organisation}"))
        .into())
}

/// Lets a node carry the CA: the key goes there from one that carries it, sealed.
async fn carry(session: &Session, node: &str) -> Result<Carried, Failure> {
    let organisation = session.identity()?.organisation;
    let target = own_node(session, &organisation, node).await?;
    let context = current(session).await?;
    let nodes = nodes(session).await?.nodes;
    let own: Vec<_> = carriers(session)
        .await?
        .into_iter()
        .filter(|carrier| carrier.organisation == organisation && carrier.full_name() != target.full_name())
        .collect();
    let target_client = reach(&context, &target.address).await?;
    let offer = target_client.offer_ca(&organisation).await?;
    let sealed = v1::SealCaRequest {
        organisation: organisation.clone(),
        node: offer.node,
        key: offer.key,
        signature: offer.signature,
        certificate: offer.certificate,
    };
    let mut refused = Rejection::new(Code::CaElsewhere, format!("no node holds the CA key of {organisation}"))
        .next("ledgerctl ca restore FILE");
    for carrier in &own {
        let Some(address) = address(&nodes, carrier) else { continue };
        let client = match reach(&context, &address).await {
            Ok(client) => client,
            Err(unreachable) => {
                refused = unreachable;
                continue;
            }
        };
        match client.seal_ca(sealed.clone()).await {
            Ok(v1::SealCaResponse { sealed, root, .. }) => {
                let taken = v1::TakeCaRequest { organisation: organisation.clone(), sealed, root };
                target_client.take_ca(taken).await?;
                return Ok(Carried { organisation, node: target.full_name(), from: carrier.full_name() });
            }
            Err(reason) => refused = reason,
        }
    }
    Err(refused.into())
}

/// A node that carries the CA no more.
#[derive(Serialize)]
struct Forgotten {
    organisation: String,
    node: String,
}

impl Facts for Forgotten {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "{} no longer holds the CA key of {}, according to the ledger", self.node, self.organisation)?;
        writeln!(
            out,
            "a node that still has the key registers it again when it starts: first remove its directory ca/{}",
            self.organisation
        )
    }
}

impl Forget {
    async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let organisation = session.identity()?.organisation;
        let node = if self.node.contains('/') { self.node } else { format!("{organisation}/{}", self.node) };
        let mut own = carriers(session).await?;
        own.retain(|carrier| carrier.organisation == organisation);
        let is_last = own.len() == 1 && own.iter().all(|carrier| carrier.full_name() == node);
        let lost = format!(
            "no other node holds the CA key of {organisation}: enrolment and renewal do not work until it is restored \
             (ledgerctl ca restore FILE)"
        );
        confirm("removing the last holder of the CA key", &Vec::from_iter(is_last.then_some(lost)), self.i_mean_it)?;
        let uncarry = UncarryCa { organisation: organisation.clone(), node: Some(node.clone()) };
        let argument = serde_json::to_vec(&uncarry).map_err(|error| {
            Rejection::new(Code::Internal, "an argument cannot be encoded").found(error.to_string())
        })?;
        session.call(MSP, "uncarry_ca", vec![Bytes::from(argument)]).await?;
        output.show(&Forgotten { organisation, node })
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn told(carriers: Vec<Carrier>) -> String {
        let mut out = Vec::new();
        Carriers { organisation: "Org1".into(), carriers }.text(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn an_organisation_whose_ca_lies_at_one_node_or_none_is_told_what_to_do() {
        let carrier = |name: &str| Carrier { node: name.into(), address: "h:1".into(), since: 0, answers: true };
        assert!(told(vec![]).contains("ledgerctl ca restore FILE"));
        let one = told(vec![carrier("Org1/node1")]);
        assert!(one.contains("ledgerctl ca carry NODE") && one.contains("ledgerctl ca backup FILE"), "{one}");
        assert!(!told(vec![carrier("Org1/node1"), carrier("Org1/node2")]).contains("ledgerctl ca carry"));
    }
}
