//! The meaning of a policy in words, as the node reads it.

use crate::answer;
use crate::output::printable;
use crate::session::{ABAC, Session};
use bytes::Bytes;
use ledger_base::rejection::Rejection;
use ledger_contract::{PolicyCheck, PolicyMeaning};
use std::io::{self, Write};

/// The faults of a text as a policy, or its meaning.
///
/// # Errors
/// The node does not answer.
pub(in crate::command) async fn check(session: &Session, text: &str) -> Result<PolicyCheck, Rejection> {
    let response = session.ask(ABAC, "check", vec![Bytes::from(text.to_owned())]).await?;
    answer::parse(&response, "the faults of a policy")
}

/// A policy in words.
pub(in crate::command) fn meaning(out: &mut dyn Write, policy: &PolicyMeaning) -> io::Result<()> {
    let PolicyMeaning { line, effect, meaning, when, limits, except, unmatched } = policy;
    writeln!(out, "  line {line}: {}", printable(meaning))?;
    for condition in when {
        writeln!(out, "    when {}", printable(&condition.replace('\n', " ")))?;
    }
    let (windows, limits): (Vec<_>, Vec<_>) = limits.iter().cloned().partition(|limit| limit.starts_with("within "));
    for window in windows {
        writeln!(out, "    {}", printable(&window))?;
    }
    if !limits.is_empty() {
        writeln!(out, "    with {}", printable(&limits.join(", ")))?;
    }
    if *unmatched {
        writeln!(out, "    warning: it applies to no current identity that the ledger lists")?;
    }
    match effect.as_str() {
        _ if except.is_empty() => Ok(()),
        "permit" => writeln!(out, "    without {}: a permit must name these actions", except.join(", ")),
        _ => writeln!(
            out,
            "    without {} by the robot and by holders: a forbid must name these actions",
            except.join(", ")
        ),
    }
}
