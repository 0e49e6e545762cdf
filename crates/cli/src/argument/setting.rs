//! The settings of a robot and its services as people type them, `KEY=VALUE`: one table for `robot add` and `robot
//! set`.

use super::span::Milliseconds;
use ledger_contract::{RobotSettings, Word};

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
    read: fn(&mut RobotSettings, &str) -> Result<(), String>,
}

/// Every setting; those of services first.
pub(crate) static KEYS: [Key; 9] = [
    Key {
        name: "mode",
        field: "mode",
        of_service: true,
        wanted: "open|exclusive",
        read: |settings, value| {
            settings.mode = Some(choice(value)?);
            Ok(())
        },
    },
    Key {
        name: "direction",
        field: "direction",
        of_service: true,
        wanted: "command|feed",
        read: |settings, value| {
            settings.direction = Some(choice(value)?);
            Ok(())
        },
    },
    Key {
        name: "lease",
        field: "lease_ms",
        of_service: true,
        wanted: "10s",
        read: |settings, value| span(&mut settings.lease_ms, value),
    },
    Key {
        name: "lease-max",
        field: "lease_ms_max",
        of_service: true,
        wanted: "10m",
        read: |settings, value| span(&mut settings.lease_ms_max, value),
    },
    Key {
        name: "max-age",
        field: "max_age_ms",
        of_service: true,
        wanted: "500ms",
        read: |settings, value| span(&mut settings.max_age_ms, value),
    },
    Key {
        name: "stop",
        field: "stop_hex",
        of_service: true,
        wanted: "HEX",
        read: |settings, value| {
            let bytes = super::bytes::from_hex(value)
                .map_err(|rejection| format!("found {}, wanted {}", rejection.found, rejection.wanted))?;
            settings.stop_hex = Some(hex::encode(bytes));
            Ok(())
        },
    },
    Key {
        name: "type",
        field: "type",
        of_service: true,
        wanted: "PACKAGE/msg/NAME",
        read: |settings, value| {
            settings.type_name = Some(value.to_owned());
            Ok(())
        },
    },
    Key {
        name: "attr-required",
        field: "attribute_required",
        of_service: false,
        wanted: "KEY[=VALUE]",
        read: |settings, value| {
            settings.attribute_required = Some(value.to_owned());
            Ok(())
        },
    },
    Key {
        name: "trust",
        field: "trusted",
        of_service: false,
        wanted: "ORG[,ORG]",
        read: |settings, value| {
            settings.trusted = Some(value.split(',').map(str::to_owned).filter(|name| !name.is_empty()).collect());
            Ok(())
        },
    },
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
        (self.read)(settings, value).map_err(|problem| format!("{}={value}: {problem}", self.name))
    }
}

/// The key of that name among those that are meant.
pub(crate) fn find(name: &str, meant: impl Fn(&Key) -> bool) -> Result<&'static Key, String> {
    if let Some(key) = KEYS.iter().find(|key| meant(key) && key.name == name) {
        return Ok(key);
    }
    let names = KEYS.iter().filter(|key| meant(key)).map(|key| key.name);
    let near = nearest::nearest(name, names);
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

fn span(place: &mut Option<u64>, value: &str) -> Result<(), String> {
    *place = Some(value.parse::<Milliseconds>()?.0);
    Ok(())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;
    use ledger_contract::{Direction, Mode};

    #[test]
    fn a_choice_shows_all_its_words() {
        for (name, words) in [("mode", words::<Mode>()), ("direction", words::<Direction>())] {
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
            "attr-required=level=3",
            "trust=Org1,Org2",
        ]);
        let settings = serde_json::to_value(settings.unwrap()).unwrap();
        assert_eq!(settings["lease_ms_max"], 120_000);
        assert_eq!(settings["attribute_required"], "level=3");
        for key in &KEYS {
            assert!(settings.get(key.field).is_some(), "{}", key.field);
        }
        assert_eq!(settings.as_object().unwrap().len(), KEYS.len(), "a setting without a key");
    }

    #[test]
    fn slips_are_refused_with_what_is_wanted() {
        for (texts, part) in [
            (&["mode"][..], "KEY=VALUE"),
            (&["modus=open"], "did you mean mode?"),
            (&["mode=shared"], "open or exclusive"),
            (&["lease=10"], "did you mean 10s?"),
            (&["stop=0g"], "hexadecimal"),
            (&["mode=open", "mode=open"], "given twice"),
        ] {
            let error = read(texts).unwrap_err();
            assert!(error.contains(part), "{texts:?}: {error}");
        }
    }
}
