//! The rows of one block: its decisions about control, what was commanded, and what was refused.

use super::{ABAC, action, certificates};
use ledger::Outcome;
use ledger::msp::{Refused, TellRefusals};
use ledger::transaction::Transaction;
use ledger_abac::MessageEvent;
use ledger_base::hash::Hash;
use ledger_storage::audit::{Holder, Row};
use ledger_storage::result::{EmittedEvent, Event, TransactionResult};
use serde_json::Value;
use std::collections::HashMap;

/// The function of `msp` that revokes a person.
const REVOKE: &str = "revoke_identity";
/// The function of `msp` that revokes the certificates of a person with other attributes than the new one.
const RECORD: &str = "record_certificate";
/// Names of creators that are remembered.
const NAMES_MAX: usize = 4096;
/// Longest text of a row, bytes.
const TEXT_BYTES_MAX: usize = 256;
/// Events that are no decision about control, or that follow from one.
const LEFT_OUT: [&str; 4] = ["attested", "line", "message", "renewed"];
/// Fields of a payload that name whom it is about, the most telling first.
const WHO: [&str; 7] = ["holder", "receiver", "contender", "submitter", "giver", "publisher", "by"];
/// Fields that are told as words.
const WORDS: [&str; 12] = [
    "change",
    "id",
    "state",
    "reason",
    "taken",
    "message",
    "role",
    "quorum",
    "number",
    "confirmed",
    "publishers",
    "topic",
];

/// The names of creators by their certificates.
#[derive(Default)]
pub(super) struct Names {
    known: HashMap<Hash, String>,
    /// Holders that no block has told yet.
    new: Vec<Holder>,
}

/// One call of a block.
#[derive(Default)]
struct Call {
    creator: String,
    chaincode: String,
    function: String,
    subject: String,
    /// The person whose certificates it ends, if it says so.
    revoked: String,
    transaction: Hash,
}

impl Names {
    /// The rows of a block, and the holders of certificates whom it shows. `signer` finds a creator.
    pub(super) fn rows(
        &mut self,
        outcome: &Outcome,
        signer: impl Fn(&Hash) -> Option<Holder>,
    ) -> (Vec<Row>, Vec<Holder>) {
        let mut rows: Vec<Row> = Vec::new();
        let mut last: Option<(u32, Call)> = None;
        for EmittedEvent { index, event } in &outcome.events {
            if !matters(event) {
                continue;
            }
            let call = match (index, last.take()) {
                (Some(index), Some((of, call))) if *index == of => call,
                (Some(index), _) => self.call(outcome, *index, &signer),
                (None, _) => Call::default(),
            };
            if event.chaincode == ledger::msp::NAME && event.name == "certified" {
                self.new.extend(certificates::certified(event));
            }
            rows.extend(of_event(event, &call).into_iter().map(|row| at(outcome, row)));
            fold_last(&mut rows);
            last = index.map(|index| (index, call));
        }
        for (index, result) in (0u32..).zip(&outcome.results).filter(|(_, result)| result.code != 0) {
            rows.push(at(outcome, of_refusal(&self.call(outcome, index, &signer), result)));
            fold_last(&mut rows);
        }
        (rows, std::mem::take(&mut self.new))
    }

    fn call(&mut self, outcome: &Outcome, index: u32, signer: impl Fn(&Hash) -> Option<Holder>) -> Call {
        let place = index as usize;
        let encoded = outcome.transactions.get(place).cloned().unwrap_or_default();
        let Ok(transaction) = Transaction::decode(encoded) else { return Call::default() };
        let body = transaction.body();
        // Nobody has signed what was refused for its signature.
        let is_signed = outcome.results.get(place).is_some_and(|result| result.not_after.is_some());
        let creator = if is_signed { self.name(&transaction.creator(), signer) } else { String::new() };
        let argument = match body.function.as_str() {
            REVOKE => name_in(body.args.first()).unwrap_or_default().into(),
            _ => body.args.first().map(|argument| String::from_utf8_lossy(argument)).unwrap_or_default(),
        };
        let revoked = match body.function.as_str() {
            REVOKE => creator.split_once('/').map(|(organisation, _)| format!("{organisation}/{argument}")),
            RECORD => certified(outcome, index),
            _ => None,
        };
        let is_name =
            argument.len() <= TEXT_BYTES_MAX && argument.chars().all(|c| c.is_alphanumeric() || "/_-.:*".contains(c));
        Call {
            creator,
            chaincode: body.chaincode.clone(),
            function: body.function.clone(),
            subject: if is_name { argument.into_owned() } else { String::new() },
            revoked: revoked.unwrap_or_default(),
            transaction: outcome.ids.get(place).copied().unwrap_or(Hash::ZERO),
        }
    }

    fn name(&mut self, creator: &Hash, signer: impl Fn(&Hash) -> Option<Holder>) -> String {
        if let Some(known) = self.known.get(creator) {
            return known.clone();
        }
        let Some(holder) = signer(creator) else { return String::new() };
        if self.known.len() >= NAMES_MAX {
            self.known.clear();
        }
        let name = holder.name.clone();
        self.known.insert(*creator, name.clone());
        self.new.push(holder);
        name
    }
}

/// The person to whom a call gives a certificate.
fn certified(outcome: &Outcome, call: u32) -> Option<String> {
    let mut events = outcome.events.iter().filter(|emitted| emitted.index == Some(call));
    events.find(|emitted| emitted.event.name == "certified").map(|emitted| emitted.event.subject.clone())
}

/// The name in an argument that is a JSON object.
fn name_in(argument: Option<&bytes::Bytes>) -> Option<String> {
    let argument: Value = serde_json::from_slice(argument?).ok()?;
    argument.get("name")?.as_str().map(str::to_owned)
}

fn matters(event: &Event) -> bool {
    match event.chaincode.as_str() {
        ABAC => event.name == "message" || !LEFT_OUT.contains(&event.name.as_str()),
        ledger::msp::NAME => !LEFT_OUT.contains(&event.name.as_str()),
        _ => false,
    }
}

/// With time and place of its block, where it has no other.
fn at(outcome: &Outcome, row: Row) -> Row {
    let (height, time) = (outcome.header.height, outcome.header.time);
    let own = |given: u64| if given == 0 { time } else { given };
    Row {
        time,
        height,
        last_height: height,
        first: own(row.first),
        last: own(row.last),
        count: row.count.max(1),
        ..row
    }
}

/// Many commands of one block, one after the other, are one row.
fn fold_last(rows: &mut Vec<Row>) {
    let [.., before, last] = &mut rows[..] else { return };
    let alike = before.is_use()
        && last.is_use()
        && (&before.who, &before.subject, before.epoch) == (&last.who, &last.subject, last.epoch);
    if alike {
        before.count = before.count.saturating_add(last.count);
        rows.pop();
    }
}

fn of_event(event: &Event, call: &Call) -> Vec<Row> {
    match (event.chaincode.as_str(), event.name.as_str()) {
        (ABAC, "message") => vec![of_message(event, call)],
        (ledger::msp::NAME, "refused") => of_telling(event, call),
        (ABAC, _) => vec![of_abac(event, call)],
        (_, "revocation_list") => {
            let list = of_msp(event, call);
            let listed = certificates::listed(event, &list);
            std::iter::once(list).chain(listed).collect()
        }
        _ => vec![of_msp(event, call)],
    }
}

fn of_message(event: &Event, call: &Call) -> Row {
    let told: Option<MessageEvent> = serde_json::from_slice(&event.payload).ok();
    let (epoch, count) = told.map_or((0, 1), |told| (told.epoch, told.count));
    // Under a grant they were decided with it.
    let action = if epoch == 0 { "publish" } else { "" };
    Row {
        decision: "used".into(),
        who: call.creator.clone(),
        robot: robot(&event.subject),
        subject: event.subject.clone(),
        count,
        epoch,
        action: action.into(),
        transaction: bytes(&call.transaction),
        ..Row::default()
    }
}

fn of_abac(event: &Event, call: &Call) -> Row {
    let payload: Value = serde_json::from_slice(&event.payload).unwrap_or_default();
    let text = |field: &str| payload.get(field).and_then(Value::as_str).unwrap_or_default();
    let number = |field: &str| payload.get(field).and_then(Value::as_u64).unwrap_or_default();
    let who = WHO.map(text).into_iter().find(|who| !who.is_empty()).unwrap_or(&call.creator).to_owned();
    let by = Some(text("by")).filter(|by| !by.is_empty()).unwrap_or(&call.creator);
    let others: Vec<_> = WHO.map(text).into_iter().chain([&*call.creator]).filter(|one| one.contains('/')).collect();
    let others = others.into_iter().filter(|one| **one != who && *one != by).map(str::to_owned).collect();
    let organisation = text("organisation");
    let about_policies = event.name.starts_with("policy");
    let action = match event.name.as_str() {
        "granted" if text("taken").is_empty() => "acquire",
        "granted" => "override",
        _ => "",
    };
    Row {
        decision: event.name.clone(),
        by: if by == who { String::new() } else { by.to_owned() },
        who,
        robot: if about_policies { String::new() } else { robot(&event.subject) },
        subject: event.subject.clone(),
        epoch: number("epoch"),
        policy_version: number("policy_version").max(number("version")),
        policies: names(&payload, "policies"),
        action: action.into(),
        detail: words(&payload),
        transaction: bytes(&call.transaction),
        others,
        organisations: Some(organisation.to_owned()).filter(|name| !name.is_empty()).into_iter().collect(),
        ..Row::default()
    }
}

fn of_msp(event: &Event, call: &Call) -> Row {
    let payload: Value = serde_json::from_slice(&event.payload).unwrap_or_default();
    let text = |field: &str| payload.get(field).and_then(Value::as_str).unwrap_or_default();
    let organisation = Some(text("organisation")).filter(|name| !name.is_empty());
    let certificate = if event.name == "revoked" { certificates::revoked(event) } else { None };
    let who = match event.name.as_str() {
        // The event has a number. The call says whose certificate it was, or the index finds it.
        "revoked" => call.revoked.clone(),
        "revocation_list" => call.creator.clone(),
        _ if event.subject.contains('/') => event.subject.clone(),
        _ => call.creator.clone(),
    };
    Row {
        decision: event.name.clone(),
        by: if who == call.creator { String::new() } else { call.creator.clone() },
        who,
        subject: event.subject.clone(),
        detail: words(&payload),
        transaction: bytes(&call.transaction),
        certificate: certificate.unwrap_or_default(),
        organisations: organisation.map(str::to_owned).into_iter().collect(),
        ..Row::default()
    }
}

/// The refusals that a node tells.
fn of_telling(event: &Event, call: &Call) -> Vec<Row> {
    let told: Option<TellRefusals> = serde_json::from_slice(&event.payload).ok();
    let rows = told.map(|told| told.refusals).unwrap_or_default().into_iter().map(|refused| {
        let Refused { who, chaincode, function, subject, code, count, first, last, why, found, .. } = refused;
        let (policy_version, policies) = policies(&why);
        Row {
            decision: "refused".into(),
            action: action::of_call(&chaincode, &function).into(),
            who,
            robot: if chaincode == ABAC { robot(&subject) } else { String::new() },
            subject: if subject.is_empty() { [chaincode, function].join(" ").trim().to_owned() } else { subject },
            code,
            count,
            first,
            last,
            policy_version,
            policies,
            detail: why,
            found,
            // Its own report: no block has what was rejected.
            transaction: bytes(&call.transaction),
            told_by: call.creator.clone(),
            ..Row::default()
        }
    });
    rows.collect()
}

/// A call that the block refused.
fn of_refusal(call: &Call, result: &TransactionResult) -> Row {
    let (policy_version, policies) = policies(&result.message);
    Row {
        decision: "refused".into(),
        action: action::of_call(&call.chaincode, &call.function).into(),
        who: call.creator.clone(),
        robot: if call.chaincode == ABAC { robot(&call.subject) } else { String::new() },
        subject: if call.subject.is_empty() {
            format!("{} {}", call.chaincode, call.function)
        } else {
            call.subject.clone()
        },
        code: result.code,
        policy_version,
        policies,
        detail: short(&result.message),
        found: short(&result.found),
        transaction: bytes(&call.transaction),
        ..Row::default()
    }
}

/// The robot of a service.
fn robot(service: &str) -> String {
    service.split('/').next().unwrap_or_default().split(':').next().unwrap_or_default().to_owned()
}

/// The number of the set of policies that a refusal names, and those that forbid: `(policies of Org2, version 3: night, rain)`.
fn policies(why: &str) -> (u64, Vec<String>) {
    let told = why.rsplit_once(", version ").and_then(|(_, told)| told.strip_suffix(')')).unwrap_or_default();
    let (number, ids) = told.split_once(": ").unwrap_or((told, ""));
    match number.parse() {
        Ok(number) => (number, ids.split(", ").filter(|id| !id.is_empty()).map(str::to_owned).collect()),
        Err(_) => (0, Vec::new()),
    }
}

/// The texts in a field of a payload that is a list.
fn names(payload: &Value, field: &str) -> Vec<String> {
    let list = payload.get(field).and_then(Value::as_array);
    list.into_iter().flatten().filter_map(|name| Some(name.as_str()?.to_owned())).collect()
}

/// The words of a payload.
fn words(payload: &Value) -> String {
    let told = WORDS.iter().filter_map(|field| match payload.get(field)? {
        Value::String(text) if !text.is_empty() => Some(text.clone()),
        Value::Number(number) => Some(format!("{field} {number}")),
        _ => None,
    });
    short(&told.collect::<Vec<_>>().join(", "))
}

fn short(text: &str) -> String {
    match text.char_indices().find(|(at, c)| at + c.len_utf8() > TEXT_BYTES_MAX) {
        Some((end, _)) => text.get(..end).unwrap_or_default().to_owned(),
        None => text.to_owned(),
    }
}

fn bytes(id: &Hash) -> bytes::Bytes {
    if *id == Hash::ZERO { bytes::Bytes::new() } else { bytes::Bytes::copy_from_slice(&id.0) }
}
