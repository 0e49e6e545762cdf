//! One organisation with people, the owner of the robots, and one node.

use super::Printed;
use crate::support::{Ctl, Dev, Process, eventually};
use serde_json::Value;
use std::fs;
use std::path::Path;

impl Printed {
    /// A grant goes from one person to another one and back.
    fn passes_on(&mut self, (owner, salma, farhad): (&Ctl, &Ctl, &Ctl), service: &str) {
        owner.run(&["robot", "set", service, "delegable=true"]).ok();
        self.run(salma, "acquire", &[service]);
        self.run(salma, "delegate", &[service, "--to", "Org1/Farhad", "--for", "30s"]);
        self.run(salma, "recall", &[service]);
        self.run(salma, "handover", &[service, "--to", "Org1/Farhad"]);
        self.run(farhad, "release", &[service]);
    }

    /// Tasks of one person, which end in all ways.
    fn traverses(&mut self, salma: &Ctl, robot: &str) {
        let points = [robot, "--points", "1,0;1,-2.5"];
        let submitted = |told: &Value| told["task"]["id"].to_string();
        let first = submitted(&self.run(salma, "task submit", &points));
        self.run(salma, "task show", &[&first]);
        self.run(salma, "task progress", &[&first, "1"]);
        self.run(salma, "task list", &[]);
        self.run(salma, "task fail", &[&first, "--reason", "demo"]);
        let second = submitted(&self.run(salma, "task submit", &points));
        self.run(salma, "task cancel", &[&second]);
    }

    /// Sets of policies of an organisation with one admin.
    fn decides_about_sets(&mut self, owner: &Ctl, [night, day]: [&str; 2]) {
        self.run(owner, "policy apply", &[night, "-m", "demo"]);
        let version = self.run(owner, "policy apply", &[day, "-m", "demo"])["version"].as_u64().unwrap();
        self.run(owner, "policy rollback", &[&(version - 1).to_string(), "-m", "demo"]);
        self.run(owner, "policy approvals", &[]);
        let proposed = self.run(owner, "policy propose", &[day, "-m", "demo"]);
        self.run(owner, "policy withdraw", &[proposed["id"].as_str().unwrap()]);
    }

    /// A robot that is shared, and no longer.
    fn shares(&mut self, owner: &Ctl) {
        self.run(
            owner,
            "share",
            &["Husky", "--with", "Org1/Farhad", "--attr", "Turtlebot4", "--max-linear", "0.3", "--yes"],
        );
        self.run(owner, "share", &["Husky", "--with", "Org1", "--read-only", "--dry-run"]);
        self.run(owner, "share list", &[]);
        self.run(owner, "share show", &["share-Husky-Org1-Farhad-Turtlebot4"]);
        self.run(owner, "unshare", &["share-Husky-Org1-Farhad-Turtlebot4", "--yes"]);
        self.run(owner, "can --matrix", &[]);
        self.run(owner, "can --as", &["Org1/Salma"]);
    }

    /// A fleet as a file.
    fn reconciles(&mut self, owner: &Ctl, files: &Path) {
        self.run(owner, "export", &[]);
        let path = files.join("fleet.toml");
        let file = path.to_str().unwrap();
        let robot =
            "[robot.Leo]\nattr-required = 'Leo'\n[robot.Leo.service.'/cmd_vel']\ntype = 'geometry_msgs/msg/Twist'\n";
        let share = "[[share]]\nresource = 'Husky'\nwith = 'Org1'\nattr = 'Turtlebot4'\n";
        fs::write(&path, format!("{robot}{share}[robot.Husky.attributes]\nkind = 'rover'\n")).unwrap();
        self.run(owner, "diff", &[file]);
        self.run(owner, "apply", &[file, "--yes"]);
        owner.run(&["unshare", "Husky", "--with", "Org1", "--yes"]).ok();
        owner.run(&["robot", "remove", "Leo"]).ok();
    }

    /// Sets of policies to which another organisation must agree.
    fn agrees_about_sets(&mut self, (owner, other): (&Ctl, &Ctl), [night, day]: [&str; 2]) {
        owner.run(&["policy", "apply", day, "--approvals", "organisations = 2"]).ok();
        let proposed = self.run(owner, "policy propose", &[night, "-m", "again"]);
        let id = proposed["id"].as_str().unwrap();
        self.run(other, "policy approve", &[id]);
        self.run(owner, "policy apply --proposal", &[id]);
    }

    /// A service that is acquired when somebody else agrees.
    fn confirms(&mut self, (owner, salma): (&Ctl, &Ctl), service: &str) {
        owner.run(&["robot", "set", service, "delegable=false", "confirm=1"]).ok();
        self.run(salma, "acquire", &[service]);
        self.run(owner, "confirm", &[service, "Org1/Salma"]);
        salma.run(&["release", service]).ok();
    }

    /// The commands as a file, and again in a ROS domain; policies for the secured domain of its robot.
    fn records(&mut self, (owner, salma): (&Ctl, &Ctl), robot: &str, files: &Path) {
        let path = |name: &str| files.join(name).to_string_lossy().into_owned();
        let (recording, bridge, enclaves) = (path("run.mcap"), path("bridge.toml"), path("sros2"));
        self.run(salma, "record", &[robot, "--since", "0", "--to", &recording]);
        self.run(salma, "replay", &[&recording, "--domain", "7", "--rate", "1000"]);
        let route =
            format!("[[route]]\ndirection = \"from_ledger\"\nservice = \"{robot}/cmd_vel\"\ntopic = \"/cmd_vel\"\n");
        fs::write(&bridge, format!("domain_id = 3\n{route}type = \"geometry_msgs/msg/Twist\"\n")).unwrap();
        let export = ["--config", &bridge, "--enclave", "/base", "--to", &enclaves];
        self.run(owner, "bridge export-sros2", &export);
    }

    /// A newcomer, contexts, a browser, invitations, a proposal and a copy of the CA.
    fn enrols_and_governs(&mut self, (admin, alone): (&Ctl, &Ctl), [copy, passphrase]: [&str; 2]) {
        let invited = self.run(admin, "identity register", &["Nadia", "--attr", "Husky"]);
        let field = |name: &str| invited[name].as_str().unwrap().to_owned();
        let (node, ca, secret) = (field("node"), field("ca_fingerprint"), field("secret"));
        self.run(alone, "enroll", &["Nadia", "--node", &node, "--ca-fingerprint", &ca, "--secret", &secret]);
        self.run(alone, "context use", &["Nadia"]);
        self.run(alone, "context delete", &["Nadia"]);
        self.run(admin, "console", &["Tablet", "--role", "member", "--attr", "Husky"]);
        self.run(admin, "identity registrar", &["Farhad", "--affiliation", "sales", "--attr", "Husky"]);
        self.run(admin, "network invite --node", &["node2"]);
        self.run(admin, "network invite --list", &[]);
        self.run(admin, "network invite --cancel", &["node2"]);
        let proposed = self.run(admin, "network propose", &["msp", "remove_organisation", r#"{"name":"Org2"}"#]);
        self.run(admin, "network withdraw", &[proposed["proposal"]["id"].as_str().unwrap()]);
        self.run(admin, "ca backup", &[copy, "--passphrase-file", passphrase]);
    }
}

/// Plays the story.
pub(super) fn play(it: &mut Printed) {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4", "Husky"], "ed25519");
    let farhad = dev.user("Farhad", &["Turtlebot4"], "ed25519");
    let (admin, owner) = (dev.admin(), dev.owner());
    let files = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = files.path().join(name);
        fs::write(&path, text).unwrap();
        path.to_string_lossy().into_owned()
    };
    for name in ["whoami", "context list", "context show", "context refresh", "status", "doctor"] {
        it.run(&salma, name, &[]);
    }
    it.run(&salma, "explain", &["HELD"]);
    it.run(&salma, "context set", &["Salma", "renew=auto"]);
    let invited = it.run(&admin, "identity register", &["Guest", "--attr", "Husky"]);
    for (name, rest) in [
        ("identity list", &[][..]),
        ("identity show", &["Salma"]),
        ("identity cancel", &["Guest"]),
        ("ca status", &[]),
        ("network status", &[]),
        ("network nodes", &[]),
        ("network organisations", &[]),
        ("network proposals", &[]),
        ("network quorums", &[]),
        ("network certificates", &[]),
        ("network rules", &[]),
    ] {
        it.run(&admin, name, rest);
    }
    assert!(invited["secret"].is_string(), "{invited}");
    let spec = [
        "Spot",
        "--attr-required",
        "Husky",
        "--trust",
        "Org1",
        "--service",
        "/cmd_vel=geometry_msgs/msg/Twist,on-conflict=queue",
    ];
    it.run(&owner, "robot add", &spec);
    it.run(&owner, "robot set", &["Spot/cmd_vel", "lease=30s"]);
    it.run(&owner, "robot list", &[]);
    let service = "Turtlebot4/cmd_vel";
    it.run(&salma, "acquire", &[service, "--for", "30s"]);
    it.run(&salma, "renew", &[service]);
    it.run(&salma, "publish", &[service, "{linear: {x: 0.1}}"]);
    it.run(&salma, "echo", &[service, "--from", "1", "--count", "1"]);
    for name in ["hz", "bw"] {
        let every = [name, service, "--every", "100ms", "-o", "json"];
        let mut measured = Process::start(name, dev.home.path(), salma.command(&every));
        let lines = |measured: &Process| -> Vec<Value> {
            let text = measured.stdout();
            text.split_inclusive('\n').filter_map(|line| serde_json::from_str(line).ok()).collect()
        };
        eventually("figures of two messages are printed", || {
            measured.check();
            salma.publish(&[service, "{linear: {x: 0.1}}"]).ok();
            lines(&measured).last().filter(|line| line["messages"].as_u64() > Some(1)).map(|_| ())
        });
        measured.interrupt();
        lines(&measured).iter().for_each(|line| it.note(name, line));
    }
    it.run(&owner, "history", &[service, "--since", "10m"]);
    it.run(&salma, "robot show", &["Turtlebot4"]);
    it.run(&salma, "queue", &[service]);
    it.run(&salma, "readers", &[service]);
    it.run(&salma, "release", &[service]);
    it.run(&owner, "take", &[service, "--reason", "demo"]);
    let stopped = it.run(&owner, "stop", &["Turtlebot4", "--reason", "demo"]);
    it.run(&owner, "resume", &["Turtlebot4"]);
    it.run(&owner, "robot remove", &["OptiTrack"]);
    let transaction = stopped["transaction"].as_str().unwrap().to_owned();
    it.run(&owner, "tx", &[&transaction]);
    it.run(&owner, "block", &[&stopped["height"].to_string()]);
    it.run(&owner, "audit", &[]);
    farhad.run(&["acquire", "Husky/cmd_vel"]).refused(2, &[]);
    it.run(&owner, "denials", &[]);
    it.run(&owner, "can", &["Org1/Farhad", "acquire", "Husky/cmd_vel"]);
    it.shares(&owner);
    it.reconciles(&owner, files.path());
    let night = file("night.cedar", "permit(principal, action, resource);");
    it.run(&owner, "policy check", &[&night]);
    it.run(&owner, "policy put", &["night", &format!("@{night}")]);
    it.run(&owner, "policy list", &[]);
    it.run(&owner, "policy show", &["night"]);
    it.run(&owner, "policy diff", &[&night]);
    it.run(&owner, "policy shadow", &[&night]);
    it.run(&owner, "policy history", &[]);
    it.run(&owner, "policy remove", &["night"]);
    it.run(&owner, "policy proposals", &[]);
    it.run(&salma, "invoke", &["abac", "acquire", service]);
    it.run(&salma, "query", &["abac", "robot", "Husky"]);
    it.run(&salma, "release", &[service]);
    it.passes_on((&owner, &salma, &farhad), service);
    it.traverses(&salma, "Turtlebot4");
    it.confirms((&owner, &salma), service);
    it.records((&owner, &salma), "Turtlebot4", files.path());
    it.run(&admin, "identity renew", &[]);
    let day = file("day.cedar", "@description(\"by day\") permit(principal, action, resource);");
    it.decides_about_sets(&owner, [&night, &day]);
    it.agrees_about_sets((&owner, &admin), [&night, &day]);
    let cases =
        "[[case]]\nwho = \"Org2/Admin\"\naction = \"acquire\"\nservice = \"Husky/cmd_vel\"\nexpect = \"allow\"\n";
    it.run(&owner, "policy test", &[&file("cases.toml", cases)]);
    let copy = files.path().join("ca.pem").to_string_lossy().into_owned();
    it.enrols_and_governs((&admin, &dev.ctl()), [&copy, &file("passphrase", "correct horse battery\n")]);
    let [evidence, genesis] = ["stop.evidence", "genesis.json"].map(|name| files.path().join(name));
    let [evidence, genesis] = [&evidence, &genesis].map(|path| path.to_string_lossy());
    it.run(&owner, "prove", &[&transaction, "--file", &evidence, "--genesis", &genesis]);
    owner.run(&["stop", "Turtlebot4", "--reason", "demo"]).ok();
    it.run(&owner, "light", &["Turtlebot4"]);
    owner.run(&["resume", "Turtlebot4"]).ok();
    let data = dev.data().to_string_lossy().into_owned();
    it.run(&owner, "ledger archive", &[&data, "--to", &files.path().join("archive").to_string_lossy()]);
    it.run(&admin, "identity revoke", &["Farhad"]);
    let mut watch = Process::start("watch", dev.home.path(), dev.owner().command(&["watch", "-o", "json"]));
    let line = eventually("watch prints a row", || {
        dev.owner().run(&["stop", "Husky"]).ok();
        dev.owner().run(&["resume", "Husky"]).ok();
        watch.stdout().split_once('\n').map(|(line, _)| line.to_owned())
    });
    watch.interrupt();
    it.note("watch", &serde_json::from_str(&line).unwrap());
}
