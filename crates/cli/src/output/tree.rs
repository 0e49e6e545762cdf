//! JSON as a tree that keeps the order of fields and the digits of numbers, with times in the form of RFC 3339 beside those in
//! microseconds.

use crate::time;
use ledger_api::json;
use serde::de::{Deserializer, MapAccess, Visitor};
use serde_json::value::RawValue;
use std::fmt::{self, Write};

/// The fields that hold a time, microseconds since the UNIX epoch, 0 for none, wherever they stand.
const TIMES: [&str; 31] = [
    "acquired_at",
    "at",
    "barred",
    "before",
    "block_time",
    "break_glass_from",
    "certified_time",
    "clock",
    "created",
    "deadline",
    "ended",
    "ends",
    "expected",
    "expires",
    "first",
    "first_time",
    "last",
    "last_time",
    "next_update",
    "not_after",
    "not_before",
    "renewed_from",
    "secret_expires",
    "since",
    "started",
    "submitted",
    "this_update",
    "time",
    "until",
    "waits_until",
    "wall_clock",
];
/// A name of [`TIMES`] that is a count elsewhere. No count is as large as a time.
const ALSO_A_COUNT: &str = "ended";
/// The first moment that a field of this name may mean.
const NO_COUNT: u64 = 1_000_000_000_000;
/// The end of the name of the same time in the form of RFC 3339.
const UTC: &str = "_utc";
/// The fields below which stands what others wrote: messages of ROS 2, payloads and answers of a chaincode.
const FOREIGN: [&str; 4] = ["message", "payload", "response", "feedback"];

/// Deeper values are taken as they are: nodes may answer with what they like.
const DEPTH_MAX: usize = 32;

/// A value of JSON.
#[derive(Debug)]
pub(super) enum Tree {
    /// A number, a text, a truth value or `null`, as it is written.
    Leaf(String),
    List(Vec<Tree>),
    Object(Vec<(String, Tree)>),
}

impl Tree {
    /// Reads JSON.
    pub(super) fn read(json: &str) -> serde_json::Result<Self> {
        Self::read_at(json, 0)
    }

    fn read_at(json: &str, depth: usize) -> serde_json::Result<Self> {
        Ok(match json.trim_start().as_bytes().first() {
            Some(b'{' | b'[') if depth == DEPTH_MAX => {
                Self::Leaf(json::compact(json).map_or_else(|| json.to_owned(), |value| value.get().to_owned()))
            }
            Some(b'{') => {
                let fields: Fields = serde_json::from_str(json)?;
                let read = fields.0.into_iter().map(|(name, value)| Ok((name, Self::read_at(value.get(), depth + 1)?)));
                Self::Object(read.collect::<serde_json::Result<_>>()?)
            }
            Some(b'[') => {
                let values: Vec<Box<RawValue>> = serde_json::from_str(json)?;
                Self::List(
                    values
                        .iter()
                        .map(|value| Self::read_at(value.get(), depth + 1))
                        .collect::<serde_json::Result<_>>()?,
                )
            }
            _ => Self::Leaf(json.trim().to_owned()),
        })
    }

    /// The same with each time a second time, in the form of RFC 3339.
    pub(super) fn with_utc(self) -> Self {
        match self {
            Self::Leaf(text) => Self::Leaf(text),
            Self::List(values) => Self::List(values.into_iter().map(Self::with_utc).collect()),
            Self::Object(fields) => {
                let mut told: Vec<(String, Self)> = Vec::with_capacity(fields.len());
                for (name, value) in fields {
                    // Answers of a node have it already.
                    if told.last().is_some_and(|(last, _)| *last == name) {
                        continue;
                    }
                    let utc = utc(&name, &value).map(|utc| (format!("{name}{UTC}"), Self::Leaf(utc)));
                    let value = if FOREIGN.contains(&name.as_str()) { value } else { value.with_utc() };
                    told.push((name, value));
                    told.extend(utc);
                }
                Self::Object(told)
            }
        }
    }

    /// The same without the fields at these paths.
    pub(super) fn without(mut self, paths: &[&str]) -> Self {
        paths.iter().for_each(|path| self.remove(path));
        self
    }

    fn remove(&mut self, path: &str) {
        match (self, path.split_once('.')) {
            (Self::Leaf(_), _) => {}
            (Self::List(values), _) => values.iter_mut().for_each(|value| value.remove(path)),
            (Self::Object(fields), None) => fields.retain(|(name, _)| name != path),
            (Self::Object(fields), Some((first, rest))) => {
                fields.iter_mut().filter(|(name, _)| name == first).for_each(|(_, value)| value.remove(rest));
            }
        }
    }

    /// For people, on one line: `robot=Rover, since=2026-11-29 14:43:11 +00:00`, with times in local time.
    pub(super) fn to_brief(&self) -> String {
        match self {
            Self::Leaf(text) => serde_json::from_str::<String>(text).unwrap_or_else(|_| text.clone()),
            Self::List(values) => format!("[{}]", values.iter().map(Self::to_brief).collect::<Vec<_>>().join(", ")),
            Self::Object(fields) => {
                let shown = |(name, value): &(String, Self)| match (moment(name, value), value) {
                    (Some(moment), _) => format!("{name}={moment}"),
                    (None, Self::Object(_)) => format!("{name}={{{}}}", value.to_brief()),
                    (None, _) => format!("{name}={}", value.to_brief()),
                };
                fields.iter().map(shown).collect::<Vec<_>>().join(", ")
            }
        }
    }

    /// As JSON on one line.
    pub(super) fn to_json(&self) -> String {
        let mut out = String::new();
        // Into a text nothing fails.
        let _done = self.write(&mut out);
        out
    }

    fn write(&self, out: &mut String) -> fmt::Result {
        match self {
            Self::Leaf(text) => out.write_str(text),
            Self::List(values) => {
                out.push('[');
                for (at, value) in values.iter().enumerate() {
                    out.push_str(if at == 0 { "" } else { "," });
                    value.write(out)?;
                }
                out.write_char(']')
            }
            Self::Object(fields) => {
                out.push('{');
                for (at, (name, value)) in fields.iter().enumerate() {
                    out.push_str(if at == 0 { "" } else { "," });
                    write!(out, "{}:", serde_json::Value::from(name.as_str()))?;
                    value.write(out)?;
                }
                out.write_char('}')
            }
        }
    }
}

/// The time of a field in the form of RFC 3339, if it is one; `null` for none.
fn utc(name: &str, value: &Tree) -> Option<String> {
    let Tree::Leaf(text) = value else { return None };
    let first = if name == ALSO_A_COUNT { NO_COUNT } else { 0 };
    let is_time = TIMES.contains(&name) && (text == "null" || text.parse::<u64>().is_ok_and(|time| time >= first));
    is_time.then(|| match text.parse() {
        Ok(micros) if micros > 0 => serde_json::Value::from(time::rfc3339(micros)).to_string(),
        _ => "null".to_owned(),
    })
}

/// The time of a field in local time, if it is one and is set.
fn moment(name: &str, value: &Tree) -> Option<String> {
    let Tree::Leaf(text) = value else { return None };
    let micros = text.parse::<u64>().ok().filter(|micros| *micros >= NO_COUNT)?;
    TIMES.contains(&name).then(|| time::moment(micros))
}

/// The fields of an object in their order.
struct Fields(Vec<(String, Box<RawValue>)>);

impl<'de> serde::Deserialize<'de> for Fields {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Read;
        impl<'de> Visitor<'de> for Read {
            type Value = Fields;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Fields, A::Error> {
                let mut fields = Vec::new();
                while let Some(field) = map.next_entry()? {
                    fields.push(field);
                }
                Ok(Fields(fields))
            }
        }
        deserializer.deserialize_map(Read)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn told(json: &str) -> String {
        Tree::read(json).unwrap().with_utc().to_json()
    }

    #[test]
    fn a_time_stands_there_twice_and_nothing_else_changes() {
        let json = r#"{"Name":"a\"b","time":1700000000000001,"expires":0,"renewed_from":null,"height":18446744073709551615,"x":[1e400,{"since":5}]}"#;
        let wanted = r#"{"Name":"a\"b","time":1700000000000001,"time_utc":"2023-11-14T22:13:20.000001Z","expires":0,"expires_utc":null,"renewed_from":null,"renewed_from_utc":null,"height":18446744073709551615,"x":[1e400,{"since":5,"since_utc":"1970-01-01T00:00:00.000005Z"}]}"#;
        assert_eq!(told(json), wanted);
    }

    #[test]
    fn a_time_that_has_its_second_form_keeps_it_and_fields_are_left_out_by_their_paths() {
        let json = r#"{"a":[{"b":1,"c":2},{"b":3}],"b":4,"time":5,"time_utc":"1970-01-01T00:00:00.000005Z"}"#;
        let wanted = r#"{"a":[{"c":2},{}],"b":4,"time":5,"time_utc":"1970-01-01T00:00:00.000005Z"}"#;
        assert_eq!(Tree::read(json).unwrap().without(&["a.b", "x.b"]).with_utc().to_json(), wanted);
    }

    #[test]
    fn a_count_is_no_time_even_under_the_name_of_one() {
        assert_eq!(told(r#"{"ended":3}"#), r#"{"ended":3}"#);
        let task = r#"{"ended":1700000000000001,"ended_utc":"2023-11-14T22:13:20.000001Z"}"#;
        assert_eq!(told(r#"{"ended":1700000000000001}"#), task);
    }

    #[test]
    fn what_others_wrote_and_what_is_no_number_stays_as_it_is() {
        for json in
            [r#"{"payload":{"time":7}}"#, r#"{"message":{"since":7}}"#, r#"{"time":"10:00"}"#, r#""time""#, "[]"]
        {
            assert_eq!(told(json), json);
        }
    }

    #[test]
    fn json_that_is_nested_without_end_stays_on_one_line_and_costs_no_stack() {
        let deep = format!("{}\n1{}", "[".repeat(200_000), "]".repeat(200_000));
        assert_eq!(told(&deep), deep.replace('\n', ""));
    }

    #[test]
    fn people_read_names_and_values_and_no_numbers_of_microseconds() {
        let brief = |json: &str| Tree::read(json).unwrap().to_brief();
        assert_eq!(brief(r#"{"robot":"Rover","count":3,"of":{"a":[1,"b"]}}"#), "robot=Rover, count=3, of={a=[1, b]}");
        let since = brief(r#"{"since":1700000000000001,"until":0}"#);
        assert!(since.starts_with("since=2023-11-1") && since.ends_with(", until=0"), "{since}");
        assert_eq!(brief("\"text\""), "text");
    }

    #[test]
    fn the_names_of_times_are_in_order() {
        assert!(TIMES.is_sorted());
    }
}
