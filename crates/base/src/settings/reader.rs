//! Reading settings one by one, so that all faults of a file are found at once.

use super::Fault;
use crate::rejection::{Code, Rejection};
use std::ops::{Range, RangeInclusive};
use std::path::Path;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Largest configuration file, in bytes.
pub const FILE_BYTES_MAX: usize = 1024 * 1024;
/// Most faults that are told of one file.
const FAULTS_MAX: usize = 100;
/// Characters of a value that a message repeats.
const VALUE_CHARS_MAX: usize = 80;

/// Reads the text of a configuration file.
///
/// # Errors
/// One fault: [`Code::BadFile`] for a file that cannot be read or is too large, [`Code::BadConfiguration`] if it is not
/// UTF-8.
pub fn load(path: &Path) -> Result<String, Vec<Fault>> {
    let whole = |rejection| vec![Fault { file: path.to_owned(), line: None, rejection }];
    let content = crate::durable::read(path, FILE_BYTES_MAX).map_err(|mut rejection| {
        if rejection.code == Code::BadFile {
            // The fault names the file.
            rejection.message = "cannot be read".into();
            rejection = rejection.next(
                "give the path of a configuration with --config; docs/configuration.md and docs/bridge.md list all settings",
            );
        }
        whole(rejection)
    })?;
    crate::text::of_bytes(&content).map_err(|fault| {
        let rejection = Rejection::new(Code::BadConfiguration, "the file is not text").found(fault.to_string());
        whole(rejection.wanted("TOML in UTF-8"))
    })
}

/// The parsed text, and the faults found so far.
pub struct Reader<'t> {
    text: &'t str,
    path: &'t Path,
    root: Spanned<DeTable<'t>>,
    faults: Vec<Fault>,
}

impl<'t> Reader<'t> {
    /// Parses the text. A part that is not TOML is a fault, and the rest is read on.
    pub fn parse(text: &'t str, path: &'t Path) -> Self {
        let (root, errors) = DeTable::parse_recoverable(text);
        let mut faults = Vec::new();
        for error in errors {
            let rejection = Rejection::new(Code::BadConfiguration, format!("this is not TOML: {}", error.message()))
                .next("NAME = VALUE, text in double quotes, sections as [NAME]");
            let line = error.span().map(|span| line(text, &span));
            faults.push(Fault { file: path.to_owned(), line, rejection });
        }
        Self { text, path, root, faults }
    }

    /// Reads the top level, then says what is left over.
    pub fn root(&mut self, read: impl FnOnce(&mut Section<'_, 't>)) {
        let mut root = std::mem::take(self.root.get_mut());
        let mut section =
            Section { reader: self, name: String::new(), spot: Spot(None), table: &mut root, known: Vec::new() };
        read(&mut section);
        section.close();
    }

    /// Ends the reading.
    ///
    /// # Errors
    /// All faults, in the order of their lines.
    pub fn finish(mut self) -> Result<(), Vec<Fault>> {
        if self.faults.is_empty() {
            return Ok(());
        }
        self.faults.sort_by_key(|fault| fault.line);
        self.faults.truncate(FAULTS_MAX);
        Err(self.faults)
    }

    fn fault(&mut self, span: Option<&Range<usize>>, rejection: Rejection) {
        let line = span.map(|span| line(self.text, span));
        self.faults.push(Fault { file: self.path.to_owned(), line, rejection });
    }

    /// The text at that part of the file, cut.
    fn found(&self, span: &Range<usize>) -> String {
        let value = self.text.get(span.clone()).unwrap_or_default().lines().next().unwrap_or_default();
        value.chars().take(VALUE_CHARS_MAX).collect()
    }
}

/// Where in the file something stands, for a fault that is found later.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Spot(Option<Range<usize>>);

/// A section that is being read: what was asked for is taken out, so that what is left is unknown.
pub struct Section<'r, 't> {
    reader: &'r mut Reader<'t>,
    /// Empty at the top level.
    name: String,
    spot: Spot,
    table: &'r mut DeTable<'t>,
    /// The names that were asked for.
    known: Vec<&'static str>,
}

impl<'t> Section<'_, 't> {
    /// A whole number in a range; its target is left alone if the setting is not there.
    pub fn integer<T>(&mut self, name: &'static str, range: RangeInclusive<u64>, target: &mut T)
    where
        T: TryFrom<u64>,
    {
        let wanted = format!("a whole number from {} to {}", range.start(), range.end());
        self.value(name, &wanted, target, |value| {
            let integer = value.as_integer()?;
            let number = u64::from_str_radix(integer.as_str(), integer.radix()).ok()?;
            if range.contains(&number) { T::try_from(number).ok() } else { None }
        });
    }

    /// A text that `read` accepts; otherwise `wanted` is told.
    pub fn text<T>(&mut self, name: &'static str, wanted: &str, target: &mut T, read: impl FnOnce(&str) -> Option<T>) {
        self.value(name, wanted, target, |value| read(value.as_str()?));
    }

    /// True or false.
    pub fn boolean(&mut self, name: &'static str, target: &mut bool) {
        self.value(name, "true or false", target, |value| value.as_bool());
    }

    /// A text that a parser with refusals of its own reads.
    pub fn parsed<T, E: Into<Rejection>>(
        &mut self,
        name: &'static str,
        wanted: &str,
        target: &mut T,
        parse: impl FnOnce(&str) -> Result<T, E>,
    ) {
        let Some((span, value)) = self.take(name) else { return };
        let rejection = match value.as_str().map(parse) {
            Some(Ok(value)) => return *target = value,
            Some(Err(refusal)) => {
                let refusal: Rejection = refusal.into();
                refusal.prefix(format_args!("{}: ", self.path(name)))
            }
            None => self.wrong(name, &span, wanted),
        };
        self.reader.fault(Some(&span), rejection);
    }

    /// A setting without a default: its absence is a fault.
    pub fn required(&mut self, name: &'static str, wanted: &str) {
        if !self.table.contains_key(name) {
            self.missing(name, wanted);
        }
    }

    /// Where this section stands.
    pub fn spot(&self) -> Spot {
        self.spot.clone()
    }

    /// Refuses what stands at a spot.
    pub fn refuse(&mut self, spot: &Spot, rejection: Rejection) {
        self.reader.fault(spot.0.as_ref(), rejection);
    }

    /// A section.
    pub fn section(&mut self, name: &'static str, read: impl FnOnce(&mut Section<'_, 't>)) {
        let Some((span, value)) = self.take(name) else { return };
        let DeValue::Table(mut table) = value else {
            let rejection = self.wrong(name, &span, "a section");
            return self.reader.fault(Some(&span), rejection);
        };
        let path = self.path(name);
        let spot = Spot(Some(span));
        let mut section = Section { reader: self.reader, name: path, spot, table: &mut table, known: Vec::new() };
        read(&mut section);
        section.close();
    }

    /// Texts in a row, `["…", "…"]`, at most so many, that a parser with refusals of its own reads; each fault names its text.
    /// None if the setting is not there.
    pub fn texts<T, E: Into<Rejection>>(
        &mut self,
        name: &'static str,
        count_max: usize,
        mut parse: impl FnMut(&str) -> Result<T, E>,
    ) -> Option<Vec<T>> {
        let wanted = format!("at most {count_max} texts in a row, [\"…\", \"…\"]");
        let (span, value) = self.take(name)?;
        let items = match value {
            DeValue::Array(items) if items.len() <= count_max => items,
            _ => {
                let rejection = self.wrong(name, &span, &wanted);
                self.reader.fault(Some(&span), rejection);
                return None;
            }
        };
        Some(items.iter().filter_map(|item| self.entry(name, &wanted, item, &mut parse)).collect())
    }

    /// A section whose settings have names of the user's own, at most so many: `read` gets each name with its text.
    pub fn entries<T, E: Into<Rejection>>(
        &mut self,
        name: &'static str,
        count_max: usize,
        mut read: impl FnMut(&str, &str) -> Result<T, E>,
    ) -> Vec<(Spot, T)> {
        let wanted = format!("at most {count_max} lines NAME = \"…\"");
        let Some((span, value)) = self.take(name) else { return Vec::new() };
        let table = match value {
            DeValue::Table(table) if table.len() <= count_max => table,
            _ => {
                let rejection = self.wrong(name, &span, &wanted);
                self.reader.fault(Some(&span), rejection);
                return Vec::new();
            }
        };
        let mut entries = Vec::new();
        for (key, value) in &table {
            let key: &str = key.get_ref();
            let read = self.entry(&format!("{name}.{key:?}"), "a text", value, &mut |text: &str| read(key, text));
            entries.extend(read.map(|read| (Spot(Some(value.span())), read)));
        }
        entries
    }

    /// One text of several under a name.
    fn entry<T, E: Into<Rejection>>(
        &mut self,
        name: &str,
        wanted: &str,
        value: &Spanned<DeValue<'t>>,
        parse: &mut impl FnMut(&str) -> Result<T, E>,
    ) -> Option<T> {
        let rejection = match value.get_ref().as_str().map(parse) {
            Some(Ok(read)) => return Some(read),
            Some(Err(refusal)) => {
                let refusal: Rejection = refusal.into();
                refusal.prefix(format_args!("{}: ", self.path(name)))
            }
            None => self.wrong(name, &value.span(), wanted),
        };
        self.reader.fault(Some(&value.span()), rejection);
        None
    }

    /// Sections in a row, `[[NAME]]`, as many as `counts` allows; `read` gets each with its number, from 1.
    pub fn sections(
        &mut self,
        name: &'static str,
        counts: RangeInclusive<usize>,
        mut read: impl FnMut(usize, &mut Section<'_, 't>),
    ) {
        let (count_min, count_max) = counts.into_inner();
        let wanted = format!("{count_min} to {count_max} sections [[{}]]", self.path(name));
        let Some((span, value)) = self.take(name) else {
            return if count_min > 0 {
                self.missing(name, &wanted)
            };
        };
        let DeValue::Array(items) = value else {
            let rejection = self.wrong(name, &span, &wanted);
            return self.reader.fault(Some(&span), rejection);
        };
        if items.len() < count_min || items.len() > count_max {
            let rejection = self.wrong(name, &span, &wanted).found(format!("{} sections", items.len()));
            self.reader.fault(Some(&span), rejection);
        }
        for (number, item) in (1..=count_max).zip(items) {
            let span = item.span();
            let DeValue::Table(mut table) = item.into_inner() else {
                let rejection = self.wrong(name, &span, &wanted);
                self.reader.fault(Some(&span), rejection);
                continue;
            };
            let path = format!("{}[{number}]", self.path(name));
            let spot = Spot(Some(span));
            let mut section = Section { reader: self.reader, name: path, spot, table: &mut table, known: Vec::new() };
            read(number, &mut section);
            section.close();
        }
    }

    /// Settings that another program reads, or that cannot be judged because of another fault.
    pub fn ignore(&mut self, names: &[&'static str]) {
        for name in names {
            self.take(name);
        }
    }

    /// A setting that is gone: what is written instead.
    pub fn replaced(&mut self, name: &str, instead: &str) {
        let Some(value) = self.table.remove(name) else { return };
        let rejection = Rejection::new(Code::BadConfiguration, format!("{} is no longer a setting", self.path(name)))
            .found(self.reader.found(&value.span()))
            .wanted(instead)
            .next("remove the line, and use the other setting if its default is not suitable");
        self.reader.fault(Some(&value.span()), rejection);
    }

    /// Settings of this section that do not go together, by their names.
    pub fn conflict(&mut self, names: [&str; 2], found: String, wanted: String) {
        let [first, second] = names.map(|name| self.path(name));
        let rejection = Rejection::new(Code::BadConfiguration, format!("{first} conflicts with {second}"))
            .found(found)
            .wanted(wanted)
            .next(format!("change {first} or {second}"));
        self.reader.fault(self.spot.0.as_ref(), rejection);
    }

    fn value<T>(
        &mut self,
        name: &'static str,
        wanted: &str,
        target: &mut T,
        read: impl FnOnce(&DeValue<'t>) -> Option<T>,
    ) {
        let Some((span, value)) = self.take(name) else { return };
        match read(&value) {
            Some(value) => *target = value,
            None => {
                let rejection = self.wrong(name, &span, wanted);
                self.reader.fault(Some(&span), rejection);
            }
        }
    }

    fn missing(&mut self, name: &str, wanted: &str) {
        let rejection =
            Rejection::new(Code::BadConfiguration, format!("{} is missing", self.path(name))).wanted(wanted);
        let spot = self.spot.clone();
        self.refuse(&spot, rejection);
    }

    fn wrong(&self, name: &str, span: &Range<usize>, wanted: &str) -> Rejection {
        Rejection::new(Code::BadConfiguration, format!("{} has a wrong value", self.path(name)))
            .found(self.reader.found(span))
            .wanted(wanted)
            .next("correct it, or omit the setting for its default")
    }

    /// Takes a setting out of the section.
    fn take(&mut self, name: &'static str) -> Option<(Range<usize>, DeValue<'t>)> {
        self.known.push(name);
        let value = self.table.remove(name)?;
        Some((value.span(), value.into_inner()))
    }

    /// Tells what is left: nobody asked for it.
    fn close(&mut self) {
        let left: Vec<_> = self.table.keys().map(|key| (key.span(), key.get_ref().to_string())).collect();
        for (span, name) in left {
            let kind = if self.name.is_empty() { "the top level".into() } else { format!("[{}]", self.name) };
            let shown: String = name.chars().take(VALUE_CHARS_MAX).collect();
            let mut rejection = Rejection::new(Code::BadConfiguration, format!("{kind} has no setting {shown:?}"))
                .wanted(format!("one of {}", self.known.join(", ")));
            rejection = match crate::nearest::nearest(&name, self.known.iter().copied()) {
                Some(near) => rejection.next(format!("did you mean {}?", self.path(near))),
                None => rejection.next("remove it"),
            };
            self.reader.fault(Some(&span), rejection);
        }
    }

    fn path(&self, name: &str) -> String {
        if self.name.is_empty() { name.to_owned() } else { format!("{}.{name}", self.name) }
    }
}

/// The line of a part of the text, from 1.
fn line(text: &str, span: &Range<usize>) -> usize {
    1 + text.as_bytes().iter().take(span.start).filter(|byte| **byte == b'\n').count()
}
