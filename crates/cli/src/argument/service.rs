//! A service on the command line: `TOPIC=TYPE[,mode=…][,direction=…][,lease=…][,lease-max=…][,max-age=…][,stop=HEX]`.

use super::span::Milliseconds;
use ledger_contract::{Direction, Mode, ServiceSpec};

/// What a service looks like, for messages.
const WANTED: &str = "TOPIC=TYPE[,mode=open|exclusive][,direction=command|feed][,lease=10s][,lease-max=10m]\
                      [,max-age=500ms][,stop=HEX], such as /cmd_vel=geometry_msgs/msg/Twist,mode=exclusive";
/// The options behind the type.
const OPTIONS: [&str; 6] = ["mode", "direction", "lease", "lease-max", "max-age", "stop"];

/// Reads one `--service`. A missing leading slash of the topic is added; names are checked by the chaincode.
pub(crate) fn parse(text: &str) -> Result<ServiceSpec, String> {
    let mut parts = text.split(',');
    let (topic, type_name) = parts
        .next()
        .and_then(|first| first.split_once('='))
        .filter(|(topic, type_name)| !topic.is_empty() && !type_name.is_empty())
        .ok_or_else(|| format!("wanted {WANTED}"))?;
    let mut spec = ServiceSpec {
        topic: if topic.starts_with('/') { topic.to_owned() } else { format!("/{topic}") },
        type_name: type_name.to_owned(),
        mode: None,
        direction: Direction::Command,
        max_age_ms: None,
        lease_ms: None,
        lease_ms_max: None,
        stop_hex: None,
    };
    let mut given = Vec::new();
    for option in parts {
        let (name, value) = option.split_once('=').ok_or_else(|| format!("option {option:?}: wanted {WANTED}"))?;
        if given.contains(&name) {
            return Err(format!("option {name:?} is given twice"));
        }
        given.push(name);
        let span = || value.parse::<Milliseconds>().map(|m| Some(m.0)).map_err(|e| format!("{name}={value}: {e}"));
        match name {
            "mode" => spec.mode = Some(choice(name, value, &[("open", Mode::Open), ("exclusive", Mode::Exclusive)])?),
            "direction" => {
                spec.direction = choice(name, value, &[("command", Direction::Command), ("feed", Direction::Feed)])?;
            }
            "lease" => spec.lease_ms = span()?,
            "lease-max" => spec.lease_ms_max = span()?,
            "max-age" => spec.max_age_ms = span()?,
            "stop" => {
                let bytes = super::bytes::from_hex(value)
                    .map_err(|rejection| format!("stop: found {}, wanted {}", rejection.found, rejection.wanted))?;
                spec.stop_hex = Some(hex::encode(bytes));
            }
            _ => return Err(unknown(name)),
        }
    }
    Ok(spec)
}

fn choice<T: Copy>(name: &str, value: &str, choices: &[(&str, T)]) -> Result<T, String> {
    choices.iter().find(|(word, _)| *word == value).map(|(_, choice)| *choice).ok_or_else(|| {
        let words: Vec<_> = choices.iter().map(|(word, _)| *word).collect();
        format!("{name}={value}: wanted {}", words.join(" or "))
    })
}

fn unknown(name: &str) -> String {
    let near = OPTIONS.iter().max_by(|a, b| strsim::jaro(a, name).total_cmp(&strsim::jaro(b, name)));
    let near = near.filter(|near| strsim::jaro(near, name) > 0.7);
    let hint = near.map(|near| format!(" (did you mean {near}?)")).unwrap_or_default();
    format!("unknown option {name:?}{hint}; wanted {WANTED}")
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

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
        assert_eq!((spec.mode, spec.direction), (Some(Mode::Open), Direction::Feed));
        assert_eq!((spec.lease_ms, spec.lease_ms_max, spec.max_age_ms), (Some(10_000), Some(120_000), Some(500)));
        assert_eq!(spec.stop_hex.as_deref(), Some("00010000"));
    }

    #[test]
    fn slips_are_refused_with_what_is_wanted() {
        for (text, part) in [
            ("", "TOPIC=TYPE"),
            ("/cmd_vel", "TOPIC=TYPE"),
            ("=a/msg/B", "TOPIC=TYPE"),
            ("/cmd_vel=", "TOPIC=TYPE"),
            ("/c=a/msg/B,mode=shared", "open or exclusive"),
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
