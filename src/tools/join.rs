//! `ledgerd join TOKEN`: one command brings a node in, of an organisation of the network or of one that was invited.
//!
//! Everything is prepared in a directory beside the data directory and put in its place when the network has accepted
//! the node. Each step keeps what it has made and is good for being done again, so that a join that was interrupted is
//! finished by typing the same command.
//!
//! | step | what remains |
//! |---|---|
//! | ask a node of the token, pinned to its CA, for the genesis, whose hash is in the token | `genesis.json` |
//! | make a key here | `node.key` |
//! | have it certified: by the CA of the organisation with the one-time secret, or by a CA founded here | `node.pem`, `ca/` |
//! | a new organisation: sign its authorities with the key of the invitation | the organisation on the ledger |
//! | submit `msp join_node` as the node | its record on the ledger, `node.json` |

mod again;
mod branches;
mod identity;
mod place;
mod renew;

pub(crate) use again::{RejoinOptions, rejoin};
pub(crate) use renew::{RenewOptions, renew};

use crate::process::clock::wall;
use crate::process::config::{Config, MemberOf};
use crate::tools::setup::{Settings, public_address};
use crate::trust::membership::Joined;
use bytes::Bytes;
use ledger::msp::NAME as MSP;
use ledger::network::Genesis;
use ledger_api::tls::{ServerTrust, TlsIdentity};
use ledger_api::token::{JoinKind, JoinToken};
use ledger_api::{Client, Credentials, Enrolment, Options};
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shell;
use place::JoinDirectory;
use serde::Deserialize;
use std::io::ErrorKind;
use std::net::TcpListener;
use std::path::PathBuf;
use std::time::Duration;

/// Most microseconds that this machine's clock may differ from the network's: certificates begin five minutes early.
const CLOCK_DIFFERENCE_MAX: u64 = 4 * 60 * 1_000_000;

/// The role of a node that was removed.
const REMOVED: &str = "removed";

/// Time in which somebody who listens accepts a connection.
const ANSWER_TIME_MAX: Duration = Duration::from_secs(2);

/// The arguments of `ledgerd join`.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct JoinOptions {
    /// Token printed by ledgerctl network invite; @FILE for the first line of a file, - for standard input. Other users
    /// of this machine can read arguments, with --run as long as the node runs.
    #[arg(value_name = "TOKEN")]
    token: String,
    /// The node's configuration; created if it does not exist.
    #[arg(long, value_name = "FILE", default_value = "ledgerd.toml")]
    pub config: PathBuf,
    /// Data directory, if the configuration is created; next to it by default.
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Address under which clients and other nodes reach the node; by default that of a returning node, else the
    /// setting `listen`.
    #[arg(long, value_name = "HOST:PORT")]
    address: Option<String>,
    /// Listen address, if the configuration is created; by default derived from the address.
    #[arg(long, value_name = "HOST:PORT")]
    listen: Option<String>,
    /// For a new organisation: name of its first admin, who gets a one-time secret.
    #[arg(long, value_name = "NAME", default_value = "admin")]
    admin: String,
    /// Continue as the running node.
    #[arg(long)]
    pub run: bool,
}

/// Joins; answers with what to tell the user.
///
/// # Errors
/// [`Code::BadArgument`] for a bad token, [`Code::Unreachable`], [`Code::Untrusted`] if a node is of another network;
/// [`Code::EnrolmentRefused`] if the secret was used or has expired, [`Code::BadFile`] if the data directory is of
/// something else; the ledger's own refusal: no invitation, not approved yet.
pub(crate) async fn join(options: &JoinOptions) -> Result<String, Rejection> {
    let token: JoinToken = ledger_api::secret(&options.token)?.parse()?;
    let (address, listen) = (options.address.as_deref(), options.listen.as_deref());
    let mut settings = Settings::of(&options.config, address, listen, options.data.as_deref())?;
    let config = &settings.config.clone();
    check_own(config, &token)?;
    let before = Some(config.member.address.as_str()).filter(|before| !before.is_empty());
    let address = public_address(address.or(before), &config.listen, "ledgerd join TOKEN")?;
    let place = JoinDirectory::open(&config.data, &token)?;
    if place.is_joined() {
        return come_back(&place, &token, options, config).await;
    }
    check_address(&token, &address, &config.listen).await?;
    let contact = Contact::find(&token).await?;
    let (genesis, document) = (&contact.genesis, &contact.document);
    place.keep_genesis(document)?;
    let identity = match token.kind {
        JoinKind::Node => identity::enrolled(&place, &token, &contact.enrolment).await?,
        JoinKind::Organisation => {
            let identity = identity::founded(&place, &token, config, wall())?;
            let join = identity::signed_join(&place, &token, &address)?;
            contact.enrolment.join_organisation(join).await?;
            identity
        }
    };
    let id = join_node(&place, &token, &contact.address, &address, &identity).await?;
    let joined = Joined {
        network: token.network,
        id,
        organisation: token.organisation.clone(),
        name: token.node.clone(),
        address,
        bootstrap: contact.in_front(&token),
        ca: token.ca,
    };
    place.finish(&joined)?;
    let hint = settings.name(joined.network, &format!("{}/{}", joined.organisation, joined.name), &joined.address);
    settings.write(&options.config)?;
    Ok(told(&joined, &genesis.label, &token, options, config)? + &hint)
}

/// The node of the token that answered.
struct Contact {
    address: String,
    enrolment: Enrolment,
    genesis: Genesis,
    document: Bytes,
}

impl Contact {
    /// The first node of the token that answers; a node that is not what the token says ends the search.
    async fn find(token: &JoinToken) -> Result<Self, Rejection> {
        let mut refused = Rejection::new(Code::Unreachable, "the token names no node");
        for address in &token.addresses {
            let enrolment = Enrolment::new(address, token.ca).into_network(token.network);
            match enrolment.genesis(&token.network).await {
                Ok((genesis, document)) => {
                    check_clock(enrolment.network().await?.clock, address)?;
                    return Ok(Self { address: address.clone(), enrolment, genesis, document });
                }
                Err(reason) if reason.code == Code::Unreachable => refused = reason,
                Err(reason) => return Err(reason),
            }
        }
        Err(refused)
    }

    /// All addresses of the token, the one that answered first.
    fn in_front(&self, token: &JoinToken) -> Vec<String> {
        let others = token.addresses.iter().filter(|other| **other != self.address);
        std::iter::once(&self.address).chain(others).cloned().collect()
    }
}

fn check_clock(theirs: u64, address: &str) -> Result<(), Rejection> {
    let ours = wall();
    if ours.abs_diff(theirs) <= CLOCK_DIFFERENCE_MAX {
        return Ok(());
    }
    let way = if ours > theirs { "ahead of" } else { "behind" };
    Err(Rejection::new(Code::BadConfiguration, "the clocks of this machine and of the network differ")
        .found(format!("this one {} s {way} that of the node at {address}", ours.abs_diff(theirs) / 1_000_000))
        .wanted(format!("at most {} s between them", CLOCK_DIFFERENCE_MAX / 1_000_000))
        .next("set the clock of this machine, for example with NTP, and run the command again"))
}

/// A configuration that is another node's already is not taken for this one.
fn check_own(config: &Config, token: &JoinToken) -> Result<(), Rejection> {
    let MemberOf { network, node, .. } = &config.member;
    let wanted = format!("{}/{}", token.organisation, token.node);
    let other_network = !network.is_empty() && *network != token.network.to_string();
    if !other_network && (node.is_empty() || *node == wanted) {
        return Ok(());
    }
    let file = config.file.display();
    Err(Rejection::new(Code::BadConfiguration, format!("{file} is the configuration of another node"))
        .found(format!("node {node} of network {network}, in the section [member]"))
        .wanted(format!("node {wanted} of network {}, as the token says", token.network))
        .next("choose another file with --config, or request a token for that node"))
}

/// That the address is somebody else's is better told before anything is used up. The token may name the address of a
/// node that is gone, and whose place this one takes. The node that listens there counts.
async fn check_address(token: &JoinToken, address: &str, listen: &str) -> Result<(), Rejection> {
    let next = "stop that process, or choose another address: ledgerd join TOKEN --address HOST:PORT";
    if let Err(error) = TcpListener::bind(listen) {
        let what = match error.kind() {
            ErrorKind::AddrInUse => format!("another process uses the address {listen}"),
            _ => format!("this node cannot listen at {listen}"),
        };
        return Err(Rejection::new(Code::BadConfiguration, what)
            .found(error.to_string())
            .wanted("an address and port of this machine, for this node alone")
            .next(next));
    }
    if token.addresses.iter().any(|theirs| theirs == address) && answers(address).await {
        return Err(Rejection::new(Code::BadConfiguration, "a node of the network answers at this address")
            .found(address)
            .wanted("an address and port for this node alone")
            .next(next));
    }
    Ok(())
}

/// Does somebody listen there?
async fn answers(address: &str) -> bool {
    let connected = tokio::time::timeout(ANSWER_TIME_MAX, tokio::net::TcpStream::connect(address)).await;
    matches!(connected, Ok(Ok(_)))
}

/// A node on the ledger, as far as it matters here: the answers of `msp nodes` and `msp join_node`.
#[derive(Deserialize)]
struct Record {
    id: u64,
    name: String,
    organisation: String,
    address: String,
    role: String,
}

impl Record {
    fn full_name(&self) -> String {
        format!("{}/{}", self.organisation, self.name)
    }
}

#[derive(Deserialize)]
struct Records {
    nodes: Vec<Record>,
}

/// The nodes on the ledger, with those that were removed.
async fn records(client: &Client) -> Result<Records, Rejection> {
    let answer = client.query(MSP, "nodes", Vec::new()).await?.response;
    serde_json::from_slice(&answer).map_err(|error| unreadable("nodes", &error))
}

fn unreadable(function: &str, error: &serde_json::Error) -> Rejection {
    Rejection::new(Code::Internal, format!("the answer of msp {function} cannot be read")).found(error.to_string())
}

/// Submits `msp join_node` as the new node; answers with its number.
async fn join_node(
    place: &JoinDirectory,
    token: &JoinToken,
    node: &str,
    address: &str,
    identity: &TlsIdentity,
) -> Result<u64, Rejection> {
    let credentials = Credentials::new(token.network, identity.clone(), ServerTrust::Fingerprint(token.ca.0))?;
    let client = Client::connect_with(vec![node.to_owned()], credentials, Options::default()).await?;
    enter(&client, (&token.organisation, &token.node), address, |present| place.id_before(present)).await
}

/// Enters a node in the ledger, as that node; answers with its number. `before` is told the number that the ledger has for
/// it, 0 for none, and answers with the one that it had at the first try.
///
/// A node of this name that is on the ledger already has lost its disk: with its number would come back a voter that
/// has forgotten its votes. So it gets a new one; unless the number is from an earlier try of this very join.
async fn enter(
    client: &Client,
    (organisation, name): (&str, &str),
    address: &str,
    before: impl FnOnce(u64) -> Result<u64, Rejection>,
) -> Result<u64, Rejection> {
    let records = records(client).await?;
    let live = || records.nodes.iter().filter(|record| record.role != REMOVED);
    let own = live().find(|record| record.organisation == organisation && record.name == name);
    let before = before(own.map_or(0, |record| record.id))?;
    let replaced = own.filter(|own| own.id == before);
    if let Some(running) = replaced.filter(|own| own.address != address)
        && answers(&running.address).await
    {
        return Err(Rejection::new(
            Code::AlreadyExists,
            format!("node {} is running on another machine", running.full_name()),
        )
        .found(format!("node {}, which answers at {}", running.id, running.address))
        .wanted("a lost node to be replaced, or another name")
        .next(format!(
            "stop that node, or invite one with another name: ledgerctl network invite --node NAME; or remove it \
                 first: ledgerctl network remove {}",
            running.full_name()
        )));
    }
    let argument = serde_json::json!({ "address": address, "replace": replaced.is_some() }).to_string();
    let done = client.invoke(MSP, "join_node", vec![argument.into()]).await.map_err(|refused| {
        match live().find(|record| record.address == address && record.full_name() != format!("{organisation}/{name}"))
        {
            Some(other) if refused.code == Code::AlreadyExists => refused.next(format!(
                "if {0} is permanently lost, an admin runs ledgerctl network remove {0}; then run the command again. \
                 Otherwise choose another address: --address HOST:PORT",
                other.full_name()
            )),
            _ => refused,
        }
    })?;
    let record: Record = serde_json::from_slice(&done.response).map_err(|error| unreadable("join_node", &error))?;
    Ok(record.id)
}

/// The node has joined before: what is to be done is told again, and a certificate that is running out, or has, is
/// replaced with the token's secret.
///
/// # Errors
/// [`Code::AlreadyExists`] if the node runs, [`Code::BadFile`] if the network has removed it.
async fn come_back(
    place: &JoinDirectory,
    token: &JoinToken,
    options: &JoinOptions,
    config: &Config,
) -> Result<String, Rejection> {
    let (joined, label) = place.joined(token)?;
    if place.is_running() {
        return Err(Rejection::new(
            Code::AlreadyExists,
            format!("node {}/{} is running already: it cannot join again", token.organisation, token.node),
        )
        .found(format!("{} is in use", config.data.display()))
        .wanted("the data directory of a stopped node, or one that does not exist yet")
        .next("ledgerctl status shows the node; to join another one, choose another --config and --data"));
    }
    check_member(place, token, &joined, config).await?;
    if token.kind == JoinKind::Node && place.renewal_due(wall())? {
        let contact = Contact::find(token).await?;
        identity::replaced(place, token, &contact.enrolment).await?;
        return Ok(format!(
            "node {}/{} has a new certificate; its data are unchanged\n\nnext:\n  ledgerd run --config {}",
            token.organisation,
            token.node,
            shell::path(&options.config)
        ));
    }
    told(&joined, &label, token, options, config)
}

/// Rejects a node that the network has removed: its number never comes back. Without an answer of the network nothing is known.
async fn check_member(
    place: &JoinDirectory,
    token: &JoinToken,
    joined: &Joined,
    config: &Config,
) -> Result<(), Rejection> {
    let Some(identity) = place.identity() else { return Ok(()) };
    let asked = async {
        let contact = Contact::find(token).await?;
        let credentials = Credentials::new(token.network, identity, ServerTrust::Fingerprint(token.ca.0))?;
        let client = Client::connect_with(vec![contact.address], credentials, Options::default()).await?;
        records(&client).await
    };
    let removed = match asked.await {
        Ok(records) => records.nodes.iter().all(|record| record.id != joined.id || record.role == REMOVED),
        Err(refused) => refused.code == Code::Revoked,
    };
    if !removed {
        return Ok(());
    }
    let data = config.data.display();
    Err(Rejection::new(
        Code::BadFile,
        format!("node {}/{} was removed from the network", joined.organisation, joined.name),
    )
    .found(format!("{data} is the data directory of node {}, which is no longer a member", joined.id))
    .wanted("a directory that does not exist yet: the node joins with a new number")
    .next(format!("move {data} away, and run the command again")))
}

/// The text that the user reads in the end: it tells the outcome, and every command that is still to be typed.
fn told(
    joined: &Joined,
    label: &str,
    token: &JoinToken,
    options: &JoinOptions,
    config: &Config,
) -> Result<String, Rejection> {
    let Joined { id, organisation, name, address, .. } = joined;
    let mut facts = format!(
        "node {organisation}/{name} has joined network {label:?} as node {id}, a learner\n\
         address  {address}, data in {}\n",
        config.data.display()
    );
    let mut next = String::new();
    if !options.run {
        next += &format!("  ledgerd run --config {}\n", shell::path(&options.config));
    }
    let mut context = String::new();
    if token.kind == JoinKind::Organisation {
        // Several organisations may have an admin of this name, and one person may be several of them.
        context = format!("--context {organisation}-{} ", options.admin);
        if let Some((fingerprint, secret)) = identity::admin_secret(token, &options.admin, config, wall())? {
            let admin = &options.admin;
            let days = config.ca.secret_days;
            facts += &format!(
                "CA       {organisation}, sha256 {fingerprint}\nadmin    {organisation}/{admin}, to enrol within {days} days\n"
            );
            next += &format!(
                "  ledgerctl {context}enroll {admin} --node {address} --ca-fingerprint {fingerprint} --secret {secret}\n"
            );
        }
    }
    Ok(format!(
        "{facts}\nnext:\n{next}  ledgerctl {context}network promote {organisation}/{name}\nThe last command makes the \
         node a voter once its log is up to date. With several organisations, it prints the command\nwith which an \
         admin of another one approves."
    ))
}
