//! Three voters of two organisations, as docs/cluster.md founds them: any one of them may die, lose its disk, or have it damaged.

use crate::own_network::isolated;
use crate::support::ctl::Ctl;
use crate::support::eventually;
use crate::support::readme::{Terminal, console, next_commands};
use rustix::process::Signal;
use serde_json::Value;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// The three nodes of docs/cluster.md: the command that runs each, and a context that knows another one.
const NODES: [(&str, &str); 3] = [
    ("ledgerd run --config a/ledgerd.toml", "Org2-admin"),
    ("ledgerd run --config b/ledgerd.toml", "admin"),
    ("ledgerd run --config c/ledgerd.toml", "admin"),
];

/// Types the block of docs/cluster.md, and waits until all three vote.
fn three(directory: &TempDir) -> Terminal {
    let mut terminal = Terminal::at(directory.path());
    for line in console("docs/cluster.md", "## Three voters of two organisations") {
        terminal.type_line(&line);
    }
    until_three_vote(&terminal, "admin");
    terminal
}

/// The output of `network status` as a context, if it answers at all.
fn status(terminal: &Terminal, context: &str) -> Option<(i32, Value)> {
    let ran = Ctl::at(&terminal.home()).as_(context).run(&["network", "status", "--check", "-o", "json"]);
    serde_json::from_str(&ran.stdout).ok().map(|value| (ran.code, value))
}

fn until_three_vote(terminal: &Terminal, context: &str) {
    eventually("three voters answer, and one may fail", || {
        let (code, status) = status(terminal, context)?;
        let organisations = status["nodes"].as_array()?.iter().filter(|node| node["role"] == "voter");
        let organisations: std::collections::BTreeSet<_> =
            organisations.map(|node| node["organisation"].as_str()).collect();
        let well = status["voters"] == 3 && status["voters_reachable"] == 3 && status["failures_tolerated"] == 1;
        // One node holds each CA key. And the disk of this machine may be almost full.
        let attention = status["attention"].as_array()?;
        let well = well
            && code == i32::from(!attention.is_empty())
            && attention.iter().all(|item| item["check"] == "disk" || item["check"] == "ca");
        (well && organisations.len() == 2).then_some(())
    });
}

/// Something is ordered, through whoever this context knows.
fn order(terminal: &Terminal, context: &str, what: &str) {
    eventually("something is ordered", || {
        let ctl = Ctl::at(&terminal.home()).as_(context);
        let robot = serde_json::json!({"name": what, "attribute_required": what, "services": [{"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist", "mode": "open"}]}).to_string();
        let ran = ctl.run(&["invoke", "abac", "setup", &robot]);
        (ran.code == 0 || ran.stderr.contains("LGR-3011")).then_some(())
    });
}

#[test]
fn the_network_of_three_of_the_readme_survives_the_death_of_any_one() {
    if !isolated(&|| ()) {
        return;
    }
    let directory = TempDir::new().unwrap();
    let mut terminal = three(&directory);
    for (round, (command, context)) in NODES.into_iter().enumerate() {
        terminal.process(command).kill();
        order(&terminal, context, &format!("Robot{round}"));
        eventually("monitoring is told that a voter is missing, and that ordering goes on", || {
            let (code, status) = status(&terminal, context)?;
            let none = status["quorum"] == true && status["failures_tolerated"] == 0;
            let quorum = status["attention"].as_array()?.iter().find(|item| item["check"] == "quorum")?;
            // The third is the only one of its organisation.
            let wanted = ["2 of 3 voters are connected: if one more fails", "only voters of Org1 are connected"];
            let told = quorum["message"].as_str()?.starts_with(wanted[usize::from(round == 2)]);
            (code == 1 && none && told).then_some(())
        });
        terminal.start(command);
        until_three_vote(&terminal, context);
    }
    // With two dead nothing is ordered, and whoever asks is told so.
    terminal.process(NODES[1].0).kill();
    terminal.process(NODES[2].0).kill();
    let told = eventually("there is no quorum", || status(&terminal, "admin").filter(|(code, _)| *code == 4)).1;
    assert_eq!((&told["quorum"], &told["voters_reachable"]), (&false.into(), &1.into()));
    let own = eventually("the node itself says so", || {
        let ran = Ctl::at(&terminal.home()).as_("admin").run(&["status"]);
        (ran.code == 4 && ran.stdout.contains("attention: Org1/node1: 1 of 3 voters are connected; 2 are needed"))
            .then_some(ran.stdout)
    });
    for word in ["disk ", " free, in ", "Org1/node1 ends in", "(CA) ends in", "Org1/admin (yours) ends in"] {
        assert!(own.contains(word), "{word:?} is missing in {own}");
    }
}

#[test]
fn a_voter_that_lost_its_disk_comes_back_at_its_address_by_what_the_messages_say() {
    if !isolated(&|| ()) {
        return;
    }
    let directory = TempDir::new().unwrap();
    let mut terminal = three(&directory);
    let run = NODES[1].0;
    terminal.process(run).kill();
    // A new disk is mounted: an empty directory.
    fs::remove_dir_all(directory.path().join("b/data")).unwrap();
    fs::create_dir(directory.path().join("b/data")).unwrap();
    let told = failed(&terminal, run);
    for word in [
        "node Org1/node2",
        "an empty directory",
        "ledgerctl network invite --node node2",
        "ledgerd join TOKEN --config b/ledgerd.toml",
    ] {
        assert!(told.contains(word), "{word:?} is missing in {told}");
    }
    assert!(!told.contains("ledgerd init"), "{told}");
    let founding = failed(&terminal, "ledgerd init --organisation Org1 --config b/ledgerd.toml");
    assert!(founding.contains("belongs to a network that was founded before") || founding.contains("exists already"));

    terminal.type_line("ledgerctl network invite --node node2");
    let joined = terminal.type_line("ledgerd join TOKEN --config b/ledgerd.toml");
    assert!(joined.contains("node Org1/node2 has joined network \"Org1\" as node 4"), "{joined}");
    follow(&mut terminal, &joined);
    until_three_vote(&terminal, "admin");
    order(&terminal, "admin", "Robot");
}

#[test]
fn a_voter_whose_blocks_are_damaged_comes_back_with_the_same_data_by_what_the_messages_say() {
    if !isolated(&|| ()) {
        return;
    }
    let directory = TempDir::new().unwrap();
    let mut terminal = three(&directory);
    order(&terminal, "admin", "Before");
    // Org2 has this node only: its CA lies here, and nobody else could invite it.
    let run = NODES[2].0;
    assert!(terminal.process(run).signal(Signal::TERM).success());
    damage(&directory.path().join("c/data/blocks"));
    let told = failed(&terminal, run);
    for word in ["LGR-5002", "is damaged at byte", "ledgerd rejoin --config c/ledgerd.toml"] {
        assert!(told.contains(word), "{word:?} is missing in {told}");
    }
    assert!(!told.contains("init"), "{told}");

    let back = terminal.type_line("ledgerd rejoin --config c/ledgerd.toml");
    assert!(back.contains("node Org2/node1 is node 4"), "{back}");
    follow(&mut terminal, &back);
    until_three_vote(&terminal, "admin");
    order(&terminal, "Org2-admin", "After");
    let height = status(&terminal, "admin").unwrap().1["height"].as_u64().unwrap();
    let block = |context: &str, height: u64| {
        let ctl = Ctl::at(&terminal.home()).as_(context);
        eventually("both have the block", || {
            let ran = ctl.run(&["block", &height.to_string(), "-o", "json"]);
            (ran.code == 0).then(|| ran.json())
        })
    };
    for height in 1..=height {
        let (ours, theirs) = (block("admin", height), block("Org2-admin", height));
        assert_eq!(
            (&ours["hash"], &ours["state_digest"]),
            (&theirs["hash"], &theirs["state_digest"]),
            "block {height}"
        );
    }
    // The founder knows no other node by itself.
    assert!(terminal.process(NODES[0].0).signal(Signal::TERM).success());
    damage(&directory.path().join("a/data/blocks"));
    assert!(failed(&terminal, NODES[0].0).contains("ledgerd rejoin --config a/ledgerd.toml"));
    assert!(failed(&terminal, "ledgerd rejoin --config a/ledgerd.toml").contains("--node HOST:PORT"));
    let back = terminal.type_line("ledgerd rejoin --config a/ledgerd.toml --node 127.0.0.1:7451");
    assert!(back.contains("node Org1/node1 is node 5"), "{back}");
    follow(&mut terminal, &back);
    until_three_vote(&terminal, "Org2-admin");

    // The CA is where it was.
    terminal.type_line("ledgerctl --context Org2-admin identity register Farhad");
}

/// Types what was printed to be typed next.
fn follow(terminal: &mut Terminal, printed: &str) {
    let commands = next_commands(printed);
    assert_eq!(commands.len(), 2, "{printed}");
    for command in commands {
        match command.starts_with("ledgerd run ") {
            true => terminal.start(&command),
            // Who votes is decided by admins: one of the organisation whose node it is, and one of the other.
            false => {
                let (own, other) =
                    if command.contains("Org2/") { ("Org2-admin", "admin") } else { ("admin", "Org2-admin") };
                until_it_follows(terminal, other, command.rsplit(' ').next().unwrap());
                terminal.type_line(&command.replace("ledgerctl ", &format!("ledgerctl --context {own} ")));
                terminal.type_line(&format!("ledgerctl --context {other} network approve ID"));
            }
        }
    }
}

/// Waits until a node has what the others have: before, it knows neither the network as it is nor, perhaps, its own
/// organisation.
fn until_it_follows(terminal: &Terminal, context: &str, name: &str) {
    eventually("the node follows", || {
        let status = status(terminal, context)?.1;
        let is_meant = |node: &&Value| {
            name.split('/').eq([node["organisation"].as_str(), node["name"].as_str()].into_iter().flatten())
        };
        let node = status["nodes"].as_array()?.iter().rfind(is_meant)?;
        (node["reachable"] == true && node["height"].as_u64()? >= status["height"].as_u64()?).then_some(())
    });
}

/// Runs a command that must fail at once; the answer is its output.
fn failed(terminal: &Terminal, line: &str) -> String {
    let done = terminal.run(line);
    assert!(!done.status.success(), "{line} has succeeded");
    String::from_utf8(done.stderr).unwrap()
}

/// Changes a byte in the first records, which later ones prove to have been durable.
fn damage(blocks: &Path) {
    let names = fs::read_dir(blocks).unwrap().map(|entry| entry.unwrap().path());
    let segment = names.filter(|path| path.extension().is_some_and(|kind| kind == "seg")).min().unwrap();
    let mut bytes = fs::read(&segment).unwrap();
    bytes[300] ^= 0x40;
    fs::write(&segment, bytes).unwrap();
}
