//! Messages from 1 kB to 4 MB over each kind of channel, in both directions, beside CycloneDDS and Fast DDS. A goal and a result of an
//! action are a request and a reply, and feedback is a topic.

#![expect(clippy::indexing_slicing, reason = "messages of known sizes")]

use std::{collections::BTreeSet, sync::Arc, time::Duration};
use testkit::own_network as network;
use tokio::sync::Notify;

use ledger_base::hash::Hash;
use ledger_gate::sample::{CDR_LE, Sample};
use ros_bridge::{
    dds::{Client, Exchange, Participant, Server},
    error::Error,
    mark::Mark,
    names::{TopicName, TypeName},
    qos::{Durability, Qos, Reliability},
    queue::Limits,
};
use testkit::{
    python::{CYCLONE, Python},
    rclpy,
};

const DOMAIN: u16 = 5;
const DEADLINE: Duration = Duration::from_secs(60);
const BYTES_MAX: usize = 8 << 20;
/// Time after which a first request or sample is sent again.
const AGAIN_AFTER: Duration = Duration::from_millis(500);
/// Bytes of the string in a message. Around 64 kB a message becomes larger than a datagram.
const SIZES: [usize; 8] = [1_000, 60_000, 64_000, 66_000, 100_000, 400_000, 1_000_000, 4_000_000];
const LATCHED: Qos = Qos::new(Reliability::Reliable, Durability::TransientLocal, 1);
const ASK: &str = "rcl_interfaces/srv/GetParameters";
const TELL: &str = "std_srvs/srv/SetBool";

/// A string of this size as CDR has it.
fn string(size: usize) -> Vec<u8> {
    let mut bytes = u32::try_from(size + 1).unwrap().to_le_bytes().to_vec();
    bytes.resize(4 + size, b'x');
    bytes.push(0);
    bytes
}

/// The size of such a string.
fn size_of(bytes: &[u8]) -> usize {
    let (length, text) = bytes.split_at(4);
    let size = u32::from_le_bytes(length.try_into().unwrap()) as usize - 1;
    assert!(text[..size].iter().all(|byte| *byte == b'x'), "a byte of {size} is wrong");
    size
}

/// A request of `GetParameters` with one name of this size.
fn question(size: usize) -> Vec<u8> {
    [1u32.to_le_bytes().to_vec(), string(size)].concat()
}

/// A reply of `SetBool` with a message of this size.
fn answer(size: usize) -> Vec<u8> {
    [vec![1, 0, 0, 0], string(size)].concat()
}

fn exchange(name: &str, of: &str) -> Exchange {
    Exchange::new(&TopicName::parse(name).unwrap(), &TypeName::parse(of).unwrap())
}

/// Calls as soon as there is a server, and returns the reply.
async fn call(client: &mut Client, request: &[u8]) -> Vec<u8> {
    let done = async {
        loop {
            match client.call(request) {
                Ok(number) => loop {
                    let reply = client.next().await.unwrap();
                    if reply.number == number {
                        return reply.message.to_vec();
                    }
                },
                Err(Error::Unserved(_)) => tokio::time::sleep(Duration::from_millis(20)).await,
                Err(error) => panic!("{error}"),
            }
        }
    };
    tokio::time::timeout(DEADLINE, done).await.expect("a reply")
}

/// Calls again and again until the first reply: a peer may acknowledge a request before its application reads from this client.
async fn first_reply(client: &mut Client, request: &[u8]) {
    let done = async {
        loop {
            if client.call(request).is_ok() && tokio::time::timeout(AGAIN_AFTER, client.next()).await.is_ok() {
                return;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(DEADLINE, done).await.expect("a first reply");
}

/// Replies to each request, and passes on how large it was.
async fn serve(mut server: Server, reply: impl Fn(usize) -> Vec<u8>, sizes: tokio::sync::mpsc::UnboundedSender<usize>) {
    let mut number = 0;
    while let Some(request) = server.next().await {
        server.reply(&request.caller, &reply(number)).unwrap();
        number += 1;
        // SetBool has no string in its request.
        sizes.send(if request.message.len() > 8 { size_of(&request.message[4..]) } else { 0 }).unwrap();
    }
}

/// The other side, and what it has printed.
struct Peer {
    python: Python,
    printed: BTreeSet<String>,
}

impl Peer {
    /// Waits until it has printed all of these.
    fn prints(&mut self, wanted: impl IntoIterator<Item = String>) {
        for wanted in wanted {
            while !self.printed.contains(&wanted) {
                let line = self.python.line().unwrap_or_else(|| panic!("{wanted} is not in {:?}", self.printed));
                self.printed.insert(line);
            }
        }
    }
}

async fn messages_of_every_size_pass_on_each_channel(start: impl FnOnce(&[String]) -> Python) {
    let bridge = Participant::open(DOMAIN, "ledgerd_bridge").await.unwrap();
    let string_type = TypeName::parse("std_msgs/msg/String").unwrap();
    let topic = |name: &str| TopicName::parse(name).unwrap();
    let sample = |size| Sample::new(CDR_LE, &string(size)).unwrap();
    let mark = Mark::new(&Hash([1; 32]), "T/large");
    let (asked, mut asked_sizes) = tokio::sync::mpsc::unbounded_channel();
    let ask = bridge.server(&exchange("/ours/ask", ASK), mark, BYTES_MAX).unwrap();
    let tell = bridge.server(&exchange("/ours/tell", TELL), mark, BYTES_MAX).unwrap();
    tokio::spawn(serve(ask, |_| 0u32.to_le_bytes().to_vec(), asked));
    let (told, _told_sizes) = tokio::sync::mpsc::unbounded_channel();
    tokio::spawn(serve(tell, |number| answer(SIZES[number]), told));
    let _latched: Vec<_> = SIZES
        .iter()
        .map(|size| {
            let writer = bridge.writer(&topic(&format!("/ours/latched_{size}")), &string_type, &LATCHED).unwrap();
            writer.write(&sample(*size)).unwrap();
            writer
        })
        .collect();
    let writer = bridge.writer(&topic("/ours/topic"), &string_type, &Qos::default()).unwrap();
    let sizes = SIZES.map(|size| size.to_string());
    let mut peer = Peer { python: start(&sizes), printed: BTreeSet::new() };
    peer.prints(["ready".to_owned()]);

    // From here to there.
    let has_arrived = Arc::new(Notify::new());
    let arrived = Arc::clone(&has_arrived);
    assert!(tokio::time::timeout(DEADLINE, writer.matched().at_least(1)).await.unwrap());
    let first = tokio::spawn(async move {
        loop {
            writer.write(&Sample::new(CDR_LE, &string(1)).unwrap()).unwrap();
            tokio::select! {
                biased;
                () = arrived.notified() => return writer,
                () = tokio::time::sleep(AGAIN_AFTER) => {}
            }
        }
    });
    peer.prints(["topic 1".to_owned()]);
    has_arrived.notify_one();
    let writer = first.await.unwrap();
    SIZES.iter().for_each(|size| writer.write(&sample(*size)).unwrap());
    let mut client = bridge.client(&exchange("/theirs/ask", ASK), mark, BYTES_MAX).unwrap();
    first_reply(&mut client, &question(1)).await;
    for size in SIZES {
        assert_eq!(call(&mut client, &question(size)).await, 0u32.to_le_bytes(), "{size}");
    }
    let mut client = bridge.client(&exchange("/theirs/tell", TELL), mark, BYTES_MAX).unwrap();
    first_reply(&mut client, &[0]).await;
    for size in SIZES {
        assert_eq!(size_of(&call(&mut client, &[1]).await[4..]), size);
    }
    let each = |channel: &str| SIZES.map(|size| format!("{channel} {size}"));
    peer.prints([each("ask"), each("topic"), each("latched")].concat());

    // And from there to here.
    let mut kept = Vec::new();
    for size in SIZES {
        let name = topic(&format!("/theirs/latched_{size}"));
        kept.push(bridge.reader(&name, &string_type, &LATCHED, Limits::default()).unwrap());
    }
    for (reader, size) in kept.iter_mut().zip(SIZES) {
        let incoming = tokio::time::timeout(DEADLINE, reader.next()).await.unwrap().unwrap();
        assert_eq!(size_of(&incoming.sample.body()), size);
    }
    let mut reader = bridge.reader(&topic("/theirs/topic"), &string_type, &Qos::default(), Limits::default()).unwrap();
    for size in SIZES {
        let incoming = tokio::time::timeout(DEADLINE, reader.next()).await.unwrap().unwrap();
        assert_eq!(size_of(&incoming.sample.body()), size);
        let asked = tokio::time::timeout(DEADLINE, asked_sizes.recv()).await.unwrap().unwrap();
        assert_eq!(asked, size);
    }
    peer.prints(each("told").into_iter().chain(["done".to_owned()]));
}

#[tokio::test(flavor = "multi_thread")]
async fn messages_of_every_size_pass_on_each_channel_beside_cyclonedds() {
    if network::isolated(&|| ()) {
        messages_of_every_size_pass_on_each_channel(|sizes| {
            let domain = DOMAIN.to_string();
            let args: Vec<&str> = [&domain].into_iter().chain(sizes).map(String::as_str).collect();
            Python::start("large.py", &args)
        })
        .await;
    }
}

/// CycloneDDS with fragments of 4000 bytes, as people set it for radio links.
#[tokio::test(flavor = "multi_thread")]
async fn messages_of_every_size_pass_on_each_channel_beside_cyclonedds_with_small_fragments() {
    if network::isolated(&|| ()) {
        let general = "<MaxMessageSize>4000B</MaxMessageSize><FragmentSize>3900B</FragmentSize></General>";
        let cyclone = CYCLONE.replace("</General>", general);
        messages_of_every_size_pass_on_each_channel(|sizes| {
            let domain = DOMAIN.to_string();
            let args: Vec<&str> = [&domain].into_iter().chain(sizes).map(String::as_str).collect();
            Python::start_within(&[], &cyclone, "large.py", &args)
        })
        .await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn messages_of_every_size_pass_on_each_channel_beside_fast_dds() {
    if rclpy::is_there() && network::isolated(&|| ()) {
        messages_of_every_size_pass_on_each_channel(|sizes| {
            rclpy::script("large.py", DOMAIN, &sizes.iter().map(String::as_str).collect::<Vec<_>>())
        })
        .await;
    }
}
