//! YAML to [`Written`].

use crate::fault::{Fault, quoted};
use crate::written::Written;
use saphyr_parser::{Event, Parser, ScalarStyle};

/// Longest YAML that is read, in bytes: a message of the largest size, every byte of it a number on a line of its own.
const TEXT_BYTES_MAX: usize = 32 * 1024 * 1024;
/// How deep lists and maps may lie within each other.
const DEPTH_MAX: usize = 64;

/// A list or a map that has begun.
enum Open {
    List(Vec<Written>),
    /// With the name whose value is to come.
    Map(Vec<(String, Written)>, Option<String>),
}

impl Written {
    /// Reads YAML of one document; JSON is YAML. An empty text is [`Written::Nothing`].
    ///
    /// # Errors
    /// If it is not YAML, names a field twice, or uses what messages have no use for: anchors, aliases and tags.
    pub fn parse(text: &str) -> Result<Self, Fault> {
        parse(text)
    }
}

/// Reads one document.
fn parse(text: &str) -> Result<Written, Fault> {
    if text.len() > TEXT_BYTES_MAX {
        return Err(Fault::new("the text is too long")
            .found(format!("{} bytes", text.len()))
            .wanted(format!("at most {TEXT_BYTES_MAX}")));
    }
    let mut open: Vec<Open> = Vec::new();
    let mut document = None;
    for event in Parser::new_from_str(text) {
        let (event, _) = event.map_err(|error| {
            let mark = error.marker();
            no_yaml(error.info()).found(format!("{} (line {}, column {})", quoted(text), mark.line(), mark.col() + 1))
        })?;
        let finished = match event {
            Event::Scalar(text, style, anchor, tag) => {
                plain_only(anchor, tag.is_some())?;
                Some(scalar(&text, style))
            }
            Event::SequenceStart(anchor, tag) => {
                plain_only(anchor, tag.is_some())?;
                open.push(Open::List(Vec::new()));
                None
            }
            Event::MappingStart(anchor, tag) => {
                plain_only(anchor, tag.is_some())?;
                open.push(Open::Map(Vec::new(), None));
                None
            }
            Event::SequenceEnd | Event::MappingEnd => match open.pop() {
                Some(Open::List(list)) => Some(Written::List(list)),
                Some(Open::Map(map, _)) => Some(Written::Map(map)),
                None => None,
            },
            Event::Alias(_) => return Err(no_yaml("a message has no use for aliases")),
            Event::Nothing | Event::StreamStart | Event::StreamEnd | Event::DocumentStart(_) | Event::DocumentEnd => {
                None
            }
        };
        if open.len() > DEPTH_MAX {
            return Err(no_yaml("it is nested too deep").wanted(format!("at most {DEPTH_MAX} levels")));
        }
        let Some(finished) = finished else { continue };
        match open.last_mut() {
            Some(Open::List(list)) => list.push(finished),
            Some(Open::Map(map, name)) => match name.take() {
                Some(name) => map.push((name, finished)),
                None => *name = Some(key(finished, map)?),
            },
            // Behind the `---` that ends a message in a stream of them comes an empty one.
            None if document.is_some() && finished == Written::Nothing => {}
            None if document.is_some() => {
                return Err(no_yaml("there are several messages").wanted("one"));
            }
            None => document = Some(finished),
        }
    }
    Ok(document.unwrap_or(Written::Nothing))
}

fn no_yaml(what: &str) -> Fault {
    Fault::new(format!("the message is not understood as YAML: {what}"))
        .next("put the message in quotes, and a space behind each colon: '{linear: {x: 0.5}}'")
}

fn plain_only(anchor: usize, is_tagged: bool) -> Result<(), Fault> {
    if anchor == 0 && !is_tagged { Ok(()) } else { Err(no_yaml("a message has no use for anchors and tags")) }
}

fn scalar(text: &str, style: ScalarStyle) -> Written {
    match (style, text) {
        (ScalarStyle::Plain, "" | "~" | "null" | "Null" | "NULL") => Written::Nothing,
        _ => Written::Text(text.to_owned()),
    }
}

/// The name of a field, which must not stand there yet.
fn key(written: Written, map: &[(String, Written)]) -> Result<String, Fault> {
    /// More fields than any message has would cost time to compare.
    const NAMES_MAX: usize = 1024;
    let name = match written {
        Written::Text(name) => name,
        other => return Err(no_yaml("a name of a field is missing").found(other.shown())),
    };
    if map.iter().any(|(known, _)| *known == name) {
        return Err(no_yaml(&format!("the field {name} is written twice")));
    }
    if map.len() >= NAMES_MAX {
        return Err(no_yaml("it has too many fields").wanted(format!("at most {NAMES_MAX}")));
    }
    Ok(name)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn text(text: &str) -> Written {
        Written::Text(text.to_owned())
    }

    fn map<const N: usize>(entries: [(&str, Written); N]) -> Written {
        Written::Map(entries.map(|(name, value)| (name.to_owned(), value)).to_vec())
    }

    #[test]
    fn flow_and_block_style_and_json_are_one_message() {
        let wanted = map([
            ("linear", map([("x", text("0.5")), ("y", Written::Nothing)])),
            ("list", Written::List(vec![text("1")])),
        ]);
        for yaml in [
            "{linear: {x: 0.5, y: }, list: [1]}",
            "{\"linear\": {\"x\": 0.5, \"y\": null}, \"list\": [1]}",
            "linear:\n  x: 0.5\n  y: ~\nlist:\n- 1\n",
            "---\nlinear: {x: 0.5, y: null}\nlist:\n  - 1\n---\n",
            "# block 4\nlinear:\n  x: 0.5 # m/s\n  y:\nlist: ['1']\n",
        ] {
            assert_eq!(parse(yaml).unwrap(), wanted, "{yaml}");
        }
        assert_eq!(parse("").unwrap(), Written::Nothing);
        assert_eq!(parse("'null'").unwrap(), text("null"), "in quotes it is a text");
    }

    #[test]
    fn slips_are_told_with_what_is_wanted() {
        for (yaml, part) in [
            ("{linear: {x: 0.5}", "not understood"),
            ("{x: 1, x: 2}", "twice"),
            ("{x: &a 1, y: *a}", "anchors"),
            ("{x: !!int 1}", "tags"),
            ("---\n1\n---\n2\n", "several"),
            ("{[1]: 2}", "name of a field"),
        ] {
            let fault = parse(yaml).unwrap_err();
            assert!(fault.message.contains(part) && fault.next.contains("quotes"), "{yaml}: {fault:?}");
        }
    }

    #[test]
    fn nesting_is_bounded() {
        let flow = |depth: usize| format!("{}1{}", "[".repeat(depth), "]".repeat(depth));
        assert!(parse(&flow(64)).is_ok());
        for depth in [65, 200, 300, 100_000] {
            assert!(parse(&flow(depth)).is_err(), "{depth}");
        }
        let block = "- ".repeat(100_000);
        assert!(parse(&block).is_err());
    }
}
