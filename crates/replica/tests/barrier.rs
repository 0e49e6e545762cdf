//! A new leader orders only when it has executed everything that was there before it.

use crate::cluster::Cluster;
use ledger_raft::Lane;

#[test]
fn a_new_leader_orders_only_when_it_has_executed_what_was_there() {
    let mut cluster = Cluster::new(1, &[1], &[]);
    cluster.elect();
    // Nothing that is written is known to be committed, as far as the disk says.
    cluster.stall(1, true);
    cluster.submit(1, Lane::Data, "before");
    cluster.run_units(3);
    assert!(cluster.holds(1, "before") && !cluster.has_executed(1, "before"));

    // What was there is to be executed by a leader that leads already.
    cluster.crash(1);
    cluster.start(1);
    cluster.run(2);
    assert_eq!(cluster.status(1).role.leader, Some(1), "it leads");
    cluster.submit(1, Lane::Data, "after");
    cluster.run(10);
    assert!(!cluster.holds(1, "after"), "ordered before what was there was executed");
    cluster.stall(1, false);
    cluster.until("ordered as soon as it was", 1, |cluster| cluster.has_executed(1, "after"));
    assert_eq!(cluster.executed_by(1), ["before", "after"]);
}
