//! More than a node carries: what is refused says why and is counted, what gives or ends control goes on, and nobody
//! takes the room of all.

use crate::support::network::{message, register_robots};
use crate::support::{Fleet, Process, connect, until, wire};
use bytes::Bytes;
use futures::StreamExt;
use futures::stream::FuturesUnordered;
use ledger::transaction::Transaction;
use ledger_api::v1::gateway_client::GatewayClient;
use ledger_api::{Call, Client, Context, v1};
use ledger_base::rejection::Code;
use ledger_identity::Role;
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::time::Duration;

/// Far more commands than a test's node looks at in its shortest waiting time.
const FLOOD: u64 = 3000;

struct Flooded {
    fleet: Fleet,
    node: Process,
    owner: Context,
    salma: Context,
    farhad: Context,
}

impl Flooded {
    /// A node with these settings; Salma and Farhad may both drive the Turtlebot.
    async fn start(settings: &str) -> Self {
        let fleet = Fleet::found(1);
        let owner = fleet.owner();
        let [salma, farhad] =
            ["Salma", "Farhad"].map(|name| fleet.issue("Org1", name, Role::Member, &["Turtlebot4", "Husky"]));
        fleet.nodes[0].configure(settings);
        let node = fleet.nodes[0].start();
        register_robots(&connect(&owner).await, "open").await;
        for who in [&salma, &farhad] {
            connect(who).await.invoke("abac", "acquire", vec!["Turtlebot4".into()]).await.unwrap();
        }
        Self { fleet, node, owner, salma, farhad }
    }

    fn end(mut self) {
        self.node.check();
        self.node.no_panic();
        self.node.interrupt();
        drop(self.fleet);
    }
}

/// The epoch of a grant that is held.
async fn epoch(client: &Client) -> u64 {
    let held = client.query("abac", "authorize", vec!["Turtlebot4/cmd_vel".into(), "publish".into()]).await.unwrap();
    let held: serde_json::Value = serde_json::from_slice(&held.response).unwrap();
    held["epoch"].as_u64().unwrap()
}

/// A signed call that stays good for longer than a flood takes.
fn prepare(client: &Client, function: &str, args: Vec<Bytes>) -> Transaction {
    let call = Call { chaincode: "abac".into(), function: function.into(), args, ttl: Duration::from_secs(100) };
    client.prepare(call).unwrap()
}

/// A flood of commands, signed before the first is sent: nothing slows it down.
async fn prepare_flood(client: &Client) -> Vec<Transaction> {
    let epoch = epoch(client).await;
    (1..=FLOOD).map(|seq| prepare(client, "set", message(epoch, seq, &[0; 48]))).collect()
}

/// Sends a flood; how many were answered with which code, and the sequence numbers that were accepted.
async fn flood(client: &Client, commands: &[Transaction]) -> (BTreeMap<Code, u64>, Vec<u64>) {
    let mut verdicts: FuturesUnordered<_> = (1..)
        .zip(commands)
        .map(|(seq, command)| {
            let verdict = client.submit_nowait(command);
            async move { (seq, verdict.await) }
        })
        .collect();
    let (mut codes, mut accepted) = (BTreeMap::new(), Vec::new());
    while let Some((seq, verdict)) = verdicts.next().await {
        match verdict {
            Ok(committed) => accepted.push((committed.height, committed.index, seq)),
            Err(refused) => {
                assert!(
                    !refused.found.is_empty() && !refused.wanted.is_empty() && !refused.advice().is_empty(),
                    "{refused}"
                );
                *codes.entry(refused.code).or_default() += 1;
            }
        }
    }
    accepted.sort_unstable();
    (codes, accepted.into_iter().map(|(_, _, seq)| seq).collect())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_cannot_be_looked_at_in_time_is_refused_with_a_reason_and_counted() {
    let flooded = Flooded::start("[order]\nwait_ms = 10").await;
    let client = connect(&flooded.salma).await;
    let (refused, accepted) = flood(&client, &prepare_flood(&client).await).await;
    assert_eq!(refused.keys().collect::<Vec<_>>(), [&Code::Overloaded], "{refused:?}");
    let refused = refused[&Code::Overloaded];
    assert_eq!(refused + accepted.len() as u64, FLOOD, "everything has its answer");
    assert!(!accepted.is_empty() && accepted.is_sorted(), "what is accepted stays in its order");

    // Visible to whoever looks after the node.
    let status = client.status().await.unwrap();
    assert_eq!(status.refused.get(&4003).copied(), Some(refused));
    let denials = connect(&flooded.owner).await.denials(100).await.unwrap();
    let counted: u64 = denials
        .iter()
        .filter(|denial| denial.verdict.as_ref().is_some_and(|verdict| verdict.code == 4003))
        .inspect(|denial| {
            assert_eq!((denial.who.as_str(), denial.subject.as_str()), ("Org1/Salma", "Turtlebot4/cmd_vel"));
        })
        .map(|denial| denial.count)
        .sum();
    assert_eq!(counted, refused);
    flooded.end();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn control_over_a_flooded_stream_overtakes_what_waits_there() {
    // Longer than the flood takes: nothing of it is refused for its time.
    let flooded = Flooded::start("[order]\nwait_ms = 60000").await;
    let client = connect(&flooded.salma).await;
    let commands = prepare_flood(&client).await;
    let release = prepare(&client, "release", vec!["Turtlebot4".into()]);
    // A node that stands still: all of it has come before the first is looked at.
    flooded.node.send(Signal::STOP);
    let mut verdicts: FuturesUnordered<_> = commands.iter().map(|command| client.submit_nowait(command)).collect();
    // Sent last, over the same stream: it ends the grant, and with it what waited.
    let release = client.submit_nowait(&release);
    flooded.node.send(Signal::CONT);
    let released = release.await.unwrap();
    let (mut after, mut refused) = (0, 0);
    while let Some(verdict) = verdicts.next().await {
        match verdict {
            Ok(committed) if committed.height > released.height => after += 1,
            Ok(_) => {}
            Err(verdict) => {
                assert!(matches!(verdict.code, Code::NotHolder | Code::StaleEpoch), "{verdict}");
                refused += 1;
            }
        }
    }
    assert_eq!(after, 0, "commands of a grant that was given back");
    assert!(refused > FLOOD / 10, "the release has waited for {} commands", FLOOD - refused);
    flooded.end();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_identity_cannot_take_the_places_of_all() {
    let flooded = Flooded::start("[limits]\nin_flight_max = 64\n[order]\nwait_ms = 60000").await;
    let (salma, farhad) = (connect(&flooded.salma).await, connect(&flooded.farhad).await);
    let (commands, epoch) = (prepare_flood(&salma).await, epoch(&farhad).await);
    let flooding = tokio::spawn(async move { flood(&salma, &commands).await });
    let mut farhads = Vec::new();
    for seq in 1.. {
        // One after the other, below the client's own patience.
        farhads.push(farhad.submit_nowait(&prepare(&farhad, "set", message(epoch, seq, &[]))).await);
        if flooding.is_finished() {
            break;
        }
    }
    let (refused, _) = flooding.await.unwrap();
    assert!(refused.get(&Code::Overloaded).is_some_and(|count| *count > 0), "{refused:?}");
    for verdict in farhads {
        verdict.unwrap();
    }
    flooded.end();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_that_reads_no_answers_is_not_read_from_without_end() {
    let flooded = Flooded::start("").await;
    let channel = wire::channel(&flooded.salma, true).await;
    let (requests, outgoing) = tokio::sync::mpsc::channel(1);
    let mut gateway = GatewayClient::new(channel);
    let answers = gateway.submit_stream(tokio_stream::wrappers::ReceiverStream::new(outgoing)).await.unwrap();
    // Not so small that HTTP/2 itself ends the connection for it.
    let garbage = || v1::SubmitRequest { transaction: Bytes::from_static(&[7; 400]), ..v1::SubmitRequest::default() };
    let mut sent = 0_u64;
    // Until the node takes nothing more, although it answers each of these at once.
    let full = loop {
        match tokio::time::timeout(Duration::from_secs(2), requests.send(garbage())).await {
            Ok(taken) => taken.unwrap(),
            Err(_) => break true,
        }
        sent += 1;
        if sent == 1_000_000 {
            break false;
        }
    };
    assert!(full, "a million requests were read, and their answers kept");
    // Read, they are all there, and it goes on.
    let mut answers = answers.into_inner();
    for _ in 0..sent {
        assert_ne!(wire::code(&answers.message().await.unwrap().unwrap()), 0);
    }
    until("the node takes requests again", || async { requests.try_send(garbage()).ok() }).await;
    flooded.end();
}
