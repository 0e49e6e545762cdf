//! Refusals as people read them, and as the wire carries them.

use crate::v1;
use ledger_base::rejection::{Code, Rejection};
use std::collections::HashMap;
use std::error::Error as _;
use tonic::Status;
use tonic_types::{ErrorDetails, StatusExt};

/// The domain of the `google.rpc.ErrorInfo` of every refusal.
pub const ERROR_DOMAIN: &str = "ledgerd";
/// Most bytes of each text of a refusal in a status, which travels in headers: clients commonly take 8 KiB of them.
const STATUS_TEXT_BYTES_MAX: usize = 384;

/// Column at which the code of a one-line message is printed, if the message leaves room.
const CODE_COLUMN: usize = 88;

/// The four lines that `ledgerctl` and `ledgerd` print: what failed with its code, what was found, what was wanted,
/// and what to try. Lines that would be empty are left out; the text ends without a newline.
///
/// ```
/// use ledger_base::rejection::{Code, Rejection};
/// let refused = Rejection::new(Code::Held, "Turtlebot4/cmd_vel is held").found("held by Org1/Salma");
/// let text = ledger_api::report(&refused);
/// assert!(text.starts_with("error: Turtlebot4/cmd_vel is held"));
/// assert!(text.ends_with("[LGR-3005]\n  found   held by Org1/Salma"));
/// ```
pub fn report(rejection: &Rejection) -> String {
    let first = format!("error: {}", rejection.message);
    let mut text = format!("{first:<CODE_COLUMN$}  [{}]", rejection.code);
    for (label, line) in
        [("found", rejection.found.as_str()), ("wanted", &rejection.wanted), ("try", rejection.advice())]
    {
        if !line.is_empty() {
            text.push_str(&format!("\n  {label:<6}  {line}"));
        }
    }
    text
}

impl From<&Rejection> for v1::Verdict {
    fn from(rejection: &Rejection) -> Self {
        Self {
            code: u32::from(rejection.code.number()),
            message: rejection.message.clone(),
            found: rejection.found.clone(),
            wanted: rejection.wanted.clone(),
            next: rejection.advice().to_owned(),
        }
    }
}

/// The refusal in a verdict; `Ok` if the call was executed.
///
/// # Errors
/// The refusal. A number that this version does not know becomes [`Code::Internal`] with the number in its text.
pub fn accepted(verdict: Option<&v1::Verdict>) -> Result<(), Rejection> {
    let Some(verdict) = verdict else {
        return Err(Rejection::new(Code::Internal, "the node answered without a verdict")
            .next("check that the address is that of a node, and that its version is not older than this program"));
    };
    if verdict.code == 0 {
        return Ok(());
    }
    let code = u16::try_from(verdict.code).ok().and_then(Code::from_number);
    let message = match code {
        Some(_) => verdict.message.clone(),
        None => format!("{} (code {}, unknown to this version)", verdict.message, verdict.code),
    };
    Err(Rejection::new(code.unwrap_or(Code::Internal), message)
        .found(verdict.found.clone())
        .wanted(verdict.wanted.clone())
        .next(verdict.next.clone()))
}

/// A refusal of a whole call as gRPC carries it: readable text for people, and a `google.rpc.Status` with a
/// `google.rpc.ErrorInfo` for programs in any language. Its reason is the name of the code, its domain
/// [`ERROR_DOMAIN`]; its metadata are `code` (`LGR-3005`), `found`, `wanted` and `try`, without those that are empty.
/// Long texts are cut.
pub fn to_status(rejection: &Rejection) -> Status {
    use ledger_base::rejection::Class;
    let code = match rejection.code.class() {
        Class::Ok | Class::Failure => tonic::Code::Internal,
        Class::Denied if rejection.code == Code::CertificateRequired => tonic::Code::Unauthenticated,
        Class::Denied => tonic::Code::PermissionDenied,
        Class::Invalid if rejection.code == Code::NotFound => tonic::Code::NotFound,
        Class::Invalid => tonic::Code::InvalidArgument,
        Class::Unreachable => tonic::Code::Unavailable,
        Class::Conflict => tonic::Code::FailedPrecondition,
    };
    let rejection = Rejection::new(rejection.code, cut(&rejection.message))
        .found(cut(&rejection.found))
        .wanted(cut(&rejection.wanted))
        .next(cut(rejection.advice()));
    let mut metadata = HashMap::from([("code".to_owned(), rejection.code.to_string())]);
    for (name, text) in
        [("found", rejection.found.as_str()), ("wanted", &rejection.wanted), ("try", rejection.advice())]
    {
        if !text.is_empty() {
            metadata.insert(name.to_owned(), text.to_owned());
        }
    }
    let details = ErrorDetails::with_error_info(rejection.code.name(), ERROR_DOMAIN, metadata);
    Status::with_error_details(code, rejection.to_string(), details)
}

fn cut(text: &str) -> String {
    if text.len() <= STATUS_TEXT_BYTES_MAX {
        return text.to_owned();
    }
    let end = text.floor_char_boundary(STATUS_TEXT_BYTES_MAX - '…'.len_utf8());
    format!("{}…", text.get(..end).unwrap_or_default())
}

/// The refusal in the status of a failed call to the node at `address`. A broken connection is
/// [`Code::Unreachable`].
pub fn from_status(address: &str, status: &Status) -> Rejection {
    if let Some(rejection) = detailed(status) {
        return rejection;
    }
    if let Some(rejection) = parse(status.message()) {
        return rejection;
    }
    let said = format!("{:?}: {}", status.code(), status.message());
    let (code, next) = match status.code() {
        _ if status.source().is_some() => (Code::Unreachable, ""),
        tonic::Code::Unavailable | tonic::Code::Unknown | tonic::Code::Cancelled | tonic::Code::Aborted => {
            (Code::Unreachable, "")
        }
        tonic::Code::DeadlineExceeded => (Code::Timeout, "try again, or use another node"),
        tonic::Code::Unauthenticated => (Code::CertificateRequired, ""),
        tonic::Code::PermissionDenied => (Code::Untrusted, "ask an admin of your organisation"),
        tonic::Code::NotFound => (Code::NotFound, "check the arguments"),
        tonic::Code::ResourceExhausted => (Code::Overloaded, ""),
        tonic::Code::OutOfRange => (Code::TooLarge, "split it into several calls"),
        tonic::Code::InvalidArgument => (Code::Malformed, "check the arguments"),
        tonic::Code::Unimplemented => (Code::Internal, "upgrade the node: it does not support this call"),
        _ => (Code::Internal, "check the log of the node"),
    };
    Rejection::new(code, format!("the call to {address} failed")).found(said).next(next)
}

/// The refusal in the details of a status, if a node made them.
fn detailed(status: &Status) -> Option<Rejection> {
    let info = status.get_details_error_info().filter(|info| info.domain == ERROR_DOMAIN)?;
    let text = |name: &str| info.metadata.get(name).cloned().unwrap_or_default();
    let first = status.message().lines().next().unwrap_or_default();
    let verdict = v1::Verdict {
        code: text("code").strip_prefix("LGR-")?.parse().ok()?,
        message: first.rsplit_once(" [LGR-").map_or(first, |(message, _)| message).to_owned(),
        found: text("found"),
        wanted: text("wanted"),
        next: text("try"),
    };
    accepted(Some(&verdict)).err()
}

/// Reads back what `Rejection` prints: for nodes that send the text only.
fn parse(text: &str) -> Option<Rejection> {
    let mut lines = text.lines();
    let (message, code) = lines.next()?.rsplit_once(" [LGR-")?;
    let code = Code::from_number(code.strip_suffix(']')?.parse().ok()?)?;
    let mut rejection = Rejection::new(code, message.trim_start_matches("error: ").trim_end());
    for line in lines {
        match line.trim_start().split_once(' ') {
            Some(("found", rest)) => rejection.found = rest.trim_start().to_owned(),
            Some(("wanted", rest)) => rejection.wanted = rest.trim_start().to_owned(),
            Some(("try", rest)) => rejection = rejection.next(rest.trim_start()),
            _ => {}
        }
    }
    Some(rejection)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn example() -> Rejection {
        Rejection::new(Code::Untrusted, "cannot join network \"fleet\"")
            .found("issuer \"CN=acme-ca\"")
            .wanted("one of the roots")
            .next("ledgerctl network add-org acme")
    }

    #[test]
    fn the_general_advice_of_a_code_is_shown_to_people_and_to_programs() {
        let behind = Rejection::new(Code::Behind, "it is behind");
        let advice = Code::Behind.advice();
        assert!(
            !advice.is_empty() && report(&behind).ends_with(&format!("\n  try     {advice}")),
            "{}",
            report(&behind)
        );
        assert_eq!(v1::Verdict::from(&behind).next, advice);
        let status = to_status(&behind);
        let metadata = status.get_details_error_info().map(|info| info.metadata).unwrap_or_default();
        assert_eq!(metadata.get("try").map(String::as_str), Some(advice));
        assert_eq!(from_status("node", &status).advice(), advice);
        let older = v1::Verdict { next: String::new(), ..v1::Verdict::from(&behind) };
        let read = accepted(Some(&older)).err();
        assert_eq!(read.as_ref().map(Rejection::advice), Some(advice), "of a node that sends none");
    }

    #[test]
    fn a_report_has_four_lines_in_this_order() {
        let text = report(&example());
        let lines: Vec<_> = text.lines().collect();
        assert!(
            matches!(
                lines.as_slice(),
                [first, "  found   issuer \"CN=acme-ca\"", "  wanted  one of the roots", "  try     ledgerctl network add-org acme"]
                    if first.starts_with("error: cannot join network \"fleet\"  ") && first.ends_with("  [LGR-2001]")
            ),
            "{text}"
        );
    }

    #[test]
    fn a_refusal_survives_the_wire_with_and_without_details() {
        let status = to_status(&example());
        assert_eq!(from_status("node:1", &status), example());
        assert_eq!(from_status("node:1", &Status::new(status.code(), status.message())), example());
    }

    #[test]
    fn programs_find_the_code_and_the_four_lines_in_the_details_of_any_status() {
        let refused = Rejection::new(Code::NotFound, "there is no block 9").wanted("a height from 0 to 4");
        let status = to_status(&refused);
        let info = status.get_details_error_info();
        let told = info.map(|info| (info.reason, info.domain, info.metadata.into_iter().collect::<BTreeMap<_, _>>()));
        let metadata = [("code", "LGR-1013"), ("wanted", "a height from 0 to 4")];
        let metadata = metadata.map(|(name, text)| (name.to_owned(), text.to_owned())).into();
        assert_eq!(told, Some(("NOT_FOUND".to_owned(), "ledgerd".to_owned(), metadata)));
        assert_eq!(status.code(), tonic::Code::NotFound);
    }

    #[test]
    fn a_long_text_fits_into_the_headers_that_clients_take() {
        let long = "Ä".repeat(10_000);
        let status = to_status(&Rejection::new(Code::Held, &long).found(&long).wanted(&long).next(&long));
        // Percent signs take three bytes for one, base64 four for three.
        let bytes = status.message().len() * 3 + status.details().len() * 4 / 3;
        assert!(bytes < 10 * 1024, "{bytes} bytes");
        let read = from_status("node:1", &status);
        assert!(read.code == Code::Held && read.found.ends_with('…') && read.advice().starts_with("ÄÄ"), "{read}");
    }

    #[test]
    fn details_of_somebody_else_are_not_taken_for_a_refusal_of_a_node() {
        let details =
            ErrorDetails::with_error_info("HELD", "example.org", [("code".to_owned(), "LGR-3005".to_owned())]);
        let status = Status::with_error_details(tonic::Code::Unavailable, "a proxy", details);
        assert_eq!(from_status("node:1", &status).code, Code::Unreachable);
    }

    #[test]
    fn a_code_of_a_newer_node_is_named_by_its_number() {
        let verdict = v1::Verdict { code: 3999, message: "no".into(), ..v1::Verdict::default() };
        let found = accepted(Some(&verdict));
        assert!(matches!(found, Err(refused) if refused.code == Code::Internal && refused.message.contains("3999")));
    }

    #[test]
    fn a_broken_connection_is_unreachable() {
        assert_eq!(from_status("node:1", &Status::unavailable("gone")).code, Code::Unreachable);
    }
}
