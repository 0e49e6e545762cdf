//! Configurations with and without faults.
#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use super::*;
use crate::{
    graph::qos::{Durability, Qos, Reliability},
    routes::kinds::KINDS,
};

const ROUTE: &str = "[[route]]\nservice = 'T/cmd_vel'\ntype = 'geometry_msgs/msg/Twist'\n";

fn parse(text: &str) -> Result<Config, Vec<Fault>> {
    Config::parse(text, Path::new("/etc/ledgerd/bridge.toml"), |_| ())
}

#[test]
fn a_short_configuration_has_defaults() {
    let config = parse(&format!("{ROUTE}direction = 'from_ledger'")).unwrap();
    assert_eq!(config.identity, IdentitySource::Selected);
    assert_eq!((config.domain_id, config.shared_memory), (None, true));
    let route = &config.routes[0];
    assert_eq!(route.kind.name, "from_ledger");
    assert_eq!(
        format!("{:?}", route.plan),
        "Settings { max_age: None, stale_after: 1s, command_timeout: None, rogue_publishers: Warn, stop: None, points: Topics { goal: None, path: None }, holder: None, max_rate_hz: None, on_demand: false }"
    );
    assert_eq!(route.limits().queue_samples_max, 100);
}

#[test]
fn a_context_directory_is_relative_to_the_file() {
    let config = parse(&format!("context_dir = 'contexts/Salma'\n{ROUTE}direction = 'to_ledger'")).unwrap();
    assert_eq!(config.identity, IdentitySource::Directory("/etc/ledgerd/contexts/Salma".into()));
}

#[test]
fn every_fault_is_named_at_once_with_its_line() {
    let text = "domain_id = 233\ncontexts = 'x'\n[[route]]\nservice = 'T'\ndirection = 'to_ledger'\ntopic = 'cmd'\n\
                type = 'Twist'\nbatch_max = 0\nmax_age_ms = 5\n[[route]]\nservise = 'a/b'\nqos = { depth = 0 }";
    let told: Vec<String> = parse(text).unwrap_err().iter().map(ToString::to_string).collect();
    let wanted = [
        (1, "domain_id has a wrong value", "a whole number from 0 to 232"),
        (2, "the top level has no setting \"contexts\"", "did you mean context?"),
        (4, "route[1].service has a wrong value", "ROBOT/TOPIC"),
        (6, "route[1].topic: ", "\"/cmd\""),
        (7, "route[1].type: ", "geometry_msgs/msg/Twist"),
        (8, "route[1].batch_max has a wrong value", "from 1 to 256"),
        (9, "[route[1]] has no setting \"max_age_ms\"", "one of service"),
        (10, "route[2].service is missing", "ROBOT/TOPIC"),
        (10, "route[2].direction is missing", "to_ledger"),
        (10, "route[2].type is missing", "geometry_msgs/msg/Twist"),
        (11, "[route[2]] has no setting \"servise\"", "did you mean route[2].service?"),
        (12, "route[2].qos.depth has a wrong value", "from 1 to 10000"),
    ];
    assert_eq!(told.len(), wanted.len(), "{told:#?}");
    for (told, (line, fault, hint)) in told.iter().zip(wanted) {
        assert!(told.starts_with(&format!("/etc/ledgerd/bridge.toml:{line}: {fault}")), "{told}");
        assert!(told.contains(hint), "{told}");
    }
}

#[test]
fn quality_of_service_is_read_by_the_names_of_ros() {
    let qos = "qos = { reliability = 'best_effort', durability = 'transient_local', depth = 5 }";
    let config = parse(&format!("{ROUTE}direction = 'to_ledger'\n{qos}")).unwrap();
    let wanted = Qos::new(Reliability::BestEffort, Durability::TransientLocal, 5);
    assert_eq!(config.routes[0].qos, wanted);
    for bad in ["reliabilty = 'reliable'", "reliability = 'maybe'", "depth = -1"] {
        assert!(parse(&format!("{ROUTE}direction = 'to_ledger'\nqos = {{ {bad} }}")).is_err(), "{bad}");
    }
}

#[test]
fn a_bridge_has_a_route() {
    for text in ["", "route = []", "route = 5", "route = [5]"] {
        let faults = parse(text).unwrap_err();
        assert!(faults[0].rejection.wanted.contains("1 to 128 sections [[route]]"), "{faults:?}");
    }
    assert!(parse(&format!("{ROUTE}direction = 'to_ledger'\n").repeat(ROUTES_MAX + 1)).is_err());
}

#[test]
fn a_service_goes_one_way_once() {
    let twice = format!("{ROUTE}direction = 'to_ledger'\n{ROUTE}direction = 'to_ledger'");
    assert!(parse(&twice).unwrap_err()[0].to_string().starts_with("/etc/ledgerd/bridge.toml:5: two routes carry"));
    let watched = format!("{ROUTE}direction = 'to_ledger'\n{ROUTE}direction = 'from_ledger'\ntopic = '/watched'");
    assert!(parse(&watched).is_ok());
}

#[test]
fn two_routes_that_close_a_circle_are_refused_and_both_named() {
    for topic in ["", "topic = '/drive'\n"] {
        let text = format!("{ROUTE}{topic}direction = 'to_ledger'\n{ROUTE}{topic}direction = 'from_ledger'");
        let faults = parse(&text).unwrap_err();
        let [Fault { rejection: fault, .. }] = faults.as_slice() else { unreachable!("{faults:?}") };
        assert!(fault.message.contains("routes 1 and 2 close a circle"), "{fault}");
        assert!(
            fault.found.contains("T/cmd_vel to_ledger") && fault.found.contains("T/cmd_vel from_ledger"),
            "{fault}"
        );
    }
}

#[test]
fn routes_that_differ_in_one_setting_are_not_the_same() {
    let of = |more: &str| parse(&format!("{ROUTE}{more}")).unwrap().routes.remove(0);
    let up = "direction = 'to_ledger'";
    assert_eq!(of(up).text(), of(up).text());
    for more in ["batch_max = 2", "max_rate_hz = 5", "topic = '/x'", "qos = { depth = 3 }", "sample_bytes_max = 64"] {
        assert_ne!(of(up).text(), of(&format!("{up}\n{more}")).text(), "{more}");
    }
    assert_ne!(of(up).text(), of(&format!("{up}\nholder_topic = '/holder'")).text());
    let down = "direction = 'from_ledger'";
    for more in ["max_age_ms = 5", "stop_hex = '00010000ff'", "goal_topic = '/goal'", "side_door = 'stop'"] {
        assert_ne!(of(down).text(), of(&format!("{down}\n{more}")).text(), "{more}");
    }
}

#[test]
fn a_rate_and_a_batch_exclude_each_other() {
    let text = format!("{ROUTE}direction = 'to_ledger'\nbatch_max = 4\nmax_rate_hz = 10");
    let faults = parse(&text).unwrap_err();
    assert!(faults[0].to_string().contains("batch_max") && faults[0].to_string().contains("max_rate_hz"), "{faults:?}");
}

#[test]
fn a_kind_of_route_carries_types_of_its_own_kind() {
    let types = ["geometry_msgs/msg/Twist", "std_srvs/srv/SetBool", "example_interfaces/action/Fibonacci"];
    for kind in KINDS {
        for of in types {
            let text = format!("{}direction = '{}'", ROUTE.replace(types[0], of), kind.name);
            let faults = parse(&text).err().unwrap_or_default();
            let fits = of.contains(&format!("/{}/", kind.carries.name()));
            assert_eq!(faults.len(), usize::from(!fits), "{kind:?} {of} {faults:?}");
            assert!(faults.iter().all(|fault| fault.to_string().contains("direction conflicts with")), "{faults:?}");
        }
    }
}

#[test]
fn a_stop_message_is_written_in_the_words_of_its_type() {
    let plan = |of: &str, more: &str| {
        let text = format!("{}direction = 'from_ledger'\n{more}", ROUTE.replace("geometry_msgs/msg/Twist", of));
        parse(&text).map(|config| format!("{:?}", config.routes[0].plan))
    };
    let joy = plan("sensor_msgs/msg/Joy", r#"stop = '{"axes": [0.0, 0.0], "buttons": [1]}'"#).unwrap();
    let header = "00010000".to_owned() + &"00".repeat(8) + "0100000000000000";
    let hex = format!("stop_hex = '{header}0200000000000000000000000100000001000000'");
    let hex = plan("sensor_msgs/msg/Joy", &hex).unwrap();
    assert_eq!(joy, hex);
    let faults = [
        ("sensor_msgs/msg/Joy", "stop = '{\"axis\": [0]}'", "axis"),
        ("sensor_msgs/msg/Joy", "stop = '{'", "stop"),
        ("arm_msgs/msg/Grip", "stop = '{}'", "arm_msgs/msg/Grip"),
        ("sensor_msgs/msg/Joy", "stop = '{}'\nstop_hex = '00010000ff'", "stop_hex"),
    ];
    for (of, more, word) in faults {
        let faults = plan(of, more).unwrap_err();
        assert!(faults.len() == 1 && faults[0].to_string().contains(word), "{faults:?}");
    }
}

#[test]
fn a_stop_message_is_cdr() {
    for (hex, good) in [("00010000ff", true), ("0001", false), ("ffff0000", false), ("zz", false)] {
        let text = format!("{ROUTE}direction = 'from_ledger'\nstop_hex = '{hex}'");
        assert_eq!(parse(&text).is_ok(), good, "{hex}");
    }
}
