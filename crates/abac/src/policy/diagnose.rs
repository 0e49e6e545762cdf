//! The faults of a policy with their places in its text.

use super::{FAULTS_SHOWN_MAX, annotation, impossible_policies, misfits, names, words};
use cedar_policy::{PolicySet, ValidationMode, Validator};
use ledger_contract::{PolicyCheck, PolicyFault};
use miette::Diagnostic;

/// Most faults that are told with their places.
const FAULTS_MAX: usize = 16;
const _: () = assert!(FAULTS_MAX >= FAULTS_SHOWN_MAX);

/// The faults of a text as a policy. If there are none, the meaning of each policy in it, and all names that it has: the caller
/// leaves those that are unknown.
pub(super) fn diagnose(validator: &Validator, text: &str) -> PolicyCheck {
    let mut faults = found(validator, text);
    // Cedar finds them in no particular order.
    faults.sort_by(|one, other| (one.line, one.column, &one.message).cmp(&(other.line, other.column, &other.message)));
    faults.dedup();
    faults.truncate(FAULTS_MAX);
    let (policies, unknown) =
        if faults.is_empty() { (words::meanings(text), names::named(text)) } else { Default::default() };
    PolicyCheck { faults, policies, unknown }
}

fn found(validator: &Validator, text: &str) -> Vec<PolicyFault> {
    let policies: PolicySet = match text.parse() {
        Ok(policies) => policies,
        Err(faults) => return cedar_policy::ParseErrors::iter(&faults).map(|fault| placed(text, fault)).collect(),
    };
    if policies.num_of_templates() > 0 {
        let at = ["?principal", "?resource"].iter().find_map(|slot| Some((text.find(slot)?, slot.len())));
        let message = "a template with ?principal or ?resource, which is never instantiated";
        return vec![fault(text, message.to_owned(), String::new(), at)];
    }
    if policies.is_empty() {
        return vec![fault(text, "no policy in the text".to_owned(), String::new(), None)];
    }
    if let Err(faults) = annotation::check(&policies) {
        return faults.into_iter().map(|message| annotation_fault(text, message)).collect();
    }
    if let Err(faults) = misfits(&policies) {
        return faults.iter().map(|one| fault(text, one.message.clone(), String::new(), one.place(text))).collect();
    }
    let result = validator.validate(&policies, ValidationMode::Strict);
    let mut faults: Vec<PolicyFault> = result.validation_errors().map(|fault| placed(text, fault)).collect();
    faults.extend(impossible_policies(&result).map(|fault| placed(text, fault)));
    faults
}

/// A fault that Cedar has found, with the place that it names first.
fn placed(text: &str, found: &(impl Diagnostic + ?Sized)) -> PolicyFault {
    let at = found.labels().and_then(|mut labels| labels.next()).map(|label| (label.offset(), label.len()));
    let help = found.help().map(|help| help.to_string()).unwrap_or_default();
    fault(text, found.to_string(), help, at)
}

/// A fault of an annotation stands where the annotation does.
fn annotation_fault(text: &str, message: String) -> PolicyFault {
    let name = message.find('@').and_then(|at| message.get(at..)).unwrap_or_default();
    let name = name.get(..name.bytes().skip(1).take_while(|b| b.is_ascii_alphanumeric() || *b == b'_').count() + 1);
    let at = name.and_then(|name| Some((text.find(name)?, name.len())));
    fault(text, message, String::new(), at)
}

/// A fault at a place: offset and length in bytes.
fn fault(text: &str, message: String, help: String, at: Option<(usize, usize)>) -> PolicyFault {
    let Some((offset, length)) = at.filter(|(offset, _)| *offset <= text.len()) else {
        return PolicyFault { message, help, line: 0, column: 0, length: 0, text: String::new() };
    };
    let before = text.get(..offset).unwrap_or_default();
    let start = before.rfind('\n').map_or(0, |end| end + 1);
    let line = text.get(start..).and_then(|rest| rest.lines().next()).unwrap_or_default();
    let column = before.get(start..).unwrap_or_default().chars().count();
    let rest = line.chars().count().saturating_sub(column);
    let marked = text.get(offset..offset.saturating_add(length)).map_or(1, |marked| marked.chars().count());
    PolicyFault {
        message,
        help,
        line: 1 + before.bytes().filter(|b| *b == b'\n').count() as u64,
        column: column as u64 + 1,
        length: marked.clamp(1, rest.max(1)) as u64,
        text: line.to_owned(),
    }
}
