//! How a decision is told: done, or who must still approve.

use crate::failure::Failure;
use crate::output::{self, Facts, Output, Table, printable};
use bytes::Bytes;
use ledger::Call;
use ledger::Quorum;
use ledger::msp::{
    self, ActivateRules, AddOrganisation, Decision, InviteOrganisation, NodeRole, RemoveOrganisation,
    SetCertificateRule, SetNodeRole,
};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::Certificate;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeSet;
use std::io::{self, Write};

/// The outcome of a wish.
#[derive(Serialize)]
pub(super) struct Decided {
    #[serde(flatten)]
    pub(super) decision: Decision,
    /// Told when it is done.
    #[serde(skip)]
    pub(super) done: String,
}

impl Decided {
    /// Tells it, as a refusal if enough have approved but the call was refused.
    pub(super) fn show(&self, output: &mut Output) -> Result<(), Failure> {
        match failed(&self.decision) {
            None => output.show(self),
            Some(refused) => Err(refused.into()),
        }
    }
}

impl Facts for Decided {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.decision.executed {
            return writeln!(out, "{}", printable(&self.done));
        }
        waiting(&self.decision, out)
    }
}

/// The refusal of a call that enough have approved.
fn failed(decision: &Decision) -> Option<Rejection> {
    let proposal = decision.proposal.as_ref()?;
    let code = Code::from_number(proposal.failed?.code).unwrap_or(Code::Refused);
    let message = format!("enough have approved, but the call failed: {}", what(&proposal.call));
    let found = format!("{code} {} when it was executed; its changes were discarded", code.name());
    let next = format!("ledgerctl explain {code}; then propose it again");
    Some(Rejection::new(code, message).found(found).wanted("a call that is still possible").next(next))
}

/// Tells which approvals a decision waits for.
pub(super) fn waiting(decision: &Decision, out: &mut dyn Write) -> io::Result<()> {
    let Some(proposal) = &decision.proposal else { return Ok(()) };
    writeln!(out, "proposed: {}", printable(&what(&proposal.call)))?;
    let mut table = Table::pairs();
    table.pair("proposal", short(&proposal.id.to_string()));
    table.pair("approved by", joined(&proposal.approvals));
    table.pair("missing", format!("{} of {}", decision.missing, joined(&decision.pending)));
    if let Some(quorum) = decision.quorum.as_ref().filter(|quorum| **quorum != Quorum::Majority) {
        table.pair("needs", quorum.to_string());
    }
    table.pair("ends", crate::time::moment(proposal.expires));
    table.write(out, 2)?;
    writeln!(out, "to approve, an admin of {} runs:", printable(&decision.pending.join(" or ")))?;
    writeln!(out, "  ledgerctl network approve {}", short(&proposal.id.to_string()))
}

/// The addition of an organisation in words: the fingerprints say which authorities are to be trusted.
fn added(add: &AddOrganisation) -> String {
    let AddOrganisation { name, roots, intermediates, units, lists } = add;
    let authority = |text: &String| {
        let der = hex::decode(text).unwrap_or_default();
        let subject =
            Certificate::parse(&der).map_or_else(|_| "an unreadable certificate".to_owned(), |found| found.subject);
        format!("{subject} (sha256 {})", Hash::of(&[&der]))
    };
    let authorities: Vec<_> = roots.iter().chain(intermediates).map(authority).collect();
    let units: Vec<_> = units.iter().map(|unit| format!("{} = {}", unit.unit, unit.role)).collect();
    let lists = lists.len();
    let units = if units.is_empty() { "all members".to_owned() } else { units.join(", ") };
    format!("add organisation {name} with {}; units: {units}; revocation lists: {lists}", authorities.join(", "))
}

/// Another rule of certificates in words.
fn certificates(SetCertificateRule { strict, hands }: &SetCertificateRule) -> String {
    let strict = strict.map(|strict| match strict {
        true => "make certificates strict".to_owned(),
        false => "end strict certificates: one lying organisation could then have two blocks certified".to_owned(),
    });
    let names = |hand: &BTreeSet<String>| hand.iter().map(String::as_str).collect::<Vec<_>>().join(" and ");
    let hands = hands.as_ref().map(|hands| match hands.as_slice() {
        [] => "count each organisation separately".to_owned(),
        hands => format!("count as one organisation: {}", hands.iter().map(names).collect::<Vec<_>>().join("; ")),
    });
    strict.into_iter().chain(hands).collect::<Vec<_>>().join("; ")
}

/// A proposed change of what a node shall be, if the call is one: its number, its name and the role.
pub(super) fn node_role(call: &Call) -> Option<(u64, String, NodeRole)> {
    let SetNodeRole { id, organisation, name, role, .. } = argument(call, "set_node_role")?;
    Some((id?, format!("{}/{}", organisation?, name?), role))
}

/// The reason in a proposed change of what a node shall be.
fn reason(call: &Call) -> &'static str {
    match argument(call, "set_node_role") {
        Some(SetNodeRole { proof: Some(_), .. }) => ", with the proof that it lied",
        _ => "",
    }
}

/// The argument of a call of this function of `msp`.
fn argument<T: DeserializeOwned>(call: &Call, function: &str) -> Option<T> {
    let [argument] = call.args.as_slice() else { return None };
    let is_this = call.chaincode == msp::NAME && call.function == function;
    is_this.then(|| serde_json::from_slice(argument).ok()).flatten()
}

/// A function of `msp` in words, if it has some.
fn in_words(call: &Call) -> Option<String> {
    if let Some((id, node, role)) = node_role(call) {
        return Some(match role {
            NodeRole::Removed => format!("remove node {node} (id {id}){}", reason(call)),
            role => format!("make node {node} (id {id}) a {role}{}", reason(call)),
        });
    }
    if let Some(InviteOrganisation { name, .. }) = argument(call, "invite_organisation") {
        return Some(format!("invite organisation {name}"));
    }
    if let Some(RemoveOrganisation { name }) = argument(call, "remove_organisation") {
        return Some(format!("remove organisation {name}"));
    }
    if let Some(ActivateRules { number, height }) = argument(call, "activate_rules") {
        let at = height.map_or_else(String::new, |height| format!(" at block {height}"));
        return Some(format!("activate rules {number}{at}"));
    }
    if let Some(rule) = argument::<SetCertificateRule>(call, "set_certificate_rule") {
        return Some(certificates(&rule));
    }
    argument::<AddOrganisation>(call, "add_organisation").as_ref().map(added)
}

/// A proposed call in words.
pub(super) fn what(call: &Call) -> String {
    in_words(call).unwrap_or_else(|| {
        let words = [call.chaincode.clone(), call.function.clone()].into_iter().chain(call.args.iter().map(shown));
        format!("call {}", words.collect::<Vec<_>>().join(" "))
    })
}

/// The beginning of an argument.
fn shown(argument: &Bytes) -> String {
    let (text, max) = match std::str::from_utf8(argument) {
        // An object is shown with its times in local time, not in microseconds.
        Ok(text) if text.starts_with('{') => (output::brief(text).unwrap_or_else(|| text.to_owned()), 60),
        Ok(text) => (text.to_owned(), 60),
        Err(_) => (format!("hex:{}", hex::encode(argument)), 24),
    };
    let mut shown: String = text.chars().take(max).collect();
    if shown.len() < text.len() {
        shown.push('…');
    }
    shown
}

/// The first digits of an id: enough to name a proposal.
pub(super) fn short(id: &str) -> &str {
    id.get(..12).unwrap_or(id)
}

pub(super) fn joined<'a>(names: impl IntoIterator<Item = &'a String>) -> String {
    names.into_iter().map(String::as_str).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger::msp::{Failed, Proposal};
    use ledger_base::hash::Hash;

    fn set_role(argument: &'static str) -> Call {
        let args = vec![Bytes::from(argument)];
        Call { chaincode: "msp".into(), function: "set_node_role".into(), args }
    }

    fn decision(executed: bool) -> Decision {
        let call = set_role(r#"{"id":2,"organisation":"Org2","name":"node2","role":"voter"}"#);
        let approvals = ["Org1".to_owned()].into();
        let (by, organisation) = ("Org1/admin".into(), "Org1".into());
        let (id, approved_by, failed) = (Hash([0xab; 32]), vec![], None);
        let proposal = Proposal { id, call, by, organisation, approvals, created: 0, expires: 1, approved_by, failed };
        let pending = vec!["Org2".to_owned(), "Org3".to_owned()];
        let quorum = Some(Quorum::Majority);
        Decision { executed, proposal: Some(proposal), missing: usize::from(!executed), pending, quorum }
    }

    fn told(executed: bool) -> String {
        let mut out = Vec::new();
        let done = "node Org2/node2 becomes a voter".to_owned();
        Decided { decision: decision(executed), done }.text(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn a_decision_that_waits_says_who_must_approve_and_how() {
        let text = told(false);
        for part in [
            "proposed: make node Org2/node2 (id 2) a voter\n",
            "  approved by  Org1\n",
            "  missing      1 of Org2, Org3\n",
            "to approve, an admin of Org2 or Org3 runs:\n  ledgerctl network approve abababababab\n",
        ] {
            assert!(text.contains(part), "{part:?} in {text}");
        }
    }

    #[test]
    fn a_decision_that_was_taken_says_what_happens() {
        assert_eq!(told(true), "node Org2/node2 becomes a voter\n");
    }

    #[test]
    fn a_call_is_shown_with_times_in_local_time_and_long_arguments_are_cut() {
        let args = [Bytes::from("text"), Bytes::from_static(b"\xff\x00"), Bytes::from("é".repeat(70))];
        let call = Call { chaincode: "abac".into(), function: "put".into(), args: args.to_vec() };
        assert_eq!(what(&call), format!("call abac put text hex:ff00 {}…", "é".repeat(60)));
        let args = vec![Bytes::from(r#"{"until":1700000000000000}"#)];
        let call = Call { chaincode: "abac".into(), function: "put".into(), args };
        assert!(what(&call).starts_with("call abac put until=2023-11-1"), "{}", what(&call));
    }

    #[test]
    fn a_quorum_that_is_not_the_usual_one_is_told() {
        let decision = Decision { quorum: Some(Quorum::All), ..decision(false) };
        let mut out = Vec::new();
        waiting(&decision, &mut out).unwrap();
        assert!(String::from_utf8(out).unwrap().contains("  needs        organisations = all\n"));
        assert!(!told(false).contains("needs"), "more than half is the usual one");
    }

    #[test]
    fn a_decision_whose_call_was_refused_ends_with_the_code_of_the_call() {
        let mut decision = decision(false);
        assert!(failed(&decision).is_none());
        let code = Code::LastOne.number();
        decision.proposal.as_mut().unwrap().failed = Some(Failed { code, height: 7 });
        let refused = failed(&decision).unwrap();
        assert_eq!(refused.code, Code::LastOne);
        assert!(refused.message.contains("make node Org2/node2 (id 2) a voter"), "{refused}");
    }

    #[test]
    fn programs_read_the_decision_as_the_ledger_gave_it() {
        let decided = Decided { decision: decision(false), done: String::new() };
        let json = serde_json::to_value(&decided).unwrap();
        assert_eq!(json, serde_json::to_value(decision(false)).unwrap());
    }
}
