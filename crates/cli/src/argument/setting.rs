//! The settings of a robot and its services as people type them, `KEY=VALUE`: one table for `robot add` and `robot
//! set`.

use super::span::Milliseconds;
use ledger_contract::{Mode, RobotSettings, Sharing, Word};

/// One setting.
pub(crate) struct Key {
    /// Its name as people type it.
    pub(crate) name: &'static str,
    /// Its name on the ledger.
    pub(crate) field: &'static str,
    /// Does it belong to a service, or to the robot?
    pub(crate) of_service: bool,
    /// The form of its value.
    wanted: &'static str,
    read: Read,
}

/// Reads a value into the settings.
type Read = fn(&mut RobotSettings, &str) -> Result<(), String>;

const fn of_service(name: &'static str, field: &'static str, wanted: &'static str, read: Read) -> Key {
    Key { name, field, of_service: true, wanted, read }
}

const fn of_robot(name: &'static str, field: &'static str, wanted: &'static str, read: Read) -> Key {
    Key { name, field, of_service: false, wanted, read }
}

/// The value that gives a setting of the rule its default again.
const DEFAULT: &str = "default";

/// Every setting; those of services first.
pub(crate) static KEYS: [Key; 26] = [
    of_service("mode", "mode", "open|exclusive|limited", |settings, value| {
        settings.mode = Some(Mode::from(value));
        Ok(())
    }),
    of_service("direction", "direction", "command|feed", |settings, value| {
        settings.direction = Some(choice(value)?);
        Ok(())
    }),
    of_service("lease", "lease_ms", "10s", |settings, value| span(&mut settings.lease_ms, value)),
    of_service("lease-max", "lease_ms_max", "10m", |settings, value| span(&mut settings.lease_ms_max, value)),
    of_service("max-age", "max_age_ms", "500ms", |settings, value| span(&mut settings.max_age_ms, value)),
    of_service("stop", "stop_hex", "HEX", |settings, value| {
        let bytes = super::bytes::from_hex(value)
            .map_err(|rejection| format!("found {}, wanted {}", rejection.found, rejection.wanted))?;
        settings.stop_hex = Some(hex::encode(bytes));
        Ok(())
    }),
    of_service("type", "type", "PACKAGE/msg/NAME", |settings, value| {
        settings.type_name = Some(value.to_owned());
        Ok(())
    }),
    of_service("publishers", "publishers", "N", |settings, value| number(&mut settings.sharing.publishers, value)),
    of_service("subscribers", "subscribers", "N", |settings, value| number(&mut settings.sharing.subscribers, value)),
    of_service("on-conflict", "on_conflict", "deny|queue|preempt", |settings, value| {
        settings.sharing.on_conflict = Some(choice(value)?);
        Ok(())
    }),
    of_service("queue-max", "queue_max", "N", |settings, value| number(&mut settings.sharing.queue_max, value)),
    of_service("queue-wait-max", "queue_wait_max_ms", "10m", |settings, value| {
        span(&mut settings.sharing.queue_wait_max_ms, value)
    }),
    of_service("priority", "priority", "attribute:NAME|policy|fixed:N", |settings, value| {
        settings.sharing.priority = Some(value.to_owned());
        Ok(())
    }),
    of_service("aging", "aging_ms", "30s", |settings, value| span(&mut settings.sharing.aging_ms, value)),
    of_service("min-hold", "min_hold_ms", "5s", |settings, value| span(&mut settings.sharing.min_hold_ms, value)),
    of_service("idle-release", "idle_release_ms", "1m", |settings, value| {
        span(&mut settings.sharing.idle_release_ms, value)
    }),
    of_service("delegable", "delegable", "true|false", |settings, value| {
        settings.sharing.delegable = Some(value.parse().map_err(|_| "wanted true or false".to_owned())?);
        Ok(())
    }),
    of_service("confirm", "confirm", "N", |settings, value| number(&mut settings.sharing.confirm, value)),
    of_service("confirm-within", "confirm_within_ms", "1m", |settings, value| {
        span(&mut settings.sharing.confirm_within_ms, value)
    }),
    of_service("confidential", "confidential", "true|false", |settings, value| {
        settings.sharing.confidential = Some(value.parse().map_err(|_| "wanted true or false".to_owned())?);
        Ok(())
    }),
    of_service("bytes-per-s", "bytes_per_s", "N", |settings, value| number(&mut settings.sharing.bytes_per_s, value)),
    of_service("messages-per-s", "messages_per_s", "N", |settings, value| {
        number(&mut settings.sharing.messages_per_s, value)
    }),
    of_service("max-linear", "max_linear_mm_s", "0.5", |settings, value| {
        thousandths(&mut settings.sharing.max_linear_mm_s, value)
    }),
    of_service("max-angular", "max_angular_mrad_s", "1.5", |settings, value| {
        thousandths(&mut settings.sharing.max_angular_mrad_s, value)
    }),
    of_robot("attr-required", "attribute_required", "KEY[=VALUE]", |settings, value| {
        settings.attribute_required = Some(value.to_owned());
        Ok(())
    }),
    of_robot("trust", "trusted", "ORG[,ORG]", |settings, value| {
        settings.trusted = Some(value.split(',').map(str::to_owned).filter(|name| !name.is_empty()).collect());
        Ok(())
    }),
];

/// `KEY=VALUE` of a command line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Setting {
    key: &'static str,
    value: String,
}

impl std::str::FromStr for Setting {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, value) =
            text.split_once('=').ok_or_else(|| format!("wanted KEY=VALUE, one of {}", listed(|_| true)))?;
        let key = find(name, |_| true)?;
        key.read(&mut RobotSettings::default(), value)?;
        Ok(Self { key: key.name, value: value.to_owned() })
    }
}

/// All settings together; each may be given once.
pub(crate) fn collect(given: &[Setting]) -> Result<RobotSettings, String> {
    let (mut all, mut seen) = (RobotSettings::default(), Vec::new());
    for Setting { key, value } in given {
        if seen.contains(key) {
            return Err(format!("{key} is given twice"));
        }
        seen.push(*key);
        find(key, |_| true)?.read(&mut all, value)?;
    }
    Ok(all)
}

impl Key {
    /// Reads a value.
    pub(crate) fn read(&self, settings: &mut RobotSettings, value: &str) -> Result<(), String> {
        if value == DEFAULT && Sharing::keys().any(|key| key == self.field) {
            settings.clear.push(self.field.to_owned());
            return Ok(());
        }
        (self.read)(settings, value).map_err(|problem| format!("{}={value}: {problem}", self.name))
    }
}

/// The key of that name among those that are meant.
pub(crate) fn find(name: &str, meant: impl Fn(&Key) -> bool) -> Result<&'static Key, String> {
    // The ledger writes a name with `_` where people write `-`: both are meant.
    let typed = name.replace('_', "-");
    if let Some(key) = KEYS.iter().find(|key| meant(key) && key.name == typed) {
        return Ok(key);
    }
    let names = KEYS.iter().filter(|key| meant(key)).map(|key| key.name);
    let near = ledger_base::nearest::nearest(name, names);
    let hint = near.map(|near| format!(" (did you mean {near}?)")).unwrap_or_default();
    Err(format!("unknown setting {name:?}{hint}; wanted one of {}", listed(meant)))
}

/// `mode=open|exclusive, direction=…` of those that are meant.
pub(crate) fn listed(meant: impl Fn(&Key) -> bool) -> String {
    let keys = KEYS.iter().filter(|key| meant(key));
    keys.map(|key| format!("{}={}", key.name, key.wanted)).collect::<Vec<_>>().join(", ")
}

fn choice<T: Word>(value: &str) -> Result<T, String> {
    T::of(value).ok_or_else(|| format!("wanted {}", words::<T>().join(" or ")))
}

fn words<T: Word>() -> Vec<&'static str> {
    T::ALL.iter().map(|value| value.word()).collect()
}

fn number(place: &mut Option<u64>, value: &str) -> Result<(), String> {
    let digits = !value.is_empty() && value.bytes().all(|b| b.is_ascii_digit());
    *place = Some(digits.then(|| value.parse().ok()).flatten().ok_or("wanted a whole number, such as 8")?);
    Ok(())
}

/// A decimal number with at most three decimals, in thousandths.
fn thousandths(place: &mut Option<u64>, value: &str) -> Result<(), String> {
    let wanted = "wanted a number with at most three decimals, such as 0.5";
    let (whole, decimals) = value.split_once('.').unwrap_or((value, "0"));
    let is_number = |digits: &str| !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit());
    if !is_number(whole) || !is_number(decimals) || decimals.len() > 3 {
        return Err(wanted.to_owned());
    }
    let number = format!("{whole}{decimals:0<3}").parse().map_err(|_| wanted.to_owned())?;
    *place = Some(number);
    Ok(())
}

fn span(place: &mut Option<u64>, value: &str) -> Result<(), String> {
    *place = Some(value.parse::<Milliseconds>()?.0);
    Ok(())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;
    use ledger_contract::{Direction, OnConflict};

    #[test]
    fn a_choice_shows_all_its_words() {
        for (name, words) in [("on-conflict", words::<OnConflict>()), ("direction", words::<Direction>())] {
            assert_eq!(find(name, |_| true).unwrap().wanted, words.join("|"));
        }
    }

    fn read(texts: &[&str]) -> Result<RobotSettings, String> {
        collect(&texts.iter().map(|text| text.parse()).collect::<Result<Vec<_>, _>>()?)
    }

    #[test]
    fn every_setting_is_read_and_has_its_name_on_the_ledger() {
        let settings = read(&[
            "mode=open",
            "direction=feed",
            "lease=10s",
            "lease-max=2m",
            "max-age=500ms",
            "stop=0001 0000",
            "type=std_msgs/msg/Empty",
            "publishers=2",
            "subscribers=3",
            "on_conflict=preempt",
            "queue-max=8",
            "queue_wait_max=1m",
            "priority=attribute:rank",
            "aging=10s",
            "min-hold=5s",
            "idle-release=30s",
            "delegable=true",
            "confirm=2",
            "confirm-within=30s",
            "confidential=true",
            "bytes-per-s=1000000",
            "max-linear=0.25",
            "max_angular=2",
            "messages-per-s=100",
            "attr-required=level=3",
            "trust=Org1,Org2",
        ]);
        let settings = serde_json::to_value(settings.unwrap()).unwrap();
        assert_eq!(settings["lease_ms_max"], 120_000);
        assert_eq!(settings["attribute_required"], "level=3");
        let (of_rule, others): (Vec<_>, Vec<_>) = KEYS.iter().partition(|key| Sharing::keys().any(|k| k == key.field));
        assert_eq!(of_rule.len(), Sharing::keys().count(), "a setting of a rule without a key");
        assert!(of_rule.iter().all(|key| settings["sharing"].get(key.field).is_some()));
        assert!(others.iter().all(|key| settings.get(key.field).is_some()));
        assert_eq!(settings.as_object().unwrap().len(), others.len() + 1, "a setting without a key");
    }

    #[test]
    fn a_setting_of_a_rule_gets_its_default_again() {
        let settings = read(&["queue-max=default", "mode=exclusive"]).unwrap();
        assert_eq!((settings.clear, settings.sharing), (vec!["queue_max".to_owned()], Sharing::default()));
    }

    #[test]
    fn slips_are_refused_with_what_is_wanted() {
        for (texts, part) in [
            (&["mode"][..], "KEY=VALUE"),
            (&["modus=open"], "did you mean mode?"),
            (&["on-conflict=fight"], "deny or queue or preempt"),
            (&["queue-max=-1"], "whole number"),
            (&["lease=10"], "did you mean 10s?"),
            (&["stop=0g"], "hexadecimal"),
            (&["mode=open", "mode=open"], "given twice"),
        ] {
            let error = read(texts).unwrap_err();
            assert!(error.contains(part), "{texts:?}: {error}");
        }
    }
}
