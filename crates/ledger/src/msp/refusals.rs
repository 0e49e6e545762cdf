//! Refusals before ordering, as nodes tell them: gathered per identity, service, function and code, so that a flood is one line.
//!
//! The ledger judges nothing of it: it is the word of the node that signed it. It keeps only when a node told last, so that
//! no node fills the chain.

use super::caller::{node, object};
use super::nodes::{self, NodeRecord};
use super::store;
use crate::chaincode::{Context, Foretold};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::result::Event;
use serde::{Deserialize, Serialize};

/// Most lines of one report. Of those beyond, each identity has one line, then each organisation, `Org1/*`.
pub const REFUSALS_MAX: usize = 64;
/// Most bytes of the argument.
pub const REFUSALS_BYTES_MAX: usize = 64 * 1024;
/// Most bytes of one text in it.
pub const REFUSED_TEXT_MAX: usize = 256;
/// Block time between two tellings of a node, microseconds.
pub const REFUSALS_PAUSE: u64 = 1_000_000;

/// Argument of `tell_refusals`, and payload of the event `refused`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TellRefusals {
    /// One line for each identity, service, function and code.
    pub refusals: Vec<Refused>,
}

/// The refusals of one identity, about one service, with one code.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Refused {
    /// The signer, e.g. `Org1/Farhad`; `Org1/*` for several identities of an organisation; empty if no signature was verified, and for
    /// the rest of too many organisations.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub who: String,
    /// The chaincode that was called; empty for the rest of too many.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub chaincode: String,
    /// The function that was called last.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub function: String,
    /// The service, or what else the call was about.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub subject: String,
    /// Number of the code; 0 for several codes, services or functions in one line.
    pub code: u32,
    /// How many there were.
    pub count: u64,
    /// When the first and the last one came, by the clock of the node, microseconds since the UNIX epoch.
    pub first: u64,
    /// See `first`.
    pub last: u64,
    /// The transaction of the last one; none if it was a subscription.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sample: Option<Hash>,
    /// The refusal of the last one, in one line.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub why: String,
    /// The value that was found.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub found: String,
}

impl Refused {
    fn texts(&self) -> [&str; 6] {
        [&self.who, &self.chaincode, &self.function, &self.subject, &self.why, &self.found]
    }

    /// Can it be as it says?
    fn is_sound(&self) -> bool {
        let readable = |text: &str| text.len() <= REFUSED_TEXT_MAX && !text.chars().any(char::is_control);
        self.count > 0 && self.first <= self.last && self.texts().into_iter().all(readable)
    }
}

/// `tell_refusals {refusals}`
pub(super) fn tell(ctx: &mut Context<'_>, argument: &Bytes) -> Result<Bytes, Rejection> {
    if argument.len() > REFUSALS_BYTES_MAX {
        return Err(Rejection::new(Code::TooLarge, "the rejection report is too large")
            .found(format!("{} bytes", argument.len()))
            .wanted(format!("at most {REFUSALS_BYTES_MAX} bytes")));
    }
    let told: TellRefusals = object("tell_refusals", argument, "{\"refusals\": [{\"code\", \"count\", …}, …]}")?;
    let caller = node(ctx, "report its rejections")?;
    if nodes::present(ctx, &caller.organisation, &caller.name)?.is_none() {
        return Err(Rejection::new(Code::NotAMember, format!("{} is not a node of this network", caller.id()))
            .wanted("a node that is a member"));
    }
    check(&told)?;
    let key = store::told_key(&caller.organisation, &caller.name);
    let last: Option<u64> = store::read(ctx, &key)?;
    let since = last.map(|last| ctx.block_time().saturating_sub(last));
    if let Some(since) = since.filter(|since| *since < REFUSALS_PAUSE) {
        return Err(Rejection::new(
            Code::LimitExceeded,
            format!("{} reported its rejections a moment ago", caller.id()),
        )
        .found(format!("{} ms ago", since / 1000))
        .wanted("at most one report per second")
        .next("combine the rejections of a second in one report"));
    }
    store::write(ctx, &key, &ctx.block_time())?;
    ctx.emit("refused", "", argument.clone());
    Ok(Bytes::new())
}

fn check(told: &TellRefusals) -> Result<(), Rejection> {
    let lines = told.refusals.len();
    if lines == 0 || lines > REFUSALS_MAX {
        return Err(Rejection::new(Code::BadArgument, "the number of lines in the rejection report is out of range")
            .found(format!("{lines} lines"))
            .wanted(format!("1 to {REFUSALS_MAX}")));
    }
    if let Some(line) = told.refusals.iter().position(|refused| !refused.is_sound()) {
        return Err(Rejection::new(Code::BadArgument, "a line of the rejection report is not usable")
            .found(format!("line {}", line + 1))
            .wanted(format!(
                "a count above 0, a first time not after the last, texts of {REFUSED_TEXT_MAX} bytes without control characters"
            )));
    }
    Ok(())
}

/// Forgets when a node told last that was removed.
pub(super) fn forget(ctx: &mut Context<'_>, node: &NodeRecord) {
    let key = store::told_key(&node.organisation, &node.name);
    if ctx.get(key.as_bytes()).is_some() {
        ctx.delete(key.as_bytes());
    }
}

/// The event says what the call says, so nothing of it is kept twice.
pub(super) fn foretell(argument: &Bytes) -> Foretold {
    let event = Event {
        chaincode: super::NAME.to_owned(),
        name: "refused".to_owned(),
        subject: String::new(),
        payload: argument.clone(),
    };
    Foretold { response: Bytes::new(), events: vec![event] }
}

/// May the submitter read what others were refused? Their nodes and admins do.
pub(super) fn may_read(ctx: &Context<'_>) -> Result<(), Rejection> {
    let reader = ctx.submitter()?;
    match reader.role {
        ledger_identity::Role::Admin | ledger_identity::Role::Node => Ok(()),
        role => Err(Rejection::new(Code::NotAdmin, format!("{} may not read the rejections of others", reader.id()))
            .found(format!("role {role}"))
            .wanted(format!("an admin of {}", reader.organisation))),
    }
}
