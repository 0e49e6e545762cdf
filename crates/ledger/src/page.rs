//! Pages of lists: queries answer with a bounded part, and say where the next one begins.
//!
//! Their one argument is JSON of [`Paging`], their answer JSON of [`Page`]. Without the argument the answer is the list itself,
//! if that is one page.

use crate::chaincode::Context;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use serde::{Deserialize, Serialize};

/// Most elements of a page.
pub const PAGE_MAX: usize = 256;
/// Bytes of JSON after which a page ends. One more element may come on top.
pub const PAGE_BYTES: usize = 256 * 1024;
/// Longest place of a page, in bytes.
const PLACE_BYTES_MAX: usize = 1024;

/// The argument of a function that answers in pages.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Paging {
    /// [`Page::next`] of the page before; the first page without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after: Option<String>,
    /// Most elements; [`PAGE_MAX`] without, and never more.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub most: Option<usize>,
    /// Nothing was said of pages: the answer is the whole list, or none.
    #[serde(skip)]
    whole: bool,
}

/// The answer of such a function.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Page<T> {
    /// A part of the list, in its order. It may be empty although there are more.
    pub items: Vec<T>,
    /// Where the next page begins; none after the last one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next: Option<String>,
}

impl Paging {
    /// The page that begins at a place; the first one without.
    pub fn at(after: Option<String>) -> Self {
        Self { after, ..Self::default() }
    }

    /// The last of the arguments of a function, if it asks for a page; without one, the list is asked for.
    ///
    /// # Errors
    /// [`Code::BadArgument`] if the argument is something else than JSON of a page.
    pub fn of(function: &str, args: &[Bytes]) -> Result<Self, Rejection> {
        let Some(argument) = args.last() else { return Ok(Self { whole: true, ..Self::default() }) };
        let usable = |paging: &Self| paging.after.as_ref().is_none_or(|after| after.len() <= PLACE_BYTES_MAX);
        serde_json::from_slice(argument).ok().filter(usable).ok_or_else(|| {
            Rejection::new(Code::BadArgument, format!("the argument of {function} is not a page"))
                .found(format!("{} bytes", argument.len()))
                .wanted(format!(r#"{{"after": "PLACE", "most": NUMBER}}, both optional; a place has at most {PLACE_BYTES_MAX} bytes"#))
                .next("start with {}; the answer contains the place of the next page")
        })
    }

    /// The page of the keys that start with `prefix`, each with what `read` makes of key and value; none where it makes
    /// nothing. A place is what follows the prefix of a key, in hexadecimal digits.
    ///
    /// # Errors
    /// As `read`; [`Code::BadArgument`] for a place that is none.
    pub fn page<T: Serialize>(
        &self,
        ctx: &Context<'_>,
        prefix: &[u8],
        mut read: impl FnMut(&[u8], &[u8]) -> Result<Option<T>, Rejection>,
    ) -> Result<Page<T>, Rejection> {
        let most = self.most.unwrap_or(PAGE_MAX).clamp(1, PAGE_MAX);
        let after = self.after.as_ref().map(|place| hex::decode(place).map_err(|_| no_place(place))).transpose()?;
        let mut after = after.map(|place| [prefix, &place].concat());
        let (mut items, mut bytes) = (Vec::new(), 0);
        let mut keys = 0;
        // Values may be large: one at a time.
        while let Some((key, value)) = ctx.range_after(prefix, after.as_deref(), 1).pop() {
            if keys == most || bytes >= PAGE_BYTES {
                let next = after.as_ref().and_then(|last| last.strip_prefix(prefix)).map(hex::encode);
                return Ok(Page { items, next });
            }
            if let Some(item) = read(&key, &value)? {
                bytes += serde_json::to_vec(&item).map_or(0, |json| json.len());
                items.push(item);
            }
            keys += 1;
            after = Some(key.to_vec());
        }
        Ok(Page { items, next: None })
    }

    /// The answer: this page, or the list whose only page it is.
    ///
    /// # Errors
    /// [`Code::OverBudget`] if nothing was said of pages and there are more.
    pub fn answer<T: Serialize>(&self, page: &Page<T>) -> Result<Bytes, Rejection> {
        let json = match (self.whole, &page.next) {
            (false, _) => serde_json::to_vec(page),
            (true, None) => serde_json::to_vec(&page.items),
            (true, Some(_)) => return Err(several_pages()),
        };
        json.map(Bytes::from)
            .map_err(|error| Rejection::new(Code::Internal, format!("an answer cannot be encoded: {error}")))
    }
}

fn several_pages() -> Rejection {
    Rejection::new(Code::OverBudget, "the list is longer than one answer")
        .found(format!("more than {PAGE_MAX} elements, or {} KiB", PAGE_BYTES / 1024))
        .wanted("a request for one page")
        .next(
            "request it in pages, with the argument {}: each page contains the place of the next; the command line shows \
             complete lists",
        )
}

fn no_place(place: &str) -> Rejection {
    Rejection::new(Code::BadArgument, "the page has no place")
        .found(format!("{} bytes", place.len()))
        .wanted("the field next of the page before")
        .next("start with {}; the answer contains the place of the next page")
}
