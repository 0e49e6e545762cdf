//! A bridge whose shared memory ends.

use super::*;
use crate::{door::Door, mark::Mark};
use ledger_base::hash::Hash;

#[tokio::test]
async fn a_topic_whose_shared_memory_ends_is_read_over_dds_and_its_route_goes_on() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (topic, message) = names();
    let local = Local::open(DOMAIN, &Reach::default(), "ledgerd_bridge", true).await.unwrap();
    let mark = Mark::new(&Hash::ZERO, "T/cmd_vel");
    let door = Arc::new(Door::new(mark, "T/cmd_vel", Duration::from_secs(10), Arc::clone(local.delivered())));
    let (_unchanged, qos) = watch::channel(Qos::default());
    let (mut inlet, _, in_memory) = local.inlet(&topic, &message, qos, Limits::default(), door).await.unwrap();
    assert!(in_memory.is_some());
    inlet.break_down_shared_memory();
    let graph = Participant::open(DOMAIN, "beside").await.unwrap();
    let writer = graph.writer(&topic, &message, &Qos::default()).unwrap();
    let heard = async {
        let mut due = tokio::time::interval(Duration::from_millis(20));
        loop {
            // Both find each other one after the other.
            tokio::select! {
                _ = due.tick() => writer.write(&twist(4)).unwrap(),
                incoming = inlet.next() => break incoming.map(|incoming| incoming.sample),
            }
        }
    };
    assert_eq!(tokio::time::timeout(DEADLINE, heard).await.unwrap(), Some(twist(4)));
}
