//! Members that want more of everybody's machines than is theirs: each attack is refused, and the robots go on.

use crate::support::network::message;
use crate::support::wire::{self, code, submit};
use crate::support::{Fleet, connect};
use crate::target::Target;
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_abac::{PolicyEntry, RobotAsset};
use ledger_api::Client;
use ledger_base::rejection::Code;
use ledger_identity::Role;

/// Functions that only read, with arguments that they take.
const READS: [(&str, &str, &[&str]); 8] = [
    ("abac", "policies", &[]),
    ("abac", "robots", &[]),
    ("abac", "grants", &[]),
    ("abac", "authorize", &["Turtlebot4"]),
    ("abac", "GetSubmittingClientIdentity", &[]),
    ("msp", "nodes", &[]),
    ("msp", "proposals", &[]),
    ("msp", "organisation", &["Org1"]),
];

fn arguments(args: &[&str]) -> Vec<Bytes> {
    args.iter().map(|arg| Bytes::copy_from_slice(arg.as_bytes())).collect()
}

async fn height(client: &Client) -> u64 {
    client.status().await.unwrap().height
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_member_without_rights_has_nothing_read_executed_or_stored_by_all() {
    let mut target = Target::start().await;
    let salma = connect(&target.salma).await;
    let channel = wire::channel(&target.salma, true).await;
    target.survived("the beginning").await;
    let before = height(&salma).await;
    for round in 0..100 {
        for (chaincode, function, args) in READS {
            let transaction = target.signed(|body| {
                (body.chaincode, body.function, body.args) = (chaincode.into(), function.into(), arguments(args));
            });
            let answer = submit(&channel, transaction.encoded().clone()).await.unwrap();
            assert_eq!(code(&answer), u32::from(Code::QueryOnly.number()), "{function}: {answer:?}");
            assert_eq!((answer.height, answer.response.len()), (0, 0), "{function} in round {round}");
        }
    }
    let blocks = height(&salma).await - before;
    assert!(blocks < 20, "{blocks} blocks were made of eight hundred of them, and what nodes say of themselves");
    // Somebody says that it is a repetition: it is ordered so that the chain decides, and answers with nothing.
    let repeated: Transaction = target.signed(|body| body.function = "policies".into());
    let answer = wire::submit_again(&channel, repeated.encoded().clone()).await.unwrap();
    assert_eq!((code(&answer), answer.response.len()), (u32::from(Code::QueryOnly.number()), 0), "{answer:?}");
    // Asked as what they are, they are answered.
    for (chaincode, function, args) in READS {
        salma.query(chaincode, function, arguments(args)).await.unwrap();
    }
    target.survived("reads as transactions").await;
    target.end("reads");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn policies_of_many_wildcards_are_refused_and_hold_up_nobody() {
    let mut target = Target::start().await;
    // Org1 owns no robot here; its admin attacks those of Org2.
    let boss = connect(&target.admin).await;
    let text = |pattern: &str, times: usize| {
        let like = format!("principal.name like \"{pattern}b\" || ").repeat(times);
        format!("permit (principal, action, resource) when {{ {like} principal.name == \"{}\" }};", "a".repeat(1000))
    };
    let apply = async |texts: &[String]| {
        let policy = |(number, text): (usize, &String)| serde_json::json!({ "id": format!("p{number}"), "text": text });
        let policies: Vec<_> = texts.iter().enumerate().map(policy).collect();
        let set = serde_json::json!({ "policies": policies }).to_string();
        boss.invoke("abac", "policy", vec!["apply".into(), set.into()]).await
    };
    for (pattern, times) in [("*a".repeat(2000), 1), ("*a".repeat(100), 1), ("*a".repeat(30), 20)] {
        let refused = apply(&[text(&pattern, times)]).await.unwrap_err();
        assert_eq!(refused.code, Code::PolicyInvalid, "{refused}");
        assert!(refused.found.contains("wildcards"), "{refused}");
        target.survived("a policy of many wildcards").await;
    }
    // What is small enough each is bounded together.
    let mut stand = Vec::new();
    for _ in 0..64 {
        let mut more = stand.clone();
        more.push(text(&format!("*{}", "a".repeat(200)), 20));
        match apply(&more).await {
            Ok(_) => stand = more,
            Err(refused) => {
                assert!(refused.code == Code::PolicyInvalid && refused.found.ends_with("steps"), "{refused}")
            }
        }
        target.survived("one more costly policy").await;
    }
    let stand = stand.len();
    assert!((1..10).contains(&stand), "{stand} of 64 stand");
    target.end("wildcards");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn long_lists_come_in_pages_and_no_answer_is_large() {
    let mut target = Target::start().await;
    let owner = connect(&target.fleet.owner()).await;
    // A long stop message makes a robot's record large; a hundred of them are 13 MB.
    let stop = "00".repeat(60 * 1024);
    let robot = |number: usize| {
        format!(
            r#"{{"name":"R{number}","attribute_required":"R","services":[{{"topic":"/c","type":"geometry_msgs/msg/Twist","stop_hex":"00010000{stop}"}}]}}"#
        )
    };
    for number in 0..100 {
        owner.invoke("abac", "setup", vec![robot(number).into()]).await.unwrap();
    }
    let refused = owner.query("abac", "robots", Vec::new()).await.unwrap_err();
    assert!(refused.code == Code::OverBudget && refused.advice().contains("pages"), "{refused}");
    let robots: Vec<RobotAsset> = owner.list("abac", "robots").await.unwrap();
    assert_eq!(robots.len(), 102, "those of the beginning, too");
    let policies: Vec<PolicyEntry> = owner.list("abac", "policies").await.unwrap();
    assert_eq!(policies.len(), 1);
    let ctl = target.fleet.ctl();
    let listed = tokio::task::spawn_blocking(move || ctl.as_("Salma").run(&["robot", "list"])).await.unwrap();
    assert!(listed.ok().stdout.contains("R99"));
    target.survived("long lists").await;
    target.end("pages");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_member_that_floods_a_service_is_limited_and_those_of_other_organisations_go_on() {
    let fleet = Fleet::found(1);
    let dora = fleet.issue("Org2", "Dora", Role::Member, &["Husky"]);
    let target = Target::start_on(fleet).await;
    let (boss, owner) = (connect(&target.admin).await, connect(&target.fleet.owner()).await);
    let quota: Vec<Bytes> = vec![r#"{"organisation":"Org1","bytes_per_s":2000,"identity_bytes_per_s":1000}"#.into()];
    for admin in [&boss, &owner] {
        admin.invoke("msp", "set_quota", quota.clone()).await.unwrap();
    }
    // One organisation alone raises nothing.
    let raised: Vec<Bytes> = vec![r#"{"organisation":"Org1","bytes_per_s":1000000000}"#.into()];
    boss.invoke("msp", "set_quota", raised).await.unwrap();

    let channel = wire::channel(&target.salma, true).await;
    let mut sequence = 0;
    let refused = loop {
        sequence += 1;
        let flood = target.signed(|body| {
            (body.function, body.args) = ("set".into(), message(1, sequence, &[0; 100]));
        });
        let answer = submit(&channel, flood.encoded().clone()).await.unwrap();
        if code(&answer) != 0 {
            break answer;
        }
        assert!(sequence < 100_000, "it floods without end");
    };
    assert_eq!(code(&refused), u32::from(Code::Overloaded.number()), "{refused:?}");
    let verdict = refused.verdict.unwrap();
    assert!(verdict.message.contains("Org1/Salma") && verdict.next.contains("retry after"), "{verdict:?}");

    // Another organisation acquires, publishes and stops, and the flooder still gives its robot back.
    let dora = connect(&dora).await;
    dora.invoke("abac", "acquire", vec!["Husky".into(), "600000".into()]).await.unwrap();
    for sequence in 1..20 {
        let mut args = message(1, sequence, &[0; 100]);
        args[0] = "Husky".into();
        dora.invoke("abac", "set", args).await.unwrap();
    }
    target.client.invoke("abac", "release", vec!["Turtlebot4".into()]).await.unwrap();
    owner.invoke("abac", "stop", vec!["Husky".into(), "a person in the cell".into()]).await.unwrap();
    target.node.no_panic();
    target.end("a flooded service");
}
