//! A full disk: nothing more is accepted, nothing acknowledged is lost, and with space it goes on.

use crate::support::network::{message, register_robots};
use crate::support::wait::PATIENCE;
use crate::support::wire;
use crate::support::{Fleet, Process, connect, eventually, until};
use ledger::Code;
use ledger::identity::Role;
use ledger_api::Call;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Size of the disk.
const DISK: &str = "size=96m";

/// A small disk in a mount namespace of its own, which ends with the process that holds it: nothing stays mounted.
struct SmallDisk {
    holder: Process,
    users: bool,
}

impl SmallDisk {
    /// Mounts a tmpfs over a directory, for processes that [`SmallDisk::enter`]. Needs root or user namespaces.
    fn over(directory: &Path, logs: &Path) -> Self {
        let mut reasons = Vec::new();
        for (flags, users) in [("-rm", true), ("-m", false)] {
            let name = format!("disk{flags}");
            let mut command = Command::new("unshare");
            command.args([
                flags,
                "sh",
                "-c",
                "mount -t tmpfs -o \"$1\" ledgerd-test \"$0\" && echo mounted && exec sleep 600",
            ]);
            command.arg(directory).arg(DISK);
            let mut holder = Process::start(&name, logs, command);
            let mounted = eventually("a disk is mounted or refused", || {
                let mounted = holder.stdout().contains("mounted");
                (mounted || !holder.is_running()).then_some(mounted)
            });
            if mounted {
                return Self { holder, users };
            }
            reasons.push(format!("unshare {flags}: {}", holder.stderr().trim()));
        }
        panic!(
            "this test needs a small disk: run it as root, or allow unprivileged user namespaces\n{}",
            reasons.join("\n")
        );
    }

    /// The command, on the small disk.
    fn enter(&self, command: &Command) -> Command {
        let mut entered = Command::new("nsenter");
        entered.arg("-t").arg(self.holder.id().to_string());
        if self.users {
            entered.args(["--preserve-credentials", "-U"]);
        }
        entered.args(["-m", "--"]).arg(command.get_program()).args(command.get_args());
        for (name, value) in command.get_envs() {
            match value {
                Some(value) => entered.env(name, value),
                None => entered.env_remove(name),
            };
        }
        entered
    }

    /// A path on the small disk, as seen from here.
    fn seen(&self, path: &Path) -> PathBuf {
        Path::new("/proc").join(self.holder.id().to_string()).join("root").join(path.strip_prefix("/").unwrap())
    }
}

/// Writes until nothing fits any more.
fn fill(path: &Path) {
    let mut file = File::create(path).unwrap();
    for size in [1 << 20, 4096, 1] {
        while file.write_all(&vec![0x55; size]).is_ok() {}
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_full_disk_refuses_and_loses_nothing_and_space_ends_it() {
    let fleet = Fleet::found(1);
    let (owner, salma) = (fleet.owner(), fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]));
    let place = &fleet.nodes[0];
    place.configure("[storage]\nsegment_mib = 4");
    // The founded directory moves onto the small disk, into the same place.
    let seed = fleet.path().join("seed");
    fs::rename(&place.data, &seed).unwrap();
    fs::create_dir(&place.data).unwrap();
    let disk = SmallDisk::over(&place.data, fleet.path());
    let mut copy = Command::new("cp");
    copy.arg("-a").arg(seed.join(".")).arg(&place.data).stdin(Stdio::null());
    assert!(disk.enter(&copy).status().unwrap().success());
    let start = || Process::start("small", fleet.path(), disk.enter(&place.command()));
    let mut node = start();
    let auditor = connect(&owner).await;
    register_robots(&auditor, "open").await;
    let client = connect(&salma).await;

    let ballast = disk.seen(&place.data).join("ballast");
    let mut acknowledged = Vec::new();
    let mut seq = 0;
    let rounds = 3;
    for round in 0..rounds {
        let channel = wire::channel(&salma, true).await;
        fill(&ballast);
        // Messages large enough to need the next segments, until the node says that it is full.
        let deadline = Instant::now() + PATIENCE;
        let refusal = loop {
            assert!(Instant::now() < deadline, "the node never says that its disk is full");
            seq += 1;
            let call = Call {
                chaincode: "abac".into(),
                function: "set".into(),
                args: message(0, seq, &vec![round; 200_000]),
                ttl: PATIENCE,
            };
            // Below the Rust client, which would wait for space.
            let transaction = client.prepare(call).unwrap();
            let answer = wire::submit(&channel, transaction.encoded().clone());
            // What is under way when the disk fills is neither lost nor refused, it waits for space: so others go on.
            if let Ok(answer) = tokio::time::timeout(Duration::from_secs(1), answer).await {
                let answer = answer.unwrap();
                match wire::code(&answer) {
                    0 => acknowledged.push((transaction.id(), answer.height, answer.index)),
                    _ => break answer.verdict.unwrap(),
                }
            }
        };
        assert_eq!(refusal.code, u32::from(Code::DiskFull.number()), "{refusal:?}");
        assert!(refusal.next.contains("free space"), "{refusal:?}");
        node.check();
        node.no_panic();
        seq += 1;
        let told = client.invoke("abac", "set", message(0, seq, &[])).await.unwrap_err();
        assert_eq!(told.code, Code::DiskFull, "{told}");
        // Reading goes on.
        client.query("abac", "robots", vec![]).await.unwrap();
        if round == 1 {
            // Killed while it is full: it does not lie, and comes back when there is space.
            node.kill();
            fs::remove_file(&ballast).unwrap();
            node = start();
        } else {
            fs::remove_file(&ballast).unwrap();
        }
        let committed = until("the node goes on", || {
            seq += 1;
            let call = message(0, seq, &[]);
            let client = &client;
            async move { client.invoke("abac", "set", call).await.ok() }
        })
        .await;
        acknowledged.push((committed.id, committed.height, committed.index));
        node.check();
        node.no_panic();
    }
    for (id, height, index) in &acknowledged {
        let record = auditor.transaction(*id).await.unwrap();
        assert_eq!((record.height, record.index), (*height, *index));
        assert_eq!(record.verdict.unwrap().code, 0);
    }
    let status = auditor.status().await.unwrap();
    node.signal(rustix::process::Signal::TERM);
    node.no_panic();
    // The state goes to the disk again too: nothing was said to the contrary after the last time that it was full.
    let log = node.stderr();
    let after = log.rsplit("there is space on the disk again").next().unwrap();
    assert!(!after.contains("cannot store"), "{after}");
    let mut node = start();
    let client = connect(&owner).await;
    let block = until("the block is there", || async { client.block(status.height).await.ok() }).await;
    assert_eq!(block.state_digest, status.state_digest);
    node.signal(rustix::process::Signal::TERM);
    println!("disk_full: {rounds} times full, {} transactions acknowledged", acknowledged.len());
}
