//! The files of SROS2: which enclave may do what. Without IO.
//!
//! A profile is a list of rules. The policy of ROS 2 tells them in the words of ROS, and the permissions of DDS Security as
//! names of DDS topics: `ros2 security create_permission` makes the same of a policy. Denials come first, because the first rule
//! that fits counts.

use ros_bridge::Guarded;
use ros_bridge::names::{Interface, TopicName};

/// The topic by which the nodes of ROS 2 find each other: everybody has it.
const GRAPH: &str = "ros_discovery_info";
/// Everything of its kind.
const ALL: &str = "/*";

/// The right to do something in a graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Right {
    Publish,
    Subscribe,
    Request,
    Reply,
    Call,
    Execute,
}

/// Names, and what may or may not be done with them.
struct Rule {
    right: Right,
    is_allowed: bool,
    names: Vec<String>,
}

/// The rules of an enclave.
pub(super) struct Enclave {
    /// Its path, such as `/base`; `/` is the one of everybody without a path.
    pub(super) path: String,
    rules: Vec<Rule>,
}

impl Right {
    /// As a policy names it: the list, its entries, and the attribute.
    fn words(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Self::Publish => ("topics", "topic", "publish"),
            Self::Subscribe => ("topics", "topic", "subscribe"),
            Self::Request => ("services", "service", "request"),
            Self::Reply => ("services", "service", "reply"),
            Self::Call => ("actions", "action", "call"),
            Self::Execute => ("actions", "action", "execute"),
        }
    }

    /// The DDS topics that one publishes and subscribes for it.
    fn topics(self, name: &str) -> (Vec<String>, Vec<String>) {
        let service = |name: &str| (vec![format!("rq{name}Request")], vec![format!("rr{name}Reply")]);
        let action = || {
            let parts = ["cancel_goal", "get_result", "send_goal"].map(|part| format!("{name}/_action/{part}"));
            let (asked, replied): (Vec<_>, Vec<_>) = parts.iter().map(|part| service(part)).unzip();
            let told = ["feedback", "status"].map(|part| format!("rt{name}/_action/{part}"));
            (asked.concat(), replied.into_iter().flatten().chain(told).collect())
        };
        let swapped = |(one, other): (Vec<String>, Vec<String>)| (other, one);
        match self {
            Self::Publish => (vec![format!("rt{name}")], Vec::new()),
            Self::Subscribe => (Vec::new(), vec![format!("rt{name}")]),
            Self::Request => service(name),
            Self::Reply => swapped(service(name)),
            Self::Call => action(),
            Self::Execute => swapped(action()),
        }
    }

    /// To use what a bridge guards.
    fn to_use(interface: Interface) -> Self {
        match interface {
            Interface::Message => Self::Publish,
            Interface::Service => Self::Request,
            Interface::Action => Self::Call,
        }
    }
}

fn rule(right: Right, is_allowed: bool, names: &[&str]) -> Rule {
    Rule { right, is_allowed, names: names.iter().map(|name| (*name).to_owned()).collect() }
}

/// The rules about what is guarded, one for each kind of it.
fn doors(guarded: &[Guarded], is_allowed: bool) -> impl Iterator<Item = Rule> {
    let kinds = [Interface::Message, Interface::Service, Interface::Action];
    let of = move |interface| {
        let same = guarded.iter().filter(|door| door.interface == interface);
        let names: Vec<String> = same.map(|door| door.name.as_str().to_owned()).collect();
        (!names.is_empty()).then(|| Rule { right: Right::to_use(interface), is_allowed, names })
    };
    kinds.into_iter().filter_map(of)
}

impl Enclave {
    /// The one that alone may use what is guarded, and else only what every node needs for itself.
    pub(super) fn of_the_relay(path: &str, guarded: &[Guarded]) -> Self {
        let own = format!("/{}/*", node(path));
        let mut rules: Vec<Rule> = doors(guarded, true).collect();
        rules.push(rule(Right::Publish, true, &["/parameter_events", "/rosout"]));
        rules.push(rule(Right::Subscribe, true, &["/parameter_events"]));
        rules.push(rule(Right::Reply, true, &[&own]));
        Self { path: path.to_owned(), rules }
    }

    /// One of the robot's own: everything but what is guarded.
    pub(super) fn of_the_robot(path: &str, guarded: &[Guarded]) -> Self {
        let mut rules: Vec<Rule> = doors(guarded, false).collect();
        let all = [Right::Publish, Right::Subscribe, Right::Reply, Right::Request, Right::Call, Right::Execute];
        rules.extend(all.map(|right| rule(right, true, &[ALL])));
        Self { path: path.to_owned(), rules }
    }

    /// Its part of a policy.
    fn profile(&self) -> String {
        let rules = self.rules.iter().map(|Rule { right, is_allowed, names }| {
            let (list, entry, attribute) = right.words();
            let verdict = if *is_allowed { "ALLOW" } else { "DENY" };
            let names: String = names.iter().map(|name| format!("            <{entry}>{name}</{entry}>\n")).collect();
            format!("          <{list} {attribute}=\"{verdict}\">\n{names}          </{list}>\n")
        });
        let (path, node, rules) = (&self.path, node(&self.path), rules.collect::<String>());
        format!(
            "    <enclave path=\"{path}\">\n      <profiles>\n        <profile ns=\"/\" node=\"{node}\">\n{rules}        \
             </profile>\n      </profiles>\n    </enclave>\n"
        )
    }

    /// Its permissions in a domain, from and until times as XML has them.
    pub(super) fn permissions(&self, domain: u16, (from, until): (&str, &str)) -> String {
        let verdict = |is_allowed| {
            let rules = self.rules.iter().filter(move |rule| rule.is_allowed == is_allowed);
            let all = rules.flat_map(|rule| rule.names.iter().map(|name| rule.right.topics(name)));
            let (published, subscribed): (Vec<_>, Vec<_>) = all.unzip();
            criteria(
                if is_allowed { "allow_rule" } else { "deny_rule" },
                domain,
                [published.concat(), subscribed.concat()],
            )
        };
        let graph = criteria("allow_rule", domain, [vec![GRAPH.to_owned()], vec![GRAPH.to_owned()]]);
        let (path, rules) = (&self.path, verdict(false) + &verdict(true) + &graph);
        format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<dds>\n  <permissions>\n    <grant name=\"{path}\">\n      \
             <subject_name>CN={path}</subject_name>\n      <validity>\n        <not_before>{from}</not_before>\n        \
             <not_after>{until}</not_after>\n      </validity>\n{rules}      <default>DENY</default>\n    </grant>\n  \
             </permissions>\n</dds>\n"
        )
    }
}

/// A rule of DDS Security; nothing if it names no topic.
fn criteria(name: &str, domain: u16, topics: [Vec<String>; 2]) -> String {
    if topics.iter().all(Vec::is_empty) {
        return String::new();
    }
    let list = |(verb, topics): (&str, Vec<String>)| {
        let topics: String = topics.iter().map(|topic| format!("            <topic>{topic}</topic>\n")).collect();
        let some = format!("        <{verb}>\n          <topics>\n{topics}          </topics>\n        </{verb}>\n");
        if topics.is_empty() { String::new() } else { some }
    };
    let lists: String = ["publish", "subscribe"].into_iter().zip(topics).map(list).collect();
    format!(
        "      <{name}>\n        <domains>\n          <id>{domain}</id>\n        </domains>\n{lists}      </{name}>\n"
    )
}

/// The policy of all enclaves, for `ros2 security create_permission`.
pub(super) fn policy(enclaves: &[Enclave]) -> String {
    let profiles: String = enclaves.iter().map(Enclave::profile).collect();
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<policy version=\"0.2.0\">\n  <enclaves>\n{profiles}  </enclaves>\n</policy>\n"
    )
}

/// The rules for all in a domain, as SROS2 has them. Nobody without a certificate joins, every topic has permissions, and
/// everything is encrypted.
pub(super) fn governance(domain: u16) -> String {
    let switch = |name: &str, value: &str| format!("          <{name}>{value}</{name}>\n");
    let on = ["enable_discovery_protection", "enable_liveliness_protection"].map(|name| switch(name, "true"));
    let access = ["enable_read_access_control", "enable_write_access_control"].map(|name| switch(name, "true"));
    let kinds = ["metadata_protection_kind", "data_protection_kind"].map(|name| switch(name, "ENCRYPT"));
    let topic = [on, access, kinds].concat().concat();
    let kind = |name: &str| format!("      <{name}_protection_kind>ENCRYPT</{name}_protection_kind>\n");
    let whole: String = ["discovery", "liveliness", "rtps"].map(kind).concat();
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<dds>\n  <domain_access_rules>\n    <domain_rule>\n      <domains>\n        \
         <id>{domain}</id>\n      </domains>\n      \
         <allow_unauthenticated_participants>false</allow_unauthenticated_participants>\n      \
         <enable_join_access_control>true</enable_join_access_control>\n{whole}      <topic_access_rules>\n        \
         <topic_rule>\n          <topic_expression>*</topic_expression>\n{topic}        </topic_rule>\n      \
         </topic_access_rules>\n    </domain_rule>\n  </domain_access_rules>\n</dds>\n"
    )
}

/// The path of an enclave as it was typed.
///
/// # Errors
/// Why it is none.
pub(super) fn path(text: &str) -> Result<String, String> {
    match text {
        "/" => Ok(text.to_owned()),
        _ => TopicName::parse(text)
            .map(|name| name.as_str().to_owned())
            .map_err(|_| format!("{text:?} is no enclave: wanted a path such as \"/base\", of letters, digits and _")),
    }
}

/// A name for the node of an enclave: the last part of its path.
fn node(path: &str) -> &str {
    path.rsplit('/').next().filter(|name| !name.is_empty()).unwrap_or("default")
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn guarded(name: &str, interface: Interface) -> Guarded {
        let service = format!("Rover{name}");
        Guarded { name: TopicName::parse(name).unwrap(), interface, service }
    }

    fn all() -> [Guarded; 3] {
        [
            guarded("/cmd_vel", Interface::Message),
            guarded("/go", Interface::Action),
            guarded("/light", Interface::Service),
        ]
    }

    /// The texts between the tags of this name.
    fn inside(text: &str, name: &str) -> Vec<String> {
        let (begin, end) = (format!("<{name}>"), format!("</{name}>"));
        text.split(&begin).skip(1).map(|rest| rest.split(&end).next().unwrap().to_owned()).collect()
    }

    /// The topics that a file names in a rule, for a verb.
    fn topics(permissions: &str, rule: &str, verb: &str) -> Vec<String> {
        let lists = inside(permissions, rule).into_iter().flat_map(|rule| inside(&rule, verb));
        lists.flat_map(|list| inside(&list, "topic")).collect()
    }

    #[test]
    fn an_enclave_of_the_robot_may_do_all_but_use_what_is_guarded_and_is_denied_that_first() {
        let file =
            Enclave::of_the_robot("/base", &all()).permissions(4, ("2026-01-01T00:00:00", "2036-01-01T00:00:00"));
        assert!(file.find("deny_rule").unwrap() < file.find("allow_rule").unwrap());
        let goal = |part: &str| format!("rq/go/_action/{part}Request");
        let denied = [
            "rt/cmd_vel".to_owned(),
            "rq/lightRequest".into(),
            goal("cancel_goal"),
            goal("get_result"),
            goal("send_goal"),
        ];
        assert_eq!(topics(&file, "deny_rule", "publish"), denied);
        assert!(!topics(&file, "deny_rule", "subscribe").contains(&"rt/cmd_vel".to_owned()), "it listens");
        assert!(topics(&file, "allow_rule", "publish").contains(&"rt/*".to_owned()));
        assert!(topics(&file, "allow_rule", "subscribe").contains(&GRAPH.to_owned()));
        assert!(file.contains("<id>4</id>") && file.contains("<subject_name>CN=/base</subject_name>"), "{file}");
    }

    #[test]
    fn the_relay_may_use_what_is_guarded_and_nothing_else_of_the_robot() {
        let file =
            Enclave::of_the_relay("/r/relay", &all()).permissions(0, ("2026-01-01T00:00:00", "2036-01-01T00:00:00"));
        assert_eq!(topics(&file, "deny_rule", "publish"), [""; 0]);
        let published = topics(&file, "allow_rule", "publish");
        assert!(published.iter().all(|topic| !topic.contains('*') || topic == "rr/relay/*Reply"), "{published:?}");
        for topic in ["rt/cmd_vel", "rq/lightRequest", "rq/go/_action/send_goalRequest", "rt/rosout", GRAPH] {
            assert!(published.contains(&topic.to_owned()), "{topic}: {published:?}");
        }
        let subscribed = topics(&file, "allow_rule", "subscribe");
        assert!(subscribed.contains(&"rt/go/_action/feedback".to_owned()) && !subscribed.contains(&"rt/*".to_owned()));
    }

    #[test]
    fn the_policy_says_the_same_in_the_words_of_ros() {
        let doors = [guarded("/cmd_vel", Interface::Message)];
        let text = policy(&[Enclave::of_the_relay("/relay", &doors), Enclave::of_the_robot("/", &doors)]);
        let [relay, robot] = text.split("<enclave path=").skip(1).collect::<Vec<_>>().try_into().unwrap();
        assert!(relay.contains("<topics publish=\"ALLOW\">\n            <topic>/cmd_vel</topic>"), "{relay}");
        assert!(robot.starts_with("\"/\"") && robot.contains("node=\"default\""), "{robot}");
        assert!(robot.contains("<topics publish=\"DENY\">\n            <topic>/cmd_vel</topic>"), "{robot}");
    }

    #[test]
    fn a_path_of_an_enclave_has_nothing_in_it_that_xml_or_a_shell_could_misread() {
        assert_eq!(path("/turtlebot4/base").unwrap(), "/turtlebot4/base");
        assert_eq!(path("/").unwrap(), "/");
        for bad in ["base", "/a b", "/a<b", "/a'b", "/../x", "/a/", "", "//"] {
            assert!(path(bad).is_err(), "{bad:?}");
        }
    }
}
