//! A network of one node for playing: both organisations of the paper, its three robots, contexts for the admins.

mod ownership;

use crate::node::supervise::until_stopped;
use crate::node::{Host, NodeBuilder};
use crate::process::clock::wall;
use crate::process::config;
use crate::process::config::{Config, Log};
use crate::process::telemetry;
use crate::process::terminal::{print_line, stop_signal_of_terminal};
use crate::tools::setup::{NetworkPlan, PlannedNode, PlannedOrganisation, found, issue};
use crate::trust::ca;
use crate::trust::ca::CertificateAuthority;
use bytes::Bytes;
use ledger_api::Client;
use ledger_api::context::{Context, home};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use ledger_identity::key::KeyKind;
use ledger_storage::layout::GENESIS_FILE;
use ownership::Ownership;
use serde::Serialize;
use serde_json::json;
use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use tracing_subscriber::filter::LevelFilter;

/// The organisations of the paper.
pub(crate) const ORGANISATIONS: [&str; 2] = ["Org1", "Org2"];
/// The label by which a network for playing is recognised.
const LABEL: &str = "dev";
/// Where the page for whoever watches the node is: at a free port.
const ADMIN: &str = "127.0.0.1:0";
/// The port of the console, where that is free and the network has its usual one: browsers keep their keys by address and port.
const CONSOLE_PORT: u16 = 7452;

/// `ledgerd dev`
#[derive(clap::Args)]
pub(crate) struct Options {
    /// Keep the network in this directory and continue with it next time; by default it is temporary.
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Listen address; port 0 selects a free port.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:7450")]
    listen: String,
    /// Print the facts as one line of JSON.
    #[arg(long)]
    json: bool,
}

/// The output of `ledgerd dev --json`.
#[derive(Serialize)]
struct Facts {
    address: String,
    /// `http://HOST:PORT` of the page for whoever watches the node.
    admin: String,
    /// `http://HOST:PORT` of the console for browsers.
    console: String,
    ca_fingerprint: Hash,
    data: PathBuf,
    contexts: Vec<String>,
    network: Hash,
    robots: Vec<String>,
    version: &'static str,
}

/// Starts the network, prints what a player needs, and ends it on Ctrl-C or when the terminal is closed. Every likely reason to fail is looked at
/// before anything is made: another one may be running.
pub(crate) async fn run(builder: &NodeBuilder, options: Options) -> Result<(), Rejection> {
    telemetry::start(&Log::for_people(LevelFilter::WARN));
    let home = home()?;
    let mut owned = Ownership::take(&home)?;
    let (host, listen) = bound(&options.listen)?;
    let temporary =
        match options.data {
            Some(_) => None,
            None => Some(tempfile::tempdir().map_err(|error| {
                Rejection::new(Code::BadFile, format!("cannot make a temporary directory: {error}"))
            })?),
        };
    let data = match (&options.data, &temporary) {
        (Some(directory), _) => directory.clone(),
        (None, Some(temporary)) => temporary.path().join("node"),
        (None, None) => return Err(Rejection::new(Code::Internal, "no directory")),
    };
    owned.sign(&listen, &data);
    let fresh = !data.join(GENESIS_FILE).is_file();
    if fresh {
        found(&plan(&data, &listen), wall())?;
    }
    let console = config::Console { listen: console_address(&options.listen), ..Default::default() };
    let config =
        Config { data: data.clone(), listen, admin: ADMIN.to_owned(), console, is_trial: true, ..Config::default() };
    // Before the node runs, which owns its CAs from then on.
    let ca_fingerprint = authority(&data, ORGANISATIONS[0])?.fingerprint();
    let mut contexts = Written::default();
    if let Err(refused) = write_contexts(&data, &config.listen, &home, &mut contexts) {
        if temporary.is_some() {
            forget_contexts(&home, &contexts);
        }
        return Err(refused);
    }
    let facts = Facts {
        address: config.listen.clone(),
        admin: String::new(),
        console: String::new(),
        ca_fingerprint,
        data,
        contexts: contexts.names.clone(),
        network: contexts.network,
        robots: Vec::new(),
        version: env!("CARGO_PKG_VERSION"),
    };
    let played = play(builder, (host, &config), facts, &home, (fresh, options.json, temporary.is_some())).await;
    if temporary.is_some() {
        forget_contexts(&home, &contexts);
    }
    drop(owned);
    played
}

/// Runs the node until it is told to stop.
async fn play(
    builder: &NodeBuilder,
    (host, config): (Host, &Config),
    mut facts: Facts,
    home: &Path,
    (fresh, as_json, temporary): (bool, bool, bool),
) -> Result<(), Rejection> {
    let stop = stop_signal_of_terminal();
    let node = builder.start_on(&host, config).await?;
    drop(host);
    facts.admin = node.admin().map(|address| format!("http://{address}")).unwrap_or_default();
    facts.console = node.console().unwrap_or_default().to_owned();
    if fresh {
        facts.robots = register_robots(home, facts.contexts.last()).await?;
    }
    print(&facts, as_json, temporary)?;
    until_stopped(node, stop, futures::stream::pending()).await
}

/// One node that orders, and carries the CAs of both organisations.
fn plan(data: &Path, address: &str) -> NetworkPlan {
    let organisations = ORGANISATIONS.map(|name| PlannedOrganisation { name: name.into(), key: KeyKind::Ed25519 });
    let node = PlannedNode {
        name: "node1".into(),
        organisation: ORGANISATIONS[0].into(),
        data: data.to_owned(),
        address: address.to_owned(),
        voter: true,
    };
    NetworkPlan {
        snapshot_every: ledger::network::SNAPSHOT_EVERY_DEFAULT,
        label: LABEL.into(),
        organisations: organisations.into(),
        nodes: vec![node],
    }
}

/// A host, and its address. The genesis names the address, so the socket is bound before that is written, and kept: no other process can take
/// the port meanwhile.
fn bound(listen: &str) -> Result<(Host, String), Rejection> {
    let listener = TcpListener::bind(listen).map_err(|error| {
        let next = match error.kind() {
            ErrorKind::AddrInUse => "end the process that uses it, or use a free port: --listen 127.0.0.1:0",
            _ => "choose another address with --listen",
        };
        Rejection::new(Code::BadConfiguration, format!("cannot listen on {listen}"))
            .found(error.to_string())
            .wanted("an address of this machine that no program listens on")
            .next(next)
    })?;
    let host = Host::on(listener)?;
    let address = if listen.ends_with(":0") { host.address().to_string() } else { listen.to_owned() };
    Ok((host, address))
}

/// Where the console listens.
fn console_address(listen: &str) -> String {
    let usual = format!("127.0.0.1:{CONSOLE_PORT}");
    let is_free = !listen.ends_with(":0") && TcpListener::bind(&usual).is_ok();
    if is_free { usual } else { ADMIN.to_owned() }
}

fn authority(data: &Path, organisation: &str) -> Result<CertificateAuthority, Rejection> {
    CertificateAuthority::open(&data.join(ca::DIRECTORY).join(organisation))
}

/// The name of an admin's context.
fn context_name(organisation: &str) -> String {
    format!("dev-{}-admin", organisation.to_lowercase())
}

/// The contexts that were written, by name, and the network's name.
#[derive(Default)]
struct Written {
    names: Vec<String>,
    network: Hash,
}

/// A context for the admin of each organisation, made anew at each start. The list of written contexts stands in
/// `written`, also if one fails.
fn write_contexts(data: &Path, address: &str, home: &Path, written: &mut Written) -> Result<(), Rejection> {
    for organisation in ORGANISATIONS {
        let admin = ("Admin", Role::Admin);
        let mut context = issue(data, organisation, admin, BTreeMap::new(), address, wall())?;
        context.name = context_name(organisation);
        context.save(home)?;
        written.network = context.network;
        written.names.push(context.name);
    }
    Ok(())
}

/// The robots of the paper, registered by their owner.
async fn register_robots(home: &Path, admin: Option<&String>) -> Result<Vec<String>, Rejection> {
    let context = Context::load(home, admin.map(String::as_str))?;
    let client = Client::connect(&context).await?;
    let robots = paper_robots("exclusive");
    let names = robots.iter().map(|(name, _)| (*name).to_owned()).collect();
    client.invoke("abac", "setup", robots.into_iter().map(|(_, spec)| Bytes::from(spec.to_string())).collect()).await?;
    Ok(names)
}

/// Turtlebot4 and Husky with their `/cmd_vel`, OptiTrack with its poses (paper, "Task"). They trust both organisations.
pub(crate) fn paper_robots(mode: &str) -> Vec<(&'static str, serde_json::Value)> {
    let mobile = |name: &'static str| {
        let service = json!({"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist", "mode": mode});
        (name, json!({"name": name, "attribute_required": name, "trusted": ORGANISATIONS, "services": [service]}))
    };
    let poses =
        json!({"topic": "/poses", "type": "geometry_msgs/msg/PoseStamped", "mode": "open", "direction": "feed"});
    let optitrack =
        json!({"name": "OptiTrack", "attribute_required": "OptiTrack", "trusted": ORGANISATIONS, "services": [poses]});
    vec![mobile("Turtlebot4"), mobile("Husky"), ("OptiTrack", optitrack)]
}

fn print(facts: &Facts, as_json: bool, temporary: bool) -> Result<(), Rejection> {
    if as_json {
        let line = serde_json::to_string(facts).map_err(|error| Rejection::new(Code::Internal, error.to_string()))?;
        return print_line(&line);
    }
    let [admin, owner] = ORGANISATIONS.map(context_name);
    print_line(&format!(
        "ledgerd {version} · a network for trials, ready\n\n  address         {address}\n  monitoring      \
         {page}/metrics\n  console         {console} (ledgerctl --context {owner} console prints a link for a \
         browser)\n  CA fingerprint  {fingerprint}\n  data            {data}{kept}\n  contexts        {admin} (Org1), \
         {owner} (Org2, owns Turtlebot4, Husky and OptiTrack)\n\nNext, in another terminal:\n\n  ledgerctl --context \
         {admin} identity register Salma --attr Turtlebot4 --attr Husky\n  ledgerctl enroll Salma --node {address} \
         --ca-fingerprint {fingerprint} --secret SECRET\n  ledgerctl --context Salma acquire Turtlebot4\n\n(The first \
         command prints SECRET. cargo build --release also builds ledgerctl.) Ctrl-C ends the network.",
        version = facts.version,
        address = facts.address,
        page = facts.admin,
        console = facts.console,
        fingerprint = facts.ca_fingerprint,
        data = facts.data.display(),
        kept = if temporary { " (removed at the end; --data DIR keeps it)" } else { "" },
    ))
}

/// Removes the contexts of a network that is gone, unless somebody has put another network's in their places.
fn forget_contexts(home: &Path, written: &Written) {
    for name in &written.names {
        if Context::load(home, Some(name)).is_ok_and(|context| context.network == written.network)
            && let Err(rejection) = Context::remove(home, name)
        {
            tracing::warn!(code = rejection.code.name(), reason = %rejection, "cannot remove a context of the \
                                                                               previous network");
        }
    }
}
