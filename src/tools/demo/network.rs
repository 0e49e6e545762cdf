//! The processes of the demo: two nodes and three bridges, in a temporary directory.

use super::bridges::{Bridges, Plan};
use super::summary::Summary;
use crate::process::clock::wall;
use crate::tools::child::Process;
use crate::tools::dev::ORGANISATIONS;
use crate::tools::setup::{Founded, NetworkPlan, PlannedNode, PlannedOrganisation, found, issue};
use ledger_api::context::Context;
use ledger_api::{Client, Enrolment};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use ledger_identity::key::KeyKind;
use std::collections::BTreeMap;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Time for a node to answer after it was started.
const START_TIME_MAX: Duration = Duration::from_secs(20);
/// Time for the follower to reach the leader's height on an idle network.
const CONVERGE_TIME_MAX: Duration = Duration::from_secs(10);
/// The robots that have bridges.
const ROBOTS: [&str; 2] = ["Turtlebot4", "OptiTrack"];

/// The running experiment. Dropping it ends the processes and removes the directory.
pub struct Network {
    /// A client of Org2's admin, who owns the robots.
    pub owner: Client,
    admin: Client,
    founded: Founded,
    addresses: [String; 2],
    nodes: Vec<Process>,
    /// The bridges that run.
    pub bridges: Bridges,
    // Declared last: removed after the processes are gone.
    directory: TempDir,
}

impl Network {
    /// Founds the network of the paper and starts its two nodes.
    pub async fn start() -> Result<Self, Rejection> {
        let directory = tempfile::Builder::new()
            .prefix("ledgerd-demo-")
            .tempdir()
            .map_err(|error| Rejection::new(Code::BadFile, format!("cannot make a temporary directory: {error}")))?;
        let addresses = free_addresses()?;
        let data = ORGANISATIONS.map(|organisation| directory.path().join(organisation));
        let founded = found(&plan(&data, &addresses), wall())?;
        // Identities that their CAs issue without being asked over the network, before the nodes own the CAs.
        let admin = identity(&data[0], ORGANISATIONS[0], ("Admin", Role::Admin), &addresses[0])?;
        let owner = identity(&data[1], ORGANISATIONS[1], ("Admin", Role::Admin), &addresses[1])?;
        for robot in ROBOTS {
            identity(&data[1], ORGANISATIONS[1], (robot, Role::Robot), &addresses[1])?
                .save(&directory.path().join("home"))?;
        }
        let mut nodes = Vec::new();
        for ((organisation, data), address) in ORGANISATIONS.iter().zip(&data).zip(&addresses) {
            let config = directory.path().join(format!("{organisation}.toml"));
            write(&config, &format!("data = {:?}\nlisten = {address:?}\n", data.display().to_string()))?;
            nodes.push(Process::start(
                organisation,
                directory.path(),
                &["run", "--config", &config.to_string_lossy()],
            )?);
        }
        let admin = connect(&admin, &mut nodes).await?;
        let owner = connect(&owner, &mut nodes).await?;
        Ok(Self { owner, admin, founded, addresses, nodes, bridges: Bridges::default(), directory })
    }

    fn home(&self) -> PathBuf {
        self.directory.path().join("home")
    }

    /// The addresses of the nodes: Org1's, and Org2's.
    pub fn addresses(&self) -> &[String; 2] {
        &self.addresses
    }

    /// Org1's admin registers a user, who enrols from outside as anybody would. An attribute is `KEY=VALUE`, or `KEY` for
    /// `KEY=true`.
    pub async fn enrol_user(&self, name: &str, attributes: &[&str]) -> Result<Client, Rejection> {
        let attributes: BTreeMap<_, _> = attributes
            .iter()
            .map(|attribute| attribute.split_once('=').unwrap_or((attribute, "true")))
            .map(|(key, value)| (key.to_owned(), value.to_owned()))
            .collect();
        let secret = self.admin.register(name, Role::Member, &attributes).await?;
        let fingerprint = self.founded.authorities.first().map_or(Hash::ZERO, |authority| authority.fingerprint);
        let context = Enrolment::new(self.addresses[0].as_str(), fingerprint)
            .enrol(name, &secret.secret, KeyKind::Ed25519)
            .await?;
        context.save(&self.home())?;
        Client::connect(&context).await
    }

    /// Starts bridges.
    pub fn start_bridges(&mut self, plans: &[Plan<'_>]) -> Result<(), Rejection> {
        let home = self.home();
        plans.iter().try_for_each(|plan| self.bridges.start(plan, &home, self.directory.path()))
    }

    /// Fails if a process has ended by itself.
    pub fn check(&mut self) -> Result<(), Rejection> {
        self.nodes.iter_mut().try_for_each(Process::check)?;
        self.bridges.check()
    }

    /// Ends the bridges, whose last line says what they saw, and compares the nodes.
    pub(super) async fn report(&mut self, summary: &mut Summary) -> Result<(), Rejection> {
        for (_, line, report) in self.bridges.stop().await? {
            summary.add(report);
            summary.counted.push(line);
        }
        let deadline = Instant::now() + CONVERGE_TIME_MAX;
        loop {
            let (leader, follower) = tokio::try_join!(self.admin.status(), self.owner.status())?;
            if leader.height == follower.height || Instant::now() > deadline {
                summary.height = leader.height;
                summary.digest_equal = leader.height == follower.height
                    && leader.state_digest == follower.state_digest
                    && leader.block_hash == follower.block_hash;
                return Ok(());
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// Ends the nodes in order; the directory goes with `self`.
    pub async fn stop(mut self) -> Result<(), Rejection> {
        for node in self.nodes.drain(..) {
            node.stop().await?;
        }
        Ok(())
    }
}

fn plan(data: &[PathBuf; 2], addresses: &[String; 2]) -> NetworkPlan {
    let organisations = ORGANISATIONS.map(|name| PlannedOrganisation { name: name.into(), key: KeyKind::Ed25519 });
    let nodes =
        ORGANISATIONS.iter().zip(data).zip(addresses).enumerate().map(|(index, ((organisation, data), address))| {
            PlannedNode {
                name: format!("{}-node", organisation.to_lowercase()),
                organisation: (*organisation).into(),
                data: data.clone(),
                address: address.clone(),
                // As in the paper: Org1 orders.
                voter: index == 0,
            }
        });
    NetworkPlan {
        snapshot_every: ledger::network::SNAPSHOT_EVERY_DEFAULT,
        label: "demo".into(),
        organisations: organisations.into(),
        nodes: nodes.collect(),
    }
}

/// Two addresses that nobody uses at the moment.
fn free_addresses() -> Result<[String; 2], Rejection> {
    let failed = |error: std::io::Error| Rejection::new(Code::Internal, format!("no free port on 127.0.0.1: {error}"));
    // Both are held at once, so that they differ.
    let (a, b) = (TcpListener::bind("127.0.0.1:0").map_err(failed)?, TcpListener::bind("127.0.0.1:0").map_err(failed)?);
    Ok([a.local_addr().map_err(failed)?.to_string(), b.local_addr().map_err(failed)?.to_string()])
}

fn write(path: &Path, text: &str) -> Result<(), Rejection> {
    std::fs::write(path, text)
        .map_err(|error| Rejection::new(Code::BadFile, format!("cannot write {}: {error}", path.display())))
}

fn identity(data: &Path, organisation: &str, who: (&str, Role), address: &str) -> Result<Context, Rejection> {
    issue(data, organisation, who, BTreeMap::new(), address, wall())
}

/// Connects as soon as the node answers.
async fn connect(context: &Context, nodes: &mut [Process]) -> Result<Client, Rejection> {
    let deadline = Instant::now() + START_TIME_MAX;
    loop {
        match Client::connect_to(context.nodes.clone(), context.credentials()?).await {
            Ok(client) => return Ok(client),
            Err(rejection) if rejection.code != Code::Unreachable || Instant::now() > deadline => {
                return Err(rejection);
            }
            Err(_) => {
                nodes.iter_mut().try_for_each(Process::check)?;
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        }
    }
}
