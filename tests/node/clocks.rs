//! Machines with wrong clocks.

use crate::support::network::{NodeWish, free_address, now, register_robots};
use crate::support::process::Process;
use crate::support::{Fleet, connect, eventually, until};
use ledger_api::{Client, Context, Options};
use ledger_base::rejection::Code;
use ledger_identity::Role;
use std::time::Duration;

/// Three voters, of which the last one has another clock.
struct Network {
    fleet: Fleet,
    owner: Context,
    salma: Context,
    _nodes: Vec<Process>,
}

impl Network {
    /// The clock of the third node is so many milliseconds ahead.
    fn start(ahead_ms: i64) -> Self {
        let wish = |name: &str, organisation: &str| NodeWish {
            name: name.into(),
            organisation: organisation.into(),
            voter: true,
            address: free_address(),
        };
        let wishes = [wish("node1", "Org1"), wish("node2", "Org2"), wish("node3", "Org1")];
        let fleet = Fleet::found_with(&wishes, now());
        let owner = fleet.owner();
        let salma = fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]);
        let nodes = fleet.nodes.iter().enumerate().map(|(at, place)| {
            let mut command = place.command();
            if at == 2 {
                command.env("LEDGERD_TEST_CLOCK_AHEAD_MS", ahead_ms.to_string());
            }
            place.start_as(command)
        });
        let nodes = nodes.collect();
        Self { fleet, owner, salma, _nodes: nodes }
    }

    /// A person at one node only.
    fn at(&self, person: &Context, node: usize) -> Context {
        Context { nodes: vec![self.fleet.nodes[node].address.clone()], ..person.clone() }
    }

    /// The same, who does not wait for long.
    async fn hasty(&self, person: &Context, node: usize) -> Client {
        connect(&self.at(person, node)).await;
        let options = Options { deadline: Duration::from_secs(2), ..Options::default() };
        let nodes = vec![self.fleet.nodes[node].address.clone()];
        Client::connect_with(nodes, person.credentials().unwrap(), options).await.unwrap()
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_whose_clock_is_an_hour_ahead_answers_nothing_says_whose_clock_is_wrong_and_still_ends_control() {
    let network = Network::start(3_600_000);
    let owner = connect(&network.at(&network.owner, 0)).await;
    register_robots(&owner, "exclusive").await;
    let salma = connect(&network.at(&network.salma, 0)).await;
    let grant = salma.invoke("abac", "acquire", vec!["Turtlebot4".into(), "600000".into()]).await.unwrap();
    assert!(grant.height > 0);

    let wrong = network.hasty(&network.salma, 2).await;
    // How far exactly depends on how long an answer took.
    let (why, ahead) = ("the clock of its machine is 3", " s ahead of those of most voters");
    let refused = until("the node compares its clock", || async {
        let refused = wrong.query("abac", "grants", vec!["Turtlebot4/cmd_vel".into()]).await.err()?;
        (refused.code == Code::ClockOutOfBounds).then_some(refused)
    })
    .await;
    assert!(refused.message.contains("Org1/node3") && refused.found.starts_with(why), "{refused:?}");
    assert!(refused.found.ends_with(ahead), "{refused:?}");
    assert!(refused.advice().contains("on the machine of Org1/node3"), "{refused:?}");
    let acquire = wrong.invoke("abac", "acquire", vec!["Husky".into()]).await.unwrap_err();
    assert!(acquire.code == Code::ClockOutOfBounds || acquire.code == Code::Timeout, "{acquire:?}");

    // A client that knows more nodes goes to one of them.
    let nodes = [2, 0, 1].map(|node| network.fleet.nodes[node].address.clone()).to_vec();
    let moving = connect(&Context { nodes, ..network.salma.clone() }).await;
    let answer = moving.query("abac", "grants", vec!["Turtlebot4/cmd_vel".into()]).await.unwrap();
    assert!(String::from_utf8_lossy(&answer.response).contains("Org1/Salma"), "{answer:?}");

    // All who look see whose clock is wrong.
    network.owner.save(&network.fleet.home()).unwrap();
    let admin = network.fleet.ctl().as_("Admin");
    let shown = eventually("the status of the network names the machine", || {
        let ran = admin.run(&["network", "status", "--check"]);
        ran.stdout.contains(&format!("attention: Org1/node3: {why}")).then_some(ran)
    });
    assert!(!shown.stdout.contains("attention: Org1/node1: the clock"), "{shown:?}");
    let doctor = admin.run(&["doctor"]);
    assert!(doctor.stdout.contains("the clock of Org1/node3"), "{doctor:?}");

    // It gives back what is held. It dates the call by the clocks of the others, so a block accepts it.
    let wrong = connect(&network.at(&network.salma, 2)).await;
    let released = wrong.invoke("abac", "release", vec!["Turtlebot4".into()]).await.unwrap();
    assert!(released.height > grant.height);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_lease_lives_at_every_node_until_a_block_ends_it_also_where_the_clock_is_four_seconds_ahead() {
    let network = Network::start(4_500);
    let owner = connect(&network.at(&network.owner, 0)).await;
    register_robots(&owner, "exclusive").await;
    let salma = connect(&network.at(&network.salma, 0)).await;
    let there = connect(&network.at(&network.salma, 2)).await;
    for _ in 0..3 {
        // By the clock over there it has ended before it begins.
        let grant = salma.invoke("abac", "acquire", vec!["Turtlebot4".into(), "4000".into()]).await.unwrap();
        let answer = there.query("abac", "grants", vec!["Turtlebot4/cmd_vel".into()]).await.unwrap();
        let held = String::from_utf8_lossy(&answer.response).contains("Org1/Salma");
        let ended = answer.height > grant.height;
        assert!(held || ended, "block {} gave it, block {} answers {answer:?}", grant.height, answer.height);
        // A slow machine may take longer than the lease.
        let _ended = salma.invoke("abac", "release", vec!["Turtlebot4".into()]).await;
    }
}
