//! An organisation that runs its two voters twice makes a node of another one execute blocks that nobody certifies, and has other
//! blocks certified with the rest. That node stops when it meets the certificate, and comes back by the command that it names.

use crate::pretenders::{as_node, part, say};
use crate::support::directory::copy;
use crate::support::network::{NodePlace, NodeWish, free_address, now, register_robots};
use crate::support::process::Process;
use crate::support::{Ctl, Fleet, connect, programs, until};
use crate::twice::{Side, Twice, runtime};
use bytes::Bytes;
use ledger::branch::CertifiedBranch;
use ledger_api::Context;
use ledger_base::hash::Hash;
use ledger_identity::Role;
use ledger_light::{Proof, Statement};
use rustix::process::Signal;
use serde_json::Value;
use std::path::PathBuf;
use std::process::Stdio;
use std::time::Duration;
use testkit::own_network::isolated;

/// Voters a1 and a2 of Org1, which lies, b1 and b2 of Org2, and c of Org3. On the first side, a1, a2 and b1 order; on the second
/// one copies of a1 and a2 with b2 and c, which are enough for a strict certificate.
struct Scene {
    fleet: Fleet,
    dead: Side,
    certified: Side,
    /// On the dead side, at b1.
    salma: Ctl,
    /// On the certified side, at b2.
    farhad: Ctl,
}

impl Scene {
    async fn new() -> Self {
        let wish = |name: &str, organisation: &str| NodeWish {
            name: name.into(),
            organisation: organisation.into(),
            voter: true,
            address: free_address(),
        };
        let wishes =
            [wish("a1", "Org1"), wish("a2", "Org1"), wish("b1", "Org2"), wish("b2", "Org2"), wish("c", "Org3")];
        let fleet = Fleet::found_with(&wishes, now());
        let user = |name: &str, node: usize| {
            let context = fleet.issue("Org1", name, Role::Member, &["Turtlebot4"]);
            Context { nodes: vec![fleet.nodes[node].address.clone()], ..context }.save(&fleet.home()).unwrap();
            fleet.ctl().as_(name)
        };
        let (salma, farhad) = (user("Salma", 2), user("Farhad", 3));
        let mut nodes: Vec<Process> = fleet.nodes.iter().map(NodePlace::start).collect();
        register_robots(&connect(&fleet.owner()).await, "exclusive").await;
        nodes.iter_mut().for_each(Process::interrupt);

        let twins = [0, 1].map(|liar| {
            let twin = fleet.path().join(format!("twin{liar}"));
            copy(&fleet.nodes[liar].data, &twin);
            fleet.nodes[liar].beside(&format!("twin{liar}"), twin)
        });
        let (mut dead, mut certified) = (Side::new(&fleet, "dead"), Side::new(&fleet, "certified"));
        [2, 0, 1].iter().for_each(|node| dead.start(&fleet.nodes[*node]));
        twins.iter().for_each(|twin| certified.start(twin));
        [3, 4].iter().for_each(|node| certified.start(&fleet.nodes[*node]));
        Self { fleet, dead, certified, salma, farhad }
    }

    fn b1(&self) -> &NodePlace {
        &self.fleet.nodes[2]
    }

    /// Each side orders something; answers with the id of Salma's transaction.
    async fn part(&self) -> String {
        let acquire = ["acquire", "Turtlebot4/cmd_vel", "--for", "10m", "-o", "json"];
        self.certified.does(&self.farhad, &acquire).await;
        let acquired = until("the dead side orders", || async {
            let (code, shown, noted) = self.dead.run(&self.salma, &acquire).await;
            (code == 0).then(|| (serde_json::from_str::<Value>(&shown).unwrap(), noted))
        })
        .await;
        let (acquired, noted) = acquired;
        // On this side nothing is certified, and the answer says so.
        assert!(
            acquired["certified"] == false && noted.contains("executed, but not certified yet"),
            "{acquired} {noted}"
        );
        until("the other side is certified", || async {
            let held = self.certified.light(&self.farhad).await.ok()?;
            (held == "Org1/Farhad").then_some(())
        })
        .await;
        acquired["transaction"].as_str().unwrap().to_owned()
    }

    /// The dead side is gone, and b1 meets the others; answers with the end of the log that it writes then.
    fn meet(&mut self) -> String {
        self.dead.nodes.iter_mut().for_each(Process::kill);
        self.start()
    }

    /// Starts b1 beside the others, and waits until it has stopped.
    fn start(&self) -> String {
        let before = self.b1().logged().len();
        let mut process = self.b1().start_as(self.certified.within(&self.b1().command()));
        let ended = process.wait();
        let log = process.stderr().split_off(before);
        assert_eq!(ended.code(), Some(7), "{ended}\n{log}");
        process.no_panic();
        log
    }

    fn rejoin(&self) -> std::process::Command {
        let mut command = programs::node();
        command.args(["rejoin", "--config"]).arg(&self.b1().config);
        self.certified.within(&command)
    }

    fn dead_branch(&self) -> PathBuf {
        self.b1().data.join("dead-branch-1")
    }

    /// A bridge of the robot, in this part, that knows b1 alone. It drives what DDS carries there.
    fn bridge(&self, side: &Side) -> Process {
        let context = self.fleet.issue("Org2", "Turtlebot4", Role::Robot, &[]);
        Context { nodes: vec![self.b1().address.clone()], ..context }.save(&self.fleet.home()).unwrap();
        let config = self.fleet.path().join("bridge.toml");
        let context = self.fleet.home().join("contexts/Turtlebot4");
        // No silence of a busy machine stops the robot.
        let settings = format!(
            "context_dir = {context:?}\ndomain_id = 3\nshared_memory = false\n[[route]]\nservice = \"Turtlebot4/cmd_vel\"\n\
             direction = \"from_ledger\"\ntopic = \"/cmd_vel\"\ntype = \"geometry_msgs/msg/Twist\"\n\
             command_timeout_ms = 0\nstale_after_ms = 10000\n"
        );
        std::fs::write(&config, settings).unwrap();
        let mut command = programs::node();
        command.args(["bridge", "--config"]).arg(config);
        Process::start("bridge", self.fleet.path(), side.within(&command))
    }

    /// b1 is back under a new number, with the branch that is certified, and its own one is kept with the list of what was lost.
    async fn is_back(&self, lost: &str) {
        let listed = std::fs::read(self.dead_branch().join("lost-transactions.json")).unwrap();
        let listed: Value = serde_json::from_slice(&listed).unwrap();
        let ids: Vec<_> = listed["transactions"].as_array().unwrap().iter().map(|one| &one["id"]).collect();
        assert!(ids.contains(&&Value::from(lost)), "{listed}");
        assert!(listed["transactions"].as_array().unwrap().iter().any(|one| {
            (&one["creator"], &one["function"], &one["verdict"])
                == (&"Org1/Salma".into(), &"acquire".into(), &"OK".into())
        }));
        let mut verify = programs::node();
        let verified = verify.arg("verify").arg(self.dead_branch()).output().unwrap();
        assert!(verified.status.success(), "{}", String::from_utf8_lossy(&verified.stderr));
        assert!(!self.b1().data.join("certified-branch").exists());

        let mut back = self.b1().start_as(self.certified.within(&self.b1().command()));
        until("b1 has what the others have", || async {
            (self.certified.light(&self.salma).await.ok()? == "Org1/Farhad").then_some(())
        })
        .await;
        until("b1 is there under a new number, and has what was ordered since", || async {
            let release = ["release", "Turtlebot4/cmd_vel", "-o", "json"];
            let (code, shown, noted) = self.certified.run(&self.farhad, &release).await;
            assert!(code != 0 || (shown.contains("\"certified\":true") && noted.is_empty()), "{shown} {noted}");
            let (_, shown, _) = self.certified.run(&self.salma, &["network", "status", "-o", "json"]).await;
            let status: Value = serde_json::from_str(&shown).ok()?;
            let nodes = status["nodes"].as_array()?;
            let highest = nodes.iter().filter_map(|node| node["height"].as_u64()).max()?;
            let b1 = nodes.iter().find(|node| node["name"] == "b1")?;
            (b1["id"].as_u64()? > 5 && b1["height"].as_u64()? + 2 > highest).then_some(())
        })
        .await;
        back.check();
        back.interrupt();
    }
}

#[test]
fn a_node_that_a_strict_certificate_contradicts_stops_and_comes_back_by_the_command_that_it_names() {
    if !isolated(&|| ()) {
        return;
    }
    runtime().block_on(async {
        let mut scene = Scene::new().await;
        let lost = scene.part().await;
        let log = scene.meet();
        assert!(log.contains("LGR-5009") && log.contains("certified another block"), "{log}");
        assert!(log.contains(&format!("ledgerd rejoin --config {}", scene.b1().config.display())), "{log}");
        // It does not execute on, however often it is started.
        let again = scene.start();
        assert!(again.contains("LGR-5009") && again.contains("ledgerd rejoin"), "{again}");
        assert!(!again.contains("ready after"), "{again}");

        // A client of that node goes to the others, of which it knows from the ledger. One that knows this node alone reaches none.
        let (code, _, refused) = scene.certified.run(&scene.salma, &["tx", &lost]).await;
        assert!(code != 0 && refused.contains("LGR-1013"), "the certified branch does not have it: {code} {refused}");
        let nima = scene.fleet.issue("Org1", "Nima", Role::Member, &["Turtlebot4"]);
        Context { nodes: vec![scene.b1().address.clone()], ..nima }.save(&scene.fleet.home()).unwrap();
        let nima = scene.fleet.ctl().as_("Nima");
        let (code, _, refused) = scene.certified.run(&nima, &["robot", "list"]).await;
        assert!(code == 4 && refused.contains("LGR-4001"), "{code} {refused}");
        let (_, shown, _) = scene.certified.run(&scene.salma, &["light", "Turtlebot4"]).await;
        assert!(shown.contains("since block 0, for the whole chain from the genesis"), "{shown}");

        let back = programs::said(&scene.rejoin().output().unwrap());
        assert!(back.contains(&lost) && back.contains("dead-branch-1"), "{back}");
        scene.is_back(&lost).await;
    });
}

/// How many commands a bridge has passed to its robot, as it reports at its end.
fn passed(mut bridge: Process) -> u64 {
    assert!(bridge.signal(Signal::TERM).success(), "{}", bridge.stderr());
    let report = bridge.stdout();
    let report: Value = serde_json::from_str(report.lines().last().unwrap()).unwrap();
    report["routes"][0]["published"].as_u64().unwrap()
}

#[test]
fn a_robot_at_the_node_obeys_the_certified_branch_alone_before_the_node_meets_it_and_after() {
    const READY: &str = "the bridge of Org2/Turtlebot4 is ready";
    const WORDS: [&str; 7] = ["publish", "Turtlebot4/cmd_vel", "{linear: {x: 0.1}}", "--rate", "20", "--count", "40"];
    if !isolated(&|| ()) {
        return;
    }
    runtime().block_on(async {
        let mut scene = Scene::new().await;
        let lost = scene.part().await;
        // On the dead branch she holds the robot, and her commands are executed there. No voters certify that, so it does not move.
        let bridge = scene.bridge(&scene.dead);
        until("the bridge is ready", || async { bridge.stderr().contains(READY).then_some(()) }).await;
        scene.dead.does(&scene.salma, &WORDS).await;
        assert_eq!(passed(bridge), 0);

        // The node has stopped. A bridge that knows no other one waits for it to come back.
        scene.meet();
        let bridge = scene.bridge(&scene.certified);
        let before = bridge.stderr().matches(READY).count();
        until("the bridge waits", || async { bridge.stderr().contains("the bridge waits").then_some(()) }).await;
        let back = programs::said(&scene.rejoin().output().unwrap());
        assert!(back.contains(&lost), "{back}");
        let mut node = scene.b1().start_as(scene.certified.within(&scene.b1().command()));
        until("the bridge is ready again", || async {
            (bridge.stderr().matches(READY).count() > before).then_some(())
        })
        .await;
        scene.certified.does(&scene.farhad, &WORDS).await;
        assert!(passed(bridge) > 0, "the holder of the certified branch drives");
        node.interrupt();
    });
}

#[test]
fn a_rejoin_that_is_killed_at_any_moment_is_finished_by_the_same_command_and_loses_nothing() {
    if !isolated(&|| ()) {
        return;
    }
    runtime().block_on(async {
        let mut scene = Scene::new().await;
        let lost = scene.part().await;
        scene.meet();
        let mut wait = Duration::from_millis(20);
        loop {
            let mut rejoin = scene.rejoin().stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
            tokio::time::sleep(wait).await;
            let ended = rejoin.try_wait().unwrap();
            if ended.is_some_and(|ended| ended.success()) {
                break;
            }
            let _ended_by_itself = rejoin.kill();
            rejoin.wait().unwrap();
            // The blocks are in one of the two places, whole.
            let places = [scene.b1().data.join("blocks"), scene.dead_branch().join("blocks")];
            assert!(places.iter().any(|place| place.exists()), "{wait:?}");
            wait += wait / 4;
            assert!(wait < Duration::from_secs(60), "it never ends");
        }
        scene.is_back(&lost).await;
    });
}

#[test]
fn where_no_history_is_certified_any_more_recover_takes_the_people_through_it() {
    if !isolated(&|| ()) {
        return;
    }
    runtime().block_on(async {
        // Three of five voters order on each side, and four signatures are needed.
        let mut twice = Twice::new(5).await;
        twice.acquire().await;
        let (one, user) = (&twice.sides[0], &twice.users[0]);
        assert!(one.light(user).await.is_err(), "nothing is certified");
        twice.sides.iter_mut().flat_map(|side| &mut side.nodes).for_each(Process::kill);

        // The people choose the first history.
        let [kept, other] = [1, 3].map(|node| &twice.fleet.nodes[node]);
        let ledgerd = |words: &[&str], place: &NodePlace| {
            let mut command = programs::node();
            command.args(words).arg("--config").arg(&place.config);
            twice.sides[0].within(&command).output().unwrap()
        };
        programs::refused(
            &ledgerd(&["recover", "--force-single"], kept),
            &["nothing was done", "would vote no longer", "--confirm"],
        );
        let done = programs::said(&ledgerd(
            &["recover", "--force-single", "--confirm", "test", "--reason", "Org1 lied"],
            kept,
        ));
        assert!(done.contains("FORCED RECOVERY") && done.contains("ledgerd rejoin"), "{done}");
        let _kept = kept.start_as(twice.sides[0].within(&kept.command()));
        twice.sides[0].does(&twice.users[0], &["robot", "list"]).await;
        let backup = twice.fleet.path().join("backup");
        let backup = backup.to_str().unwrap();
        until("a backup is made", || async { ledgerd(&["backup", backup], kept).status.success().then_some(()) }).await;

        // A node of the other history comes back, and what it had is kept for auditors.
        let back = programs::said(&ledgerd(&["rejoin", "--node", &kept.address, "--blocks", backup], other));
        assert!(back.contains("damaged-1"), "{back}");
        let _other = other.start_as(twice.sides[0].within(&other.command()));
        let there = other.data.join("damaged-1");
        let verified = programs::node().arg("verify").arg(&there).output().unwrap();
        assert!(verified.status.success(), "{}", String::from_utf8_lossy(&verified.stderr));
        let at_it = twice.fleet.issue("Org1", "Nima", Role::Member, &["Turtlebot4"]);
        Context { nodes: vec![other.address.clone()], ..at_it }.save(&twice.fleet.home()).unwrap();
        let nima = twice.fleet.ctl().as_("Nima");
        until("it has the history that was kept", || async {
            let (_, shown, _) = twice.sides[0].run(&nima, &["robot", "show", "Turtlebot4"]).await;
            shown.contains("Org1/Salma").then_some(())
        })
        .await;
    });
}

/// Waits until a node has kept the proof of a block that was ordered after the parts were separated.
async fn proof_after(place: &NodePlace, side: &Side, user: &Ctl, height: u64) -> Proof {
    until("the newest proof is kept", || async {
        side.light(user).await.ok()?;
        kept_proof(place).filter(|kept| kept.certificate.statement.height > height)
    })
    .await
}

/// The newest proof that a node has kept.
fn kept_proof(place: &NodePlace) -> Option<Proof> {
    Proof::from_bytes(&std::fs::read(place.data.join("certificates/newest.proof")).ok()?).ok()
}

#[test]
fn a_rejoin_drops_nothing_that_a_strict_certificate_of_its_node_covers() {
    if !isolated(&|| ()) {
        return;
    }
    runtime().block_on(async {
        let wish = |number: usize| NodeWish {
            name: format!("node{number}"),
            organisation: format!("Org{number}"),
            voter: true,
            address: free_address(),
        };
        let fleet = Fleet::found_with(&[1, 2, 3, 4].map(wish), now());
        let user = |name: &str, node: usize| {
            let context = fleet.issue("Org1", name, Role::Member, &["Turtlebot4"]);
            Context { nodes: vec![fleet.nodes[node].address.clone()], ..context }.save(&fleet.home()).unwrap();
            fleet.ctl().as_(name)
        };
        let (salma, farhad) = (user("Salma", 3), user("Farhad", 0));
        let mut nodes: Vec<Process> = fleet.nodes.iter().map(NodePlace::start).collect();
        let owner = connect(&fleet.owner()).await;
        register_robots(&owner, "exclusive").await;
        let height = owner.status().await.unwrap().height;
        nodes.iter_mut().for_each(Process::interrupt);

        // Three organisations lie together: they run their voters twice, once with the fourth one and once without it.
        let twins = [0, 1, 2].map(|liar| {
            let twin = fleet.path().join(format!("twin{liar}"));
            copy(&fleet.nodes[liar].data, &twin);
            fleet.nodes[liar].beside(&format!("twin{liar}"), twin)
        });
        let (mut first, mut second) = (Side::new(&fleet, "first"), Side::new(&fleet, "second"));
        fleet.nodes.iter().for_each(|node| first.start(node));
        twins.iter().for_each(|twin| second.start(twin));
        let acquire = ["acquire", "Turtlebot4/cmd_vel", "--for", "10m"];
        first.does(&salma, &acquire).await;
        second.does(&farhad, &acquire).await;
        let node4 = &fleet.nodes[3];
        // The grant is certified now, and the node keeps the certificate in a moment.
        let (_, shown, _) = first.run(&salma, &["status", "-o", "json"]).await;
        let certified = serde_json::from_str::<Value>(&shown).unwrap()["certified"].as_u64().unwrap();
        assert!(certified > height, "{shown}");
        proof_after(node4, &first, &salma, certified - 1).await;
        let other = proof_after(&twins[0], &second, &farhad, height).await;
        first.nodes.iter_mut().for_each(Process::kill);
        let own = kept_proof(node4).unwrap();

        // As if the node had met the other certificate before its own one.
        let mark = node4.data.join("contradicted");
        std::fs::write(&mark, CertifiedBranch::of(other.certificate).to_bytes()).unwrap();
        let mut command = programs::node();
        command.args(["rejoin", "--config"]).arg(&node4.config);
        let refused = programs::refused(
            &second.within(&command).output().unwrap(),
            &["LGR-5009", "two strict certificates contradict each other; nothing was changed", "people must choose"],
        );
        let certified = own.certificate.statement;
        assert!(refused.contains(&format!("block {} at height {}", certified.block, certified.height)), "{refused}");
        assert!(mark.exists() && node4.data.join("blocks").exists() && !node4.data.join("dead-branch-1").exists());
        let verified = programs::node().arg("verify").arg(&node4.data).output().unwrap();
        assert!(verified.status.success(), "{}", String::from_utf8_lossy(&verified.stderr));
    });
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_strict_certificates_are_shown_and_no_node_leaves_what_its_own_one_covers() {
    let wish = |number: usize| NodeWish {
        name: format!("node{number}"),
        organisation: format!("Org{number}"),
        voter: true,
        address: free_address(),
    };
    let fleet = Fleet::found_with(&[1, 2, 3, 4].map(wish), now());
    let owner = fleet.owner();
    let mut nodes: Vec<Process> = fleet.nodes.iter().map(NodePlace::start).collect();
    register_robots(&connect(&owner).await, "exclusive").await;
    let first = connect(&Context { nodes: vec![fleet.nodes[0].address.clone()], ..owner.clone() }).await;
    let height = until("a block is certified", || async {
        let certified = first.status().await.ok()?.certified;
        (certified > 0).then_some(certified)
    })
    .await;

    // Three of four organisations lie, each with its own key.
    let (time, block, results) = (now(), Hash([9; 32]), Hash([7; 32]));
    for (place, number) in fleet.nodes.iter().zip(1..).skip(1) {
        let voter = as_node(place, &owner);
        let statement = Statement { network: owner.network, recoveries: 0, height, time, block, results };
        let signed = statement.sign(number, Bytes::copy_from_slice(&voter.chain[0]), &voter.key).unwrap();
        say(&voter, &fleet.nodes[0].address, vec![part(6, &part(1, &signed.to_bytes())).into()]).await;
    }
    until("the first node shows it", || async {
        let status = first.status().await.ok()?;
        status.divergence.contains(&format!("voters have certified two blocks of height {height}")).then_some(())
    })
    .await;
    let kept = fleet.nodes[0].data.join("certificates/other.branch");
    until("the other certificate is kept", || async { kept.exists().then_some(()) }).await;
    assert!(!fleet.nodes[0].data.join("contradicted").exists());
    nodes[0].check();
    nodes[0].interrupt();
    // It is shown after a restart, too, and the node starts.
    nodes[0] = fleet.nodes[0].start();
    until("the first node shows it again", || async {
        first.status().await.ok()?.divergence.contains("people must decide").then_some(())
    })
    .await;
}
