//! Which nodes a client knows, and which of them it uses.

use crate::authority::Authority;
use crate::fake::{Fake, until};
use ledger_api::{Client, Context, Options};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use std::fs;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::time::timeout;

/// More than anything here takes.
const PATIENCE: Duration = Duration::from_secs(60);

/// A context on the disk, as every command loads it.
fn stored(context: &Context) -> TempDir {
    let home = TempDir::new().unwrap();
    context.save(home.path()).unwrap();
    home
}

fn load(home: &TempDir) -> Context {
    Context::load(home.path(), None).unwrap()
}

fn tells(node: &Fake, addresses: &[&Fake]) {
    *node.node.addresses.lock().unwrap() = addresses.iter().map(|node| node.address()).collect();
}

#[tokio::test]
async fn a_node_that_says_nothing_does_not_cost_its_patience() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    // It takes connections, as the kernel does for a process that was stopped, and says nothing.
    let silent = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let nodes = vec![silent.local_addr().unwrap().to_string(), node.address()];
    let options = Options { connect: 100 * PATIENCE, ..Options::default() };
    let credentials = authority.context(&[&node]).credentials().unwrap();
    let client = timeout(PATIENCE, Client::connect_with(nodes, credentials, options)).await.unwrap().unwrap();
    assert_eq!(*client.node(), *node.address());
}

#[tokio::test]
async fn a_node_that_is_cut_off_is_used_only_if_all_are() {
    let authority = Arc::new(Authority::new());
    let (cut, whole) = (Fake::start(&authority).await, Fake::start(&authority).await);
    cut.node.cut_off.store(true, Ordering::SeqCst);
    let context = authority.context(&[&cut, &whole]);
    assert_eq!(*Client::connect(&context).await.unwrap().node(), *whole.address());
    whole.node.cut_off.store(true, Ordering::SeqCst);
    assert_eq!(*Client::connect(&context).await.unwrap().node(), *cut.address());
    let alone = authority.context(&[&cut]);
    assert_eq!(*Client::connect(&alone).await.unwrap().node(), *cut.address());
}

#[tokio::test]
async fn a_client_leaves_a_node_that_is_cut_off_while_it_is_connected() {
    let authority = Arc::new(Authority::new());
    let (first, second) = (Fake::start(&authority).await, Fake::start(&authority).await);
    let client = Client::connect(&authority.context(&[&first, &second])).await.unwrap();
    assert_eq!(*client.node(), *first.address());
    first.node.cut_off.store(true, Ordering::SeqCst);
    until("the client has found the other one", || *client.node() == *second.address()).await;
    client.invoke("abac", "acquire", Vec::new()).await.unwrap();
}

#[tokio::test]
async fn a_client_learns_the_nodes_and_goes_on_through_them_also_next_time() {
    let authority = Arc::new(Authority::new());
    let (first, second) = (Fake::start(&authority).await, Fake::start(&authority).await);
    tells(&first, &[&first, &second]);
    tells(&second, &[&first, &second]);
    let home = stored(&authority.context(&[&first]));
    let client = Client::connect(&load(&home)).await.unwrap();
    client.invoke("abac", "acquire", Vec::new()).await.unwrap();
    let known = load(&home);
    assert_eq!(known.addresses(), [first.address(), second.address()]);
    assert_eq!(known.last_node(), Some(first.address().as_str()));
    first.stop().await;
    client.invoke("abac", "acquire", Vec::new()).await.unwrap();
    let again = Client::connect(&load(&home)).await.unwrap();
    assert_eq!(*again.node(), *second.address());
    until("the one that served is first", || load(&home).addresses()[0] == second.address()).await;
}

#[tokio::test]
async fn those_that_the_network_tells_come_before_those_that_it_does_not_tell_any_more() {
    let authority = Arc::new(Authority::new());
    let (first, second) = (Fake::start(&authority).await, Fake::start(&authority).await);
    tells(&first, &[&second]);
    let home = stored(&authority.context_of(vec![first.address(), "gone.example:7450".into()]));
    Client::connect(&load(&home)).await.unwrap();
    let known = load(&home).addresses();
    assert_eq!(known, [first.address(), second.address(), "gone.example:7450".to_owned()]);
}

#[tokio::test]
async fn a_context_that_cannot_be_written_is_used_all_the_same() {
    let authority = Arc::new(Authority::new());
    let (first, second) = (Fake::start(&authority).await, Fake::start(&authority).await);
    tells(&first, &[&first, &second]);
    let home = stored(&authority.context(&[&first]));
    let directory = home.path().join("contexts/Salma");
    // Root may write everywhere; but nobody writes a file where a directory is.
    fs::create_dir(directory.join("nodes.json.new")).unwrap();
    let client = Client::connect(&load(&home)).await.unwrap();
    client.invoke("abac", "acquire", Vec::new()).await.unwrap();
    first.stop().await;
    client.invoke("abac", "acquire", Vec::new()).await.unwrap();
    assert!(!directory.join("nodes.json").exists());
    assert_eq!(load(&home).note().err(), None, "nothing was learnt, so nothing is written");
}

#[tokio::test]
async fn what_was_learnt_is_a_memory_and_damage_to_it_costs_nothing() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let home = stored(&authority.context(&[&node]));
    let file = home.path().join("contexts/Salma/nodes.json");
    for damage in ["", "{", "[]", "{\"nodes\": 7}"] {
        fs::write(&file, damage).unwrap();
        Client::connect(&load(&home)).await.unwrap();
        assert_eq!(load(&home).last_node(), Some(node.address().as_str()), "{damage:?}");
    }
}

#[tokio::test]
async fn a_context_that_was_removed_meanwhile_does_not_come_back() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let home = stored(&authority.context(&[&node]));
    let context = load(&home);
    Context::remove(home.path(), "Salma").unwrap();
    Client::connect(&context).await.unwrap();
    assert!(!home.path().join("contexts/Salma").exists());
}

#[tokio::test]
async fn addresses_that_are_none_are_not_remembered() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let long = format!("{}:7450", "a".repeat(5000));
    *node.node.addresses.lock().unwrap() = vec!["nowhere".into(), long, String::new(), "ok.example:7450".into()];
    let home = stored(&authority.context(&[&node]));
    Client::connect(&load(&home)).await.unwrap();
    assert_eq!(load(&home).addresses(), [node.address(), "ok.example:7450".to_owned()]);
}

#[tokio::test]
async fn who_chooses_nodes_stays_with_them() {
    let authority = Arc::new(Authority::new());
    let (first, second) = (Fake::start(&authority).await, Fake::start(&authority).await);
    tells(&first, &[&first, &second]);
    let credentials = authority.context(&[&first]).credentials().unwrap();
    let options = Options { deadline: Duration::from_secs(5), ..Options::default() };
    let client = Client::connect_with(vec![first.address()], credentials, options).await.unwrap();
    first.stop().await;
    client.invoke("abac", "acquire", Vec::new()).await.unwrap_err();
    assert!(second.received().is_empty());
}

#[tokio::test]
async fn a_different_network_is_told_from_a_forger() {
    let (before, after) = (Arc::new(Authority::new()), Arc::new(Authority::new()));
    let node = Fake::start(&after).await;
    *node.node.network.lock().unwrap() = Hash([9; 32]);
    let refused = Client::connect(&before.context(&[&node])).await.err().unwrap();
    assert_eq!(refused.code, Code::WrongNetwork, "{refused}");
    assert_eq!(refused.message, format!("a different network answers at {}", node.address()));
    assert!(refused.found.contains(&Hash([9; 32]).to_string()), "{refused}");
    assert!(refused.found.contains(&after.fingerprint().to_string()), "{refused}");
    assert!(refused.advice().contains("enrol again"), "{refused}");
    // With the name of our network, but another CA: a forger.
    *node.node.network.lock().unwrap() = crate::authority::NETWORK;
    let refused = Client::connect(&before.context(&[&node])).await.err().unwrap();
    assert_eq!(refused.code, Code::Untrusted, "{refused}");
}

#[tokio::test]
async fn a_clock_that_is_wrong_is_named_in_place_of_the_certificate() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let context = authority.valid(&[&node], (2090, 2095));
    assert_eq!(Client::connect(&context).await.err().unwrap().code, Code::CertificateNotYetValid);
    // The node says that it is about 2092: by its clock the certificate is good, by ours it is not.
    let years = 66 * 365 * 24 * 3600 * 1_000_000_u64;
    node.node.ahead.store(years, Ordering::SeqCst);
    let refused = Client::connect(&context).await.err().unwrap();
    assert_eq!(refused.code, Code::ClockOff, "{refused}");
    assert!(refused.message.starts_with("the clock of this machine is 240"), "{refused}");
    assert!(refused.message.contains("days behind that of the node at"), "{refused}");
    assert!(refused.advice().contains("timedatectl"), "{refused}");
}

#[tokio::test]
async fn the_last_admin_is_told_of_the_secret_at_the_node() {
    let authority = Arc::new(Authority::new());
    let node = Fake::start(&authority).await;
    let refused = Client::connect(&authority.expired_admin(&[&node])).await.err().unwrap();
    assert_eq!(refused.code, Code::CertificateExpired, "{refused}");
    for words in ["ask another admin of Org1", "ledgerd admin-secret"] {
        assert!(refused.advice().contains(words), "{refused}");
    }
}
