//! How routes start, each by itself.

use super::*;

const TWIST_ROUTE: &str = "[[route]]\nservice = 'T/cmd_vel'\ntype = 'geometry_msgs/msg/Twist'";
const WRONG_ROUTE: &str = "[[route]]\nservice = 'T/cmd_vel'\ntype = 'std_msgs/msg/String'";

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_route_to_a_service_whose_rule_is_not_known_is_refused_at_the_start() {
    let network = Network::until(2900);
    let fake = Fake::new("limited", &network);
    let text = "[[route]]\nservice = 'T/cmd_vel'\ntype = 'geometry_msgs/msg/Twist'\ndirection = 'to_ledger'";
    let config = Config::parse(text, Path::new(""), |_| ()).unwrap();
    let refused = Bridge::start_with(config, fake, &context(&network)).await.unwrap_err();
    assert_eq!(refused.code, Code::UnknownMode);
    assert_eq!(refused.message, "T/cmd_vel is in mode limited, which this bridge does not support");
    assert_eq!(refused.found, "capability \"places\" with the value \"2\"");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_route_of_another_type_is_refused_at_the_start() {
    let network = Network::until(2900);
    let fake = Fake::new("exclusive", &network);
    let text = "[[route]]\nservice = 'T/cmd_vel'\ntype = 'std_msgs/msg/String'\ndirection = 'to_ledger'";
    let config = Config::parse(text, Path::new(""), |_| ()).unwrap();
    let refused = Bridge::start_with(config, fake, &context(&network)).await.unwrap_err();
    assert_eq!(refused.code, Code::WrongType);
    assert_eq!((&refused.found[..], &refused.wanted[..]), ("std_msgs/msg/String", "geometry_msgs/msg/Twist"));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_route_that_cannot_start_waits_while_the_others_carry_messages_and_starts_when_it_can() {
    if !network::isolated(&|| ()) {
        return;
    }
    let network = Network::until(2900);
    let fake = Fake::new("exclusive", &network);
    fake.set_own_epoch(3);
    beside::prepare().await;
    let transport = beside::transport();
    let text = format!(
        "domain_id = {DOMAIN}\n{transport}\nshared_memory = false\n{TWIST_ROUTE}\ndirection = 'to_ledger'\n\
         {WRONG_ROUTE}\ndirection = 'from_ledger'\ntopic = '/watched'"
    );
    let config = Config::parse(&text, Path::new(""), |_| ()).unwrap();
    let bridge = Bridge::start_with(config, fake.clone(), &context(&network)).await.unwrap();
    let graph = Beside::open("beside").await;
    let bench = Bench { fake, network, bridge, graph };
    let waiting = |bench: &Bench| bench.bridge.summary().routes[1].waiting.clone();
    let reason = waiting(&bench).unwrap();
    assert!(reason.starts_with("LGR-3012 the route of T/cmd_vel has another type"), "{reason}");
    let writer = bench.writer().await;
    writer.write(&twist(1)).unwrap();
    bench.sets(1).await;
    bench.fake.set_type("std_msgs/msg/String");
    let opened = async {
        while waiting(&bench).is_some() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(DEADLINE, opened).await.unwrap();
    let text = TypeName::parse("std_msgs/msg/String").unwrap();
    let watched = TopicName::parse("/watched").unwrap();
    let reader = bench.graph.reader(&watched, &text, &Qos::default(), Limits::default()).await.unwrap();
    assert!(tokio::time::timeout(DEADLINE, reader.matched().at_least(1)).await.unwrap());
    assert_eq!(bench.bridge.stop().await.routes[0].submitted, 1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn of_two_routes_that_close_a_circle_by_the_topic_of_their_service_the_second_waits() {
    if !network::isolated(&|| ()) {
        return;
    }
    let network = Network::until(2900);
    let fake = Fake::new("exclusive", &network);
    let text = format!(
        "domain_id = {DOMAIN}\nshared_memory = false\n{TWIST_ROUTE}\ndirection = 'to_ledger'\n\
         {TWIST_ROUTE}\ndirection = 'from_ledger'\ntopic = '/cmd_vel'"
    );
    let config = Config::parse(&text, Path::new(""), |_| ()).unwrap();
    let bridge = Bridge::start_with(config, fake, &context(&network)).await.unwrap();
    let [first, second] = bridge.stop().await.routes.try_into().unwrap();
    assert_eq!(first.waiting, None);
    assert!(second.waiting.unwrap().contains("routes 1 and 2 close a circle"));
}

/// The first message on `/diagnostics` with these words.
async fn diagnosis(bench: &Bench, words: &str) -> String {
    diagnosis_with(bench, |yaml| yaml.contains(words)).await
}

/// The first message on `/diagnostics` of which that holds.
async fn diagnosis_with(bench: &Bench, holds: impl Fn(&str) -> bool) -> String {
    let kind = "diagnostic_msgs/msg/DiagnosticArray";
    let (topic, message) = (TopicName::parse("/diagnostics").unwrap(), TypeName::parse(kind).unwrap());
    let mut reader = bench.graph.reader(&topic, &message, &Qos::default(), Limits::default()).await.unwrap();
    let array = crate::graph::messages::builtin::of(kind).unwrap();
    let heard = async {
        loop {
            let yaml = array.decode(reader.next().await.unwrap().sample.wire()).unwrap().to_yaml(None);
            if holds(&yaml) {
                break yaml;
            }
        }
    };
    tokio::time::timeout(DEADLINE, heard).await.unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn diagnostics_warn_of_a_publisher_beside_the_bridge() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("exclusive", "direction = 'from_ledger'", |_| ()).await;
    let (topic, message) = names();
    let _stranger = bench.graph.writer(&topic, &message, &Qos::default()).await.unwrap();
    let alive = async {
        loop {
            bench.fake.heartbeat(micros());
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    tokio::select! {
        yaml = diagnosis(&bench, "1 publish on /cmd_vel beside this bridge") => assert!(yaml.contains("level: 1"), "{yaml}"),
        () = alive => {}
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn diagnostics_show_each_route_and_why_it_is_silent() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("exclusive", "direction = 'to_ledger'", |fake| fake.set_own_epoch(3)).await;
    let yaml = diagnosis(&bench, "silent").await;
    for wanted in [
        "name: 'ledgerd_bridge: ledger'",
        "name: 'ledgerd_bridge: T/cmd_vel to_ledger'",
        "message: 'silent: nobody publishes on /cmd_vel'",
        "hardware_id: Org2/T",
    ] {
        assert!(yaml.contains(wanted), "{wanted}: {yaml}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn diagnostics_name_the_holder_on_the_robots_side_and_on_a_users() {
    if !network::isolated(&|| ()) {
        return;
    }
    for direction in ["from_ledger", "to_ledger"] {
        let more = format!("direction = '{direction}'");
        let bench = bench("exclusive", &more, |fake| fake.set_holder("Org1/Salma", 3, 60_000)).await;
        let named = |name: &'static str| diagnosis_with(&bench, move |yaml| yaml.contains(name));
        named("value: Org1/Salma").await;
        bench.fake.set_free();
        bench.fake.deliver(micros(), "released", &released("Org1/Salma", 3), None);
        diagnosis_with(&bench, |yaml| yaml.contains("key: holder") && !yaml.contains("Org1/Salma")).await;
        bench.fake.set_holder("Org1/Farhad", 4, 60_000);
        bench.fake.deliver(micros(), "granted", &json!(held_by("Org1/Farhad", 4, 60_000)), None);
        named("value: Org1/Farhad").await;
        bench.bridge.stop().await;
    }
}

/// The event of a grant that has ended.
fn released(holder: &str, epoch: u64) -> serde_json::Value {
    json!({ "service": "T/cmd_vel", "holder": holder, "epoch": epoch, "reason": "released" })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_program_that_comes_late_hears_who_holds_the_service_and_then_that_nobody_does() {
    if network::isolated(&|| ()) {
        shows_the_holder("from_ledger").await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_program_on_a_users_side_hears_who_holds_the_service_too() {
    if network::isolated(&|| ()) {
        shows_the_holder("to_ledger").await;
    }
}

async fn shows_the_holder(direction: &str) {
    let more = format!("direction = '{direction}'\nholder_topic = '/t/holder'");
    let bench = bench("exclusive", &more, |fake| fake.set_holder("Org1/Salma", 3, 60_000)).await;
    let (topic, kind) = (TopicName::parse("/t/holder").unwrap(), TypeName::parse("std_msgs/msg/String").unwrap());
    let latched = Qos { durability: crate::graph::qos::Durability::TransientLocal, ..Qos::default() };
    let mut reader = bench.graph.reader(&topic, &kind, &latched, Limits::default()).await.unwrap();
    let text = crate::graph::messages::builtin::of("std_msgs/msg/String").unwrap();
    let hear = async |reader: &mut Reader| {
        let heard = tokio::time::timeout(DEADLINE, reader.next()).await.unwrap().unwrap();
        text.decode(heard.sample.wire()).unwrap().to_yaml(None)
    };
    let first = hear(&mut reader).await;
    assert!(first.contains("Org1/Salma") && first.contains(r#""epoch":3"#), "{first}");
    bench.fake.set_free();
    bench.fake.deliver(micros(), "released", &released("Org1/Salma", 3), None);
    let second = hear(&mut reader).await;
    assert!(second.contains(r#""holders":[]"#), "{second}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn the_topic_of_the_holder_is_not_that_of_the_route() {
    if !network::isolated(&|| ()) {
        return;
    }
    let network = Network::until(2900);
    for direction in ["from_ledger", "to_ledger"] {
        let route = format!("{TWIST_ROUTE}\ndirection = '{direction}'\nholder_topic = '/cmd_vel'");
        let config = Config::parse(&format!("shared_memory = false\n{route}"), Path::new(""), |_| ()).unwrap();
        let fake = Fake::new("exclusive", &network);
        let refused = Bridge::start_with(config, fake, &context(&network)).await.unwrap_err();
        assert_eq!(refused.message, "two kinds of messages cannot share a topic", "{direction}");
    }
}
