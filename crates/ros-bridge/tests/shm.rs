//! Shared memory between two nodes, and between two processes.

#[path = "../examples/shared_memory.rs"]
#[expect(dead_code, reason = "an example, run as a program")]
mod example;

use std::{
    env,
    process::{Child, Command},
    sync::Arc,
    time::Duration,
};

use iceoryx2::{
    node::{NodeBuilder, NodeState, NodeView},
    prelude::{CallbackProgression, ServiceName},
    service::ipc_threadsafe,
};
use ledger_base::hash::Hash;
use ledger_gate::sample::{CDR_LE, Sample};
use ros_bridge::{
    loop_filter::LoopFilter,
    mark::Mark,
    names::TopicName,
    queue::{Incoming, Limits},
    shm::{self, Node, Subscriber},
};
use rustix::process::{Pid, Signal, kill_process};

const DEADLINE: Duration = Duration::from_secs(20);
/// Tells the child which topic to publish.
const CHILD_TOPIC: &str = "LEDGERD_TEST_SHM_TOPIC";

/// A topic that no other test run uses.
fn topic(test: &str) -> TopicName {
    TopicName::parse(&format!("/test_{}/{test}", std::process::id()).replace("test_", "t")).unwrap()
}

fn sample(byte: u8, len: usize) -> Sample {
    Sample::new(CDR_LE, &vec![byte; len]).unwrap()
}

async fn next(subscriber: &mut Subscriber) -> Incoming {
    tokio::time::timeout(DEADLINE, subscriber.next()).await.unwrap().unwrap()
}

#[tokio::test]
async fn samples_pass_between_two_nodes_and_grow() {
    let topic = topic("grow");
    let (here, there) = (Node::open(0, "here", [1; 16]).await.unwrap(), Node::open(0, "there", [2; 16]).await.unwrap());
    let mut subscriber = there.subscriber(&topic, Limits::default()).await.unwrap();
    let publisher = here.publisher(&topic).await.unwrap();
    assert_eq!((publisher.subscribers(), subscriber.publishers()), (1, 1));
    for (number, len) in [(1, 48), (2, 300_000), (3, 0), (4, 1_000_000), (5, 48)] {
        assert_eq!(publisher.write(&sample(number, len)).unwrap(), 1);
        let incoming = next(&mut subscriber).await;
        assert_eq!(incoming.sample, sample(number, len));
        assert_eq!((incoming.source, incoming.sequence), ([1; 16], u64::from(number)));
    }
}

#[tokio::test]
async fn a_service_that_an_application_opened_with_smaller_limits_is_used_as_it_is() {
    let topic = topic("small");
    let name = ServiceName::new(&topic.dds()).unwrap();
    let application = NodeBuilder::new().config(&shm::config().unwrap()).create::<ipc_threadsafe::Service>().unwrap();
    let data = application.service_builder(&name).publish_subscribe::<[u8]>().user_header::<[u8; 32]>();
    let data = data.max_publishers(2).max_subscribers(2).max_nodes(2).subscriber_max_buffer_size(1);
    let data = data.enable_safe_overflow(false).create().unwrap();
    let events = application.service_builder(&name).event();
    let _events = events.max_notifiers(3).max_listeners(2).max_nodes(2).create().unwrap();
    let stalled = data.subscriber_builder().create().unwrap();
    let here = Node::open(0, "here", [1; 16]).await.unwrap();
    let publisher = here.publisher(&topic).await.unwrap();
    // A subscriber that takes nothing and may not lose anything holds up nobody.
    let reached: Vec<usize> = (0..3).map(|number| publisher.write(&sample(number, 48)).unwrap()).collect();
    assert_eq!(reached, [1, 0, 0]);
    assert_eq!(stalled.receive().unwrap().unwrap().payload(), sample(0, 48).wire().as_ref());
    let _heard = here.subscriber(&topic, Limits::default()).await.unwrap();
}

#[tokio::test]
async fn a_program_with_nothing_but_iceoryx2_speaks_and_listens_as_the_example_does() {
    let (said, heard) = (topic("said"), topic("heard"));
    let node = Node::open(0, "here", [1; 16]).await.unwrap();
    let mut subscriber = node.subscriber(&said, Limits::default()).await.unwrap();
    let message = sample(7, 48);
    let wire = message.wire().clone();
    let saying =
        tokio::task::spawn_blocking(move || example::say(said.as_str(), &wire, 50).map_err(|error| error.to_string()));
    for sequence in 1..=50 {
        let incoming = next(&mut subscriber).await;
        assert_eq!((incoming.sample, incoming.sequence), (message.clone(), sequence));
    }
    saying.await.unwrap().unwrap();

    let publisher = node.publisher(&heard).await.unwrap();
    let listening = tokio::task::spawn_blocking(move || {
        let mut found = Vec::new();
        let take = |message: &[u8]| {
            found.push(message.to_vec());
            found.len() < 3
        };
        example::hear(heard.as_str(), take).map_err(|error| error.to_string()).map(|()| found)
    });
    let mut pause = tokio::time::interval(Duration::from_millis(5));
    while !listening.is_finished() {
        pause.tick().await;
        publisher.write(&message).unwrap();
    }
    assert_eq!(listening.await.unwrap().unwrap(), vec![message.wire().to_vec(); 3]);
}

#[tokio::test]
async fn domains_do_not_hear_each_other() {
    let topic = topic("domains");
    let (one, two) = (Node::open(1, "one", [1; 16]).await.unwrap(), Node::open(2, "two", [2; 16]).await.unwrap());
    let also_two = Node::open(2, "also-two", [3; 16]).await.unwrap();
    let mut subscriber = two.subscriber(&topic, Limits::default()).await.unwrap();
    let (stranger, neighbour) = (one.publisher(&topic).await.unwrap(), also_two.publisher(&topic).await.unwrap());
    assert_eq!(stranger.write(&sample(1, 10)).unwrap(), 0);
    assert_eq!(neighbour.write(&sample(2, 10)).unwrap(), 1);
    assert_eq!(next(&mut subscriber).await.sample, sample(2, 10));
}

#[tokio::test]
async fn a_node_never_hears_itself() {
    let topic = topic("own");
    let (here, there) = (Node::open(0, "here", [1; 16]).await.unwrap(), Node::open(0, "there", [2; 16]).await.unwrap());
    let mut subscriber = here.subscriber(&topic, Limits::default()).await.unwrap();
    let own = here.publisher(&topic).await.unwrap();
    let other = there.publisher(&topic).await.unwrap();
    own.write(&sample(1, 10)).unwrap();
    other.write(&sample(2, 10)).unwrap();
    assert_eq!(next(&mut subscriber).await.sample, sample(2, 10));
    assert!(subscriber.try_next().is_none());
}

#[tokio::test]
async fn what_a_bridge_publishes_is_not_taken_in_by_another_one_of_its_network() {
    let topic = topic("mark");
    let (here, there) = (Node::open(0, "here", [1; 16]).await.unwrap(), Node::open(0, "there", [2; 16]).await.unwrap());
    let mark = |network| Mark::new(&Hash([network; 32]), "T/cmd_vel");
    let door = Arc::new(LoopFilter::new(mark(7), "T/cmd_vel", Duration::from_secs(1), Arc::default()));
    let mut subscriber = here.subscriber_behind(&topic, Limits::default(), Arc::clone(&door)).await.unwrap();
    let bridge = there.marked_publisher(&topic, mark(7)).await.unwrap();
    let other_network = there.marked_publisher(&topic, mark(8)).await.unwrap();
    bridge.write(&sample(1, 10)).unwrap();
    other_network.write(&sample(2, 10)).unwrap();
    assert_eq!(next(&mut subscriber).await.sample, sample(2, 10));
    while door.returned() == 0 {
        tokio::task::yield_now().await;
    }
    assert!(subscriber.try_next().is_none());
}

#[tokio::test]
async fn a_sample_above_the_limit_is_dropped_and_the_next_one_comes() {
    let topic = topic("limit");
    let (here, there) = (Node::open(0, "here", [1; 16]).await.unwrap(), Node::open(0, "there", [2; 16]).await.unwrap());
    let limits = Limits { sample_bytes_max: 100, ..Limits::default() };
    let mut subscriber = there.subscriber(&topic, limits).await.unwrap();
    let publisher = here.publisher(&topic).await.unwrap();
    publisher.write(&sample(1, 1000)).unwrap();
    publisher.write(&sample(2, 10)).unwrap();
    assert_eq!(next(&mut subscriber).await.sample, sample(2, 10));
    assert_eq!(subscriber.dropped(), 1);
}

#[tokio::test]
async fn a_dropped_subscriber_leaves_the_service() {
    let topic = topic("leave");
    let (here, there) = (Node::open(0, "here", [1; 16]).await.unwrap(), Node::open(0, "there", [2; 16]).await.unwrap());
    let publisher = here.publisher(&topic).await.unwrap();
    for _ in 0..3 * shm::SUBSCRIBERS_MAX {
        let subscriber = there.subscriber(&topic, Limits::default()).await.unwrap();
        drop(subscriber);
    }
    let gone = async {
        while publisher.subscribers() > 0 {
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(DEADLINE, gone).await.unwrap();
}

#[tokio::test]
async fn a_killed_process_does_not_stand_in_the_way_of_the_next() {
    let topic = topic("killed");
    let node = Node::open(0, "here", [1; 16]).await.unwrap();
    let mut subscriber = node.subscriber(&topic, Limits::default()).await.unwrap();
    // More often than there are places for publishers, so that the dead ones must have been removed.
    for _ in 0..shm::PUBLISHERS_MAX + 2 {
        let mut child = start_child(&topic);
        let before = next(&mut subscriber).await;
        assert_eq!(before.sample, sample(9, 52));
        child.kill().unwrap();
        child.wait().unwrap();
        while subscriber.try_next().is_some() {}
    }
}

#[tokio::test]
async fn a_subscriber_whose_process_was_stopped_and_continued_hears_again() {
    let topic = topic("stopped");
    let node = Node::open(0, "here", [1; 16]).await.unwrap();
    let publisher = node.publisher(&topic).await.unwrap();
    let mut echo = node.subscriber(&echo_of(&topic), Limits::default()).await.unwrap();
    let mut child = start(&topic, "child_says_what_it_hears_until_it_is_killed");
    let process = Pid::from_raw(i32::try_from(child.id()).unwrap()).unwrap();
    for number in 0..5 {
        let heard = async {
            let mut pause = tokio::time::interval(Duration::from_millis(5));
            loop {
                tokio::select! {
                    _ = pause.tick() => {
                        publisher.write(&sample(number, 52)).unwrap();
                    }
                    incoming = echo.next() => if incoming.unwrap().sample == sample(number, 52) {
                        break;
                    },
                }
            }
        };
        assert!(tokio::time::timeout(DEADLINE, heard).await.is_ok(), "it is deaf after {number} times");
        kill_process(process, Signal::STOP).unwrap();
        while !stands_still(&child) {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        kill_process(process, Signal::CONT).unwrap();
    }
    child.kill().unwrap();
    child.wait().unwrap();
}

/// Is every thread of it stopped?
fn stands_still(child: &Child) -> bool {
    let tasks = std::fs::read_dir(format!("/proc/{}/task", child.id())).unwrap();
    let mut stats = tasks.filter_map(|task| std::fs::read_to_string(task.unwrap().path().join("stat")).ok());
    stats.all(|stat| stat.rsplit_once(") ").is_some_and(|(_, state)| state.starts_with('T')))
}

/// Where the child says what it has heard.
fn echo_of(topic: &TopicName) -> TopicName {
    TopicName::parse(&format!("{topic}_again")).unwrap()
}

#[tokio::test]
async fn killed_subscribers_take_nothing_from_another_one_and_leave_no_node_behind() {
    let topic = topic("deaf");
    let node = Node::open(0, "here", [1; 16]).await.unwrap();
    let publisher = node.publisher(&topic).await.unwrap();
    let mut subscriber =
        Node::open(0, "there", [2; 16]).await.unwrap().subscriber(&topic, Limits::default()).await.unwrap();
    let mut killed = Vec::new();
    // More often than there are places for subscribers.
    for number in 0..u8::try_from(shm::SUBSCRIBERS_MAX + 2).unwrap() {
        let mut child = start(&topic, "child_listens_until_it_is_killed");
        let mut pause = tokio::time::interval(Duration::from_millis(5));
        let both = async {
            while publisher.subscribers() < 2 {
                pause.tick().await;
            }
        };
        tokio::time::timeout(DEADLINE, both).await.unwrap();
        child.kill().unwrap();
        child.wait().unwrap();
        killed.push(child.id());
        publisher.write(&sample(number, 52)).unwrap();
        assert_eq!(next(&mut subscriber).await.sample, sample(number, 52));
    }
    // The next node to start takes away what is left of them.
    let _next = Node::open(0, "next", [4; 16]).await.unwrap();
    let mut left = Vec::new();
    iceoryx2::node::Node::<ipc_threadsafe::Service>::list(&shm::config().unwrap(), |state| {
        if let NodeState::Dead(view) = state {
            left.push(view.id().pid::<ipc_threadsafe::Service>().unwrap().value().cast_unsigned());
        }
        CallbackProgression::Continue
    })
    .unwrap();
    left.retain(|pid| killed.contains(pid));
    assert_eq!(left, [0; 0]);
}

#[test]
fn shared_memory_through_a_link_is_rejected_and_otherwise_below_the_directory_of_the_session() {
    let session = tempfile::tempdir().unwrap();
    let said = || {
        let mut child = Command::new(env::current_exe().unwrap());
        child.args(["--exact", "shm::child_says_whether_it_opens_shared_memory", "--nocapture"]);
        let child = child.env(CHILD_TOPIC, "").env("XDG_RUNTIME_DIR", session.path());
        String::from_utf8_lossy(&child.output().unwrap().stdout).into_owned()
    };
    let (elsewhere, own) = (session.path().join("elsewhere"), session.path().join("iceoryx2"));
    std::fs::create_dir(&elsewhere).unwrap();
    std::os::unix::fs::symlink(&elsewhere, &own).unwrap();
    let refused = said();
    assert!(refused.contains("is not safe to use") && refused.contains("a link"), "{refused}");
    assert_eq!(std::fs::read_dir(&elsewhere).unwrap().count(), 0);
    std::fs::remove_file(&own).unwrap();
    let opened = said();
    assert!(opened.contains("opened") && own.join("nodes").exists(), "{opened}");
}

/// Not a test of its own: a process with a session of its own.
#[tokio::test]
async fn child_says_whether_it_opens_shared_memory() {
    let Ok(_) = env::var(CHILD_TOPIC) else { return };
    match Node::open(0, "child", [6; 16]).await {
        Ok(_) => println!("opened"),
        Err(error) => println!("{error}"),
    }
}

fn start_child(topic: &TopicName) -> Child {
    start(topic, "child_publishes_until_it_is_killed")
}

fn start(topic: &TopicName, child: &str) -> Child {
    Command::new(env::current_exe().unwrap())
        .args(["--exact", &format!("shm::{child}")])
        .env(CHILD_TOPIC, topic.as_str())
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap()
}

/// Not a test of its own: the other process of the test above.
#[tokio::test]
async fn child_publishes_until_it_is_killed() {
    let Ok(topic) = env::var(CHILD_TOPIC) else { return };
    let node = Node::open(0, "child", [3; 16]).await.unwrap();
    let publisher = node.publisher(&TopicName::parse(&topic).unwrap()).await.unwrap();
    let mut pause = tokio::time::interval(Duration::from_millis(5));
    loop {
        pause.tick().await;
        publisher.write(&sample(9, 52)).unwrap();
    }
}

/// As above, for a subscriber.
#[tokio::test]
async fn child_listens_until_it_is_killed() {
    let Ok(topic) = env::var(CHILD_TOPIC) else { return };
    let node = Node::open(0, "child", [3; 16]).await.unwrap();
    let mut subscriber = node.subscriber(&TopicName::parse(&topic).unwrap(), Limits::default()).await.unwrap();
    while subscriber.next().await.is_some() {}
}

/// As above, for one that does both.
#[tokio::test]
async fn child_says_what_it_hears_until_it_is_killed() {
    let Ok(topic) = env::var(CHILD_TOPIC) else { return };
    let topic = TopicName::parse(&topic).unwrap();
    let node = Node::open(0, "child", [5; 16]).await.unwrap();
    let mut subscriber = node.subscriber(&topic, Limits::default()).await.unwrap();
    let publisher = node.publisher(&echo_of(&topic)).await.unwrap();
    while let Some(incoming) = subscriber.next().await {
        publisher.write(&incoming.sample).unwrap();
    }
}
