//! The output of `ros2`.

/// An endpoint in the output of `ros2 topic info -v`.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Endpoint {
    pub(crate) node: String,
    pub(crate) role: String,
    pub(crate) type_hash: String,
    pub(crate) reliability: String,
}

/// The endpoints that `ros2 topic info -v` shows.
pub(crate) fn endpoints(info: &str) -> Vec<Endpoint> {
    let blocks = info.split("Node name: ").skip(1);
    let endpoint = |block: &str| {
        let after = |name: &str| {
            let line = block.lines().find_map(|line| line.trim().strip_prefix(name));
            line.unwrap_or_default().trim().to_owned()
        };
        let node = block.lines().next().unwrap_or_default().trim().to_owned();
        Endpoint {
            node,
            role: after("Endpoint type:"),
            type_hash: after("Topic type hash:"),
            reliability: after("Reliability:"),
        }
    };
    blocks.map(endpoint).collect()
}

/// The lines that are indented further than this one below it.
pub(crate) fn under<'a>(said: &'a str, title: &'a str) -> impl Iterator<Item = &'a str> {
    let depth = |line: &str| line.len() - line.trim_start().len();
    let mut lines = said.lines().skip_while(move |line| line.trim() != title);
    let title_depth = lines.next().map_or(0, depth);
    lines.take_while(move |line| depth(line) > title_depth).map(str::trim)
}

/// The last rate that `ros2 topic hz` measured.
pub(crate) fn rate(said: &str) -> Option<f64> {
    said.lines().rev().find_map(|line| line.trim().strip_prefix("average rate:")?.trim().parse().ok())
}

#[test]
fn the_output_of_ros2_is_understood() {
    let info = "Type: geometry_msgs/msg/Twist\n\nPublisher count: 1\n\nNode name: ledgerd_bridge\nNode namespace: /\n\
        Topic type: geometry_msgs/msg/Twist\nTopic type hash: RIHS01_9c45\nEndpoint type: PUBLISHER\nGID: 01.12\n\
        QoS profile:\n  Reliability: RELIABLE\n  History (Depth): KEEP_LAST (100)\n  Durability: VOLATILE\n\n\
        Subscription count: 1\n\nNode name: listener\nTopic type hash: INVALID\nEndpoint type: SUBSCRIPTION\n\
        QoS profile:\n  Reliability: BEST_EFFORT\n";
    let shown = endpoints(info);
    let fields: Vec<_> =
        shown.iter().map(|end| [&end.node, &end.role, &end.type_hash, &end.reliability].map(String::as_str)).collect();
    assert_eq!(
        fields,
        [
            ["ledgerd_bridge", "PUBLISHER", "RIHS01_9c45", "RELIABLE"],
            ["listener", "SUBSCRIPTION", "INVALID", "BEST_EFFORT"]
        ]
    );
    let node = "/ledgerd_bridge\n  Subscribers:\n    /driven: geometry_msgs/msg/Twist\n  Publishers:\n    /cmd_vel: \
        geometry_msgs/msg/Twist\n  Service Servers:\n";
    assert_eq!(under(node, "Subscribers:").collect::<Vec<_>>(), ["/driven: geometry_msgs/msg/Twist"]);
    assert_eq!(under(node, "Service Servers:").count(), 0);
    let echo = "linear:\n  x: 7.0\n  y: 0.0\nangular:\n  x: 0.0\n---\n";
    assert_eq!(under(echo, "linear:").collect::<Vec<_>>(), ["x: 7.0", "y: 0.0"]);
    let hz = "average rate: 49.9\n\tmin: 0.019s max: 0.021s\naverage rate: 50.01\n\tmin: 0.019s\n";
    assert_eq!(rate(hz), Some(50.01));
    assert_eq!(rate("WARNING: topic [/cmd_vel] does not appear to be published yet"), None);
}
