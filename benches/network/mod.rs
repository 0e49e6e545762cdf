//! A network of real processes: the `ledgerd` of this build, each node with its data on disk, TLS between all.

use crate::founding::{Founding, Shape, robots, twist};
use ledger::transaction::Transaction;
use ledger::{Bytes, Code};
use ledger_abac::Grant;
use ledger_api::{Call, Client, Context, Pending};
use std::fs::{File, write};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Time for a node to answer after it was started.
const START_TIME_MAX: Duration = Duration::from_secs(20);
/// How long after now a command may still be executed.
const COMMAND_TTL: Duration = Duration::from_secs(30);
/// Longest lease: no bench shall measure a renewal.
const LEASE_MS: &str = "600000";

/// A running network; its processes and directory end with it.
pub(crate) struct Network {
    processes: Vec<Child>,
    founding: Founding,
}

impl Network {
    /// Founds a network, starts its nodes and registers the robots.
    pub(crate) async fn start(shape: Shape) -> Self {
        let founding = Founding::new(shape);
        let mut network = Self { processes: Vec::new(), founding };
        for (data, address) in &network.founding.nodes {
            let config = data.with_extension("toml");
            write(&config, format!("data = {data:?}\nlisten = {address:?}\n")).unwrap();
            let log = File::create(data.with_extension("log")).unwrap();
            let child = Command::new(env!("CARGO_BIN_EXE_ledgerd"))
                .args(["run", "--config"])
                .arg(&config)
                .stdin(Stdio::null())
                .stdout(log.try_clone().unwrap())
                .stderr(log)
                .spawn()
                .unwrap();
            network.processes.push(child);
        }
        let owner = network.connect(&network.founding.owner).await;
        owner.invoke("abac", "setup", robots()).await.unwrap();
        network
    }

    /// Salma with the grant of a robot. Her calls go to the first node.
    pub(crate) async fn operator(&self, robot: &str) -> Operator {
        let client = self.connect(&self.founding.salma).await;
        let lease = [robot, LEASE_MS].map(|arg| Bytes::copy_from_slice(arg.as_bytes()));
        let granted = client.invoke("abac", "acquire", lease.into()).await.unwrap();
        let grant: Grant = serde_json::from_slice(&granted.response).unwrap();
        Operator {
            client,
            service: grant.service.into(),
            epoch: grant.epoch.to_string().into(),
            next_seq: AtomicU64::new(grant.next_seq),
            message: twist(),
        }
    }

    /// Connects as soon as the node answers.
    async fn connect(&self, context: &Context) -> Client {
        let deadline = Instant::now() + START_TIME_MAX;
        loop {
            match Client::connect(context).await {
                Ok(client) => return client,
                Err(refused) if refused.code != Code::Unreachable || Instant::now() > deadline => {
                    let log = self.founding.nodes[0].0.with_extension("log");
                    panic!("{refused}\n{}", std::fs::read_to_string(log).unwrap_or_default());
                }
                Err(_) => tokio::time::sleep(Duration::from_millis(20)).await,
            }
        }
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        for process in &mut self.processes {
            let _gone = process.kill();
            let _status = process.wait();
        }
    }
}

/// Somebody who drives a robot.
pub(crate) struct Operator {
    client: Client,
    service: Bytes,
    epoch: Bytes,
    next_seq: AtomicU64,
    message: Bytes,
}

impl Operator {
    /// Signs the next command and sends it.
    pub(crate) fn command(&self) -> Pending {
        self.client.submit_nowait(&self.sign())
    }

    fn sign(&self) -> Transaction {
        let seq = self.next_seq.fetch_add(1, Ordering::Relaxed).to_string();
        let args = vec![self.service.clone(), self.epoch.clone(), seq.into(), self.message.clone()];
        let call = Call { chaincode: "abac".into(), function: "set".into(), args, ttl: COMMAND_TTL };
        self.client.prepare(call).unwrap()
    }
}
