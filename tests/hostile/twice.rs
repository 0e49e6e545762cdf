//! An organisation runs its voter twice, on two copies of its disk, each with other voters: a leader that tells two stories.

use crate::support::directory::copy;
use crate::support::network::{NodePlace, NodeWish, free_address, now, register_robots};
use crate::support::process::Process;
use crate::support::{Ctl, Fleet, connect, until};
use ledger_api::Context;
use ledger_identity::Role;
use serde_json::Value;
use std::process::Command;
use testkit::own_network::isolated;

/// A part of the network that hears nothing of the rest: a network namespace of its own.
pub(crate) struct Side {
    holder: Process,
    pub(crate) nodes: Vec<Process>,
}

impl Side {
    pub(crate) fn new(fleet: &Fleet, name: &str) -> Self {
        let mut command = Command::new("unshare");
        command.args(["-n", "sh", "-c", "ip link set lo up && echo up && exec sleep 600"]);
        let mut holder = Process::start(name, fleet.path(), command);
        assert_eq!(holder.first_line(), "up");
        Self { holder, nodes: Vec::new() }
    }

    /// The command, in this part.
    pub(crate) fn within(&self, command: &Command) -> Command {
        let mut inside = Command::new("nsenter");
        inside.args(["-t", &self.holder.id().to_string(), "-n", "--"]).arg(command.get_program());
        inside.args(command.get_args());
        for (name, value) in command.get_envs() {
            match value {
                Some(value) => inside.env(name, value),
                None => inside.env_remove(name),
            };
        }
        inside
    }

    pub(crate) fn start(&mut self, place: &NodePlace) {
        self.nodes.push(place.start_as(self.within(&place.command())));
    }

    /// Runs `ledgerctl` in this part until it succeeds.
    pub(crate) async fn does(&self, user: &Ctl, words: &[&str]) {
        until(&format!("{words:?} is done"), || async {
            let done = self.run(user, words).await;
            (done.0 == 0).then_some(())
        })
        .await;
    }

    pub(crate) async fn run(&self, user: &Ctl, words: &[&str]) -> (i32, String, String) {
        let mut command = tokio::process::Command::from(self.within(&user.command(words)));
        let done = command.stdin(std::process::Stdio::null()).output().await.unwrap();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        (done.status.code().unwrap_or(-1), text(done.stdout), text(done.stderr))
    }

    /// The holder of the robot as voters have signed it, or the reason why nobody believes it.
    pub(crate) async fn light(&self, user: &Ctl) -> Result<Value, String> {
        match self.run(user, &["light", "Turtlebot4", "-o", "json"]).await {
            (0, shown, _) => {
                let shown: Value = serde_json::from_str(&shown).unwrap();
                Ok(shown["services"][0]["grants"][0]["holder"].clone())
            }
            (_, _, refused) => Err(refused),
        }
    }
}

/// A network of so many organisations with a voter each. The first one runs its voter twice: once with the first half of the
/// others, once with the second half. In each part a user acquires the robot.
pub(crate) struct Twice {
    pub(crate) fleet: Fleet,
    pub(crate) sides: [Side; 2],
    pub(crate) users: [Ctl; 2],
}

impl Twice {
    pub(crate) async fn new(organisations: usize) -> Self {
        let wish = |number: usize| NodeWish {
            name: format!("node{number}"),
            organisation: format!("Org{number}"),
            voter: true,
            address: free_address(),
        };
        let fleet = Fleet::found_with(&(1..=organisations).map(wish).collect::<Vec<_>>(), now());
        let half = 1 + (organisations - 1) / 2;
        // Each of them knows one node.
        let user = |name: &str, node: usize| {
            let context = fleet.issue("Org1", name, Role::Member, &["Turtlebot4"]);
            Context { nodes: vec![fleet.nodes[node].address.clone()], ..context }.save(&fleet.home()).unwrap();
            fleet.ctl().as_(name)
        };
        let users = [user("Salma", 1), user("Farhad", half)];
        let mut nodes: Vec<Process> = fleet.nodes.iter().map(NodePlace::start).collect();
        register_robots(&connect(&fleet.owner()).await, "exclusive").await;
        nodes.iter_mut().for_each(Process::interrupt);

        let twin = fleet.path().join("twin");
        copy(&fleet.nodes[0].data, &twin);
        let twin = fleet.nodes[0].beside("twin", twin);

        let mut sides = [Side::new(&fleet, "side1"), Side::new(&fleet, "side2")];
        sides[0].start(&fleet.nodes[0]);
        sides[1].start(&twin);
        for (number, place) in fleet.nodes.iter().enumerate().skip(1) {
            sides[usize::from(number >= half)].start(place);
        }
        Self { fleet, sides, users }
    }

    /// Both users acquire the robot.
    pub(crate) async fn acquire(&self) {
        for (side, user) in self.sides.iter().zip(&self.users) {
            side.does(user, &["acquire", "Turtlebot4/cmd_vel", "--for", "10m"]).await;
        }
    }
}

#[test]
fn where_certificates_are_strict_a_voter_that_runs_twice_has_nothing_certified() {
    if !isolated(&|| ()) {
        return;
    }
    runtime().block_on(async {
        let twice = Twice::new(5).await;
        // Three voters order on each side, and their stories differ. Nobody who asks for signatures believes one of them.
        twice.acquire().await;
        for (side, user) in twice.sides.iter().zip(&twice.users) {
            let refused = side.light(user).await.unwrap_err();
            assert!(refused.contains("too few voters") || refused.contains("no proof"), "{refused}");
            let (_, shown, _) = side.run(user, &["status"]).await;
            assert!(shown.contains("4 signatures, strict since block 0"), "{shown}");
            assert!(shown.contains("no block is certified"), "{shown}");
        }
        drop(twice.fleet);
    });
}

#[test]
fn with_three_voters_a_voter_that_runs_twice_has_both_stories_certified_as_the_table_says() {
    if !isolated(&|| ()) {
        return;
    }
    runtime().block_on(async {
        let twice = Twice::new(3).await;
        twice.acquire().await;
        let [one, other] = [0, 1].map(|side| (&twice.sides[side], &twice.users[side]));
        assert_eq!(one.0.light(one.1).await.as_ref().map(Value::as_str), Ok(Some("Org1/Salma")));
        assert_eq!(other.0.light(other.1).await.as_ref().map(Value::as_str), Ok(Some("Org1/Farhad")));
        let (_, shown, _) = one.0.run(one.1, &["status"]).await;
        assert!(shown.contains("1 crash, lies of none, silence of one organisation"), "{shown}");
        let (_, shown, _) = one.0.run(one.1, &["light", "Turtlebot4"]).await;
        assert!(shown.contains("one lying organisation could have another block certified"), "{shown}");
        drop(twice.fleet);
    });
}

pub(crate) fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap()
}
