#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use super::*;
use ledger_base::rejection::Code;

fn parse(text: &str) -> Result<Config, Vec<Fault>> {
    Config::parse(text, Path::new("ledgerd.toml"))
}

fn faults(text: &str) -> Vec<String> {
    parse(text).unwrap_err().iter().map(ToString::to_string).collect()
}

fn assert_default(config: Result<Config, Vec<Fault>>) {
    assert_eq!(format!("{:?}", config.unwrap()), format!("{:?}", Config::default()));
}

/// The one fault of a text.
fn fault(text: &str) -> String {
    let faults = faults(text);
    assert_eq!(faults.len(), 1, "{faults:#?}");
    faults[0].clone()
}

const SHIPPED: &str = include_str!("../../../ledgerd.toml");

#[test]
fn an_empty_file_is_the_default() {
    assert_default(parse(""));
    assert_default(parse(SHIPPED));
}

#[test]
fn the_shipped_file_lists_every_setting_with_its_default() {
    let uncomment = |line: &str| match line.strip_prefix('#') {
        Some(setting) if !setting.starts_with([' ', '#']) => setting.to_owned(),
        _ => line.to_owned(),
    };
    let uncommented = SHIPPED.lines().map(uncomment).collect::<Vec<_>>().join("\n");
    assert_default(parse(&uncommented));

    // Settings that exist are those that an unknown one is compared with.
    for section in ["", "member", "limits", "storage", "order", "peers", "ca", "log"] {
        let text = if section.is_empty() { "zzz = 1".into() } else { format!("{section}.zzz = 1") };
        let told = fault(&text);
        let known = told.lines().find_map(|line| line.trim().strip_prefix("wanted  one of ")).unwrap();
        let table = uncommented.parse::<toml::Table>().unwrap();
        let table = if section.is_empty() { &table } else { table[section].as_table().unwrap() };
        for name in known.split(", ").filter(|name| *name != "bridge") {
            assert!(table.contains_key(name), "{section}.{name} is missing in ledgerd.toml");
        }
    }
}

#[test]
fn settings_replace_defaults() {
    let config = parse(
        "data = '/var/lib/ledgerd'\nlisten = '[::]:0'\n[limits]\npayload_bytes_max = 2_048\n\
         [log]\nlevel = 'debug'\nformat = 'json'\n[ca]\ncertificate_days = 0x10\n\
         [storage]\nretention = '30d'\narchive = 'old'\n",
    )
    .unwrap();
    assert_eq!(config.storage.retention.to_string(), "30d");
    assert!(fault("[storage]\nretention = '1min'").contains("at least 10min"));
    assert_eq!(config.storage.archive, Path::new("old"));
    assert_eq!(config.data, Path::new("/var/lib/ledgerd"));
    assert_eq!(config.listen, "[::]:0");
    assert_eq!(config.limits.payload_bytes_max, 2048);
    assert_eq!(config.limits.in_flight_max, 65_536);
    assert_eq!((config.log.level, config.log.format), (LevelFilter::DEBUG, LogFormat::Json));
    assert_eq!(config.ca.certificate_days, 16);
}

#[test]
fn addresses_that_are_dialled_all_the_same_are_read_and_faults_name_them() {
    let config = parse("[peers]\nallow = ['*:443', '127.0.0.1:7451']").unwrap();
    assert_eq!(config.allow, ["*:443", "127.0.0.1:7451"].map(|text| text.parse().unwrap()));
    assert!(fault("[peers]\nallow = ['everything']").contains("\"everything\""));
}

#[test]
fn the_profile_is_balanced_unless_the_file_says_low_latency() {
    assert_eq!(parse("").unwrap().profile, Profile::Balanced);
    assert_eq!(parse("profile = 'low-latency'").unwrap().profile, Profile::LowLatency);
    assert!(fault("profile = 'fast'").contains("balanced or low-latency"));
}

#[test]
fn a_setting_that_the_profile_has_replaced_says_so() {
    let told = fault("[order]\nawake_us = 2000");
    assert!(told.starts_with("ledgerd.toml:2: order.awake_us is no longer a setting"), "{told}");
    assert!(told.contains("found   2000") && told.contains("profile = \"low-latency\""), "{told}");
}

#[test]
fn relative_paths_start_at_the_file() {
    let config = Config::parse("data = 'here'", Path::new("/etc/ledgerd/ledgerd.toml")).unwrap();
    assert_eq!(config.data, Path::new("/etc/ledgerd/here"));
    let config = Config::parse("", Path::new("/etc/ledgerd/ledgerd.toml")).unwrap();
    assert_eq!(config.data, Path::new("/etc/ledgerd/data"));
}

#[test]
fn all_faults_are_told_at_once_with_their_lines_and_the_nearest_names() {
    let told = faults(
        "lisen = '0.0.0.0:7450'\n\
         data = 5\n\
         [limits]\n\
         payload_bytes_max = 99999999999\n\
         subscriber_max = 7\n\
         in_flight_max = -1\n\
         [storge]\n\
         segment_mib = 1\n\
         [log]\n\
         level = 'loud'\n\
         [order]\n\
         tick_ms = 'fast'\n",
    );
    let all = told.join("\n");
    assert_eq!(told.len(), 8, "{all}");
    for (i, (line, name, hint)) in [
        (1, "\"lisen\"", "did you mean listen?"),
        (2, "data has a wrong value", "a path"),
        (4, "limits.payload_bytes_max", "from 1024 to 4194304"),
        (5, "\"subscriber_max\"", "did you mean limits.subscribers_max?"),
        (6, "limits.in_flight_max", "-1"),
        (7, "\"storge\"", "did you mean storage?"),
        (10, "log.level", "off, error, warn, info, debug or trace"),
        (12, "order.tick_ms", "'fast'"),
    ]
    .iter()
    .enumerate()
    {
        assert!(told[i].starts_with(&format!("ledgerd.toml:{line}: ")), "{}", told[i]);
        assert!(told[i].contains(name) && told[i].contains(hint), "{}", told[i]);
    }
}

#[test]
fn a_fault_prints_as_four_lines() {
    let told = fault("listen = 7450");
    let lines: Vec<_> = told.lines().collect();
    assert_eq!(
        lines,
        [
            "ledgerd.toml:1: listen has a wrong value [LGR-7001]",
            "  found   7450",
            "  wanted  HOST:PORT, for example \"0.0.0.0:7450\"",
            "  try     correct it, or omit the setting for its default",
        ]
    );
}

#[test]
fn a_name_unlike_any_setting_gets_no_suggestion() {
    let told = fault("[limits]\nzzz = 1");
    assert!(!told.contains("did you mean") && told.contains("[limits] has no setting \"zzz\""), "{told}");
}

#[test]
fn settings_that_do_not_go_together_are_both_named() {
    let told = fault("[order]\ntick_ms = 1\nelection_ticks = 2");
    assert!(told.contains("order.tick_ms") && told.contains("order.election_ticks"), "{told}");
    let told = fault("[limits]\npayload_bytes_max = 1048576\n[storage]\nsegment_mib = 1");
    assert!(told.contains("limits.payload_bytes_max") && told.contains("storage.segment_mib"), "{told}");
}

#[test]
fn the_largest_transaction_fits_a_small_segment_where_nobody_has_set_it() {
    for (settings, bytes) in
        [("", 4 << 20), ("[storage]\nsegment_mib = 8", 4 << 20), ("[storage]\nsegment_mib = 1", 512 << 10)]
    {
        let config = parse(&format!("data = '/var/lib/ledgerd'\nlisten = '[::]:0'\n{settings}"));
        assert_eq!(config.unwrap().limits.payload_bytes_max, bytes, "{settings}");
    }
}

#[test]
fn what_is_not_toml_is_told_with_its_line_and_the_rest_is_still_read() {
    let told = faults("data = \n[limits]\nin_flight = 5\n");
    assert!(told[0].starts_with("ledgerd.toml:1: this is not TOML"), "{told:#?}");
    assert!(told.iter().any(|fault| fault.contains("limits.in_flight_max")), "{told:#?}");
}

#[test]
fn a_setting_given_twice_is_a_fault() {
    assert!(faults("data = 'a'\ndata = 'b'")[0].starts_with("ledgerd.toml:2:"));
}

#[test]
fn a_section_that_is_a_value_and_a_value_that_is_a_section_are_faults() {
    assert!(fault("limits = 5").contains("wanted  a section"));
    assert!(fault("bridge = 5").contains("wanted  a section"));
    assert!(fault("[data]\nx = 1").contains("wanted  a path"));
}

#[test]
fn every_fault_of_the_bridge_is_told_with_its_line_beside_those_of_the_node() {
    let told = faults(
        "listn = 'localhost:7450'\n\
         [bridge]\n\
         domian_id = 7\n\
         report_s = 0\n\
         [[bridge.route]]\n\
         service = 'Turtlebot4'\n\
         direction = 'sideways'\n\
         type = 'Twist'\n",
    );
    let wanted = [
        (1, "the top level has no setting \"listn\"", "did you mean listen?"),
        (3, "[bridge] has no setting \"domian_id\"", "did you mean bridge.domain_id?"),
        (4, "bridge.report_s has a wrong value", "found   0"),
        (6, "bridge.route[1].service has a wrong value", "'Turtlebot4'"),
        (7, "bridge.route[1].direction has a wrong value", "\"to_ledger\" or \"from_ledger\""),
        (8, "bridge.route[1].type: ", "geometry_msgs/msg/Twist"),
    ];
    assert_eq!(told.len(), wanted.len(), "{told:#?}");
    for (told, (line, fault, hint)) in told.iter().zip(wanted) {
        assert!(told.starts_with(&format!("ledgerd.toml:{line}: {fault}")), "{told}");
        assert!(told.contains(hint), "{told}");
    }
}

#[test]
fn only_host_and_port_are_an_address() {
    for good in ["0.0.0.0:7450", "localhost:0", "[::1]:7450", "robot-1.fleet.example:65535"] {
        assert!(parse(&format!("listen = '{good}'")).is_ok(), "{good}");
    }
    for bad in ["", "7450", ":7450", "localhost", "localhost:65536", "::1:7450", "[::1]", "http://a:1", "a b:1"] {
        assert!(fault(&format!("listen = '{bad}'")).contains("wanted  HOST:PORT"), "{bad}");
    }
}

#[test]
fn a_file_that_is_missing_too_large_or_not_text_is_a_fault_of_the_file() {
    let place = tempfile::TempDir::new().unwrap();
    let path = place.path().join("ledgerd.toml");
    let code = || Config::load(&path).unwrap_err()[0].rejection.code;
    assert_eq!(code(), Code::BadFile);
    std::fs::write(&path, "#".repeat(ledger_base::settings::FILE_BYTES_MAX + 1)).unwrap();
    assert_eq!(code(), Code::BadFile);
    std::fs::write(&path, b"data = '\xff'").unwrap();
    assert_eq!(code(), Code::BadConfiguration);
    std::fs::write(&path, "data = 'd'").unwrap();
    assert_eq!(Config::load(&path).unwrap().data, place.path().join("d"));
}

#[test]
fn many_faults_and_deep_nesting_are_bounded() {
    let many: String = (0..1000).map(|i| format!("x{i} = 1\n")).collect();
    assert_eq!(faults(&many).len(), 100);
    let deep = format!("data = {}", "[".repeat(100_000));
    assert!(!faults(&deep).is_empty());
}

#[test]
fn paths_of_the_bridge_are_relative_to_the_file_as_well() {
    let route = "route = [{ service = 'T/cmd_vel', direction = 'to_ledger', type = 'geometry_msgs/msg/Twist' }]";
    let text = format!("[bridge]\ncontext_dir = \"contexts/robot\"\n{route}\n");
    let config = Config::parse(&text, Path::new("/etc/ledgerd/ledgerd.toml")).unwrap();
    let wanted = ros_bridge::IdentitySource::Directory("/etc/ledgerd/contexts/robot".into());
    assert_eq!(config.bridge.unwrap().identity, wanted);
}
