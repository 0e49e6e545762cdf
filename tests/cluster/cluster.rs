//! The nodes of a network, and one observer at each.

use crate::support::network::{NodeWish, free_address, now, register_robots};
use crate::support::wait::PATIENCE;
use crate::support::{Fleet, Process, connect, programs, until};
use futures::future::join_all;
use ledger_api::v1::StatusResponse;
use ledger_api::{Client, Context};
use ledger_identity::Role;
use std::process::Command;
use std::time::{Duration, Instant};

/// The nodes by their place in this file's arrays: three voters, then the learner.
pub const VOTERS: usize = 3;
/// All of them.
pub const NODES: usize = 4;

/// How long a node may take to say how it is, before it counts as silent.
const ANSWER_TIME: Duration = Duration::from_secs(2);

/// How the command of a node is put into its surroundings.
pub type Enter = Box<dyn Fn(Command) -> Command + Send + Sync>;

/// A founded network and its running nodes.
pub struct Cluster {
    // Before the directory that they use: killed first.
    nodes: Vec<Option<Process>>,
    enter: Vec<Enter>,
    observers: Vec<Client>,
    /// The admin of Org2, who owns the robots.
    pub owner: Context,
    /// Members of Org1 who may use Turtlebot4 and publish all the time.
    pub people: Vec<Context>,
    /// One more, who only does what a test says.
    pub guest: Context,
    pub fleet: Fleet,
}

impl Cluster {
    /// Founds a network on loopback; nothing runs.
    pub fn found() -> Self {
        Self::found_at([(); NODES].map(|()| free_address()))
    }

    /// Founds a network at these addresses; nothing runs.
    pub fn found_at(addresses: [String; NODES]) -> Self {
        let places =
            [("node1", "Org1", true), ("node2", "Org2", true), ("node3", "Org1", true), ("node4", "Org2", false)];
        let wishes: Vec<_> = places
            .into_iter()
            .zip(addresses)
            .map(|((name, organisation, voter), address)| NodeWish {
                name: name.into(),
                organisation: organisation.into(),
                voter,
                address,
            })
            .collect();
        let fleet = Fleet::found_with(&wishes, now());
        for place in &fleet.nodes {
            // Segments are written ahead: small ones, so that many networks fit on a disk.
            place.configure("[storage]\nsegment_mib = 4");
        }
        let owner = fleet.owner();
        let person = |name| fleet.issue("Org1", name, Role::Member, &["Turtlebot4", "Husky"]);
        let (people, guest) = (["Salma", "Farhad", "Nadia"].map(person), person("Omar"));
        let enter = (0..NODES).map(|_| Box::new(|command| command) as Enter).collect();
        let nodes = (0..NODES).map(|_| None).collect();
        Self { nodes, enter, observers: Vec::new(), owner, people: people.into(), guest, fleet }
    }

    /// From now on, this node starts in these surroundings.
    pub fn surround(&mut self, node: usize, enter: Enter) {
        self.enter[node] = enter;
    }

    /// Starts every node and registers the robots with `/cmd_vel` in this mode.
    pub async fn run(&mut self, mode: &str) {
        for node in 0..NODES {
            self.start(node);
        }
        self.observers = join_all((0..NODES).map(|node| self.client_at(&self.owner, node))).await;
        register_robots(&self.observers[0], mode).await;
    }

    /// Starts a node that does not run.
    pub fn start(&mut self, node: usize) {
        let place = &self.fleet.nodes[node];
        let command = (self.enter[node])(place.command());
        assert!(self.nodes[node].is_none(), "{} is running already", place.name);
        self.nodes[node] = Some(Process::start(&place.name, self.fleet.path(), command));
    }

    /// `kill -9`.
    pub fn kill(&mut self, node: usize) {
        let mut process = self.nodes[node].take().expect("a running node");
        process.check();
        process.kill();
        process.no_panic();
    }

    /// Takes a node that has ended by itself, to see why.
    pub fn ended(&mut self, node: usize) -> Process {
        let mut process = self.nodes[node].take().expect("a node that was started");
        process.wait();
        process
    }

    /// Ends every node in order and executes what each of them keeps again from its first block, as an auditor would.
    pub fn stop_and_verify(&mut self) {
        for process in self.nodes.iter_mut().flatten() {
            process.interrupt();
        }
        for place in &self.fleet.nodes {
            let done = programs::node().arg("verify").arg(&place.data).output().unwrap();
            assert!(done.status.success(), "{}: {}", place.name, String::from_utf8_lossy(&done.stderr));
        }
    }

    /// The process of a running node.
    pub fn process(&mut self, node: usize) -> &mut Process {
        self.nodes[node].as_mut().expect("a running node")
    }

    /// Every node that should run does, and none has panicked.
    pub fn check(&mut self) {
        for process in self.nodes.iter_mut().flatten() {
            process.check();
            process.no_panic();
        }
    }

    /// A person at one node only.
    pub async fn client_at(&self, person: &Context, node: usize) -> Client {
        let nodes = vec![self.fleet.nodes[node].address.clone()];
        connect(&Context { nodes, ..person.clone() }).await
    }

    /// A person who knows all nodes and begins at this one.
    pub async fn client_from(&self, person: &Context, first: usize) -> Client {
        let address = |at: usize| self.fleet.nodes[(first + at) % NODES].address.clone();
        connect(&Context { nodes: (0..NODES).map(address).collect(), ..person.clone() }).await
    }

    /// The admin of Org2 at one node.
    pub fn observer(&self, node: usize) -> &Client {
        &self.observers[node]
    }

    /// How a node is, if it says so soon.
    pub async fn status(&self, node: usize) -> Option<StatusResponse> {
        self.nodes[node].as_ref()?;
        tokio::time::timeout(ANSWER_TIME, self.observers[node].status()).await.ok()?.ok()
    }

    /// The leader of the newest term among these nodes, as soon as there is one.
    pub async fn leader_among(&self, nodes: &[usize]) -> (usize, StatusResponse) {
        until(&format!("one of the nodes {nodes:?} leads"), || async {
            let asked = nodes.iter().map(|node| async move { Some((*node, self.status(*node).await?)) });
            let leading = join_all(asked).await.into_iter().flatten().filter(|(_, status)| status.role == "leader");
            leading.max_by_key(|(_, status)| status.term)
        })
        .await
    }
    /// Waits until a node is at this height (true) or has ended by itself (false).
    pub async fn reaches_or_ends(&mut self, what: &str, node: usize, height: u64) -> bool {
        let deadline = Instant::now() + PATIENCE;
        while self.process(node).is_running() {
            if self.status(node).await.is_some_and(|status| status.height >= height) {
                return true;
            }
            assert!(Instant::now() < deadline, "never happened: {what}\n{}", self.process(node).stderr());
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        false
    }

    /// The height at which all nodes are, as soon as they are all at the same one, which is at least this.
    pub async fn converge(&self, height: u64) -> u64 {
        until(&format!("all nodes are at the same height, at least {height}"), || async {
            let heights = join_all((0..NODES).map(|node| self.status(node))).await;
            let heights: Vec<_> = heights.into_iter().map(|status| Some(status?.height)).collect();
            heights[0].filter(|first| *first >= height && heights.iter().all(|other| *other == Some(*first)))
        })
        .await
    }
}
