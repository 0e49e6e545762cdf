//! Plain zenoh in Python: the bytes on the wire, written and read without this crate.

use std::process::{Child, Command, Stdio};

use ros_zenoh::{node::Node, qos::TokenQos, token::Kind};

use crate::support::{
    BYTES_MAX, DEADLINE, DOMAIN, Received, client_of, free_endpoint, message, router, seen, subject, until,
};

/// A script of this folder, if there is a Python with zenoh.
fn script(name: &str, endpoint: &str, more: &[&str]) -> Option<Child> {
    let Ok(python) = std::env::var("LEDGERD_TEST_PYTHON") else {
        println!("skipped: LEDGERD_TEST_PYTHON is not set");
        return None;
    };
    let script = format!("{}/python/{name}.py", env!("CARGO_MANIFEST_DIR"));
    let mut command = Command::new(python);
    Some(command.arg(script).arg(endpoint).args(more).stdout(Stdio::piped()).spawn().unwrap())
}

fn output(child: Child) -> Vec<String> {
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    String::from_utf8(output.stdout).unwrap().lines().map(str::to_owned).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_plain_session_reads_our_keys_tokens_and_attachments() {
    let endpoint = free_endpoint();
    let _router = router(&endpoint).await;
    let node = Node::join(DOMAIN, "bridge", &client_of(&endpoint)).await.unwrap();
    let topic = subject("/robot1/cmd_vel");
    let publisher = node.publisher(&topic, TokenQos { depth: Some(7), ..TokenQos::default() }).unwrap();
    let Some(child) = script("listen", &endpoint, &[&DOMAIN.to_string()]) else { return };
    // Its token comes when it listens.
    until("the listener is there", || seen(&node, Kind::Subscriber, "/listener").len() == 1).await;
    publisher.publish(message(9)).unwrap();
    let lines = tokio::task::spawn_blocking(move || output(child)).await.unwrap();
    let hash = topic.hash.unwrap();
    let session = &node.identity().session;
    let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>();
    let type_name = &topic.type_name;
    assert_eq!(lines[0], format!("@ros2_lv/{DOMAIN}/{session}/0/0/NN/%/%/bridge"));
    assert_eq!(
        lines[1],
        format!("@ros2_lv/{DOMAIN}/{session}/0/1/MP/%/%/bridge/%robot1%cmd_vel/{type_name}/{hash}/::,7:,:,:,,")
    );
    assert_eq!(lines[2], format!("{DOMAIN}/robot1/cmd_vel/{type_name}/{hash}"));
    assert_eq!(lines[3], hex(&message(9)));
    // The number 1, eight bytes of time, and the length and bytes of the identifier.
    assert_eq!(lines[4][..16], *"0100000000000000");
    assert_eq!(lines[4][32..], format!("10{}", hex(&publisher.gid())));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_plain_session_writes_by_hand_is_understood_and_malformed_things_are_counted() {
    let endpoint = free_endpoint();
    let _router = router(&endpoint).await;
    let node = Node::join(DOMAIN, "bridge", &client_of(&endpoint)).await.unwrap();
    let topic = subject("/cmd_vel");
    let received = Received::open(&node, &topic, TokenQos::default());
    let mut server = node.server(&subject("/reset"), TokenQos::default(), BYTES_MAX).unwrap();
    let (topic_key, service_key) = (topic.key(DOMAIN), subject("/reset").key(DOMAIN));
    let Some(child) = script("write", &endpoint, &[&topic_key, &service_key]) else { return };
    let request = tokio::time::timeout(DEADLINE, server.next()).await.unwrap().unwrap();
    assert_eq!(request.id, ([0xab; 16], 5));
    assert_eq!(request.message, message(4));
    server.reply(&request.id, message(6)).unwrap();
    let taken = received.take(4).await;
    use ros_zenoh::subscriber::Incoming;
    assert!(matches!(taken[0], Incoming::Malformed), "without an attachment: {taken:?}");
    assert!(matches!(taken[1], Incoming::Malformed), "with a short one: {taken:?}");
    assert!(matches!(taken[2], Incoming::Malformed), "with a very long one: {taken:?}");
    let Incoming::Message(bytes, attachment) = &taken[3] else { unreachable!("{taken:?}") };
    assert_eq!(
        (bytes, attachment.sequence, attachment.time, attachment.gid),
        (&message(3), 7, 1_700_000_000_000_000_000, [0xab; 16])
    );
    let lines = tokio::task::spawn_blocking(move || output(child)).await.unwrap();
    // The reply names the request, in the client's own number and identifier.
    assert_eq!(lines[0], "0001000006060606");
    assert_eq!((&lines[1][..16], &lines[1][32..]), ("0500000000000000", format!("10{}", "ab".repeat(16)).as_str()));
    assert_eq!(server.dropped(), 1, "a request without an attachment");
}
