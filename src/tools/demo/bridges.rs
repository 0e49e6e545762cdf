//! The bridges of a demo: a process for each graph.

use super::graph::{DISCOVERY_TIME_MAX, nobody_there};
use super::summary::BridgeReport;
use crate::process::random;
use crate::tools::child::Process;
use ledger_api::context::{Context, Memory};
use ledger_base::rejection::{Code, Rejection};
use std::path::Path;
use std::time::Instant;

/// Between two looks at what the bridges have found.
const LOOK: std::time::Duration = std::time::Duration::from_millis(20);
/// Highest ROS 2 domain id whose UDP ports are not taken by the operating system for other things.
const DOMAIN_MAX: u64 = 100;

/// So many ROS 2 domain ids that follow each other, somewhere in their range.
pub fn domains<const COUNT: usize>() -> Result<[u16; COUNT], Rejection> {
    let first = 1 + random::number()? % (DOMAIN_MAX - COUNT as u64);
    let mut domains = [0; COUNT];
    for (domain, number) in domains.iter_mut().zip(first..) {
        *domain = u16::try_from(number).unwrap_or(1);
    }
    Ok(domains)
}

/// One topic of a service, in one direction.
#[derive(Clone, Copy)]
pub struct Route {
    /// `Turtlebot4/cmd_vel`
    pub service: &'static str,
    /// `to_ledger` or `from_ledger`
    pub direction: &'static str,
    /// The local topic.
    pub topic: &'static str,
    /// `geometry_msgs/msg/Twist`
    pub kind: &'static str,
}

/// A bridge to start.
pub struct Plan<'a> {
    /// The name of its context.
    pub name: &'static str,
    /// The ROS 2 domain of its graph.
    pub domain: u16,
    /// Its routes.
    pub routes: &'a [Route],
    /// The address at which it reaches its node, if it is another one than in its context.
    pub via: Option<&'a str>,
}

/// Running bridges.
#[derive(Default)]
pub struct Bridges {
    running: Vec<Running>,
}

struct Running {
    name: &'static str,
    process: Process,
    topics: Vec<&'static str>,
}

impl Bridges {
    /// Starts a bridge. Its identity is in `home`; its files go into `directory`.
    pub fn start(&mut self, plan: &Plan<'_>, home: &Path, directory: &Path) -> Result<(), Rejection> {
        let name = plan.name;
        let home = match plan.via {
            None => home.to_owned(),
            Some(address) => moved(home, name, address, directory)?,
        };
        let context = home.join("contexts").join(name);
        let mut text = format!(
            "context_dir = {:?}\ndomain_id = {}\nshared_memory = false\n",
            context.display().to_string(),
            plan.domain
        );
        for Route { service, direction, topic, kind } in plan.routes {
            text += &format!(
                "\n[[route]]\nservice = {service:?}\ndirection = {direction:?}\ntopic = {topic:?}\ntype = {kind:?}\n"
            );
        }
        let config = directory.join(format!("bridge-{name}.toml"));
        std::fs::write(&config, &text)
            .map_err(|error| Rejection::new(Code::BadFile, format!("cannot write {}: {error}", config.display())))?;
        let arguments = ["bridge", "--config", &config.to_string_lossy()];
        let process = Process::start(&format!("bridge-{name}"), directory, &arguments)?;
        self.running.push(Running { name, process, topics: plan.routes.iter().map(|route| route.topic).collect() });
        Ok(())
    }

    /// Waits until each bridge has found the ROS 2 nodes of its graph. Discovery has two directions: a node that has found
    /// its bridge may still be unknown to it, and then a message to the node is lost.
    pub async fn found(&mut self) -> Result<(), Rejection> {
        let deadline = Instant::now() + DISCOVERY_TIME_MAX;
        let knows =
            |bridge: &Running| bridge.topics.iter().all(|topic| bridge.process.logged(&format!("on {topic} has come")));
        while !self.running.iter().all(knows) {
            self.check()?;
            if Instant::now() > deadline {
                return Err(nobody_there("the node of a bridge"));
            }
            tokio::time::sleep(LOOK).await;
        }
        Ok(())
    }

    /// Fails if a process has ended by itself.
    pub fn check(&mut self) -> Result<(), Rejection> {
        self.running.iter_mut().try_for_each(|bridge| bridge.process.check())
    }

    /// Ends the bridges. Answers with the name of each, and with its report as it was printed and read.
    pub async fn stop(&mut self) -> Result<Vec<(&'static str, String, BridgeReport)>, Rejection> {
        let mut reports = Vec::new();
        for bridge in self.running.drain(..) {
            let printed = bridge.process.stop().await?;
            let line = printed.lines().last().unwrap_or_default().to_owned();
            let report = BridgeReport::read(&printed)?;
            reports.push((bridge.name, line, report));
        }
        Ok(reports)
    }
}

/// The same identity with its node at another address.
fn moved(home: &Path, name: &str, address: &str, directory: &Path) -> Result<std::path::PathBuf, Rejection> {
    let mut context = Context::load(home, Some(name))?;
    context.nodes = vec![address.to_owned()];
    // Without it the bridge would know its node's own address.
    context.memory = Memory::default();
    let other = directory.join("moved");
    context.save(&other)?;
    Ok(other)
}
