//! Lists that come in pages.

use bytes::Bytes;
use ledger::{Page, Paging};
use ledger_base::rejection::{Code, Rejection};
use serde::de::DeserializeOwned;

/// All elements of a list: follows its pages. `ask` queries the function with these arguments.
///
/// # Errors
/// As `ask`; [`Code::Malformed`] for an answer that is no page.
pub async fn follow<T: DeserializeOwned, A: Future<Output = Result<Bytes, Rejection>>>(
    what: &str,
    ask: impl Fn(Vec<Bytes>) -> A,
) -> Result<Vec<T>, Rejection> {
    let (mut items, mut paging) = (Vec::new(), Paging::default());
    loop {
        let argument = serde_json::to_vec(&paging).map_err(|error| unreadable(what, &error))?;
        let answer = ask(vec![argument.into()]).await?;
        let page: Page<T> = serde_json::from_slice(&answer).map_err(|error| unreadable(what, &error))?;
        items.extend(page.items);
        match page.next {
            Some(next) if paging.after.as_ref() != Some(&next) => paging.after = Some(next),
            _ => return Ok(items),
        }
    }
}

fn unreadable(what: &str, error: &serde_json::Error) -> Rejection {
    Rejection::new(Code::Malformed, format!("{what} cannot be read"))
        .found(error.to_string())
        .wanted("the JSON that this version knows")
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
}
