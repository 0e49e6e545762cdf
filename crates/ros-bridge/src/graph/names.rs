//! Names of topics, types and nodes: ROS 2's on our side, DDS's on the wire.
//!
//! ROS 2 maps a topic `/cmd_vel` to the DDS topic `rt/cmd_vel`, and a message type
//! `geometry_msgs/msg/Twist` to the DDS type `geometry_msgs::msg::dds_::Twist_`. A name that is
//! wrong in a way we recognise is refused with the name that was probably meant.

use std::fmt;

use crate::error::{Error, Explained, Result};

/// Longest topic name in bytes: DDS allows 255, ROS 2 keeps 8 of them for its prefixes.
pub const TOPIC_NAME_BYTES_MAX: usize = 247;
/// Longest type or node name in bytes.
pub const TYPE_NAME_BYTES_MAX: usize = 255;

/// Types that people name without their package; used for suggestions only.
const WELL_KNOWN: [&str; 14] = [
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/Pose",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/TransformStamped",
    "nav_msgs/msg/Odometry",
    "nav_msgs/msg/Path",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/PointCloud2",
    "std_msgs/msg/String",
    "tf2_msgs/msg/TFMessage",
];

/// An absolute, fully expanded ROS 2 topic name such as `/robot1/cmd_vel`.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TopicName(String);

/// The name of a ROS 2 type: of a message such as `geometry_msgs/msg/Twist`, of a service, or of an action.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TypeName {
    package: String,
    interface: Interface,
    name: String,
}

/// The way in which nodes use a type.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Interface {
    /// They publish messages and subscribe to them.
    Message,
    /// One calls, another replies.
    Service,
    /// One sets goals, another works on them, and tells how far it is.
    Action,
}

impl Interface {
    const ALL: [Self; 3] = [Self::Message, Self::Service, Self::Action];

    /// The part of a type's name that says it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Message => "msg",
            Self::Service => "srv",
            Self::Action => "action",
        }
    }
}

impl TopicName {
    /// Checks a topic name by the rules of ROS 2.
    ///
    /// Relative names, `~` and `{substitutions}` are refused: a bridge has no node whose namespace
    /// could complete them.
    pub fn parse(text: &str) -> Result<Self> {
        match topic_fault(text) {
            None => Ok(Self(text.to_owned())),
            Some(fault) => {
                let hint = repaired_topic(text).map_or(String::new(), |name| format!("{name:?}"));
                let what = format!("topic name is not valid: {fault}");
                Err(Error::Name(Explained::new(what, quoted(text), "an absolute name such as \"/cmd_vel\"", hint)))
            }
        }
    }

    /// The name itself, or the nearest one that ROS 2 allows.
    pub(crate) fn near(text: &str) -> Option<Self> {
        if topic_fault(text).is_none() { Some(Self(text.to_owned())) } else { repaired_topic(text).map(Self) }
    }

    /// The name with a part behind it, such as `/_action/status`.
    ///
    /// # Errors
    /// As [`TopicName::parse`]: the whole may be too long.
    pub(crate) fn below(&self, part: &str) -> Result<Self> {
        Self::parse(&format!("{}{part}", self.0))
    }

    /// The name as ROS 2 writes it, `/cmd_vel`.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The name of the DDS topic, `rt/cmd_vel`.
    pub fn dds(&self) -> String {
        format!("rt{}", self.0)
    }
}

impl TypeName {
    /// Checks the name of a type by the rules of ROS 2.
    pub fn parse(text: &str) -> Result<Self> {
        match split_type(text) {
            Ok((package, interface, name)) => {
                Ok(Self { package: package.to_owned(), interface, name: name.to_owned() })
            }
            Err(fault) => {
                let hint = repaired_type(text).map_or(String::new(), |name| format!("{name:?}"));
                let what = format!("message type is not valid: {fault}");
                let wanted = "package/msg/Name such as \"geometry_msgs/msg/Twist\"";
                Err(Error::Type(Explained::new(what, quoted(text), wanted, hint)))
            }
        }
    }

    /// The name of the DDS type, `geometry_msgs::msg::dds_::Twist_`.
    pub fn dds(&self) -> String {
        format!("{}::{}::dds_::{}_", self.package, self.interface.name(), self.name)
    }

    /// The way in which nodes use it.
    pub fn interface(&self) -> Interface {
        self.interface
    }

    /// The type of a part of a service or an action, such as `_Request`.
    pub(crate) fn part(&self, suffix: &str) -> Self {
        Self { name: format!("{}{suffix}", self.name), ..self.clone() }
    }
}

impl fmt::Display for TopicName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl fmt::Display for TypeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{}", self.package, self.interface.name(), self.name)
    }
}

/// The fault of a topic name, if it has one.
fn topic_fault(text: &str) -> Option<String> {
    if text.is_empty() {
        return Some("it is empty".to_owned());
    }
    if text.len() > TOPIC_NAME_BYTES_MAX {
        return Some(format!("it has {} bytes, at most {TOPIC_NAME_BYTES_MAX} are allowed", text.len()));
    }
    let Some(rest) = text.strip_prefix('/') else {
        return Some("it does not begin with '/'".to_owned());
    };
    rest.split('/').find_map(token_fault)
}

/// The fault of one part of a name between slashes, if it has one.
fn token_fault(token: &str) -> Option<String> {
    if token.is_empty() {
        return Some("it has an empty part: two slashes in a row, or one at the end".to_owned());
    }
    if let Some(bad) = token.chars().find(|c| !(c.is_ascii_alphanumeric() || *c == '_')) {
        return Some(format!("{bad:?} is not allowed, only letters, digits, '_' and '/'"));
    }
    if token.starts_with(|c: char| c.is_ascii_digit()) {
        return Some(format!("the part {token:?} begins with a digit"));
    }
    token.contains("__").then(|| format!("the part {token:?} has two underscores in a row"))
}

/// The topic name that was probably meant.
fn repaired_topic(text: &str) -> Option<String> {
    if text.len() > TOPIC_NAME_BYTES_MAX {
        return None;
    }
    let text = text.trim();
    let text = text.strip_prefix("rt/").unwrap_or(text);
    let clean: String = text.chars().map(|c| if c.is_ascii_alphanumeric() || c == '/' { c } else { '_' }).collect();
    let tokens: Vec<String> = clean
        .split('/')
        .map(|token| token.split('_').filter(|word| !word.is_empty()).collect::<Vec<_>>().join("_"))
        .filter(|token| !token.is_empty())
        .collect();
    let name = format!("/{}", tokens.join("/"));
    topic_fault(&name).is_none().then_some(name)
}

/// The parts of the name of a type, or what is wrong with it.
fn split_type(text: &str) -> std::result::Result<(&str, Interface, &str), String> {
    if text.len() > TYPE_NAME_BYTES_MAX {
        return Err(format!("it has {} bytes, at most {TYPE_NAME_BYTES_MAX} are allowed", text.len()));
    }
    let parts: Vec<&str> = text.split('/').collect();
    let &[package, middle, name] = parts.as_slice() else {
        return Err(format!("it has {} parts between slashes, not three", parts.len()));
    };
    let Some(interface) = Interface::ALL.into_iter().find(|interface| interface.name() == middle) else {
        return Err(format!("the middle part is {middle:?}, not \"msg\", \"srv\" or \"action\""));
    };
    let lower = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    if !package.starts_with(|c: char| c.is_ascii_lowercase()) || !package.chars().all(lower) {
        return Err(format!("{package:?} is no package name: small letters, digits and '_' only"));
    }
    let upper = |c: char| c.is_ascii_uppercase();
    if !name.starts_with(upper) || !name.chars().all(|c| c.is_ascii_alphanumeric()) {
        return Err(format!("{name:?} is no message name: letters and digits, the first a capital"));
    }
    Ok((package, interface, name))
}

/// The type name that was probably meant.
fn repaired_type(text: &str) -> Option<String> {
    if text.len() > TYPE_NAME_BYTES_MAX {
        return None;
    }
    let parts: Vec<&str> = text
        .trim()
        .split(['/', ':', '.'])
        .filter(|part| !part.is_empty() && *part != "dds_" && *part != "msg" && *part != "msgs")
        .collect();
    let name = match parts.as_slice() {
        [name] => {
            let name = name.trim_end_matches('_');
            let known = |known: &&&str| known.rsplit('/').next().is_some_and(|known| known.eq_ignore_ascii_case(name));
            (*WELL_KNOWN.iter().find(known)?).to_owned()
        }
        [package, name] => {
            let name = name.trim_end_matches('_');
            let mut letters = name.chars();
            let first = letters.next()?.to_ascii_uppercase();
            format!("{}/msg/{first}{}", package.to_ascii_lowercase(), letters.as_str())
        }
        _ => return None,
    };
    split_type(&name).is_ok().then_some(name)
}

/// The text as it goes into a message: quoted, control characters escaped, never longer than a line.
pub(crate) fn quoted(text: &str) -> String {
    let short: String = text.chars().take(80).collect();
    if short.len() < text.len() { format!("{short:?}… ({} bytes)", text.len()) } else { format!("{short:?}") }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn topic_names_map_to_dds_topics() {
        assert_eq!(TopicName::parse("/cmd_vel").unwrap().dds(), "rt/cmd_vel");
        assert_eq!(TopicName::parse("/robot1/arm/cmd_vel").unwrap().dds(), "rt/robot1/arm/cmd_vel");
    }

    #[test]
    fn type_names_map_to_dds_types() {
        let twist = TypeName::parse("geometry_msgs/msg/Twist").unwrap();
        assert_eq!(twist.dds(), "geometry_msgs::msg::dds_::Twist_");
        assert_eq!(twist.to_string(), "geometry_msgs/msg/Twist");
    }

    #[test]
    fn bad_topic_names_are_refused_with_the_name_probably_meant() {
        for (bad, meant) in [
            ("cmd_vel", "/cmd_vel"),
            ("rt/cmd_vel", "/cmd_vel"),
            ("/cmd_vel/", "/cmd_vel"),
            ("//cmd_vel", "/cmd_vel"),
            ("/cmd-vel", "/cmd_vel"),
            ("/cmd__vel", "/cmd_vel"),
            ("~/cmd_vel", "/cmd_vel"),
        ] {
            let error = TopicName::parse(bad).unwrap_err();
            let Error::Name(explained) = error else { unreachable!("{error}") };
            assert_eq!(explained.hint, format!("{meant:?}"), "for {bad:?}");
        }
    }

    #[test]
    fn hopeless_topic_names_are_refused_without_advice() {
        for bad in ["", "/", "/1robot", "/ü/1", &"/a".repeat(200)] {
            let Err(Error::Name(explained)) = TopicName::parse(bad) else { unreachable!("{bad}") };
            assert_eq!(explained.hint, "", "for {bad:?}");
            assert!(explained.to_string().len() < 400);
        }
    }

    #[test]
    fn bad_type_names_are_refused_with_the_name_probably_meant() {
        for bad in [
            "geometry_msgs/Twist",
            "geometry_msgs::msg::Twist",
            "geometry_msgs::msg::dds_::Twist_",
            "geometry_msgs.msg.Twist",
            "geometry_msgs/msgs/Twist",
            "geometry_msgs/msg/twist",
            "Geometry_msgs/msg/Twist",
            "twist",
        ] {
            let Err(Error::Type(explained)) = TypeName::parse(bad) else { unreachable!("{bad}") };
            assert_eq!(explained.hint, "\"geometry_msgs/msg/Twist\"", "for {bad:?}");
        }
    }

    #[test]
    fn nonsense_is_no_type() {
        for bad in ["", "/", "a/b/c/d", "turtlesim/serv/Spawn", "geometry_msgs/msg/Tw ist", "\0"] {
            assert!(TypeName::parse(bad).is_err(), "for {bad:?}");
        }
    }

    #[test]
    fn the_type_of_a_service_has_parts() {
        let spawn = TypeName::parse("turtlesim/srv/Spawn").unwrap();
        assert_eq!((spawn.interface(), spawn.to_string().as_str()), (Interface::Service, "turtlesim/srv/Spawn"));
        assert_eq!(spawn.part("_Request").dds(), "turtlesim::srv::dds_::Spawn_Request_");
        let rotate = TypeName::parse("turtlesim/action/RotateAbsolute").unwrap();
        assert_eq!(rotate.interface(), Interface::Action);
        assert_eq!(rotate.part("_FeedbackMessage").dds(), "turtlesim::action::dds_::RotateAbsolute_FeedbackMessage_");
    }
}
