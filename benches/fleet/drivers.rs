//! Those who drive robots, each with a key of their own. They may share connections: what is measured is what their
//! transactions cost the network, not what clients cost this machine.

use crate::founding::twist;
use crate::network::Network;
use bytes::Bytes;
use futures::future::join_all;
use ledger::transaction::{Body, Transaction};
use ledger_abac::{Acquired, Grant};
use ledger_api::{Client, Context, Pending};
use ledger_base::hash::Hash;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

/// How long after now a command may still be executed, microseconds.
const TTL: u64 = 30_000_000;
/// Longest lease: no point shall measure a renewal.
const LEASE_MS: &str = "600000";
/// Calls under way while a part is prepared.
const AT_ONCE: usize = 64;

/// Somebody with the right to publish on a service.
struct Driver {
    who: Context,
    service: Bytes,
    /// 0 where the service is open to everybody.
    epoch: Bytes,
}

/// Several, who send in turn.
pub(crate) struct Drivers {
    clients: Vec<Client>,
    drivers: Vec<Driver>,
    turn: AtomicUsize,
    /// One sequence for all, so that a number names one message, whoever has sent it.
    next_seq: AtomicU64,
}

/// A robot with one `/cmd_vel` in this mode, for those who carry the attribute `Fleet`.
pub(crate) fn robot(name: &str, mode: &str) -> Bytes {
    let service = format!(r#"{{"topic":"/cmd_vel","type":"geometry_msgs/msg/Twist","mode":"{mode}"}}"#);
    format!(r#"{{"name":"{name}","attribute_required":"Fleet","trusted":["Org1","Org2"],"services":[{service}]}}"#)
        .into()
}

/// Registers robots in calls of a size that is accepted.
pub(crate) async fn register(owner: &Client, robots: Vec<Bytes>) {
    for robots in robots.chunks(AT_ONCE) {
        owner.invoke("abac", "setup", robots.to_vec()).await.unwrap();
    }
}

impl Drivers {
    /// Nobody yet; commands go through these connections.
    pub(crate) fn new(clients: Vec<Client>) -> Self {
        Self { clients, drivers: Vec::new(), turn: AtomicUsize::new(0), next_seq: AtomicU64::new(1) }
    }

    /// How many they are.
    pub(crate) fn len(&self) -> usize {
        self.drivers.len()
    }

    /// Adds a connection.
    pub(crate) fn connect(&mut self, client: Client) {
        self.clients.push(client);
    }

    /// Adds people with a robot each, which they acquire.
    pub(crate) async fn acquire(&mut self, people: &[(Context, String)]) {
        for people in people.chunks(AT_ONCE) {
            let all = &*self;
            let granted = people.iter().map(|(who, robot)| async move {
                let args = [robot.as_str(), LEASE_MS].map(|arg| Bytes::copy_from_slice(arg.as_bytes())).to_vec();
                let call = all.introduced(who, "acquire", args);
                let granted = all.clients[0].submit(call).await.unwrap();
                serde_json::from_slice::<Grant>(&granted.response).unwrap()
            });
            for (Grant { service, epoch, next_seq, .. }, (who, _)) in join_all(granted).await.into_iter().zip(people) {
                self.next_seq.fetch_max(next_seq, Ordering::Relaxed);
                let driver = Driver { who: who.clone(), service: service.into(), epoch: epoch.to_string().into() };
                self.drivers.push(driver);
            }
        }
    }

    /// Puts people in the lines of robots that others hold, at most this many at once.
    pub(crate) async fn wait(&self, people: &[(Context, String)]) {
        for people in people.chunks(AT_ONCE) {
            let joined = people.iter().map(|(who, robot)| async move {
                let call = self.introduced(who, "acquire", vec![Bytes::from(robot.clone())]);
                let joined = self.clients[0].submit(call).await.unwrap();
                serde_json::from_slice::<Acquired>(&joined.response).unwrap()
            });
            assert!(join_all(joined).await.iter().all(|joined| matches!(joined, Acquired::Queued { .. })));
        }
    }

    /// A call of somebody whose certificate the ledger may not know yet.
    fn introduced(&self, who: &Context, function: &str, args: Vec<Bytes>) -> Transaction {
        let certificate = Bytes::copy_from_slice(&who.chain[0]);
        sign(who, self.clients[0].now(), function, args).with_certificate(certificate).unwrap()
    }

    /// Adds people who share a service that is open to them; their first messages introduce them.
    pub(crate) async fn share(&mut self, people: &[Context], service: &str) {
        let first = self.drivers.len();
        self.drivers.extend(people.iter().map(|who| Driver {
            who: who.clone(),
            service: Bytes::copy_from_slice(service.as_bytes()),
            epoch: Bytes::from_static(b"0"),
        }));
        let all = &*self;
        let numbers: Vec<_> = (first..all.len()).collect();
        for numbers in numbers.chunks(AT_ONCE) {
            let introduced = numbers.iter().map(|number| async move {
                let certificate = Bytes::copy_from_slice(&all.drivers[*number].who.chain[0]);
                let call = all.sign(*number, 1).with_certificate(certificate).unwrap();
                all.client(*number).submit(call).await.unwrap()
            });
            join_all(introduced).await;
        }
    }

    /// Sequence number of the next message.
    pub(crate) fn next_seq(&self) -> u64 {
        self.next_seq.load(Ordering::Relaxed)
    }

    /// Signs the next driver's command with so many messages and sends it.
    pub(crate) fn command(&self, messages: usize) -> Pending {
        let number = self.turn.fetch_add(1, Ordering::Relaxed) % self.drivers.len();
        self.client(number).submit_nowait(&self.sign(number, messages))
    }

    fn client(&self, number: usize) -> &Client {
        &self.clients[number % self.clients.len()]
    }

    fn sign(&self, number: usize, messages: usize) -> Transaction {
        let Driver { who, service, epoch } = &self.drivers[number];
        let seq = self.next_seq.fetch_add(messages as u64, Ordering::Relaxed).to_string();
        let mut args = vec![service.clone(), epoch.clone(), seq.into()];
        args.extend(std::iter::repeat_n(twist(), messages));
        sign(who, self.client(number).now(), "set", args)
    }
}

/// One driver of the paper's robot, through one connection.
pub(crate) async fn salma(network: &Network) -> Drivers {
    let who = network.founding().salma.clone();
    let mut drivers = Drivers::new(vec![network.connect(&who).await]);
    drivers.acquire(&[(who, "Turtlebot4".to_owned())]).await;
    drivers
}

fn sign(who: &Context, now: u64, function: &str, args: Vec<Bytes>) -> Transaction {
    let mut nonce = [0; 16];
    ring::rand::SecureRandom::fill(&ring::rand::SystemRandom::new(), &mut nonce).unwrap();
    let body = Body {
        network: Bytes::copy_from_slice(&who.network.0),
        creator: Bytes::copy_from_slice(&Hash::of(&[&who.chain[0]]).0),
        nonce: Bytes::copy_from_slice(&nonce),
        not_after: now + TTL,
        chaincode: "abac".into(),
        function: function.into(),
        args,
        known_block: None,
    };
    Transaction::sign(&body, &who.key).unwrap()
}
