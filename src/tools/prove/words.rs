//! A counterexample in words: who, what, on what, when, and which policies permit it.

use cedar_policy::{Authorizer, Entities, Entity, EntityUid, PolicySet, Request};
use std::fmt::Write;

/// A request that is permitted.
pub(super) struct Found {
    action: String,
    who: Vec<String>,
    what: Vec<String>,
    context: String,
    policies: Vec<String>,
}

impl Found {
    pub(super) fn of(set: &PolicySet, action: &str, request: &Request, entities: &Entities) -> Self {
        let response = Authorizer::new().is_authorized(request, set, entities);
        let mut policies: Vec<_> = response.diagnostics().reason().map(ToString::to_string).collect();
        policies.sort();
        Self {
            action: action.to_owned(),
            who: described(entities, request.principal()),
            what: described(entities, request.resource()),
            context: request.context().map(|context| context.to_string()).unwrap_or_default(),
            policies,
        }
    }
}

/// The request, a line for each part.
pub(super) fn request(found: &Found) -> String {
    let Found { action, who, what, context, policies } = found;
    let mut text = String::new();
    let mut line = |name: &str, value: &str| {
        let _written = writeln!(text, "  {name:<9} {value}");
    };
    line("who", &who.join(", "));
    line("does", action);
    line("on", &what.join(", "));
    line("context", context);
    line("by", &policies.join(", "));
    text.trim_end().to_owned()
}

/// The attributes and tags of an entity.
fn described(entities: &Entities, uid: Option<&EntityUid>) -> Vec<String> {
    let Some(entity) = uid.and_then(|uid| entities.get(uid)) else {
        return vec![uid.map_or_else(|| "anybody".to_owned(), ToString::to_string)];
    };
    let attributes = entity.attrs().filter_map(|(name, value)| Some(format!("{name} {}", value.ok()?)));
    let tags = entity.tags().filter_map(|(name, value)| Some(format!("attribute {name:?} {}", value.ok()?)));
    let mut parts: Vec<String> = attributes.collect();
    parts.sort();
    let mut own: Vec<String> = tags.collect();
    own.sort();
    std::iter::once(uid_text(entity)).chain(parts).chain(own).collect()
}

fn uid_text(entity: &Entity) -> String {
    entity.uid().type_name().basename().to_owned()
}
