//! Questions to the index.

use super::row::{Kind, PLACE_BYTES, Place, name_prefix};
use super::{FOLDED_US, Index, ROWS, ROWS_AT_ONCE, Row};
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};

/// Rows that one question looks at, at most. The next one goes on behind them.
const LOOKED_AT_MAX: usize = 20_000;
/// A refusal before ordering is on the ledger so much later, usually, microseconds. A folded row may begin that much earlier.
const LATE_US: u64 = 10 * FOLDED_US;

/// A question. An empty text, or 0, stands for all.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Question {
    /// A robot by its name.
    pub robot: String,
    /// An identity, e.g. `Org1/Salma`.
    pub user: String,
    /// An organisation of one that it concerns.
    pub organisation: String,
    /// Number of a code.
    pub code: u32,
    /// Rows that ended before this time are left out, microseconds.
    pub since: u64,
    /// Rows that began after this time are left out, microseconds; 0 = none is.
    pub until: u64,
    /// Goes on behind this place: that of an earlier [`Page`].
    pub after: Bytes,
    /// At most so many rows.
    pub most: usize,
}

/// A part of an answer.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Page {
    /// In order of time.
    pub rows: Vec<Row>,
    /// Where the next question goes on.
    pub after: Bytes,
    /// Is there perhaps more behind it?
    pub more: bool,
}

impl Question {
    /// The beginning of the keys that are looked at: those of the narrowest name.
    fn keys(&self) -> Vec<u8> {
        let code = self.code.to_string();
        let names = [
            (Kind::User, self.user.as_str()),
            (Kind::Code, if self.code > 0 { code.as_str() } else { "" }),
            (Kind::Robot, self.robot.as_str()),
            (Kind::Organisation, self.organisation.as_str()),
        ];
        let named = names.into_iter().find(|(_, name)| !name.is_empty());
        named.map_or_else(|| vec![ROWS], |(kind, name)| name_prefix(kind, name))
    }

    fn asks_for(&self, row: &Row) -> bool {
        (self.robot.is_empty() || self.robot == row.robot)
            && (self.user.is_empty() || row.identities().any(|identity| identity == self.user))
            && (self.organisation.is_empty() || row.organisations().any(|name| name == self.organisation))
            && (self.code == 0 || self.code == row.code)
            && row.last >= self.since
            && (self.until == 0 || row.first <= self.until)
    }

    fn ends_before(&self, place: &Place) -> bool {
        self.until != 0 && place.time > self.until.saturating_add(LATE_US)
    }
}

impl Index {
    /// The rows that are asked for and that `shown` lets pass. Looks at the rows of one name and time, and never at blocks.
    ///
    /// # Errors
    /// [`Code::BadArgument`] for an `after` that is none; [`Code::Corrupt`], [`Code::DiskFailed`].
    pub fn find(&self, question: &Question, mut shown: impl FnMut(&Row) -> bool) -> Result<Page, Rejection> {
        if ![0, PLACE_BYTES].contains(&question.after.len()) {
            return Err(Rejection::new(Code::BadArgument, "the place in the audit cannot be read")
                .found(format!("{} bytes", question.after.len()))
                .wanted(format!("{PLACE_BYTES} bytes from `after` of the previous page, or none"))
                .next("start without it"));
        }
        let prefix = question.keys();
        let begin = Place::at(question.since.saturating_sub(FOLDED_US)).max(Place::of_key(&question.after));
        let mut page = Page { after: Bytes::copy_from_slice(&begin.to_bytes()), ..Page::default() };
        for _ in 0..LOOKED_AT_MAX / ROWS_AT_ONCE {
            let after = [&prefix[..], &page.after].concat();
            let pairs = self.store.range(&prefix, Some(&after), ROWS_AT_ONCE)?;
            let is_last = pairs.len() < ROWS_AT_ONCE;
            for (key, value) in pairs {
                let place = Place::of_key(&key);
                if question.ends_before(&place) {
                    return Ok(page);
                }
                if page.rows.len() >= question.most {
                    return Ok(Page { more: true, ..page });
                }
                page.after = Bytes::copy_from_slice(&place.to_bytes());
                let row = match prefix[..] {
                    [ROWS] => Some(value),
                    _ => self.store.get(&super::place_key(ROWS, &place))?,
                };
                let row = row.map(|row| Row::read(&row)).transpose()?;
                page.rows.extend(row.filter(|row| question.asks_for(row) && shown(row)));
            }
            if is_last {
                return Ok(page);
            }
        }
        Ok(Page { more: true, ..page })
    }
}
