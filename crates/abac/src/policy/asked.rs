//! Questions as Cedar takes them: a request, and the entities that it is about.

use super::{Question, display};
use crate::arguments::shown;
use cedar_policy::{Context, Entities, Entity, EntityId, EntityTypeName, EntityUid, Request, RestrictedExpression};
use ledger_contract::{Attribute, Attributes};
use std::collections::{BTreeMap, HashSet};

/// A question as Cedar takes it.
pub(super) struct Asked {
    pub(super) request: Request,
    pub(super) entities: Entities,
    /// The principal, and what it is in.
    pub(super) principals: [EntityUid; 2],
    /// The resource, and what it is in.
    pub(super) resources: [EntityUid; 3],
}

/// The request and its entities: the user, the robot, the service, and the organisations of both.
///
/// # Errors
/// The fault of a name or a value, in Cedar's words.
pub(super) fn asked(question: &Question) -> Result<Asked, String> {
    let (user, object) = (&question.user, &question.resource);
    let principal = uid("User", &format!("{}/{}", user.organisation, user.name))?;
    let robot = uid("Robot", &object.robot)?;
    let (home, owner) = (uid("Organisation", &user.organisation)?, uid("Organisation", &object.owner)?);
    let text = |value: &str| RestrictedExpression::new_string(value.to_owned());
    let pair = |key: &str, value: &str| (key.to_owned(), text(value));
    let trusted = ("trusted".to_owned(), RestrictedExpression::new_set(object.trusted.iter().map(|name| text(name))));

    let user_attributes = [pair("organisation", &user.organisation), pair("name", &user.name), pair("role", user.role)];
    let (robots_own, own) = (&object.own.0, &object.own.1);
    let tags = user.attributes.iter().map(|(key, value)| pair(key, value));
    let of_robot = object.of_robot.iter().map(|(key, value)| pair(key, value));
    let robot_attributes = [pair("name", &object.robot), pair("owner", &object.owner), trusted.clone()];
    let mut entities = vec![
        Entity::new_with_tags(principal.clone(), user_attributes, [home.clone()], tags).map_err(display)?,
        Entity::new_with_tags(robot.clone(), of_robot.chain(robot_attributes), [owner.clone()], tags_of([robots_own]))
            .map_err(display)?,
        Entity::new_no_attrs(home.clone(), HashSet::new()),
    ];
    if owner != home {
        entities.push(Entity::new_no_attrs(owner.clone(), HashSet::new()));
    }
    let resource = match &object.service {
        None => robot.clone(),
        Some((id, texts)) => {
            let service = uid("Service", id)?;
            let of_robot = [pair("robot", &object.robot), pair("owner", &object.owner), trusted];
            let attributes = texts.iter().map(|(key, value)| pair(key, value)).chain(of_robot);
            let tags = tags_of([robots_own, own]);
            entities.push(Entity::new_with_tags(service.clone(), attributes, [robot.clone()], tags).map_err(display)?);
            service
        }
    };
    let entities = Entities::from_entities(entities, None).map_err(display)?;
    let context = Context::from_pairs([("time".to_owned(), RestrictedExpression::new_long(question.time_ms))])
        .map_err(display)?;
    let action = uid("Action", question.action)?;
    let request = Request::new(principal.clone(), action, resource.clone(), context, None).map_err(display)?;
    Ok(Asked { request, entities, principals: [principal, home], resources: [resource, robot, owner] })
}

/// The owner's attributes as the schema has them: those that come later take the place of those before.
fn tags_of<const N: usize>(own: [&Attributes; N]) -> Vec<(String, RestrictedExpression)> {
    let all: BTreeMap<&String, &Attribute> = own.into_iter().flatten().collect();
    let text = |text: &String| RestrictedExpression::new_string(text.clone());
    let tag = |(name, value): (&String, &Attribute)| {
        let field = match value {
            Attribute::Text(value) => ("text".to_owned(), text(value)),
            Attribute::Number(value) => ("number".to_owned(), RestrictedExpression::new_long(*value)),
            Attribute::Set(values) => ("set".to_owned(), RestrictedExpression::new_set(values.iter().map(text))),
        };
        RestrictedExpression::new_record([field]).ok().map(|record| (name.clone(), record))
    };
    all.into_iter().filter_map(tag).collect()
}

/// An entity by its type and its id.
pub(super) fn uid(kind: &str, id: &str) -> Result<EntityUid, String> {
    let kind: EntityTypeName = kind.parse().map_err(|fault| format!("{}: {fault}", shown(kind)))?;
    Ok(EntityUid::from_type_name_and_id(kind, EntityId::new(id)))
}
