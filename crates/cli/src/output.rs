//! The result of a command, for people or for programs.
//!
//! A command fills a struct of facts and shows it: `-o table` (the default) calls [`Facts::text`], `-o json` writes
//! the struct as one line of JSON, `-o csv` that JSON as rows. So all always tell the same. docs/output.md has the fields.

mod csv;
mod screen;
mod tree;

pub(crate) use crate::format::Format;
pub(crate) use crate::printable::{printable, printable_lines};

use crate::failure::Failure;
use crate::printable::{harmless, harmless_json};
use csv::Sheet;
use serde::Serialize;
use std::io::{self, Write};
use tree::Tree;

/// The version of the JSON. A new field does not change it; a field that goes or means something else does.
pub(crate) const JSON_VERSION: u32 = 1;

/// Facts that can be told to people.
pub(crate) trait Facts: Serialize {
    /// Writes them for people.
    fn text(&self, out: &mut dyn Write) -> io::Result<()>;

    /// Fields that only the HTTP API has, as paths below an object and the lists in it: `peers.role`.
    fn omitted(&self) -> &'static [&'static str] {
        &[]
    }

    /// The JSON whose elements are the rows of comma-separated values: all of it, unless the facts have one list that matters.
    fn rows(&self) -> serde_json::Result<String> {
        serde_json::to_string(self)
    }
}

/// Where the results of a command go.
pub(crate) struct Output {
    format: Format,
    sheet: Sheet,
    out: Box<dyn Write>,
}

impl Output {
    /// Results go to standard output.
    pub(crate) fn stdout(format: Format) -> Self {
        Self { format, sheet: Sheet::default(), out: Box::new(io::stdout()) }
    }

    /// How results are written.
    pub(crate) fn format(&self) -> Format {
        self.format
    }

    /// Writes them so from now on, for a command that has an option of its own for it.
    pub(crate) fn set_format(&mut self, format: Format) {
        self.format = format;
    }

    /// Writes the facts and flushes, so that whoever reads a stream of them gets each at once.
    pub(crate) fn show<F: Facts>(&mut self, facts: &F) -> Result<(), Failure> {
        let read = |json: String| Ok(Tree::read(&json)?.without(facts.omitted()).with_utc());
        let shown = match self.format {
            Format::Table => {
                let mut text = Vec::new();
                facts.text(&mut text)?;
                harmless(&String::from_utf8_lossy(&text))
            }
            Format::Json => {
                let json = serde_json::to_string(facts).and_then(read).map_err(io::Error::from)?;
                harmless_json(&json.to_json()) + "\n"
            }
            Format::Csv => {
                let rows = facts.rows().and_then(read).map_err(io::Error::from)?;
                self.sheet.lines(rows)
            }
        };
        self.raw(shown.as_bytes())
    }

    /// Tells people something beside the results, on standard error. Programs are not bothered with it.
    pub(crate) fn note(&self, text: &str) {
        if self.format == Format::Table {
            let _ = writeln!(io::stderr(), "{}", printable(text));
        }
    }

    /// Writes bytes as they are and flushes.
    pub(crate) fn raw(&mut self, bytes: &[u8]) -> Result<(), Failure> {
        self.out.write_all(bytes)?;
        Ok(self.out.flush()?)
    }
}

/// Tells people and programs on standard error what they should do something about, though the command went on.
pub(crate) fn warn(format: Format, message: &str, next: &str) {
    #[derive(Serialize)]
    struct Warning<'a> {
        warning: &'a str,
        r#try: &'a str,
    }
    let text = match format {
        Format::Table | Format::Csv => format!("warning: {}\n  try     {}", printable(message), printable(next)),
        Format::Json => serde_json::to_string(&Warning { warning: message, r#try: next }).unwrap_or_default(),
    };
    // Where standard error is closed, nobody wants to know.
    let _ = writeln!(io::stderr(), "{text}");
}

/// JSON for people on one line, with times in local time; none if it is not JSON.
pub(crate) fn brief(json: &str) -> Option<String> {
    Tree::read(json).ok().map(|tree| tree.to_brief())
}

/// Columns of text, each as wide as its widest cell.
pub(crate) struct Table {
    rows: Vec<Vec<String>>,
    has_headings: bool,
}

impl Table {
    /// A table with these headings.
    pub(crate) fn new<const N: usize>(headings: [&str; N]) -> Self {
        Self { rows: vec![headings.map(str::to_owned).to_vec()], has_headings: true }
    }

    /// Lines of a name and a value, without headings.
    pub(crate) fn pairs() -> Self {
        Self { rows: Vec::new(), has_headings: false }
    }

    /// Adds a row.
    pub(crate) fn row<const N: usize>(&mut self, cells: [String; N]) -> &mut Self {
        self.rows.push(cells.iter().map(|cell| printable(cell).into_owned()).collect());
        self
    }

    /// Adds a name and its value, unless the value is empty.
    pub(crate) fn pair(&mut self, name: &str, value: impl ToString) -> &mut Self {
        let value = value.to_string();
        if value.is_empty() { self } else { self.row([name.to_owned(), value]) }
    }

    /// Writes it, each line behind `indent` spaces.
    pub(crate) fn write(&self, out: &mut dyn Write, indent: usize) -> io::Result<()> {
        self.write_within(out, indent, screen::width().map(|room| room.saturating_sub(indent)))
    }

    /// The same for a terminal with this many columns behind the indent; none for a file or a pipe.
    fn write_within(&self, out: &mut dyn Write, indent: usize, room: Option<usize>) -> io::Result<()> {
        let columns = self.rows.iter().map(Vec::len).max().unwrap_or(0);
        let width = |column: usize| {
            self.rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count()).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..columns).map(width).collect();
        let cells = |column: usize| self.rows.iter().filter_map(move |row| row.get(column));
        let word = |column: usize| cells(column).map(|cell| screen::longest_word(cell)).max().unwrap_or_default();
        let least: Vec<usize> = (0..columns).map(word).collect();
        let widths = match room {
            Some(room) => {
                let fitted = screen::fitted(widths, &least, room);
                if self.has_headings && self.rows.len() > 1 && screen::whole(&fitted) > room {
                    return self.write_stacked(out, indent, room);
                }
                fitted
            }
            None => widths,
        };
        for row in &self.rows {
            self::row(out, row, &widths, indent)?;
        }
        // Headings alone look like an answer that was cut off.
        if self.has_headings && self.rows.len() == 1 { writeln!(out, "{}(none)", " ".repeat(indent)) } else { Ok(()) }
    }

    /// For a terminal that is too narrow for the columns: each row as lines of a heading and a cell, with an empty line between
    /// rows. Empty cells are left out.
    fn write_stacked(&self, out: &mut dyn Write, indent: usize, room: usize) -> io::Result<()> {
        let Some((headings, rows)) = self.rows.split_first() else { return Ok(()) };
        let name = headings.iter().map(|heading| heading.chars().count()).max().unwrap_or_default();
        let widths = [name, room.saturating_sub(name + screen::GAP).max(screen::COLUMN_MIN)];
        for (at, cells) in rows.iter().enumerate() {
            if at > 0 {
                writeln!(out)?;
            }
            for (heading, cell) in headings.iter().zip(cells).filter(|(_, cell)| !cell.is_empty()) {
                row(out, &[heading.clone(), cell.clone()], &widths, indent)?;
            }
        }
        Ok(())
    }
}

/// Writes a row, on several lines where a cell is wider than its column.
fn row(out: &mut dyn Write, cells: &[String], widths: &[usize], indent: usize) -> io::Result<()> {
    let cells: Vec<Vec<String>> = cells.iter().zip(widths).map(|(cell, width)| screen::broken(cell, *width)).collect();
    for at in 0..cells.iter().map(Vec::len).max().unwrap_or_default() {
        let mut line = " ".repeat(indent);
        for (cell, width) in cells.iter().zip(widths) {
            line.push_str(&format!("{:<width$}  ", cell.get(at).map(String::as_str).unwrap_or_default()));
        }
        writeln!(out, "{}", line.trim_end())?;
    }
    Ok(())
}

/// `KEY=VALUE, KEY=VALUE` of attributes, or `none`.
pub(crate) fn attributes<'a>(attributes: impl IntoIterator<Item = (&'a String, &'a String)>) -> String {
    let list: Vec<_> = attributes.into_iter().map(|(key, value)| format!("{key}={value}")).collect();
    if list.is_empty() { "none".to_owned() } else { list.join(", ") }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::printable::deceives;

    fn written(table: &Table, indent: usize) -> String {
        let mut out = Vec::new();
        table.write(&mut out, indent).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn columns_are_as_wide_as_their_widest_cell() {
        let mut table = Table::new(["NAME", "MODE"]);
        table.row(["Turtlebot4".into(), "exclusive".into()]).row(["Häschen".into(), "open".into()]);
        assert_eq!(written(&table, 0), "NAME        MODE\nTurtlebot4  exclusive\nHäschen     open\n");
    }

    #[test]
    fn a_table_that_is_wider_than_the_terminal_is_stacked() {
        let mut table = Table::new(["SERVICE", "TYPE", "RULE", "OWNER", "HOLDER", "WAITING"]);
        let cells = ["Turtlebot4/cmd_vel", "geometry_msgs/msg/Twist", "exclusive", "Org2", "Org1/Salma", ""];
        table.row(cells.map(str::to_owned)).row(cells.map(str::to_owned));
        let within = |room| {
            let mut out = Vec::new();
            table.write_within(&mut out, 0, Some(room)).unwrap();
            String::from_utf8(out).unwrap()
        };
        assert!(within(80).starts_with("SERVICE"), "{}", within(80));
        let record = "SERVICE  Turtlebot4/cmd_vel\nTYPE     geometry_msgs/msg/Twist\nRULE     exclusive\nOWNER    Org2\nHOLDER   Org1/Salma\n";
        assert_eq!(within(40), format!("{record}\n{record}"));
        for room in 24..100 {
            let widest = within(room).lines().map(|line| line.chars().count()).max().unwrap();
            assert!(widest <= room, "{widest} columns on {room}");
        }
    }

    #[test]
    fn a_table_without_rows_is_said_to_have_none() {
        assert_eq!(written(&Table::new(["NODE", "STATE"]), 2), "  NODE  STATE\n  (none)\n");
        assert_eq!(written(&Table::pairs(), 0), "");
    }

    #[test]
    fn pairs_without_a_value_are_left_out() {
        let mut table = Table::pairs();
        table.pair("name", "Salma").pair("chain", "").pair("role", "member");
        assert_eq!(written(&table, 2), "  name  Salma\n  role  member\n");
    }

    #[test]
    fn cells_cannot_move_the_cursor_or_start_a_line() {
        let mut table = Table::pairs();
        table.pair("name", "a\u{1b}[2J\nb\u{9b}");
        assert_eq!(written(&table, 0), "name  a\\u{1b}[2J\\nb\\u{9b}\n");
    }

    /// A name that would obey somebody else.
    #[derive(Serialize)]
    struct Evil {
        name: &'static str,
    }

    impl Facts for Evil {
        fn text(&self, out: &mut dyn Write) -> io::Result<()> {
            writeln!(out, "held by {}\tnow", self.name)
        }
    }

    #[test]
    fn no_result_has_a_character_that_a_terminal_obeys_and_json_says_the_same_without_them() {
        let evil = Evil { name: "a\u{1b}[2J\r\u{9b}\u{202e}b\u{200b}\u{e0041}c" };
        for format in [Format::Table, Format::Json, Format::Csv] {
            let written = std::rc::Rc::new(std::cell::RefCell::new(Vec::new()));
            struct Into(std::rc::Rc<std::cell::RefCell<Vec<u8>>>);
            impl Write for Into {
                fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
                    self.0.borrow_mut().extend_from_slice(bytes);
                    Ok(bytes.len())
                }
                fn flush(&mut self) -> io::Result<()> {
                    Ok(())
                }
            }
            let mut output =
                Output { format, sheet: Sheet::default(), out: Box::new(Into(std::rc::Rc::clone(&written))) };
            assert!(output.show(&evil).is_ok());
            let text = String::from_utf8(written.borrow().clone()).unwrap();
            assert!(!text.chars().any(|c| deceives(c) && !matches!(c, '\n' | '\t')), "{text:?}");
            match format {
                Format::Table => {
                    assert!(text.starts_with("held by a\\u{1b}[2J") && text.ends_with("c\tnow\n"), "{text:?}")
                }
                Format::Csv => assert!(text.starts_with("name\na\\u{1b}[2J"), "{text:?}"),
                Format::Json => {
                    let read: serde_json::Value = serde_json::from_str(&text).unwrap();
                    assert_eq!(read.get("name"), Some(&evil.name.into()));
                }
            }
        }
    }

    #[test]
    fn no_attributes_are_said_to_be_none() {
        let none = std::collections::BTreeMap::new();
        assert_eq!(attributes(&none), "none");
        let some = [("Husky".to_owned(), "true".to_owned())].into();
        assert_eq!(attributes::<'_>(&some as &std::collections::BTreeMap<_, _>), "Husky=true");
    }
}
