//! Reading settings one by one, so that all faults of a file are found at once.

use super::Fault;
use ledger_rejection::{Code, Rejection};
use std::ops::{Range, RangeInclusive};
use std::path::Path;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Most faults that are told of one file.
const FAULTS_MAX: usize = 100;
/// Characters of a value that a message repeats.
const VALUE_CHARS_MAX: usize = 80;

/// The parsed text, and the faults found so far.
pub(super) struct Reader<'t> {
    text: &'t str,
    path: &'t Path,
    root: Spanned<DeTable<'t>>,
    faults: Vec<Fault>,
}

impl<'t> Reader<'t> {
    /// Parses the text; what cannot be parsed is a fault, the rest is read on.
    pub(super) fn parse(text: &'t str, path: &'t Path) -> Self {
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
    pub(super) fn root(&mut self, read: impl FnOnce(&mut Section<'_, 't>)) {
        let mut root = std::mem::take(self.root.get_mut());
        let mut section = Section { reader: self, name: String::new(), table: &mut root, known: Vec::new() };
        read(&mut section);
        section.close();
    }

    /// The faults, if there are any, in the order of their lines.
    pub(super) fn finish(mut self) -> Result<(), Vec<Fault>> {
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

    /// What stands there, cut.
    fn found(&self, span: &Range<usize>) -> String {
        let value = self.text.get(span.clone()).unwrap_or_default().lines().next().unwrap_or_default();
        value.chars().take(VALUE_CHARS_MAX).collect()
    }
}

/// A section that is being read: what was asked for is taken out, so that what is left is unknown.
pub(super) struct Section<'r, 't> {
    reader: &'r mut Reader<'t>,
    /// Empty at the top level.
    name: String,
    table: &'r mut DeTable<'t>,
    /// What was asked for.
    known: Vec<&'static str>,
}

impl<'t> Section<'_, 't> {
    /// A whole number in a range; its target is left alone if the setting is not there.
    pub(super) fn integer<T>(&mut self, name: &'static str, range: RangeInclusive<u64>, target: &mut T)
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
    pub(super) fn text<T>(
        &mut self,
        name: &'static str,
        wanted: &str,
        target: &mut T,
        read: impl FnOnce(&str) -> Option<T>,
    ) {
        self.value(name, wanted, target, |value| read(value.as_str()?));
    }

    /// A section.
    pub(super) fn section(&mut self, name: &'static str, read: impl FnOnce(&mut Section<'_, 't>)) {
        let Some((span, value)) = self.take(name) else { return };
        let DeValue::Table(mut table) = value else {
            let rejection = self.wrong(name, &span, "a section");
            return self.reader.fault(Some(&span), rejection);
        };
        let path = self.path(name);
        let mut section = Section { reader: self.reader, name: path, table: &mut table, known: Vec::new() };
        read(&mut section);
        section.close();
    }

    /// A section that somebody else reads.
    pub(super) fn table(&mut self, name: &'static str, target: &mut Option<toml::Table>) {
        let Some((span, value)) = self.take(name) else { return };
        if !matches!(value, DeValue::Table(_)) {
            let rejection = self.wrong(name, &span, "a section");
            return self.reader.fault(Some(&span), rejection);
        }
        // If the rest of the text is not TOML, that is told already.
        let Ok(mut root) = self.reader.text.parse::<toml::Table>() else { return };
        *target = match root.remove(name) {
            Some(toml::Value::Table(table)) => Some(table),
            _ => None,
        };
    }

    /// A setting that is gone: what is written instead.
    pub(super) fn replaced(&mut self, name: &str, instead: &str) {
        let Some(value) = self.table.remove(name) else { return };
        let rejection = Rejection::new(Code::BadConfiguration, format!("{} is no setting any more", self.path(name)))
            .found(self.reader.found(&value.span()))
            .wanted(instead)
            .next("remove the line, and write the other setting if its default is not what you want");
        self.reader.fault(Some(&value.span()), rejection);
    }

    /// Settings that do not go together, by their full names.
    pub(super) fn conflict(&mut self, [first, second]: [&str; 2], found: String, wanted: String) {
        let rejection = Rejection::new(Code::BadConfiguration, format!("{first} does not fit {second}"))
            .found(found)
            .wanted(wanted)
            .next(format!("change {first} or {second}"));
        self.reader.fault(None, rejection);
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

    fn wrong(&self, name: &str, span: &Range<usize>, wanted: &str) -> Rejection {
        Rejection::new(Code::BadConfiguration, format!("{} has a wrong value", self.path(name)))
            .found(self.reader.found(span))
            .wanted(wanted)
            .next("correct it, or leave the setting out for its default")
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
            rejection = match nearest(&name, &self.known) {
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

/// The known name that was probably meant.
fn nearest(name: &str, known: &[&'static str]) -> Option<&'static str> {
    if name.len() > VALUE_CHARS_MAX {
        return None;
    }
    let likeness = |known: &&'static str| (strsim::jaro_winkler(name, known), *known);
    known
        .iter()
        .map(likeness)
        .filter(|(likeness, _)| *likeness > 0.75)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, known)| known)
}

/// The line of a place in the text, from 1.
fn line(text: &str, span: &Range<usize>) -> usize {
    1 + text.as_bytes().iter().take(span.start).filter(|byte| **byte == b'\n').count()
}
