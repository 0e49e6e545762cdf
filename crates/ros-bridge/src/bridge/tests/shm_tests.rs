//! A bridge whose shared memory ends.

use super::*;
use crate::graph::{choice::MiddlewareChoice, local::LocalGraph, loop_filter::LoopFilter, mark::Mark, reach::Reach};
use ledger_base::hash::Hash;
use tokio::sync::watch;

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_topic_whose_shared_memory_ends_is_read_over_dds_and_its_route_goes_on() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (topic, message) = names();
    let local =
        LocalGraph::join(DOMAIN, (&MiddlewareChoice::Dds, &Reach::default()), "ledgerd_bridge", true).await.unwrap();
    let mark = Mark::new(&Hash::ZERO, "T/cmd_vel");
    let filter = Arc::new(LoopFilter::new(mark, "T/cmd_vel", Duration::from_secs(10), Arc::clone(local.delivered())));
    let (_unchanged, qos) = watch::channel(Qos::default());
    let mut input = local.input(&topic, &message, qos, Limits::default(), filter).await.unwrap();
    assert!(input.in_memory().is_some());
    input.break_down_shared_memory();
    let graph = Beside::open("beside").await;
    let writer = graph.writer(&topic, &message, &Qos::default()).await.unwrap();
    let heard = async {
        let mut due = tokio::time::interval(Duration::from_millis(20));
        loop {
            // Both find each other one after the other.
            tokio::select! {
                _ = due.tick() => writer.write(&twist(4)).unwrap(),
                incoming = input.next() => break incoming.map(|incoming| incoming.sample),
            }
        }
    };
    assert_eq!(tokio::time::timeout(DEADLINE, heard).await.unwrap(), Some(twist(4)));
}
