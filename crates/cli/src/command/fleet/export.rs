//! The file of a fleet, written from the ledger.

use super::plan::{FleetState, spec_of};
use crate::argument::setting::KEYS;
use crate::argument::span::Milliseconds;
use crate::time::rfc3339;
use crate::words::decimal;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Attribute, Attributes, RobotSpec, ServiceSpec, ShareEntry, ShareTerms, Sharing};
use toml::{Table, Value};

/// The file that describes this fleet.
///
/// # Errors
/// [`Code::Internal`] if it cannot be written as TOML.
pub(super) fn written(state: &FleetState) -> Result<String, Rejection> {
    let mut file = Table::new();
    file.insert("organisation".into(), state.organisation.clone().into());
    let robots = state.robots.iter().map(|robot| (robot.name.clone(), Value::Table(robot_table(spec_of(robot)))));
    insert(&mut file, "robot", robots.collect());
    let (mut policies, mut shares) = (Table::new(), Vec::new());
    for policy in &state.policies {
        match ShareEntry::of(&state.organisation, &policy.id, &policy.text).and_then(|share| share.terms) {
            Some(terms) => shares.push(Value::Table(share_table(terms))),
            None => drop(policies.insert(policy.id.clone(), policy.text.clone().into())),
        }
    }
    insert(&mut file, "policy", policies);
    if !shares.is_empty() {
        file.insert("share".into(), Value::Array(shares));
    }
    toml::to_string_pretty(&file)
        .map_err(|fault| Rejection::new(Code::Internal, "the file cannot be written").found(fault.to_string()))
}

fn insert(table: &mut Table, name: &str, content: Table) {
    if !content.is_empty() {
        table.insert(name.to_owned(), Value::Table(content));
    }
}

fn robot_table(spec: RobotSpec) -> Table {
    let mut table = Table::new();
    table.insert("attr-required".into(), spec.attribute_required.into());
    table.insert("trust".into(), texts(&spec.trusted.unwrap_or_default()));
    insert(&mut table, "attributes", attributes(&spec.attributes.unwrap_or_default()));
    let services =
        spec.services.into_iter().map(|service| (service.topic.clone(), Value::Table(service_table(service))));
    insert(&mut table, "service", services.collect());
    table
}

fn service_table(service: ServiceSpec) -> Table {
    let mut table = Table::new();
    table.insert("type".into(), service.type_name.into());
    table.insert("direction".into(), service.direction.to_string().into());
    if let Some(mode) = service.mode {
        table.insert("mode".into(), mode.to_string().into());
    }
    let spans = [("max-age", service.max_age_ms), ("lease", service.lease_ms), ("lease-max", service.lease_ms_max)];
    for (name, ms) in spans {
        if let Some(ms) = ms {
            table.insert(name.into(), Milliseconds(ms).to_string().into());
        }
    }
    if let Some(stop) = service.stop_hex {
        table.insert("stop".into(), stop.into());
    }
    for key in KEYS.iter().filter(|key| Sharing::keys().any(|field| field == key.field)) {
        let shown = service.sharing.shown(key.field);
        let value = match shown.as_str() {
            // It has its default.
            "" => continue,
            text if key.field.ends_with("_ms") => {
                text.parse().map_or(Value::String(shown.clone()), |ms| Milliseconds(ms).to_string().into())
            }
            text if key.field.ends_with("_mm_s") || key.field.ends_with("_mrad_s") => {
                text.parse().map_or(Value::String(shown.clone()), |number| decimal(number).into())
            }
            "true" => Value::Boolean(true),
            "false" => Value::Boolean(false),
            text => text.parse().map_or_else(|_| Value::String(shown.clone()), Value::Integer),
        };
        table.insert(key.name.to_owned(), value);
    }
    insert(&mut table, "attributes", attributes(&service.attributes.unwrap_or_default()));
    table
}

fn share_table(terms: ShareTerms) -> Table {
    let mut table = Table::new();
    let moment = |moment: Option<u64>| moment.map(rfc3339);
    let fields = [
        ("resource", Some(terms.resource)),
        ("with", Some(terms.with)),
        ("attr", terms.attribute),
        ("from", moment(terms.from)),
        ("until", moment(terms.until)),
        ("hours", terms.hours),
        ("max-linear", terms.max_linear),
        ("max-angular", terms.max_angular),
        ("rate", terms.rate),
        ("priority", terms.priority),
    ];
    for (name, value) in fields {
        if let Some(value) = value {
            table.insert(name.to_owned(), value.into());
        }
    }
    if terms.read_only {
        table.insert("read-only".into(), true.into());
    }
    table
}

fn attributes(attributes: &Attributes) -> Table {
    let value = |value: &Attribute| match value {
        Attribute::Number(number) => Value::Integer(*number),
        Attribute::Text(text) => Value::String(text.clone()),
        Attribute::Set(several) => texts(several),
    };
    attributes.iter().map(|(name, attribute)| (name.clone(), value(attribute))).collect()
}

fn texts(texts: &[String]) -> Value {
    Value::Array(texts.iter().map(|text| Value::String(text.clone())).collect())
}
