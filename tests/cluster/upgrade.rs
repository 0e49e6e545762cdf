//! A rolling upgrade under load: nodes of an older program and of this one serve together, in every mixture on the way.
//!
//! The older program is the node of the last release, which `LEDGERD_OLD_BINARY` names. Without it nothing is tested, and the
//! test says so. It must speak the newest rules, or `./test` names the release that founds with its own.

use crate::audit::audit;
use crate::cluster::{Cluster, NODES};
use crate::load::Load;
use std::ffi::OsString;
use std::process::Command;

/// Names the older program.
const OLD: &str = "LEDGERD_OLD_BINARY";

/// The same command for the older program.
fn older(program: OsString) -> impl Fn(Command) -> Command + Send + Sync {
    move |command| {
        let mut older = Command::new(&program);
        older.args(command.get_args()).env_remove("RUST_LOG");
        older
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nodes_of_the_last_release_and_of_this_one_serve_together_while_they_are_upgraded_one_by_one() {
    let Some(program) = std::env::var_os(OLD) else {
        println!("skipped: {OLD} names no node of an older release");
        return;
    };
    let mut cluster = Cluster::found();
    (0..NODES).for_each(|node| cluster.surround(node, Box::new(older(program.clone()))));
    cluster.run("open").await;
    let load = Load::start(&cluster).await;
    load.more("with old nodes alone", 30, &mut cluster).await;
    for node in 0..NODES {
        cluster.kill(node);
        cluster.surround(node, Box::new(|command| command));
        cluster.start(node);
        load.more(&format!("with {} upgraded", node + 1), 60, &mut cluster).await;
        // Whoever leads, the others understand it.
        let (leader, _) = cluster.leader_among(&[0, 1, 2]).await;
        cluster.kill(leader);
        load.more("without the leader", 20, &mut cluster).await;
        cluster.start(leader);
    }
    let told = load.finish().await;
    audit(&mut cluster, &told).await;
    cluster.stop_and_verify();
    println!("{} acknowledged transactions, refused {:?}", told.acknowledged.len(), told.refused);
    assert!(!told.acknowledged.is_empty());
}
