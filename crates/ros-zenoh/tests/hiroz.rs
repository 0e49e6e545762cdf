//! `hiroz`, an implementation of the convention of `rmw_zenoh` by others.

use hiroz::{
    Builder, MessageTypeInfo, ServiceTypeInfo,
    context::{ZContext, ZContextBuilder},
    entity::{TypeHash, TypeInfo},
    msg::{SerdeCdrSerdes, ZMessage, ZService},
    qos::{QosDurability, QosHistory, QosProfile},
};
use ros_message::{ByteOrder, Library, Time, Written};
use ros_zenoh::{key::Subject, node::Node, qos::TokenQos, token::Kind};
use serde::{Deserialize, Serialize};

use crate::support::{BYTES_MAX, DEADLINE, DOMAIN, Received, client_of, free_endpoint, latched, router, seen, until};

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Default, MessageTypeInfo)]
#[ros_msg(type_name = "geometry_msgs/msg/Vector3")]
struct Vector3 {
    x: f64,
    y: f64,
    z: f64,
}

impl ZMessage for Vector3 {
    type Serdes = SerdeCdrSerdes<Self>;
}

#[derive(Debug, Clone, Serialize, Deserialize, Default, MessageTypeInfo)]
#[ros_msg(type_name = "std_srvs/srv/SetBool_Request")]
struct SetBoolRequest {
    data: bool,
}

impl ZMessage for SetBoolRequest {
    type Serdes = SerdeCdrSerdes<Self>;
}

#[derive(Debug, Clone, Serialize, Deserialize, Default, MessageTypeInfo)]
#[ros_msg(type_name = "std_srvs/srv/SetBool_Response")]
struct SetBoolResponse {
    success: bool,
    message: String,
}

impl ZMessage for SetBoolResponse {
    type Serdes = SerdeCdrSerdes<Self>;
}

struct SetBool;

impl ServiceTypeInfo for SetBool {
    fn service_type_info() -> TypeInfo {
        TypeInfo::new(
            "std_srvs::srv::dds_::SetBool_",
            TypeHash::from_rihs_string(&hash("std_srvs/srv/SetBool")).unwrap(),
        )
    }
}

impl ZService for SetBool {
    type Request = SetBoolRequest;
    type Response = SetBoolResponse;
}

/// The types that a bridge knows, and the service of these tests.
fn library() -> Library {
    let mut library = Library::builtin();
    let event = "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\nint64 sequence_number";
    library.add("service_msgs/msg/ServiceEventInfo", event).unwrap();
    library.add("std_srvs/srv/SetBool", "bool data\n---\nbool success\nstring message").unwrap();
    library
}

/// The hash of a type as the bridge computes it.
fn hash(name: &str) -> String {
    library().message(name).unwrap().type_hash()
}

fn encoded(name: &str, yaml: &str) -> bytes::Bytes {
    let message = library().message(name).unwrap();
    message.encode(&Written::parse(yaml).unwrap(), ByteOrder::Little, Time::default()).unwrap().into()
}

fn vectors(name: &str) -> Subject {
    Subject {
        name: name.to_owned(),
        type_name: "geometry_msgs::msg::dds_::Vector3_".to_owned(),
        hash: Some(hash("geometry_msgs/msg/Vector3")),
    }
}

/// The service, whether its hash is known or not.
fn service(is_known: bool) -> Subject {
    Subject {
        name: "/light".to_owned(),
        type_name: "std_srvs::srv::dds_::SetBool_".to_owned(),
        hash: is_known.then(|| hash("std_srvs/srv/SetBool")),
    }
}

/// A router, a node of this crate, and a context of hiroz.
async fn graph() -> (Node, Node, ZContext) {
    let endpoint = free_endpoint();
    let router = router(&endpoint).await;
    let node = Node::join(DOMAIN, "bridge", &client_of(&endpoint)).await.unwrap();
    let context = ZContextBuilder::default()
        .with_domain_id(DOMAIN.into())
        .with_mode("client")
        .with_connect_endpoints([endpoint.as_str()])
        .build()
        .unwrap();
    (router, node, context)
}

#[tokio::test(flavor = "multi_thread")]
async fn hiroz_computes_the_hash_that_we_compute() {
    assert_eq!(Vector3::type_hash().to_rihs_string(), hash("geometry_msgs/msg/Vector3"));
}

#[tokio::test(flavor = "multi_thread")]
async fn messages_of_hiroz_come_in_and_the_graph_names_their_node() {
    let (_router, node, context) = graph().await;
    let talker = context.create_node("talker").with_namespace("/robot1").build().unwrap();
    let publisher = talker.create_pub::<Vector3>("/speed").build().unwrap();
    let received = Received::open(&node, &vectors("/speed"), TokenQos::default());
    until("the publisher is seen", || seen(&node, Kind::Publisher, "/speed").len() == 1).await;
    // It does not tell when it has seen a subscriber.
    let talks = async {
        loop {
            publisher.async_publish(&Vector3 { x: 0.5, y: 1.0, z: -2.0 }).await.unwrap();
            tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        }
    };
    let (bytes, attachment) = tokio::select! {
        messages = received.messages(1) => messages[0].clone(),
        () = talks => unreachable!("it talks without end"),
    };
    assert_eq!(bytes, encoded("geometry_msgs/msg/Vector3", "{x: 0.5, y: 1.0, z: -2.0}"));
    // hiroz takes the identifier of its messages from elsewhere, so only the token names the node.
    let endpoint = node.graph().endpoint(&seen(&node, Kind::Publisher, "/speed")[0]).unwrap();
    assert_eq!(endpoint.token.node.full_name(), "/robot1/talker");
    assert_eq!(endpoint.token.subject, vectors("/speed"));
    assert!(attachment.sequence >= 0 && attachment.time > 0 && !node.graph().has_left(&attachment.gid));
}

#[tokio::test(flavor = "multi_thread")]
async fn hiroz_reads_what_we_publish_and_counts_us_in_its_graph() {
    let (_router, node, context) = graph().await;
    let listener = context.create_node("listener").build().unwrap();
    let subscriber = listener.create_sub::<Vector3>("/speed").build().unwrap();
    let publisher = node.publisher(&vectors("/speed"), TokenQos::default()).unwrap();
    until("the subscriber is seen", || seen(&node, Kind::Subscriber, "/speed").len() == 1).await;
    publisher.publish(encoded("geometry_msgs/msg/Vector3", "{x: 3.0}")).unwrap();
    let heard = tokio::time::timeout(DEADLINE, subscriber.async_recv()).await.unwrap().unwrap();
    assert_eq!(heard, Vector3 { x: 3.0, ..Vector3::default() });
}

#[tokio::test(flavor = "multi_thread")]
async fn latched_messages_pass_both_ways() {
    let (_router, node, context) = graph().await;
    let hiroz = context.create_node("hiroz").build().unwrap();
    let depth = QosHistory::KeepLast(std::num::NonZeroUsize::new(1).unwrap());
    let qos = QosProfile { durability: QosDurability::TransientLocal, history: depth, ..QosProfile::default() };

    let publisher = hiroz.create_pub::<Vector3>("/theirs").with_qos(qos).build().unwrap();
    publisher.async_publish(&Vector3 { x: 1.0, ..Vector3::default() }).await.unwrap();
    until("the publisher is seen", || seen(&node, Kind::Publisher, "/theirs").len() == 1).await;
    let endpoint = node.graph().endpoint(&seen(&node, Kind::Publisher, "/theirs")[0]).unwrap();
    assert!(endpoint.token.qos.is_latched, "{:?}", endpoint.token.qos);
    let late = Received::open(&node, &vectors("/theirs"), latched(1));
    assert_eq!(late.messages(1).await[0].0, encoded("geometry_msgs/msg/Vector3", "{x: 1.0}"));

    let publisher = node.publisher(&vectors("/ours"), latched(1)).unwrap();
    publisher.publish(encoded("geometry_msgs/msg/Vector3", "{y: 2.0}")).unwrap();
    let late = hiroz.create_sub::<Vector3>("/ours").with_qos(qos).build().unwrap();
    let heard = tokio::time::timeout(DEADLINE, late.async_recv()).await.unwrap().unwrap();
    assert_eq!(heard, Vector3 { y: 2.0, ..Vector3::default() });
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_of_hiroz_is_served() {
    let (_router, node, context) = graph().await;
    for is_known in [true, false] {
        let mut server = node.server(&service(is_known), TokenQos::default(), BYTES_MAX).unwrap();
        let caller = context.create_node("caller").build().unwrap();
        let client = caller.create_client::<SetBool>("/light").build().unwrap();
        until("the client is seen", || seen(&node, Kind::Client, "/light").len() == 1).await;
        let serves = async {
            let request = server.next().await.unwrap();
            assert_eq!(request.message, encoded("std_srvs/srv/SetBool_Request", "{data: true}"));
            let reply = encoded("std_srvs/srv/SetBool_Response", "{success: true, message: on}");
            server.reply(&request.id, reply).unwrap();
        };
        let request = SetBoolRequest { data: true };
        let calls = client.call_with_timeout(&request, DEADLINE);
        let (reply, ()) = tokio::join!(calls, serves);
        let reply = reply.unwrap();
        assert_eq!((reply.success, reply.message.as_str()), (true, "on"));
        drop((client, caller));
        until("the client has left", || seen(&node, Kind::Client, "/light").is_empty()).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_of_hiroz_is_called() {
    let (_router, node, context) = graph().await;
    let serving = context.create_node("light").build().unwrap();
    let mut server = serving.create_service::<SetBool>("/light").build().unwrap();
    for is_known in [true, false] {
        let mut client = node.client(&service(is_known), TokenQos::default(), BYTES_MAX, DEADLINE).unwrap();
        until("the server is seen", || seen(&node, Kind::Server, "/light").len() == 1).await;
        let number = client.call(encoded("std_srvs/srv/SetBool_Request", "{data: true}")).unwrap();
        let request = tokio::time::timeout(DEADLINE, server.async_take_request()).await.unwrap().unwrap();
        assert!(request.message().data);
        let reply = SetBoolResponse { success: true, message: "on".to_owned() };
        let replies = move || request.reply_blocking(&reply).map_err(|error| error.to_string());
        tokio::task::spawn_blocking(replies).await.unwrap().unwrap();
        let reply = tokio::time::timeout(DEADLINE, client.next()).await.unwrap().unwrap();
        assert_eq!(reply.number, number);
        assert_eq!(reply.message, encoded("std_srvs/srv/SetBool_Response", "{success: true, message: on}"));
    }
}
