//! A leader that is stopped (SIGSTOP: a suspended laptop, a hypervisor, a debugger) and wakes up, believing that it
//! still leads. It must not answer questions of that moment from the past.

use crate::audit::audit;
use crate::cluster::{Cluster, VOTERS};
use crate::load::Told;
use crate::rounds;
use crate::support::network::message;
use crate::support::wait::PATIENCE;
use crate::support::{Dice, until, wire};
use ledger_api::v1::gateway_client::GatewayClient;
use ledger_api::v1::{QueryRequest, QueryResponse};
use ledger_api::{Call, Client, Context};
use rustix::process::Signal;
use serde_json::Value;
use std::time::Duration;
use tonic::transport::Channel;

/// Questions that wait for the leader when it wakes up.
const QUESTIONS: usize = 8;

/// Takes the robot; answers with height and epoch of the grant.
async fn acquire(client: &Client) -> (u64, u64) {
    let grant = client.invoke("abac", "acquire", vec!["Turtlebot4".into(), "600000".into()]).await.unwrap();
    let told: Value = serde_json::from_slice(&grant.response).unwrap();
    let epoch = told["epoch"].as_u64().or_else(|| told[0]["epoch"].as_u64());
    (grant.height, epoch.unwrap_or_else(|| panic!("no epoch in {told}")))
}

/// The driver of the robot according to an answer to `robot Turtlebot4`.
fn driver(answer: &[u8]) -> String {
    let robot: Value = serde_json::from_slice(answer).unwrap();
    robot["owner"].as_str().unwrap_or_default().to_owned()
}

/// Asks a node who drives the robot; a majority has to confirm the answer.
async fn ask(line: Channel) -> Result<QueryResponse, tonic::Status> {
    let request = QueryRequest {
        chaincode: "abac".into(),
        function: "robot".into(),
        args: vec!["Turtlebot4".into()],
        min_height: 0,
        may_be_stale: false,
    };
    GatewayClient::new(line).query(request).await.map(tonic::Response::into_inner)
}

/// The driver, if the node has answered and not refused.
fn answered(answer: Result<QueryResponse, tonic::Status>) -> Option<String> {
    let answer = answer.ok()?;
    (answer.verdict.as_ref().map_or(0, |verdict| verdict.code) == 0).then(|| driver(&answer.response))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_leader_that_wakes_up_answers_nothing_from_the_past_and_lets_nobody_drive_with_an_old_grant() {
    let mut dice = Dice::roll("pauses");
    let mut cluster = Cluster::found();
    cluster.run("exclusive").await;
    let (mut pauses, mut right, mut refused) = (0, 0, 0);
    for round in 0..2 * rounds() {
        let (leader, before) = cluster.leader_among(&[0, 1, 2]).await;
        let at_leader =
            |person: &Context| Context { nodes: vec![cluster.fleet.nodes[leader].address.clone()], ..person.clone() };
        let (salma_there, owner_there) = (at_leader(&cluster.people[0]), at_leader(&cluster.owner));
        let (commands, questions) = (wire::channel(&salma_there, true).await, wire::channel(&owner_there, true).await);
        let elsewhere = (leader + 1) % VOTERS;
        let salma = cluster.client_from(&cluster.people[0], elsewhere).await;
        let farhad = cluster.client_from(&cluster.people[1], elsewhere).await;
        // Salma drives, and the leader knows it: nothing but what comes is missing when it wakes up.
        let (granted, epoch) = acquire(&salma).await;
        let known =
            cluster.observer(leader).query_at(granted, "abac", "robot", vec!["Turtlebot4".into()]).await.unwrap();
        assert_eq!(driver(&known.response), "Org1/Salma");
        let go = Call {
            chaincode: "abac".into(),
            function: "set".into(),
            args: message(epoch, 1_000_000 + round, b"go"),
            ttl: PATIENCE,
        };
        let go = salma.prepare(go).unwrap();

        // Not a wait for anything: the moment of the fault.
        tokio::time::sleep(Duration::from_micros(dice.below(20_000))).await;
        cluster.process(leader).send(Signal::STOP);
        pauses += 1;
        // The others elect, and the robot changes hands.
        let others: Vec<_> = (0..VOTERS).filter(|node| *node != leader).collect();
        let (_, after) = cluster.leader_among(&others).await;
        assert!(after.term > before.term);
        salma.invoke("abac", "release", vec!["Turtlebot4".into()]).await.unwrap();
        acquire(&farhad).await;

        // Asked while it cannot answer: these are the first things that it finds when it wakes up.
        let asked: Vec<_> = (0..QUESTIONS).map(|_| tokio::spawn(ask(questions.clone()))).collect();
        let ordered = tokio::spawn(async move { wire::submit(&commands, go.encoded().clone()).await });
        // Not a wait for anything either: the bytes go to sleep with it.
        tokio::time::sleep(Duration::from_millis(20)).await;
        cluster.process(leader).send(Signal::CONT);
        for question in asked {
            let answer = tokio::time::timeout(PATIENCE, question).await.expect("an answer or a refusal").unwrap();
            match answered(answer) {
                Some(driver) => {
                    assert_eq!(driver, "Org1/Farhad", "an answer from the past");
                    right += 1;
                }
                None => refused += 1,
            }
        }
        if let Ok(answer) = tokio::time::timeout(PATIENCE, ordered).await.expect("an answer or a refusal").unwrap() {
            assert_ne!(wire::code(&answer), 0, "a command under an old grant was executed: {answer:?}");
        }
        // Awake again, it follows, and serves also what is linearizable.
        let driver = until("the node that slept answers what a majority confirms", || async {
            answered(ask(wire::channel(&owner_there, true).await).await)
        })
        .await;
        assert_eq!(driver, "Org1/Farhad");
        farhad.invoke("abac", "release", vec!["Turtlebot4".into()]).await.unwrap();
        cluster.check();
    }
    audit(&mut cluster, &Told::default()).await;
    println!(
        "faults injected: {pauses} leaders stopped and woken; {right} right answers and {refused} refusals by them"
    );
    assert!(pauses > 0 && right + refused > 0);
}
