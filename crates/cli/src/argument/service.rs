//! A service on the command line: `TOPIC=TYPE[,KEY=VALUE]…`, with the keys of services in [`setting::KEYS`].

use super::setting::{self, Key};
use ledger_contract::{RobotSettings, ServiceSpec};

/// The form of a service, for messages.
const WANTED: &str = "TOPIC=TYPE[,KEY=VALUE]…, such as /cmd_vel=geometry_msgs/msg/Twist,mode=exclusive; the keys are in \
                      ledgerctl robot set --help";

/// Reads one `--service`. A missing leading slash of the topic is added; names are checked by the chaincode.
pub(crate) fn parse(text: &str) -> Result<ServiceSpec, String> {
    let mut parts = text.split(',');
    let (topic, type_name) = parts
        .next()
        .and_then(|first| first.split_once('='))
        .filter(|(topic, type_name)| !topic.is_empty() && !type_name.is_empty())
        .ok_or_else(|| format!("wanted {WANTED}"))?;
    let (mut settings, mut given) = (RobotSettings::default(), Vec::new());
    for option in parts {
        let (name, value) = option.split_once('=').ok_or_else(|| format!("option {option:?}: wanted {WANTED}"))?;
        // The type stands behind the topic.
        let key = setting::find(name, |key: &Key| key.of_service && key.name != "type")?;
        if given.contains(&key.name) {
            return Err(format!("option {name:?} is given twice"));
        }
        given.push(key.name);
        key.read(&mut settings, value)?;
    }
    Ok(ServiceSpec {
        topic: if topic.starts_with('/') { topic.to_owned() } else { format!("/{topic}") },
        type_name: type_name.to_owned(),
        mode: settings.mode,
        direction: settings.direction.unwrap_or_default(),
        max_age_ms: settings.max_age_ms,
        lease_ms: settings.lease_ms,
        lease_ms_max: settings.lease_ms_max,
        stop_hex: settings.stop_hex,
        sharing: settings.sharing,
        attributes: None,
    })
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_contract::{Direction, Mode};

    #[test]
    fn topic_and_type_are_enough() {
        let spec = parse("/cmd_vel=geometry_msgs/msg/Twist").unwrap();
        assert_eq!((spec.topic.as_str(), spec.type_name.as_str()), ("/cmd_vel", "geometry_msgs/msg/Twist"));
        assert_eq!((spec.mode, spec.direction, spec.lease_ms), (None, Direction::Command, None));
        assert_eq!(parse("cmd_vel=a/msg/B").unwrap().topic, "/cmd_vel");
    }

    #[test]
    fn every_option_is_read() {
        let spec = parse(
            "/pose=geometry_msgs/msg/PoseStamped,mode=open,direction=feed,lease=10s,lease-max=2m,max-age=500ms,stop=0001 0000",
        )
        .unwrap();
        assert_eq!((spec.mode, spec.direction), (Some(Mode::OPEN), Direction::Feed));
        assert_eq!((spec.lease_ms, spec.lease_ms_max, spec.max_age_ms), (Some(10_000), Some(120_000), Some(500)));
        assert_eq!(spec.stop_hex.as_deref(), Some("00010000"));
        let spec = parse("/c=a/msg/B,mode=limited,publishers=2,on_conflict=queue,queue_max=8").unwrap();
        assert_eq!((spec.sharing.publishers, spec.sharing.queue_max), (Some(2), Some(8)));
    }

    #[test]
    fn slips_are_refused_with_what_is_wanted() {
        for (text, part) in [
            ("", "TOPIC=TYPE"),
            ("/cmd_vel", "TOPIC=TYPE"),
            ("=a/msg/B", "TOPIC=TYPE"),
            ("/cmd_vel=", "TOPIC=TYPE"),
            ("/c=a/msg/B,on-conflict=fight", "deny or queue or preempt"),
            ("/c=a/msg/B,modus=open", "did you mean mode?"),
            ("/c=a/msg/B,lease=10", "did you mean 10s?"),
            ("/c=a/msg/B,mode", "TOPIC=TYPE"),
            ("/c=a/msg/B,mode=open,mode=open", "given twice"),
            ("/c=a/msg/B,stop=0g", "hexadecimal"),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.contains(part), "{text:?}: {error}");
        }
    }
}
