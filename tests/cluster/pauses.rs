//! A leader that is stopped (SIGSTOP: a suspended laptop, a hypervisor, a debugger) and wakes up, believing that it
//! still leads. What it is asked in that moment it must not answer from the past.

use crate::audit::audit;
use crate::cluster::{Cluster, VOTERS};
use crate::load::Told;
use crate::rounds;
use crate::support::network::message;
use crate::support::wait::PATIENCE;
use crate::support::{Dice, wire};
use ledger::Code;
use ledger_api::v1::QueryRequest;
use ledger_api::v1::gateway_client::GatewayClient;
use ledger_api::{Call, Client, Context};
use rustix::process::Signal;
use std::time::Duration;

/// Questions that wait for the leader when it wakes up.
const QUESTIONS: usize = 8;

/// What `robot Turtlebot4` says of who operates it.
async fn acquire(client: &Client) -> u64 {
    let grant = client.invoke("abac", "acquire", vec!["Turtlebot4".into(), "600000".into()]).await.unwrap();
    grant.height
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_leader_that_wakes_up_answers_nothing_from_the_past_and_lets_nobody_drive_with_an_old_grant() {
    let mut dice = Dice::roll("pauses");
    let mut cluster = Cluster::found();
    cluster.run("exclusive").await;
    let (mut pauses, mut answers, mut refusals) = (0, 0, 0);
    for round in 0..2 * rounds() {
        let (leader, before) = cluster.leader_among(&[0, 1, 2]).await;
        // Salma has the robot, and both she and the owner are connected to the leader.
        let (salma, farhad) = (cluster.people[0].clone(), cluster.people[1].clone());
        let there = Context { nodes: vec![cluster.fleet.nodes[leader].address.clone()], ..salma.clone() };
        let elsewhere = (leader + 1) % VOTERS;
        let (salma_elsewhere, farhad_elsewhere) =
            (cluster.client_from(&salma, elsewhere).await, cluster.client_from(&farhad, elsewhere).await);
        let granted = acquire(&salma_elsewhere).await;
        let owned = Context { nodes: there.nodes.clone(), ..cluster.owner.clone() };
        let (command_line, question_line) = (wire::channel(&there, true).await, wire::channel(&owned, true).await);
        // Executed there, so nothing but the past is missing when it wakes up.
        let seen = cluster.observer(leader).query_at(granted, "abac", "robot", vec!["Turtlebot4".into()]).await.unwrap();
        let operator = |response: &[u8]| {
            let text = String::from_utf8_lossy(response).into_owned();
            (text.contains("Org1/Salma"), text.contains("Org1/Farhad"))
        };
        assert_eq!(operator(&seen.response), (true, false), "{:?}", seen.response);
        let command = |epoch: u64| {
            let args = message(epoch, 1_000_000 + round, b"go");
            salma_elsewhere.prepare(Call { chaincode: "abac".into(), function: "set".into(), args, ttl: PATIENCE })
        };
        // Any epoch up to the newest that Salma may have had: none of them counts any more afterwards.
        let commands: Vec<_> = (1..=2 * round + 1).map(|epoch| command(epoch).unwrap()).collect();

        // Not a wait for anything: the moment of the fault.
        tokio::time::sleep(Duration::from_micros(dice.below(20_000))).await;
        cluster.process(leader).send(Signal::STOP);
        pauses += 1;
        // The others elect, the robot changes hands.
        let others: Vec<_> = (0..VOTERS).filter(|node| *node != leader).collect();
        let (_, after) = cluster.leader_among(&others).await;
        assert!(after.term > before.term);
        salma_elsewhere.invoke("abac", "release", vec!["Turtlebot4".into()]).await.unwrap();
        acquire(&farhad_elsewhere).await;

        // Asked while it cannot answer: these are the first things that it finds when it wakes up.
        let questions: Vec<_> = (0..QUESTIONS)
            .map(|_| {
                let mut gateway = GatewayClient::new(question_line.clone());
                let request = QueryRequest {
                    chaincode: "abac".into(),
                    function: "robot".into(),
                    args: vec!["Turtlebot4".into()],
                    min_height: 0,
                    linearizable: true,
                };
                tokio::spawn(async move { gateway.query(request).await })
            })
            .collect();
        let orders: Vec<_> = commands
            .into_iter()
            .map(|transaction| {
                let line = command_line.clone();
                tokio::spawn(async move { wire::submit(&line, transaction.encoded().clone()).await })
            })
            .collect();
        // The bytes are on their way before it wakes up.
        tokio::time::sleep(Duration::from_millis(20)).await;
        cluster.process(leader).send(Signal::CONT);

        for question in questions {
            let answer = tokio::time::timeout(PATIENCE, question).await.expect("an answer or a refusal").unwrap();
            match answer {
                Ok(answer) => {
                    let answer = answer.into_inner();
                    match answer.verdict.as_ref().map_or(0, |verdict| verdict.code) {
                        0 => {
                            let found = operator(&answer.response);
                            assert_eq!(found, (false, true), "an answer from the past at height {}", answer.height);
                            answers += 1;
                        }
                        _ => refusals += 1,
                    }
                }
                // It may say that it does not lead, never what was.
                Err(_) => refusals += 1,
            }
        }
        for order in orders {
            let Ok(answer) = tokio::time::timeout(PATIENCE, order).await.expect("an answer or a refusal").unwrap() else {
                continue;
            };
            assert_ne!(wire::code(&answer), 0, "a command under an old grant was executed: {answer:?}");
        }
        // Awake again, it follows and serves: also what is linearizable.
        let request = || QueryRequest {
            chaincode: "abac".into(),
            function: "robot".into(),
            args: vec!["Turtlebot4".into()],
            min_height: 0,
            linearizable: true,
        };
        crate::support::until("the node that slept answers what is linearizable", || async {
            let answer = GatewayClient::new(question_line.clone()).query(request()).await;
            let answer = match answer {
                Ok(answer) => answer.into_inner(),
                Err(_) => {
                    let line = wire::channel(&owned, true).await;
                    GatewayClient::new(line).query(request()).await.ok()?.into_inner()
                }
            };
            (answer.verdict.as_ref().map_or(0, |verdict| verdict.code) == 0).then(|| {
                assert_eq!(operator(&answer.response), (false, true));
            })
        })
        .await;
        farhad_elsewhere.invoke("abac", "release", vec!["Turtlebot4".into()]).await.unwrap();
        cluster.check();
    }
    audit(&mut cluster, &Told::default()).await;
    println!(
        "faults injected: {pauses} leaders stopped and woken; {answers} questions answered rightly when they woke, \
         {refusals} refused"
    );
    assert!(pauses > 0 && answers + refusals > 0);
    let _unused = Code::NoLeader;
}
