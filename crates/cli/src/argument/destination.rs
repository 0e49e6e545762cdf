//! The option `-o`: how results are written. `record` takes the name of its file there too, as `ros2 bag record` does.

use crate::output::{Format, JSON_VERSION};
use clap::ValueEnum;
use clap::builder::{EnumValueParser, PossibleValue, TypedValueParser};
use clap::error::{ContextKind, ContextValue, ErrorKind};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// The ending by which a file is told from a format.
const ENDING: &str = "mcap";
/// JSON of one version, for programs that know that one.
const JSON_OF_VERSION: &str = "json@";
/// The command that takes a file.
const RECORD: &str = "record";

/// The word behind `-o`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Destination {
    /// Results in this form, on standard output.
    Format(Format),
    /// A recording in this file; results for people.
    File(PathBuf),
}

impl Destination {
    /// How results are written.
    pub(crate) fn format(&self) -> Format {
        match self {
            Self::Format(format) => *format,
            Self::File(_) => Format::Table,
        }
    }

    /// The file, if it is one.
    pub(crate) fn file(&self) -> Option<&Path> {
        match self {
            Self::Format(_) => None,
            Self::File(path) => Some(path),
        }
    }
}

/// The format that a command line asks for, although the rest of it cannot be understood.
pub(crate) fn asked(arguments: impl IntoIterator<Item = std::ffi::OsString>) -> Format {
    let words: Vec<String> = arguments.into_iter().map(|word| word.to_string_lossy().into_owned()).collect();
    let behind = |word: &String| {
        let value = word.strip_prefix("--output=").or_else(|| word.strip_prefix("-o"))?;
        Some(value.strip_prefix('=').unwrap_or(value).to_owned())
    };
    let values =
        words.iter().zip(words.iter().skip(1).map(Some).chain([None])).filter_map(|(word, next)| match word.as_str() {
            "-o" | "--output" => next.cloned(),
            _ => behind(word),
        });
    let is_json = values.last().is_some_and(|value| value == "json" || value.starts_with(JSON_OF_VERSION));
    if is_json { Format::Json } else { Format::Table }
}

/// Reads it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reader;

impl TypedValueParser for Reader {
    type Value = Destination;

    fn parse_ref(
        &self,
        command: &clap::Command,
        arg: Option<&clap::Arg>,
        value: &OsStr,
    ) -> Result<Destination, clap::Error> {
        let path = Path::new(value);
        let records = command.get_name() == RECORD;
        if records && path.extension().is_some_and(|ending| ending == ENDING) {
            return Ok(Destination::File(path.to_owned()));
        }
        if value.to_str().and_then(|text| text.strip_prefix(JSON_OF_VERSION)) == Some(&JSON_VERSION.to_string()) {
            return Ok(Destination::Format(Format::Json));
        }
        EnumValueParser::<Format>::new().parse_ref(command, arg, value).map(Destination::Format).map_err(|mut error| {
            if records && error.kind() == ErrorKind::InvalidValue {
                let values = ["FILE.mcap", "table", "json", "csv"].map(str::to_owned).to_vec();
                error.insert(ContextKind::ValidValue, ContextValue::Strings(values));
            }
            error
        })
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(Format::value_variants().iter().filter_map(ValueEnum::to_possible_value)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_cannot_be_understood_still_tells_its_format() {
        let asked = |line: &str| asked(line.split(' ').map(Into::into)) == Format::Json;
        for line in [
            "x -o json y",
            "x -ojson",
            "x --output json",
            "x --output=json",
            "x -o=json",
            "x -o json@1",
            "x -o table -o json",
        ] {
            assert!(asked(line), "{line}");
        }
        for line in ["x", "x -o", "x -o table", "x json", "x -o json -o csv", "x --output"] {
            assert!(!asked(line), "{line}");
        }
    }
}
