//! Services of ROS 2: servers and clients of ours, and those of others. CycloneDDS in Python has its numbers in front of messages.
//! `ros2-client` has them beside, as Fast DDS does.

use std::time::Duration;
use testkit::own_network as network;

use ledger_base::hash::Hash;
use ros_bridge::{
    dds::{Caller, Client, Exchange, Number, Participant, Server},
    error::Error,
    mark::Mark,
    names::{TopicName, TypeName},
};
use ros2_client::{
    Message, Name, NodeName, NodeOptions, ServiceMapping, ServiceTypeName,
    ros2::{Duration as DdsDuration, QosPolicies, QosPolicyBuilder, policy},
};
use testkit::python::Python;

const DEADLINE: Duration = Duration::from_secs(40);
/// How long a reply may take before the request is made again.
const PATIENCE: Duration = Duration::from_secs(5);
const BYTES_MAX: usize = 1024;

fn exchange() -> Exchange {
    Exchange::new(&TopicName::parse("/light").unwrap(), &TypeName::parse("std_srvs/srv/SetBool").unwrap())
}

fn mark(network: u8) -> Mark {
    Mark::new(&Hash([network; 32]), "T/light")
}

/// A reply of `SetBool`: `bool success`, `string message`.
fn reply(success: bool, message: &str) -> Vec<u8> {
    let mut bytes = vec![u8::from(success), 0, 0, 0];
    bytes.extend(u32::try_from(message.len() + 1).unwrap().to_le_bytes());
    bytes.extend(message.bytes().chain([0]));
    bytes
}

/// Says yes to every request.
async fn serve(mut server: Server) {
    while let Some(request) = server.next().await {
        let data = request.message.first() == Some(&1);
        server.reply(&request.caller, &reply(data, "ours")).unwrap();
    }
}

/// Sends a request as soon as somebody serves.
async fn request(client: &mut Client, data: bool) -> Number {
    loop {
        match client.call(&[u8::from(data)]) {
            Ok(number) if client.matched().now().matched > 0 => return number,
            Ok(_) | Err(Error::Unserved(_)) => tokio::time::sleep(Duration::from_millis(20)).await,
            Err(error) => panic!("{error}"),
        }
    }
}

/// Calls until somebody serves and replies. A server that was killed is taken to be there for a while, and replies to nothing.
async fn call(client: &mut Client, data: bool) -> (bool, Vec<u8>) {
    let done = async {
        loop {
            let number = request(client, data).await;
            let replied = async {
                loop {
                    let reply = client.next().await.unwrap();
                    if reply.number == number {
                        return (reply.message.first() == Some(&1), reply.message.to_vec());
                    }
                }
            };
            if let Ok(reply) = tokio::time::timeout(PATIENCE, replied).await {
                return reply;
            }
        }
    };
    tokio::time::timeout(DEADLINE, done).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_on_cyclone_gets_the_replies_to_its_own_requests() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bridge = Participant::open(5, "ledgerd_bridge").await.unwrap();
    tokio::spawn(serve(bridge.server(&exchange(), mark(1), BYTES_MAX).unwrap()));
    let args = ["call", "5", "/light", "SetBool", "20", "true", "false", "true"];
    let both = [Python::start("calls.py", &args), Python::start("calls.py", &args)];
    for mut client in both {
        assert_eq!(client.line().unwrap(), "matched");
        for expected in ["True ours", "False ours", "True ours"] {
            assert_eq!(client.line().unwrap(), expected);
        }
        assert!(client.finish());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_waits_until_its_client_hears_replies() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bridge = Participant::open(5, "ledgerd_bridge").await.unwrap();
    tokio::spawn(serve(bridge.server(&exchange(), mark(1), BYTES_MAX).unwrap()));
    let mut client = Python::start("calls.py", &["late", "5", "/light", "SetBool", "20", "true", "false"]);
    for expected in ["matched", "True ours", "False ours"] {
        assert_eq!(client.line().unwrap(), expected);
    }
    assert!(client.finish());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_knows_of_each_client_whether_it_is_still_there() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (here, there) = (Participant::open(5, "here").await.unwrap(), Participant::open(5, "there").await.unwrap());
    let mut server = here.server(&exchange(), mark(1), BYTES_MAX).unwrap();
    let mut clients = [(); 2].map(|()| there.client(&exchange(), mark(2), BYTES_MAX).unwrap());
    let mut callers: Vec<Caller> = Vec::new();
    for client in &mut clients {
        tokio::time::timeout(DEADLINE, request(client, true)).await.unwrap();
        let request = tokio::time::timeout(DEADLINE, server.next()).await.unwrap().unwrap();
        assert!(server.is_there(&request.caller), "from its first request on");
        callers.push(request.caller);
    }
    let ([leaves, _stays], [gone, there]) = (clients, <[Caller; 2]>::try_from(callers).unwrap());
    drop(leaves);
    let left = async {
        while server.is_there(&gone) {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(DEADLINE, left).await.unwrap();
    assert!(server.is_there(&there), "another one of the same process");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_on_cyclone_replies_and_does_so_again_after_its_restart() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bridge = Participant::open(5, "ledgerd_bridge").await.unwrap();
    let mut client = bridge.client(&exchange(), mark(1), BYTES_MAX).unwrap();
    assert!(matches!(client.call(&[1]), Err(Error::Unserved(_))));
    for _start in 0..2 {
        let mut server = Python::start("calls.py", &["serve", "5", "/light", "SetBool"]);
        assert_eq!(server.line().unwrap(), "ready");
        let (success, message) = call(&mut client, true).await;
        assert!(success && message.starts_with(&reply(true, "from /light")), "{message:?}");
        assert!(server.line().unwrap().starts_with("request"));
        drop(server);
    }
}

#[derive(Clone, serde::Serialize, serde::Deserialize)]
struct SetBool {
    data: bool,
}

#[derive(Clone, serde::Serialize, serde::Deserialize)]
struct Done {
    success: bool,
    message: String,
}

impl Message for SetBool {}
impl Message for Done {}

fn qos() -> QosPolicies {
    let history = policy::History::KeepLast { depth: 10 };
    QosPolicyBuilder::new().reliable(DdsDuration::from_secs(1)).history(history).build()
}

fn node() -> ros2_client::Node {
    let context = ros2_client::Context::with_options(ros2_client::ContextOptions::new().domain_id(5)).unwrap();
    let mut node = context.new_node(NodeName::new("/", "beside").unwrap(), NodeOptions::new()).unwrap();
    tokio::spawn(node.spinner().unwrap().spin());
    node
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_with_the_numbers_beside_the_message_gets_its_replies() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bridge = Participant::open(5, "ledgerd_bridge").await.unwrap();
    tokio::spawn(serve(bridge.server(&exchange(), mark(1), BYTES_MAX).unwrap()));
    let mut node = node();
    let (name, of) = (Name::new("/", "light").unwrap(), ServiceTypeName::new("std_srvs", "SetBool"));
    let client =
        node.create_client::<SetBool, Done>(ServiceMapping::Enhanced, &name, &of, (&qos()).into(), (&qos()).into());
    let client = client.unwrap();
    tokio::time::timeout(DEADLINE, client.wait_for_service(&node)).await.unwrap();
    for data in [true, false] {
        let id = client.async_send_request(SetBool { data }).await.unwrap();
        let done = tokio::time::timeout(DEADLINE, client.async_receive_response(id)).await.unwrap().unwrap();
        assert_eq!((done.success, done.message.as_str()), (data, "ours"));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_with_the_numbers_beside_the_message_replies() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bridge = Participant::open(5, "ledgerd_bridge").await.unwrap();
    let mut client = bridge.client(&exchange(), mark(1), BYTES_MAX).unwrap();
    let mut node = node();
    let (name, of) = (Name::new("/", "light").unwrap(), ServiceTypeName::new("std_srvs", "SetBool"));
    let server =
        node.create_server::<SetBool, Done>(ServiceMapping::Enhanced, &name, &of, (&qos()).into(), (&qos()).into());
    let server = server.unwrap();
    tokio::spawn(async move {
        loop {
            let (id, SetBool { data }) = server.async_receive_request().await.unwrap();
            server.async_send_response(id, Done { success: data, message: "theirs".into() }).await.unwrap();
        }
    });
    let (success, message) = call(&mut client, true).await;
    // RTPS may have filled the last four bytes up.
    assert!(success && message.starts_with(&reply(true, "theirs")), "{message:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn bridges_of_one_network_do_not_call_each_other() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (here, there) = (Participant::open(5, "here").await.unwrap(), Participant::open(5, "there").await.unwrap());
    let server = here.server(&exchange(), mark(1), BYTES_MAX).unwrap();
    let mut same = there.client(&exchange(), mark(1), BYTES_MAX).unwrap();
    assert!(tokio::time::timeout(DEADLINE, same.matched().at_least(1)).await.unwrap());
    assert!(tokio::time::timeout(DEADLINE, server.matched().at_least(1)).await.unwrap());
    assert!(matches!(same.call(&[1]), Err(Error::Unserved(_))), "a bridge of the same network");
    tokio::spawn(serve(server));
    let mut other = there.client(&exchange(), mark(2), BYTES_MAX).unwrap();
    assert!(call(&mut other, true).await.0, "a bridge of another network is like anybody");
}
