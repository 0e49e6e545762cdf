//! A network of real processes: the `ledgerd` of this build, each node with its data on disk, TLS between all.
#![allow(dead_code, clippy::allow_attributes, reason = "each bench uses its own part")]

use crate::founding::{Founding, OPERATORS, OWNERS, Shape, robot, robots, twist};
use bytes::Bytes;
use ledger::msp::QUOTAS_MAX;
use ledger::transaction::Transaction;
use ledger_abac::{Caller, Grant, MessageEvent};
use ledger_api::{Call, Client, Context, Pending, Subscription, v1};
use ledger_base::rejection::{Code, Rejection};
use ledger_confidential::{Keyring, ReadingKey, Sealer};
use rustix::process::{Pid, Signal, kill_process};
use std::collections::HashMap;
use std::fs::{File, write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Time for a node to answer after it was started.
const START_TIME_MAX: Duration = Duration::from_secs(20);
/// How long after now a command may still be executed.
const COMMAND_TTL: Duration = Duration::from_secs(30);
/// Longest lease: no bench shall measure a renewal.
const LEASE_MS: &str = "600000";

/// The largest quotas: bytes and messages a second.
const BYTES_PER_S: u64 = QUOTAS_MAX.bytes_per_s;
const MESSAGES_PER_S: u64 = QUOTAS_MAX.messages_per_s;

/// A running network; its processes and directory end with it.
pub(crate) struct Network {
    processes: Vec<Child>,
    founding: Founding,
}

impl Network {
    /// Founds a network, starts its nodes and registers the robots.
    pub(crate) async fn start(shape: Shape) -> Self {
        Self::start_with(shape, "").await
    }

    /// As [`Network::start`], with more settings: sections of TOML.
    pub(crate) async fn start_with(shape: Shape, settings: &str) -> Self {
        Self::start_founded(Founding::new(shape), settings).await
    }

    /// As [`Network::start_with`], where it is founded already.
    pub(crate) async fn start_founded(founding: Founding, settings: &str) -> Self {
        let mut network = Self::of(founding);
        for node in 0..network.founding.nodes.len() {
            network.start_node(node, settings);
        }
        network.raise_quotas().await;
        let owner = network.connect(&network.founding.owner).await;
        owner.invoke("abac", "setup", robots()).await.unwrap();
        network.let_the_first_node_lead().await;
        network
    }

    /// Two organisations agree that no budget limits what is measured.
    pub(crate) async fn raise_quotas(&self) {
        for organisation in [OPERATORS, OWNERS] {
            let rates =
                |whose: &str| format!(r#""{whose}bytes_per_s":{BYTES_PER_S},"{whose}messages_per_s":{MESSAGES_PER_S}"#);
            let quota = format!(
                r#"{{"organisation":"{organisation}",{},{},{}}}"#,
                rates(""),
                rates("identity_"),
                rates("service_")
            );
            for admin in [&self.founding.operator, &self.founding.owner] {
                let admin = self.connect(admin).await;
                admin.invoke("msp", "set_quota", vec![quota.clone().into()]).await.unwrap();
            }
        }
    }

    /// Clients are connected to the first node: it leads, so that each run measures the same way.
    async fn let_the_first_node_lead(&self) {
        let operator = self.connect(&self.founding.operator).await;
        let mut last = None;
        let begun = Instant::now();
        while operator.status().await.unwrap().leader_id != 1 {
            assert!(begun.elapsed() < START_TIME_MAX, "the first node does not come to lead: {last:?}");
            // Demanded once in ten seconds at most; it may be refused, or lose an election meanwhile.
            last = operator.transfer_leadership(1).await.err();
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
    }

    /// A founded network of which no node runs yet.
    pub(crate) fn of(founding: Founding) -> Self {
        Self { processes: Vec::new(), founding }
    }

    /// Height of a node, once it answers.
    pub(crate) async fn height(&self, node: usize) -> u64 {
        let nodes = vec![self.founding.nodes[node].1.clone()];
        let client = Client::connect_to(nodes, self.founding.owner.credentials().unwrap()).await;
        match client {
            Ok(client) => client.status().await.map_or(0, |status| status.height),
            Err(_) => 0,
        }
    }

    /// Starts a node with more settings: sections of TOML. `LEDGERD_BENCH_PROFILE` sets its profile.
    pub(crate) fn start_node(&mut self, node: usize, settings: &str) {
        let (data, address) = &self.founding.nodes[node];
        let config = data.with_extension("toml");
        let profile = std::env::var("LEDGERD_BENCH_PROFILE").unwrap_or_else(|_| "balanced".into());
        let settings = format!("data = {data:?}\nlisten = {address:?}\nprofile = {profile:?}\n{settings}");
        write(&config, settings).unwrap();
        let log = File::create(data.with_extension("log")).unwrap();
        let child = Command::new(env!("CARGO_BIN_EXE_ledgerd"))
            .args(["run", "--config"])
            .arg(&config)
            .stdin(Stdio::null())
            .stdout(log.try_clone().unwrap())
            .stderr(log)
            .spawn()
            .unwrap();
        self.processes.push(child);
    }

    /// Ends the process that was started last in an orderly way, and waits for it.
    pub(crate) fn stop_last(&mut self) {
        let mut process = self.processes.pop().unwrap();
        kill_process(Pid::from_child(&process), Signal::TERM).unwrap();
        assert!(process.wait().unwrap().success());
    }

    /// The members of the network, and the places of its nodes.
    pub(crate) fn founding(&self) -> &Founding {
        &self.founding
    }

    /// The owner's admin, at a node.
    pub(crate) async fn owner_at(&self, node: usize) -> Client {
        let nodes = vec![self.founding.nodes[node].1.clone()];
        self.connect(&Context { nodes, ..self.founding.owner.clone() }).await
    }

    /// The processes' ids.
    pub(crate) fn processes(&self) -> Vec<u32> {
        self.processes.iter().map(Child::id).collect()
    }

    /// The nodes' data directories.
    pub(crate) fn directories(&self) -> impl Iterator<Item = &Path> {
        self.founding.nodes.iter().map(|(data, _)| data.as_path())
    }

    /// Notes when messages about a robot arrive at a subscriber of the owner, at the last node: the other
    /// organisation's, where there is one.
    pub(crate) async fn listen(&self, robot: &str) -> Arrivals {
        self.listen_to(vec![format!("{robot}/cmd_vel")]).await
    }

    /// As [`Network::listen`], to several services; to all, if none is named.
    pub(crate) async fn listen_to(&self, services: Vec<String>) -> Arrivals {
        let client = self.owner_at(self.founding.nodes.len() - 1).await;
        let mut events = client.subscribe(Subscription {
            chaincode: "abac".into(),
            subjects: services,
            names: vec!["message".into()],
            ..Subscription::default()
        });
        let arrivals = Arrivals::default();
        let noted = arrivals.clone();
        tokio::spawn(async move {
            while let Ok(delivery) = events.next().await {
                let now = Instant::now();
                for event in delivery.events {
                    let message: MessageEvent = serde_json::from_slice(&event.payload).unwrap();
                    noted.0.lock().unwrap().insert(message.first_seq, now);
                }
            }
        });
        arrivals
    }

    /// As [`Network::listen`], where the owner opens each message before it counts as arrived.
    pub(crate) async fn listen_confidential(&self, robot: &str) -> Arrivals {
        let client = self.owner_at(self.founding.nodes.len() - 1).await;
        let service = format!("{robot}/cmd_vel");
        let own = ReadingKey::generate();
        let me = client.query("abac", "GetSubmittingClientIdentity", vec![]).await.unwrap();
        let me: Caller = serde_json::from_slice(&me.response).unwrap();
        let mut keyring = Keyring::new(self.founding.owner.network, me.id, own);
        let settings = r#"{"sharing":{"confidential":true}}"#;
        let text = |text: &str| Bytes::copy_from_slice(text.as_bytes());
        client.invoke("abac", "configure", vec![text(&service), text(settings)]).await.unwrap();
        client.invoke("abac", "reader", vec![text(&service), text(&keyring.public_hex())]).await.unwrap();
        let mut events = client.subscribe(Subscription {
            chaincode: "abac".into(),
            subjects: vec![service.clone()],
            names: vec!["message".into(), "keyed".into()],
            ..Subscription::default()
        });
        events.open().await.unwrap();
        let arrivals = Arrivals::default();
        let noted = arrivals.clone();
        tokio::spawn(async move {
            while let Ok(delivery) = events.next().await {
                for event in delivery.events {
                    let transaction = Transaction::decode(event.transaction).unwrap();
                    let args = &transaction.body().args;
                    if event.name == "keyed" {
                        let share = serde_json::from_slice(&args[2]).unwrap();
                        assert!(keyring.learn(&service, "Org1/Salma", delivery.height, &share));
                        continue;
                    }
                    let message: MessageEvent = serde_json::from_slice(&event.payload).unwrap();
                    keyring.open(&service, "Org1/Salma", message.epoch, message.first_seq, &args[3]).unwrap();
                    noted.0.lock().unwrap().insert(message.first_seq, Instant::now());
                }
            }
        });
        arrivals
    }

    /// Farhad, who holds nothing: his commands are refused. His calls go to the first node.
    pub(crate) async fn intruder(&self) -> Operator {
        let client = self.connect(&self.founding.farhad).await;
        let service = Bytes::from_static(b"Turtlebot4/cmd_vel");
        Operator {
            client,
            service,
            epoch: Bytes::from_static(b"1"),
            next_seq: Mutex::new(1),
            message: twist(),
            sealer: None,
        }
    }

    /// Salma with the grant of a robot. Her calls go to the first node.
    pub(crate) async fn operator(&self, robot: &str) -> Operator {
        self.granted(&self.founding.salma, robot).await
    }

    /// A driver with the grant of a robot. The calls go to the first node.
    pub(crate) async fn driver(&self, number: usize, robot: &str) -> Operator {
        self.granted(&self.founding.drivers[number], robot).await
    }

    /// Registers robots for the drivers.
    pub(crate) async fn register(&self, names: &[&str]) {
        let owner = self.connect(&self.founding.owner).await;
        let robots = names.iter().map(|name| robot(name, "Fleet")).collect();
        owner.invoke("abac", "setup", robots).await.unwrap();
    }

    async fn granted(&self, who: &Context, robot: &str) -> Operator {
        let client = self.connect(who).await;
        let lease = [robot, LEASE_MS].map(|arg| Bytes::copy_from_slice(arg.as_bytes()));
        let granted = client.invoke("abac", "acquire", lease.into()).await.unwrap();
        let grant: Grant = serde_json::from_slice(&granted.response).unwrap();
        Operator {
            client,
            service: grant.service.into(),
            epoch: grant.epoch.to_string().into(),
            next_seq: Mutex::new(grant.next_seq),
            message: twist(),
            sealer: None,
        }
    }

    /// Connects as soon as the node answers.
    pub(crate) async fn connect(&self, context: &Context) -> Client {
        let deadline = Instant::now() + START_TIME_MAX;
        loop {
            match Client::connect_to(context.nodes.clone(), context.credentials().unwrap()).await {
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
    /// Held until a command is handed over: one that overtakes another makes it stale.
    next_seq: Mutex<u64>,
    message: Bytes,
    /// Encrypts the messages, on a confidential service.
    sealer: Option<Sealer>,
}

/// When messages arrived, by sequence number.
#[derive(Clone, Default)]
pub(crate) struct Arrivals(Arc<Mutex<HashMap<u64, Instant>>>);

impl Arrivals {
    /// When the message with this number arrived; waits a moment for it.
    pub(crate) fn of(&self, seq: u64) -> Instant {
        let deadline = Instant::now() + Duration::from_secs(10);
        loop {
            if let Some(arrival) = self.0.lock().unwrap().get(&seq) {
                return *arrival;
            }
            assert!(Instant::now() < deadline, "message {seq} did not arrive");
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

impl Operator {
    /// Sequence number of the next command.
    pub(crate) fn next_seq(&self) -> u64 {
        *self.next_seq.lock().unwrap()
    }

    /// Bytes of a command as it is signed and sent.
    pub(crate) fn command_bytes(&self) -> usize {
        self.sign(&mut self.next_seq.lock().unwrap(), 1).encoded().len()
    }

    /// Signs the next command with so many messages and sends it.
    pub(crate) fn commands(&self, messages: usize) -> Pending {
        let mut next_seq = self.next_seq.lock().unwrap();
        self.client.submit_nowait(&self.sign(&mut next_seq, messages))
    }

    /// Signs the next command and sends it.
    pub(crate) fn command(&self) -> Pending {
        self.commands(1)
    }

    /// The next command, signed to be sent within this time.
    pub(crate) fn signed(&self, ttl: Duration) -> Transaction {
        self.sign_for(&mut self.next_seq.lock().unwrap(), 1, ttl)
    }

    /// Sends a command that was signed before.
    pub(crate) fn send(&self, signed: &Transaction) -> Pending {
        self.client.submit_nowait(signed)
    }

    /// Gives the robot back.
    pub(crate) async fn release(&self) -> Result<(), Rejection> {
        self.control("release", &[]).await
    }

    /// Takes the robot again. Its commands go on under the old grant, so this is for who sends none.
    pub(crate) async fn acquire(&self) -> Result<(), Rejection> {
        self.control("acquire", &[LEASE_MS]).await
    }

    /// Renews the grant.
    pub(crate) async fn renew(&self) -> Result<(), Rejection> {
        self.control("renew", &[]).await
    }

    /// How the node is.
    pub(crate) async fn status(&self) -> v1::StatusResponse {
        self.client.status().await.unwrap()
    }

    async fn control(&self, function: &str, more: &[&'static str]) -> Result<(), Rejection> {
        let more = more.iter().map(|arg| Bytes::from_static(arg.as_bytes()));
        let args = std::iter::once(self.service.clone()).chain(more).collect();
        self.client.invoke("abac", function, args).await.map(drop)
    }

    /// The same, encrypted for the readers of the service.
    pub(crate) async fn sealing(self, network: &Network) -> Self {
        let named = vec![self.service.clone()];
        let readers = self.client.query("abac", "readers", named).await.unwrap();
        let readers = serde_json::from_slice(&readers.response).unwrap();
        let (share, fresh) = Sealer::share(&network.founding.salma.network, "Org1/Salma", &readers).unwrap();
        let share = serde_json::to_vec(&share).unwrap();
        let args = vec![self.service.clone(), self.epoch.clone(), share.into()];
        let shared = self.client.invoke("abac", "share", args).await.unwrap();
        Self { sealer: Some(fresh.shared_at(shared.height)), ..self }
    }

    fn payload(&self, seq: u64) -> Bytes {
        match &self.sealer {
            Some(sealer) => {
                let epoch = std::str::from_utf8(&self.epoch).unwrap().parse().unwrap();
                sealer.seal(epoch, seq, &self.message).unwrap()
            }
            None => self.message.clone(),
        }
    }

    fn sign(&self, next_seq: &mut u64, messages: usize) -> Transaction {
        self.sign_for(next_seq, messages, COMMAND_TTL)
    }

    fn sign_for(&self, next_seq: &mut u64, messages: usize, ttl: Duration) -> Transaction {
        let first = *next_seq;
        *next_seq += messages as u64;
        let mut args = vec![self.service.clone(), self.epoch.clone(), first.to_string().into()];
        args.extend((first..*next_seq).map(|seq| self.payload(seq)));
        let call = Call { chaincode: "abac".into(), function: "set".into(), args, ttl };
        self.client.prepare(call).unwrap()
    }
}
