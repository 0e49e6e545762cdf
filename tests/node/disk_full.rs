//! A full disk: nothing more is accepted, nothing acknowledged is lost, and with space it goes on.

use crate::support::network::{message, register_robots};
use crate::support::small_disk::{SmallDisk, fill};
use crate::support::wait::PATIENCE;
use crate::support::wire;
use crate::support::{Fleet, Process, connect, until};
use ledger_api::Call;
use ledger_base::rejection::Code;
use ledger_identity::Role;
use std::fs;
use std::time::{Duration, Instant};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_full_disk_refuses_and_loses_nothing_and_space_ends_it() {
    let fleet = Fleet::found(1);
    let (owner, salma) = (fleet.owner(), fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]));
    let place = &fleet.nodes[0];
    place.configure("[storage]\nsegment_mib = 4");
    let disk = SmallDisk::under(place, fleet.path());
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
                    // The share of the organisation: a disk that is almost full takes less a second.
                    code if code == u32::from(Code::Overloaded.number()) => {
                        tokio::time::sleep(Duration::from_millis(100)).await;
                    }
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
    let after = log.rsplit("disk space available again").next().unwrap();
    assert!(!after.contains("cannot store"), "{after}");
    let mut node = start();
    let client = connect(&owner).await;
    let block = until("the block is there", || async { client.block(status.height).await.ok() }).await;
    assert_eq!(block.state_digest, status.state_digest);
    node.signal(rustix::process::Signal::TERM);
    println!("disk_full: {rounds} times full, {} transactions acknowledged", acknowledged.len());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_that_was_killed_without_any_space_left_starts_again_on_that_disk() {
    let fleet = Fleet::found(1);
    let (owner, place) = (fleet.owner(), &fleet.nodes[0]);
    place.configure("[storage]\nsegment_mib = 4");
    let disk = SmallDisk::under(place, fleet.path());
    let start = || Process::start("small", fleet.path(), disk.enter(&place.command()));
    let mut node = start();
    let client = connect(&owner).await;
    register_robots(&client, "open").await;
    let height = client.status().await.unwrap().height;
    let ballast = |name: &str| fill(&disk.seen(&place.data).join(name));
    ballast("ballast");
    node.kill();
    // What the node had prepared for its next blocks may be free now.
    ballast("more");
    let mut node = start();
    let client = connect(&owner).await;
    let status = client.status().await.unwrap();
    assert!(status.disk_accepts != "all", "{status:?}");
    // It has executed what it knew to be committed; it commits the rest when it leads.
    until("the node has what it had", || async {
        let status = client.status().await.ok()?;
        (status.height >= height).then_some(())
    })
    .await;
    node.check();
    node.interrupt();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_holds_a_robot_releases_it_and_is_revoked_while_messages_find_no_room() {
    let fleet = Fleet::found(1);
    let (owner, admin) = (fleet.owner(), fleet.issue("Org1", "Boss", Role::Admin, &[]));
    let salma = fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4", "Husky"]);
    let place = &fleet.nodes[0];
    place.configure("[storage]\nsegment_mib = 4");
    let disk = SmallDisk::under(place, fleet.path());
    let mut node = Process::start("small", fleet.path(), disk.enter(&place.command()));
    let auditor = connect(&owner).await;
    register_robots(&auditor, "exclusive").await;
    let (client, boss) = (connect(&salma).await, connect(&admin).await);
    let acquire = |robot: &'static str| vec![robot.into(), "600000".into()];
    client.invoke("abac", "acquire", acquire("Turtlebot4")).await.unwrap();
    client.invoke("abac", "acquire", acquire("Husky")).await.unwrap();

    // A message is under way that is larger than what is zeroed ahead of the log, and the disk is full to the last byte:
    // what ends control must not wait behind it.
    let ballast = disk.seen(&place.data).join("ballast");
    fill(&ballast);
    let channel = wire::channel(&salma, true).await;
    let mut seq = 0;
    let refusal = until("messages are refused", || {
        seq += 1;
        let args = message(1, seq, &vec![7; 900_000]);
        let call = Call { chaincode: "abac".into(), function: "set".into(), args, ttl: PATIENCE };
        let (channel, transaction) = (channel.clone(), client.prepare(call).unwrap());
        let answer = tokio::spawn(async move { wire::submit(&channel, transaction.encoded().clone()).await.unwrap() });
        // What is under way waits for space: so others go on.
        async {
            let answer = tokio::time::timeout(Duration::from_secs(1), answer).await.ok()?.unwrap();
            (![0, u32::from(Code::Overloaded.number())].contains(&wire::code(&answer))).then_some(answer)
        }
    })
    .await;
    assert_eq!(wire::code(&refusal), u32::from(Code::DiskFull.number()), "{refusal:?}");
    let status = auditor.status().await.unwrap();
    assert_eq!((status.disk_accepts.as_str(), status.data_directory), ("ends", place.data.display().to_string()));
    // Nothing, or what the reserve gave up a moment ago: 16 MiB.
    assert!(status.disk_free_bytes <= 16 << 20, "{} free", status.disk_free_bytes);

    client.invoke("abac", "release", vec!["Turtlebot4".into()]).await.unwrap();
    let held = || async {
        let answer = auditor.query("abac", "grants", vec![]).await.unwrap().response;
        String::from_utf8(answer.to_vec()).unwrap()
    };
    assert!(!held().await.contains("Turtlebot4") && held().await.contains("Husky"), "{}", held().await);
    let refused = client.invoke("abac", "acquire", acquire("Turtlebot4")).await.unwrap_err();
    assert_eq!(refused.code, Code::DiskFull, "{refused}");
    let certificate = ledger_identity::certificate::Certificate::parse(&salma.chain[0]).unwrap();
    let issuer = hex::encode(certificate.issuer_name.hash().0);
    let revoked = vec![issuer.into(), hex::encode(&certificate.serial).into()];
    boss.invoke("msp", "revoke", revoked).await.unwrap();
    assert!(!held().await.contains("Husky"), "{}", held().await);

    fs::remove_file(&ballast).unwrap();
    until("everything is accepted again", || async {
        (auditor.status().await.unwrap().disk_accepts == "all").then_some(())
    })
    .await;
    // Nobody writes now, so the reserve stays, and the disk stays full.
    fill(&ballast);
    let warned = "less than a tenth of the disk is free";
    let path = format!("path={}", place.data.display());
    until("the node warns with path and numbers", || async {
        let log = node.stderr();
        log.lines().any(|line| line.contains(warned) && line.contains(&path) && line.contains("MiB")).then_some(())
    })
    .await;
    node.check();
    node.no_panic();
}
