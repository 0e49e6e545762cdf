//! Reading a table key by key: whatever is wrong is noted, and what nobody asked for is a fault.

use std::ops::RangeInclusive;

use ledger_rejection::{Code, Rejection};
use serde::de::DeserializeOwned;

/// How alike two keys must be (Jaro-Winkler) for one to be suggested for the other.
const ALIKE: f64 = 0.7;

/// A table that is being read.
pub(crate) struct Table<'f> {
    /// The beginning of messages, e.g. `route 2: `.
    place: String,
    left: toml::Table,
    asked: Vec<&'static str>,
    faults: &'f mut Vec<Rejection>,
}

impl<'f> Table<'f> {
    pub(crate) fn new(place: &str, table: toml::Table, faults: &'f mut Vec<Rejection>) -> Self {
        Self { place: place.to_owned(), left: table, asked: Vec::new(), faults }
    }

    /// The value of a key, if it is there and usable.
    pub(crate) fn take<T: DeserializeOwned>(&mut self, key: &'static str, wanted: &str) -> Option<T> {
        self.asked.push(key);
        let value = self.left.remove(key)?;
        let found = value.to_string();
        match value.try_into() {
            Ok(value) => Some(value),
            Err(error) => {
                let reason = error.to_string().trim_end().replace('\n', " ");
                self.fault(&format!("{key} is not usable"), &format!("{found} ({reason})"), wanted, "");
                None
            }
        }
    }

    /// The value of a key that must be there.
    pub(crate) fn required<T: DeserializeOwned>(&mut self, key: &'static str, wanted: &str) -> Option<T> {
        if !self.left.contains_key(key) {
            self.asked.push(key);
            self.fault(&format!("{key} is missing"), "", wanted, "");
            return None;
        }
        self.take(key, wanted)
    }

    /// A whole number within a range.
    pub(crate) fn integer(&mut self, key: &'static str, range: RangeInclusive<u64>) -> Option<u64> {
        let wanted = format!("{} to {}", range.start(), range.end());
        let value: i64 = self.take(key, &wanted)?;
        let inside = u64::try_from(value).ok().filter(|value| range.contains(value));
        if inside.is_none() {
            self.fault(&format!("{key} is out of range"), &value.to_string(), &wanted, "");
        }
        inside
    }

    /// The value, or its fault noted.
    pub(crate) fn checked<T, E: Into<Rejection>>(&mut self, checked: Result<T, E>) -> Option<T> {
        checked
            .map_err(|error| {
                let mut fault: Rejection = error.into();
                fault.message.insert_str(0, &self.place);
                self.faults.push(fault);
            })
            .ok()
    }

    /// Notes a fault.
    pub(crate) fn fault(&mut self, message: &str, found: &str, wanted: &str, next: &str) {
        let message = format!("{}{message}", self.place);
        self.faults.push(Rejection::new(Code::BadConfiguration, message).found(found).wanted(wanted).next(next));
    }

    /// Keys that cannot be judged because of another fault.
    pub(crate) fn ignore(&mut self, keys: &[&'static str]) {
        for key in keys {
            self.asked.push(key);
            self.left.remove(*key);
        }
    }

    /// Keys that are left are unknown.
    pub(crate) fn finish(mut self) {
        for key in std::mem::take(&mut self.left).keys() {
            let alike = self.asked.iter().map(|known| (strsim::jaro_winkler(key, known), known));
            let nearest = alike.filter(|(score, _)| *score >= ALIKE).max_by(|a, b| a.0.total_cmp(&b.0));
            let next = nearest.map_or(String::new(), |(_, known)| format!("did you mean {known}?"));
            let wanted = format!("one of {}", self.asked.join(", "));
            self.fault(&format!("{key} is no setting here"), key, &wanted, &next);
        }
    }
}
