//! Contexts on people's machines: `ledgerd dev` and its contexts, what contexts learn, and certificates that end.

use crate::join::{Newcomer, token};
use crate::support::network::now;
use crate::support::{Ctl, Dev, Fleet, Process, connect, programs};
use ledger_api::Context;
use ledger_identity::Role;
use ledger_identity::certificate::Certificate;
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Microseconds.
const DAY: u64 = 24 * 3600 * 1_000_000;

/// `ledgerd dev` in this home, at this address.
fn dev(home: &Path, listen: &str) -> Command {
    let mut command = programs::node();
    command.args(["dev", "--json", "--listen", listen]);
    command.env("LEDGERD_HOME", home).env("TMPDIR", home);
    command
}

/// Every file of the contexts of a home.
fn files(home: &Path) -> BTreeMap<String, Vec<u8>> {
    let Ok(contexts) = fs::read_dir(home.join("contexts")) else { return BTreeMap::new() };
    let files = contexts.flat_map(|context| fs::read_dir(context.unwrap().path()).unwrap());
    files.map(|file| file.unwrap().path()).map(|path| (path.display().to_string(), fs::read(&path).unwrap())).collect()
}

#[test]
fn a_second_dev_refuses_before_it_touches_anything_of_the_first() {
    let first = Dev::start();
    first.admin().run(&["status"]).ok();
    let before = files(first.home.path());
    // At another port, and at the same one.
    for listen in ["127.0.0.1:0", first.fact("address")] {
        let second = dev(first.home.path(), listen).output().unwrap();
        let said = String::from_utf8(second.stderr).unwrap();
        assert!(!second.status.success(), "{said}");
        for words in ["another ledgerd dev is running", first.fact("address"), "LEDGERD_HOME=DIR"] {
            assert!(said.contains(words), "{words:?} is missing in {said}");
        }
        assert_eq!(files(first.home.path()), before);
    }
    // In another home, at the same port.
    let home = tempfile::tempdir().unwrap();
    let second = dev(home.path(), first.fact("address")).output().unwrap();
    let said = String::from_utf8(second.stderr).unwrap();
    assert!(!second.status.success() && said.contains("cannot listen on"), "{said}");
    assert!(files(home.path()).is_empty(), "nothing is left behind");
    first.admin().run(&["robot", "list"]).ok();
}

#[test]
fn what_a_killed_dev_left_the_next_one_replaces_and_people_are_told_that_the_network_is_a_different_one() {
    let first = Dev::start();
    first.user("Salma", &["Turtlebot4"], "ed25519").run(&["whoami"]).ok();
    let address = first.fact("address").to_owned();
    let Dev { mut process, home, .. } = first;
    process.kill();
    assert!(home.path().join("contexts/dev-org1-admin").is_dir());
    let mut second = Process::start("dev2", home.path(), dev(home.path(), &address));
    second.first_line();
    let ctl = Ctl::at(home.path());
    ctl.as_("dev-org1-admin").run(&["status"]).ok();
    ctl.as_("Salma").run(&["status"]).refused(
        3,
        &[
            "LGR-1003",
            &format!("a different network answers at {address}"),
            "the CA",
            "of Org1",
            "--context dev-org1-admin or --context dev-org2-admin",
        ],
    );
    for name in ["dev-org1-admin", "dev-org2-admin"] {
        fs::remove_dir_all(home.path().join("contexts").join(name)).unwrap();
    }
    ctl.as_("Salma").run(&["status"]).refused(3, &["LGR-1003", "enrol again with --force"]);
    second.interrupt();
    assert_eq!(Context::list(home.path()).unwrap(), ["Salma"], "it removes its own, and nobody else's");
}

#[test]
fn a_dev_whose_terminal_is_closed_removes_its_contexts() {
    let first = Dev::start();
    let Dev { mut process, home, .. } = first;
    assert_eq!(Context::list(home.path()).unwrap().len(), 2);
    assert!(process.signal(Signal::HUP).success());
    assert!(Context::list(home.path()).unwrap().is_empty());
}

#[test]
fn dev_never_replaces_a_context_that_it_has_not_made() {
    let fleet = Fleet::found(1);
    let mut context = fleet.issue("Org1", "Admin", Role::Admin, &[]);
    context.name = "dev-org1-admin".into();
    context.save(&fleet.home()).unwrap();
    let before = files(&fleet.home());
    let refused = dev(&fleet.home(), "127.0.0.1:0").output().unwrap();
    let said = String::from_utf8(refused.stderr).unwrap();
    assert!(!refused.status.success() && said.contains("was not created by ledgerd dev"), "{said}");
    assert_eq!(files(&fleet.home()), before);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_context_learns_a_node_that_joined_later_and_works_through_it_alone() {
    let fleet = Fleet::found(1);
    let admin = fleet.issue("Org1", "Admin", Role::Admin, &[]);
    let node = fleet.nodes[0].start();
    let leader = connect(&admin).await;
    let invited = token(&fleet, &leader, "Org1", "node2").await;
    let newcomer = Newcomer::new(&fleet, "second");
    newcomer.join(&invited.to_string()).ok();
    let _second = newcomer.run("second", &fleet);
    crate::join::follows(&admin, &leader, &newcomer).await;

    let ctl = fleet.ctl().as_("Admin");
    let refreshed = ctl.json(&["context", "refresh"]);
    assert_eq!(refreshed["new"][0], newcomer.address.as_str(), "{refreshed}");
    let shown = ctl.json(&["context", "show"]);
    assert_eq!(shown["nodes"][1], newcomer.address.as_str(), "{shown}");
    assert_eq!(shown["known_nodes"][1]["organisation"], "Org1", "{shown}");
    // Nothing can be ordered any more, but whatever a node knows by itself is told.
    drop(node);
    let status = ctl.run(&["status", "-o", "json"]);
    assert_eq!(status.json()["node_name"], "node2", "{status:?}");
    assert_eq!(ctl.json(&["context", "show"])["nodes"][0], newcomer.address.as_str(), "who served is asked first");
}

/// The end of a context's certificate.
fn end(fleet: &Fleet, name: &str) -> u64 {
    let context = Context::load(&fleet.home(), Some(name)).unwrap();
    Certificate::parse(&context.chain[0]).unwrap().not_after
}

#[test]
fn ledgerctl_renews_a_certificate_in_the_last_third_of_its_life_unless_it_is_told_not_to() {
    let fleet = Fleet::found_at(1, now() - 360 * DAY);
    fleet.issue_at("Salma", now() - 300 * DAY, 365);
    fleet.issue_at("Farhad", now() - 350 * DAY, 365);
    fleet.issue_at("Young", now() - 200 * DAY, 365);
    let before = ["Salma", "Farhad", "Young"].map(|name| end(&fleet, name));
    let mut node = fleet.nodes[0].start();
    let ctl = fleet.ctl();
    crate::support::eventually("the node leads", || {
        node.check();
        (ctl.as_("Young").run(&["robot", "list"]).code == 0).then_some(())
    });
    assert_eq!(end(&fleet, "Young"), before[2], "it has more than a third of its life before it");

    let said = crate::support::eventually("the certificate is renewed", || {
        let said = ctl.as_("Salma").run(&["robot", "list"]);
        (end(&fleet, "Salma") > now() + 300 * DAY).then_some(said)
    });
    assert_eq!(said.ok().stderr, "", "a renewal that works is nobody's business");
    ctl.as_("Salma").run(&["robot", "list"]).ok();

    ctl.run(&["context", "set", "Farhad", "renew=never"]).ok();
    // Commands that ask a node, and commands that do not, each once.
    for command in [&["robot", "list"][..], &["context", "show"], &["whoami"], &["block", "0"]] {
        let said = ctl.as_("Farhad").run(command).ok();
        assert_eq!(said.stderr.matches("warning: the certificate of Org1/Farhad ends ").count(), 1, "{said:?}");
        assert!(said.stderr.contains("ledgerctl identity renew --context Farhad"), "{said:?}");
    }
    let said = ctl.as_("Farhad").run(&["robot", "list", "-o", "json"]).ok();
    let warning: serde_json::Value = serde_json::from_str(&said.stderr).unwrap();
    assert!(warning["warning"].as_str().unwrap().contains("Org1/Farhad ends"), "{warning}");
    assert_eq!(end(&fleet, "Farhad"), before[1]);
    let said = ctl.as_("Farhad").run(&["identity", "renew"]).ok();
    assert_eq!(said.stderr, "", "it has just been cured");
    assert!(end(&fleet, "Farhad") > now() + 300 * DAY);
    node.check();
}

#[test]
fn a_renewal_that_fails_is_a_warning_and_an_end_that_has_come_says_what_to_do() {
    let fleet = Fleet::found_at(1, now() - 410 * DAY);
    fleet.issue_at("Salma", now() - 350 * DAY, 365);
    fleet.issue_at("Late", now() - 400 * DAY, 365);
    let _node = fleet.nodes[0].start();
    let ctl = fleet.ctl();
    let files = fs::read_dir(fleet.home().join("contexts").join("Salma")).unwrap();
    let files: Vec<_> = files.map(|file| file.unwrap().path()).filter(|file| file.is_file()).collect();
    let old: Vec<_> = files.into_iter().map(|file| (fs::read(&file).unwrap(), file)).collect();
    crate::support::eventually("the certificate is renewed when it is used", || {
        ctl.as_("Salma").run(&["robot", "list"]);
        (end(&fleet, "Salma") > now() + 300 * DAY).then_some(())
    });
    // A CA that has just given a name a certificate gives it no other one for a minute.
    for (bytes, file) in &old {
        fs::write(file, bytes).unwrap();
    }
    // The command that tried says why it failed, and so do those after it, which do not try again yet.
    for _ in 0..2 {
        let told = ctl.as_("Salma").run(&["robot", "list"]).ok().stderr;
        for words in ["warning: the certificate of Org1/Salma ends ", "could not be renewed"] {
            assert!(told.contains(words), "{words:?} is missing in {told}");
        }
    }
    crate::support::eventually("the node answers", || {
        let said = ctl.as_("Late").run(&["robot", "list"]);
        (said.code != 4).then(|| {
            said.refused(
                2,
                &["LGR-2002", "the certificate of Org1/Late has expired", "identity register Late --reissue"],
            )
        })
    });
}
