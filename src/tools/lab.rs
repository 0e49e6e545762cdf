//! A network of several nodes for trials: organisations, nodes, robots and users on this machine, removed at the end.
//!
//! Everything is in one temporary directory, with a home of its own for the contexts: the user's home is not touched, and several
//! networks can run at a time.

mod facts;
mod layout;

use crate::process::clock::wall;
use crate::process::config::Log;
use crate::process::telemetry;
use crate::process::terminal::{eprint_line, print_line, stop_signal};
use crate::tools::child::Process;
use crate::tools::dev::paper_robots;
use crate::tools::setup::{found, issue};
use bytes::Bytes;
use facts::{Facts, NodeFacts};
use layout::{Layout, NodeLayout, Person};
use ledger_api::Client;
use ledger_api::context::Context;
use ledger_base::rejection::{Class, Code, Rejection};
use ledger_base::shell;
use std::path::Path;
use std::time::{Duration, Instant};
use tracing_subscriber::filter::LevelFilter;

/// Most organisations, and most voters.
const COUNT_MAX: u64 = 16;
/// Time until every node answers and the network has a leader.
const START_TIME_MAX: Duration = Duration::from_secs(60);
/// Between two looks at the processes.
const LOOK: Duration = Duration::from_millis(200);

/// `ledgerd lab`
#[derive(clap::Args)]
#[command(after_help = "Example:\n  ledgerd lab --organisations 4 --voters 4")]
pub(crate) struct Options {
    /// Organisations: Org1, Org2 and so on. Each has its own node and CA.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u64).range(1..=COUNT_MAX))]
    organisations: u64,
    /// Voters, assigned to the organisations in turn. The node of an organisation without a voter is a learner.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u64).range(1..=COUNT_MAX))]
    voters: u64,
    /// Print the facts as one line of JSON.
    #[arg(long)]
    json: bool,
}

/// Starts the network, prints what a user needs, and removes everything on Ctrl-C.
pub(crate) async fn run(options: Options) -> Result<(), Rejection> {
    telemetry::start(&Log::for_people(LevelFilter::WARN));
    let directory = tempfile::Builder::new()
        .prefix("ledgerd-lab-")
        .tempdir()
        .map_err(|error| Rejection::new(Code::BadFile, format!("cannot make a temporary directory: {error}")))?;
    let layout = Layout::new(directory.path(), options.organisations, options.voters)?;
    let stop = stop();
    tokio::pin!(stop);
    // Dropping the processes ends them, before the directory goes.
    let mut nodes = Vec::new();
    let started = tokio::select! {
        started = start(&layout, &mut nodes) => started,
        () = &mut stop => Err(Rejection::new(Code::ShuttingDown, "interrupted; all started processes have been ended")),
    };
    let facts = started?;
    print_line(&if options.json { facts.json()? } else { facts.text() })?;
    tokio::select! {
        () = watch(&layout, &mut nodes) => {}
        () = stop => {}
    }
    end(nodes).await;
    Ok(())
}

/// Ctrl-C, SIGTERM, or the end of the terminal.
fn stop() -> impl Future<Output = ()> {
    use tokio::signal::unix::{SignalKind, signal};
    let (stopped, hang_up) = (stop_signal(), signal(SignalKind::hangup()).ok());
    async move {
        let hung_up = async {
            match hang_up {
                Some(mut hang_up) => drop(hang_up.recv().await),
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            () = stopped => {}
            () = hung_up => {}
        }
    }
}

/// Founds the network, writes the contexts, starts the nodes and registers the robots.
async fn start(layout: &Layout, nodes: &mut Vec<Process>) -> Result<Facts, Rejection> {
    let founded = found(&layout.plan(), wall())?;
    let home = layout.home();
    let mut contexts = Vec::new();
    // Before the nodes run, which own their CAs from then on.
    for person in layout.people() {
        contexts.push(written(layout, &person, &home)?);
    }
    for node in &layout.nodes {
        std::fs::write(&node.config, node.settings()).map_err(|error| {
            Rejection::new(Code::BadFile, format!("cannot write {}: {error}", node.config.display()))
        })?;
        nodes.push(Process::start(
            &node.name,
            layout.directory(),
            &["run", "--config", &node.config.to_string_lossy()],
        )?);
    }
    let deadline = Instant::now() + START_TIME_MAX;
    let owner = Context::load(&home, Some(&layout::admin_context(layout.owner())))?;
    for node in &layout.nodes {
        ready(&owner, node, nodes, deadline).await?;
    }
    let robots = register_robots(layout, &owner).await?;
    let node_facts = |(node, process): (&NodeLayout, &Process)| NodeFacts::of(node, process.id());
    Ok(Facts {
        label: layout::LABEL,
        network: founded.network,
        directory: layout.directory().to_owned(),
        home,
        owner: layout.owner().to_owned(),
        robots,
        contexts,
        nodes: layout.nodes.iter().zip(nodes.iter()).map(node_facts).collect(),
        version: env!("CARGO_PKG_VERSION"),
    })
}

/// Issues an identity and writes its context, which knows the nodes of its organisation before the others. Its name is returned.
fn written(layout: &Layout, person: &Person, home: &Path) -> Result<String, Rejection> {
    let carrier = layout.carrier(&person.organisation)?;
    let who = (person.name.as_str(), person.role);
    let mut context =
        issue(&carrier.data, &person.organisation, who, person.attributes.clone(), &carrier.address, wall())?;
    context.nodes = layout.addresses_for(&person.organisation);
    context.name.clone_from(&person.context);
    context.save(home)?;
    Ok(context.name)
}

/// Waits until a node answers and knows a leader.
async fn ready(admin: &Context, node: &NodeLayout, nodes: &mut [Process], deadline: Instant) -> Result<(), Rejection> {
    loop {
        let status =
            async { Client::connect_to(vec![node.address.clone()], admin.credentials()?).await?.status().await };
        match status.await {
            Ok(status) if status.leader_id != 0 => return Ok(()),
            Ok(_) if Instant::now() > deadline => {
                return Err(Rejection::new(Code::Unreachable, format!("{} has no leader", node.name))
                    .wanted(format!("a leader within {START_TIME_MAX:?}"))
                    .next("end other programs that keep the machine busy, or start fewer voters: --voters 1"));
            }
            Err(rejection) if rejection.code.class() != Class::Unreachable || Instant::now() > deadline => {
                return Err(rejection);
            }
            _ => {
                nodes.iter_mut().try_for_each(Process::check)?;
                tokio::time::sleep(LOOK).await;
            }
        }
    }
}

/// The robots of the paper, of one organisation, which trusts the attributes of all.
async fn register_robots(layout: &Layout, owner: &Context) -> Result<Vec<String>, Rejection> {
    let client = Client::connect(owner).await?;
    let (mut names, mut specs) = (Vec::new(), Vec::new());
    for (name, mut spec) in paper_robots("exclusive") {
        if let Some(fields) = spec.as_object_mut() {
            fields.insert("trusted".to_owned(), layout.organisations.clone().into());
        }
        names.push(name.to_owned());
        specs.push(Bytes::from(spec.to_string()));
    }
    client.invoke("abac", "setup", specs).await?;
    Ok(names)
}

/// Names each node that ends, as a node does that is killed for a trial. The others continue.
async fn watch(layout: &Layout, nodes: &mut [Process]) {
    let mut has_ended = vec![false; nodes.len()];
    loop {
        for ((process, node), ended) in nodes.iter_mut().zip(&layout.nodes).zip(&mut has_ended) {
            if let Some(status) = process.ended().filter(|_| !*ended) {
                *ended = true;
                let config = shell::path(&node.config);
                eprint_line(&format!(
                    "{} has ended ({status}); to start it again: ledgerd run --config {config}",
                    node.name
                ));
            }
        }
        tokio::time::sleep(LOOK).await;
    }
}

/// Ends all nodes at a time.
async fn end(nodes: Vec<Process>) {
    let ends = nodes.into_iter().map(|mut node| async move {
        if node.ended().is_none()
            && let Err(rejection) = node.stop().await
        {
            tracing::warn!(code = rejection.code.name(), reason = %rejection, "a node did not shut down cleanly");
        }
    });
    futures::future::join_all(ends).await;
}
