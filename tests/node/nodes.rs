//! How the nodes of a network are, asked through one of them.

use crate::support::network::{NodeWish, free_address, now};
use crate::support::{Fleet, connect, until};
use ledger_api::Context;
use ledger_api::v1::NodeStatus;
use ledger_identity::Role;

fn wish(name: &str, organisation: &str) -> NodeWish {
    NodeWish { name: name.into(), organisation: organisation.into(), voter: true, address: free_address() }
}

fn names(nodes: &[NodeStatus]) -> Vec<String> {
    nodes.iter().map(|node| format!("{}/{}", node.organisation, node.name)).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn each_node_tells_through_any_other_how_its_disk_and_certificate_are_and_one_that_is_gone_is_named() {
    let fleet = Fleet::found_with(&[wish("node1", "Org1"), wish("node2", "Org2"), wish("node3", "Org1")], now());
    let mut running: Vec<_> = fleet.nodes.iter().map(|place| place.start()).collect();
    let salma = fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]);
    let at = |node: usize| Context { nodes: vec![fleet.nodes[node].address.clone()], ..salma.clone() };
    let second = connect(&at(1)).await;
    let all = ["Org1/node1", "Org2/node2", "Org1/node3"];

    let told = until("all nodes answer", || async {
        let nodes = second.nodes().await.ok()?;
        nodes.iter().all(|node| node.status.is_some()).then_some(nodes)
    })
    .await;
    assert_eq!(names(&told), all);
    for (node, name) in told.iter().zip(all) {
        let status = node.status.as_ref().unwrap();
        assert_eq!(
            (status.node_id, format!("{}/{}", status.organisation, status.node_name)),
            (node.node_id, name.into())
        );
        assert!(status.disk_free_bytes > 0 && status.disk_total_bytes >= status.disk_free_bytes, "{name}");
        let own = status.certificates.iter().find(|certificate| certificate.kind == "node").unwrap();
        assert!(own.name == name && own.not_after > now(), "{own:?}");
    }

    // Each compares its clock with those of the other voters: here it is the same one.
    let peers = until("this node has heard the clocks of the others", || async {
        let peers = second.status().await.ok()?.peers;
        peers.iter().all(|peer| peer.clock_error_us > 0).then_some(peers)
    })
    .await;
    for peer in &peers {
        assert!(peer.clock_offset_us.unsigned_abs() <= peer.clock_error_us + 1_000, "{peer:?}");
    }

    // Whoever asks often does not make the node ask the others as often.
    let clock = |nodes: &[NodeStatus], at: usize| Some(nodes[at].status.as_ref()?.clock);
    until("of two questions the second does not make it ask the others again", || async {
        let (again, third) = (second.nodes().await.ok()?, second.nodes().await.ok()?);
        assert!(clock(&third, 1)? > clock(&again, 1)?, "this node answers anew");
        let of_others = |nodes: &[NodeStatus]| Some((clock(nodes, 0)?, clock(nodes, 2)?));
        (of_others(&third)? == of_others(&again)?).then_some(())
    })
    .await;

    running[2].kill();
    let told = until("the answer that is kept is too old", || async {
        let nodes = second.nodes().await.ok()?;
        let is_told = nodes[2].status.is_none() && nodes[..2].iter().all(|node| node.status.is_some());
        is_told.then_some(nodes)
    })
    .await;
    assert_eq!(names(&told), all);
    assert!(!told[2].unreachable.is_empty(), "{told:?}");
}
