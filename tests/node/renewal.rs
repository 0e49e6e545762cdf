//! Certificates of nodes renew while the network works: it lives on past the end of its first certificates.

use crate::support::network::NodeWish;
use crate::support::programs::{run_ledgerd, said};
use crate::support::{Fleet, connect, network, until, wire};
use ledger_api::{Client, Context};
use ledger_identity::Role;
use ledger_identity::certificate::Certificate;
use rustix::process::Signal;
use std::path::Path;

/// Microseconds.
const SECOND: u64 = 1_000_000;
const YEAR: u64 = 365 * 24 * 3600 * SECOND;

fn wish(name: &str, voter: bool) -> NodeWish {
    NodeWish { name: name.into(), organisation: "Org1".into(), voter, address: network::free_address() }
}

/// The end of a node's certificate, as it lies on the disk.
fn end(data: &Path) -> u64 {
    let pem = pem::parse(std::fs::read(data.join("node.pem")).unwrap()).unwrap();
    Certificate::parse(pem.contents()).unwrap().not_after
}

fn at(context: &Context, fleet: &Fleet, node: usize) -> Context {
    Context { nodes: vec![fleet.nodes[node].address.clone()], ..context.clone() }
}

async fn works(one: &Client, other: &Client) {
    let height = network::some_block(one).await;
    until("the other node follows", || async { (other.status().await.unwrap().height >= height).then_some(()) }).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_network_lives_on_past_the_end_of_its_first_certificates() {
    // Founded nearly a year ago: the certificates of the nodes, good for 365 days, end in less than a minute.
    let founded = network::now() - YEAR + 40 * SECOND;
    let fleet = Fleet::found_with(&[wish("node1", true), wish("node2", false)], founded);
    let admin = fleet.issue("Org1", "Admin", Role::Admin, &[]);
    let first_end = end(&fleet.nodes[0].data).max(end(&fleet.nodes[1].data));
    assert!(first_end < network::now() + 60 * SECOND);
    let mut nodes = [fleet.nodes[0].start(), fleet.nodes[1].start()];
    let (one, two) = (connect(&at(&admin, &fleet, 0)).await, connect(&at(&admin, &fleet, 1)).await);
    works(&one, &two).await;
    // Node 1 carries the CA; node 2 asks it.
    for place in &fleet.nodes {
        until("the node renews", || async { (end(&place.data) > network::now() + YEAR / 2).then_some(()) }).await;
    }
    until("the first certificates end", || async { (network::now() > first_end).then_some(()) }).await;
    works(&one, &two).await;
    // New connections see the new certificates, between nodes too, and a restart finds key and certificate together.
    let (fresh, other) = (connect(&at(&admin, &fleet, 0)).await, connect(&at(&admin, &fleet, 1)).await);
    works(&other, &fresh).await;
    nodes[1].interrupt();
    nodes[1] = fleet.nodes[1].start();
    works(&fresh, &connect(&at(&admin, &fleet, 1)).await).await;
    for node in &mut nodes {
        node.check();
        node.interrupt();
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_whose_certificate_ran_out_comes_back_by_its_own_ca_or_says_how() {
    let fleet = Fleet::found_with(&[wish("node1", true), wish("node2", false)], network::now() - YEAR - SECOND);
    let admin = fleet.issue("Org1", "Admin", Role::Admin, &[]);
    let mut stranded = fleet.nodes[1].start();
    assert!(!stranded.wait().success());
    let told = stranded.stderr();
    for word in ["expired while", "ledgerctl network invite --node node2", "ledgerd join TOKEN"] {
        assert!(told.contains(word), "{word:?} is missing in {told}");
    }
    let _node = fleet.nodes[0].start();
    network::some_block(&connect(&at(&admin, &fleet, 0)).await).await;
    assert!(end(&fleet.nodes[0].data) > network::now() + YEAR / 2);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_renews_soon_after_its_machine_wakes_also_if_its_certificate_has_ended() {
    const HOUR: u64 = 3600 * SECOND;
    // The first certificate ends in 13 hours, and is replaced at once by one of a day.
    let fleet = Fleet::found_with(&[wish("node1", true)], network::now() - YEAR + 13 * HOUR);
    fleet.nodes[0].configure("[ca]\ncertificate_days = 1");
    let suspended = fleet.path().join("suspended");
    let mut command = fleet.nodes[0].command();
    command.env("LEDGERD_TEST_SUSPENDED", &suspended);
    let mut node = fleet.nodes[0].start_as(command);
    let data = &fleet.nodes[0].data;
    let ends_after = async |hours: u64| {
        until("the node renews", || async { (end(data) > network::now() + hours * HOUR).then_some(()) }).await;
    };
    ends_after(20).await;
    assert!(end(data) < network::now() + 25 * HOUR);
    for (sleeps, hours) in [(17, 40), (60, 80)] {
        std::fs::write(&suspended, (sleeps * HOUR / 1000).to_string()).unwrap();
        ends_after(hours).await;
    }
    until("renewed by the CA key of this node", || async {
        node.stderr().contains("renewed by the CA key of this node").then_some(())
    })
    .await;
    node.check();
    node.interrupt();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_valid_certificate_of_a_node_that_runs_is_replaced_by_a_command_and_shown_after_a_reload() {
    let fleet = Fleet::found_with(&[wish("node1", true), wish("node2", false)], network::now() - 3600 * SECOND);
    let admin = fleet.issue("Org1", "Admin", Role::Admin, &[]);
    let nodes = [fleet.nodes[0].start(), fleet.nodes[1].start()];
    works(&connect(&at(&admin, &fleet, 0)).await, &connect(&at(&admin, &fleet, 1)).await).await;
    // The first one holds the CA key, the other one does not.
    for (place, node) in fleet.nodes.iter().zip(&nodes) {
        let of = Context { nodes: vec![place.address.clone()], ..admin.clone() };
        let (first, first_key) = (shown(&of).await, std::fs::read(place.data.join("node.key")).unwrap());
        let renewed = said(&run_ledgerd(&["renew"], &place.config));
        assert!(renewed.contains(&format!("node Org1/{} has a new key and certificate", place.name)), "{renewed}");
        assert_ne!(std::fs::read(place.data.join("node.key")).unwrap(), first_key);
        node.send(Signal::HUP);
        until("the node shows it", || async { (shown(&of).await != first).then_some(()) }).await;
    }
    works(&connect(&at(&admin, &fleet, 1)).await, &connect(&at(&admin, &fleet, 0)).await).await;
}

/// The certificate that a node shows on a new connection.
async fn shown(context: &Context) -> Vec<u8> {
    let stream = wire::tls(context, true).await.unwrap();
    stream.get_ref().1.peer_certificates().unwrap()[0].to_vec()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn sighup_takes_over_the_level_of_the_log_and_a_certificate_put_there_by_hand_and_none_of_somebody_else() {
    let fleet = Fleet::found_with(&[wish("node1", true)], network::now() - SECOND);
    let (mut node, admin) = (fleet.nodes[0].start(), fleet.issue("Org1", "Admin", Role::Admin, &[]));
    let client = connect(&admin).await;
    let first = shown(&admin).await;
    let data = &fleet.nodes[0].data;
    let put = |paper: &Context| {
        let chain: String =
            paper.chain.iter().map(|der| pem::encode(&pem::Pem::new("CERTIFICATE", der.to_vec()))).collect();
        std::fs::write(data.join("node.pem"), chain).unwrap();
        std::fs::write(data.join("node.key"), paper.key.to_pkcs8_pem().as_bytes()).unwrap();
    };
    put(&fleet.issue("Org1", "node2", Role::Node, &[]));
    node.send(Signal::HUP);
    until("the node refuses the papers of another one", || async {
        node.stderr().contains("is of another identity").then_some(())
    })
    .await;
    assert_eq!(shown(&admin).await, first);

    // With the level of errors nothing is told of it; with the level of before it is.
    let told = || node.stderr().contains("using the new node certificate from the data directory");
    fleet.nodes[0].configure("[log]\nlevel = \"error\"");
    put(&fleet.issue("Org1", "node1", Role::Node, &[]));
    node.send(Signal::HUP);
    until("the node shows its other certificate", || async { (shown(&admin).await != first).then_some(()) }).await;
    let lies_there = pem::parse(std::fs::read(data.join("node.pem")).unwrap()).unwrap();
    assert_eq!(shown(&admin).await, lies_there.contents());
    network::some_block(&client).await;
    assert!(!told(), "{}", node.stderr());
    let config = std::fs::read_to_string(&fleet.nodes[0].config).unwrap();
    std::fs::write(&fleet.nodes[0].config, config.replace("level = \"error\"", "level = \"info\"")).unwrap();
    put(&fleet.issue("Org1", "node1", Role::Node, &[]));
    node.send(Signal::HUP);
    until("the log tells it", || async { told().then_some(()) }).await;
    connect(&admin).await;
    node.interrupt();
}
