//! The formats of results.

/// How results are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Format {
    /// Tables and sentences for people.
    Table,
    /// One JSON object or array on one line for programs; errors as one JSON object on standard error.
    Json,
    /// Comma-separated values with a line of headings; errors as for people.
    Csv,
}
