//! Lists that come in pages, and ways that come in steps, from a node that may never end them.

use crate::v1;
use bytes::Bytes;
use ledger::{Page, Paging};
use ledger_base::rejection::{Code, Rejection};
use prost::Message;
use serde::de::DeserializeOwned;

/// Most elements of a list that are taken.
const ITEMS_MAX: usize = 100_000;
/// Most pages without an element.
const EMPTY_MAX: usize = 1000;

/// Bounds the pages of one list, so that a node that always has another page does not keep a client busy without end.
#[derive(Clone, Debug, Default)]
pub struct PageBound {
    items: usize,
    empty: usize,
}

impl PageBound {
    /// Counts a page of so many elements, which has another one behind it.
    ///
    /// # Errors
    /// [`Code::TooLarge`] if the list has more than 100 000 elements, or the node sends pages without any.
    pub fn count(&mut self, what: &str, items: usize) -> Result<(), Rejection> {
        self.items = self.items.saturating_add(items);
        self.empty += usize::from(items == 0);
        if self.items <= ITEMS_MAX && self.empty <= EMPTY_MAX {
            return Ok(());
        }
        Err(Rejection::new(Code::TooLarge, format!("the pages of {what} of this node do not end"))
            .found(format!("{} so far, {} pages without any", self.items, self.empty))
            .wanted(format!("at most {ITEMS_MAX}, and {EMPTY_MAX} pages without any"))
            .next("ask another node, or narrow the query"))
    }
}

/// Most steps of a way without content. An honest node sends one at most.
const EMPTY_STEPS_MAX: usize = 16;

/// Bounds the steps of one way, so that a node that always shows another one does not keep a client busy without end.
#[derive(Clone, Debug)]
pub(crate) struct WayBound {
    bytes: usize,
    bytes_max: usize,
    empty: usize,
}

impl WayBound {
    /// At most this number of bytes.
    pub(crate) fn new(bytes_max: usize) -> Self {
        Self { bytes: 0, bytes_max, empty: 0 }
    }

    /// Counts a step.
    ///
    /// # Errors
    /// [`Code::TooLarge`] if the way has too many bytes, or too many steps without content.
    pub(crate) fn count(&mut self, step: &v1::GovernanceStep) -> Result<(), Rejection> {
        let bytes = step.encoded_len();
        self.bytes = self.bytes.saturating_add(bytes);
        self.empty += usize::from(bytes == 0);
        if self.bytes <= self.bytes_max && self.empty <= EMPTY_STEPS_MAX {
            return Ok(());
        }
        Err(Rejection::new(Code::TooLarge, "the changes of voters that this node sends do not end")
            .found(format!("{} bytes so far, {} steps without content", self.bytes, self.empty))
            .wanted(format!("at most {} bytes, and {EMPTY_STEPS_MAX} steps without content", self.bytes_max))
            .next("ask another node, or start at a checkpoint"))
    }
}

/// All elements of a list: follows its pages. `ask` queries the function with these arguments.
///
/// # Errors
/// As `ask`; [`Code::Malformed`] for an answer that is no page, [`Code::TooLarge`] for a list that does not end ([`PageBound`]).
pub async fn follow<T: DeserializeOwned, A: Future<Output = Result<Bytes, Rejection>>>(
    what: &str,
    ask: impl Fn(Vec<Bytes>) -> A,
) -> Result<Vec<T>, Rejection> {
    let (mut items, mut paging, mut bound) = (Vec::new(), Paging::default(), PageBound::default());
    loop {
        let argument = serde_json::to_vec(&paging).map_err(|error| unreadable(what, &error))?;
        let answer = ask(vec![argument.into()]).await?;
        let page: Page<T> = serde_json::from_slice(&answer).map_err(|error| unreadable(what, &error))?;
        let count = page.items.len();
        items.extend(page.items);
        match page.next {
            Some(next) if paging.after.as_ref() != Some(&next) => {
                bound.count(what, count)?;
                paging.after = Some(next);
            }
            _ => return Ok(items),
        }
    }
}

fn unreadable(what: &str, error: &serde_json::Error) -> Rejection {
    Rejection::new(Code::Malformed, format!("{what} cannot be read"))
        .found(error.to_string())
        .wanted("JSON that this version understands")
        .next("use the same version for client and node")
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[tokio::test]
    async fn pages_are_followed_to_the_end() {
        let node = |args: Vec<Bytes>| async move {
            let paging: Paging = serde_json::from_slice(args.first().unwrap()).unwrap();
            let from: u64 = paging.after.map_or(0, |after| after.parse().unwrap());
            let page = Page { items: (from..from + 3).collect(), next: (from < 6).then(|| (from + 3).to_string()) };
            Ok(serde_json::to_vec(&page).unwrap().into())
        };
        assert_eq!(follow::<u64, _>("a list", node).await.unwrap(), (0..9).collect::<Vec<_>>());
        let refusing = |_: Vec<Bytes>| async { Err(Rejection::new(Code::Revoked, "revoked")) };
        assert_eq!(follow::<u64, _>("a list", refusing).await.unwrap_err().code, Code::Revoked);
        let lying = |_: Vec<Bytes>| async { Ok(Bytes::from(r#"{"items":[1],"next":"1"}"#)) };
        assert_eq!(follow::<u64, _>("a list", lying).await.unwrap(), [1, 1], "a place that stands still ends it");
    }

    #[tokio::test]
    async fn a_list_that_never_ends_is_left_with_a_reason() {
        for count in [0, 1000] {
            let endless = |args: Vec<Bytes>| async move {
                let paging: Paging = serde_json::from_slice(args.first().unwrap()).unwrap();
                let from: u64 = paging.after.map_or(0, |after| after.parse().unwrap());
                let page = Page { items: vec![from; count], next: Some((from + 1).to_string()) };
                Ok(serde_json::to_vec(&page).unwrap().into())
            };
            let refused = follow::<u64, _>("robots", endless).await.unwrap_err();
            assert!(refused.code == Code::TooLarge && refused.message.contains("robots"), "{refused}");
        }
    }

    #[test]
    fn a_way_that_never_ends_is_refused_whatever_its_steps_hold() {
        let with = |genesis: Vec<u8>| v1::GovernanceStep { genesis: genesis.into(), ..Default::default() };
        let taken = |step: &v1::GovernanceStep| {
            let mut bound = WayBound::new(1 << 20);
            (0..1_000_000).find(|_| bound.count(step).is_err_and(|refused| refused.code == Code::TooLarge))
        };
        assert_eq!(taken(&with(Vec::new())), Some(EMPTY_STEPS_MAX));
        assert!(taken(&with(vec![0; 1000])).is_some_and(|steps| (900..1100).contains(&steps)));
        assert!(taken(&with(vec![0; 1])).is_some());
    }
}
