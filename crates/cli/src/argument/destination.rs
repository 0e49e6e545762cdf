//! The option `-o`: how results are written. `record` takes the name of its file there too, as `ros2 bag record` does.

use crate::output::Format;
use clap::ValueEnum;
use clap::builder::{EnumValueParser, PossibleValue, TypedValueParser};
use clap::error::{ContextKind, ContextValue, ErrorKind};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// The ending by which a file is told from a format.
const ENDING: &str = "mcap";
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
        EnumValueParser::<Format>::new().parse_ref(command, arg, value).map(Destination::Format).map_err(|mut error| {
            if records && error.kind() == ErrorKind::InvalidValue {
                let values = ["FILE.mcap", "table", "json"].map(str::to_owned).to_vec();
                error.insert(ContextKind::ValidValue, ContextValue::Strings(values));
            }
            error
        })
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(Format::value_variants().iter().filter_map(ValueEnum::to_possible_value)))
    }
}
