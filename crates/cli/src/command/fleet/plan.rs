//! The plan that makes a network as a file has it. All that the file does not name stays, unless it is pruned.

use super::file::{FleetFile, RobotEntry, ServiceEntry};
use crate::command::robot::with_replies;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{
    Attribute, Attributes, FleetPlan, PolicyDraft, PolicyText, RemovedRobot, RobotAsset, RobotSettings, RobotSpec,
    ServiceSpec, ServiceState, ShareEntry, Sharing, replies,
};
use std::collections::BTreeMap;

/// The id of the built-in policy.
const DEFAULT: &str = "default";

/// The fleet of an organisation as the ledger has it.
pub(super) struct FleetState {
    pub(super) organisation: String,
    pub(super) robots: Vec<RobotAsset>,
    /// The number of the set in force, and its policies; none of them where the built-in one decides.
    pub(super) version: u64,
    pub(super) policies: Vec<PolicyText>,
    /// The text of the built-in policy.
    pub(super) built_in: String,
}

/// The plan; with nothing in it if the network is as the file has it.
///
/// # Errors
/// A robot or a service that is new and lacks what a new one needs, a share that would give nothing.
pub(super) fn plan(state: &FleetState, file: &FleetFile, prune: bool) -> Result<FleetPlan, Rejection> {
    if let Some(owner) = file.organisation.as_ref().filter(|owner| **owner != state.organisation) {
        return Err(Rejection::new(Code::NotOwner, format!("the file describes the fleet of {owner}"))
            .found(format!("an identity of {}", state.organisation))
            .wanted(format!("an admin of {owner}"))
            .next("use a context of that organisation: --context NAME"));
    }
    let mut plan = FleetPlan::default();
    for (name, entry) in &file.robots {
        let before = state.robots.iter().find(|robot| robot.name == *name);
        let spec = merged_robot(name, before, entry, prune)?;
        if before.map(spec_of).as_ref() != Some(&spec) {
            let base = before.map(|robot| robot.version.clone()).unwrap_or_default();
            plan.robots.push(RobotSpec { base: Some(base), ..spec });
        }
    }
    if prune {
        let gone = state.robots.iter().filter(|robot| !file.robots.contains_key(&robot.name));
        plan.removed =
            gone.map(|robot| RemovedRobot { name: robot.name.clone(), base: robot.version.clone() }).collect();
    }
    check_trust(state, file)?;
    let policies = policies(state, file, prune);
    if policies != state.policies {
        plan.policies =
            Some(PolicyDraft { policies: Some(policies), base: Some(state.version), ..PolicyDraft::default() });
    }
    Ok(plan)
}

/// The next set of policies, in order of their ids.
fn policies(state: &FleetState, file: &FleetFile, prune: bool) -> Vec<PolicyText> {
    let names_some = !(file.policies.is_empty() && file.shares.is_empty());
    let mut set: BTreeMap<String, String> = BTreeMap::new();
    if state.policies.is_empty() && names_some {
        set.insert(DEFAULT.to_owned(), state.built_in.clone());
    }
    if !prune {
        set.extend(state.policies.iter().map(|policy| (policy.id.clone(), policy.text.clone())));
    }
    set.extend(file.policies.clone());
    let shares: Vec<ShareEntry> = state
        .policies
        .iter()
        .filter_map(|policy| ShareEntry::of(&state.organisation, &policy.id, &policy.text))
        .collect();
    for terms in &file.shares {
        let is_same = |share: &&ShareEntry| share.terms.as_ref().is_some_and(|other| other.is_about_the_same(terms));
        let id = shares.iter().find(is_same).map(|share| share.id.clone());
        let id = id.unwrap_or_else(|| free_id(&terms.id(), &set));
        set.insert(id, terms.text());
    }
    let only_built_in = set.len() == 1 && set.get(DEFAULT) == Some(&state.built_in);
    if only_built_in && (prune || state.policies.is_empty()) {
        set.clear();
    }
    set.into_iter().map(|(id, text)| PolicyText { id, text }).collect()
}

fn free_id(id: &str, set: &BTreeMap<String, String>) -> String {
    let numbered = (2..).map(|number: u32| format!("{id}-{number}"));
    std::iter::once(id.to_owned()).chain(numbered).find(|id| !set.contains_key(id)).unwrap_or_default()
}

/// A share with an attribute gives nothing where the robot does not trust the organisation.
fn check_trust(state: &FleetState, file: &FleetFile) -> Result<(), Rejection> {
    for terms in file.shares.iter().filter(|terms| terms.attribute.is_some()) {
        let (name, organisation) = (terms.robot(), terms.organisation());
        let of_file = file.robots.get(name).and_then(|robot| robot.settings.trusted.clone());
        let known = state.robots.iter().find(|robot| robot.name == name).map(|robot| robot.trusted.clone());
        let trusted = of_file.or(known).unwrap_or_else(|| vec![state.organisation.clone()]);
        if !trusted.iter().any(|one| one == organisation) {
            return Err(Rejection::new(
                Code::BadArgument,
                format!("{name} does not trust {organisation}, so the attribute of a share has no effect"),
            )
            .found(format!("trust = {trusted:?}"))
            .wanted(format!(
                "{organisation} among the organisations that {name} trusts, or a share without an \
                             attribute"
            ))
            .next(format!("add {organisation} to trust of [robot.{name}] in the file")));
        }
    }
    Ok(())
}

/// A robot with what the file names.
fn merged_robot(
    name: &str,
    before: Option<&RobotAsset>,
    entry: &RobotEntry,
    prune: bool,
) -> Result<RobotSpec, Rejection> {
    let spec = before.map(spec_of);
    let attribute = entry.settings.attribute_required.clone();
    let attribute =
        attribute.map(|attribute| if attribute.contains('=') { attribute } else { format!("{attribute}=true") });
    let attribute_required = attribute
        .or(spec.as_ref().map(|spec| spec.attribute_required.clone()))
        .ok_or_else(|| incomplete(&format!("robot.{name}"), "attr-required"))?;
    let mut trusted = entry.settings.trusted.clone();
    if let Some(trusted) = &mut trusted {
        trusted.sort();
        trusted.dedup();
    }
    let mut services = Vec::new();
    for service in spec.iter().flat_map(|spec| &spec.services) {
        let is_reply = |topic: &String| replies(topic) == service.topic;
        match entry.services.get(&service.topic) {
            Some(named) => services.push(merged_service(service.clone(), named, prune)),
            None if !prune || entry.services.keys().any(is_reply) => services.push(service.clone()),
            None => {}
        }
    }
    let known: Vec<String> = services.iter().map(|service| service.topic.clone()).collect();
    let mut new = Vec::new();
    for (topic, named) in entry.services.iter().filter(|(topic, _)| !known.contains(topic)) {
        new.push(new_service(name, topic, named)?);
    }
    let new = with_replies(new).into_iter().filter(|service| !known.contains(&service.topic));
    services.extend(new);
    if services.is_empty() {
        return Err(incomplete(&format!("robot.{name}"), "a table service with a topic"));
    }
    let attributes = spec.as_ref().and_then(|spec| spec.attributes.clone()).unwrap_or_default();
    Ok(RobotSpec {
        name: name.to_owned(),
        attribute_required,
        trusted: trusted.or(spec.and_then(|spec| spec.trusted)),
        services,
        attributes: merged_attributes(attributes, &entry.attributes, prune),
        base: None,
    })
}

fn merged_attributes(before: Attributes, named: &Attributes, prune: bool) -> Option<Attributes> {
    let mut attributes = if prune { Attributes::new() } else { before };
    attributes.extend(named.clone().into_iter().map(|(name, value)| (name, sorted(value))));
    (!attributes.is_empty()).then_some(attributes)
}

/// A set as the ledger has it: sorted, each text once.
fn sorted(value: Attribute) -> Attribute {
    match value {
        Attribute::Set(mut texts) => {
            texts.sort();
            texts.dedup();
            Attribute::Set(texts)
        }
        value => value,
    }
}

fn merged_service(
    mut service: ServiceSpec,
    ServiceEntry { settings, attributes }: &ServiceEntry,
    prune: bool,
) -> ServiceSpec {
    for key in &settings.clear {
        service.sharing.clear(key);
    }
    service.sharing.change(&settings.sharing);
    let RobotSettings { type_name, mode, direction, max_age_ms, lease_ms, lease_ms_max, stop_hex, .. } =
        settings.clone();
    ServiceSpec {
        type_name: type_name.unwrap_or(service.type_name),
        mode: mode.or(service.mode),
        direction: direction.unwrap_or(service.direction),
        max_age_ms: max_age_ms.or(service.max_age_ms),
        lease_ms: lease_ms.or(service.lease_ms),
        lease_ms_max: lease_ms_max.or(service.lease_ms_max),
        stop_hex: stop_hex.or(service.stop_hex).filter(|digits| !digits.is_empty()),
        attributes: merged_attributes(service.attributes.unwrap_or_default(), attributes, prune),
        topic: service.topic,
        sharing: service.sharing,
    }
}

fn new_service(robot: &str, topic: &str, entry: &ServiceEntry) -> Result<ServiceSpec, Rejection> {
    let place = format!("robot.{robot}.service.{topic:?}");
    let type_name = entry.settings.type_name.clone().ok_or_else(|| incomplete(&place, "type"))?;
    let service = ServiceSpec {
        topic: topic.to_owned(),
        type_name,
        mode: None,
        direction: entry.settings.direction.unwrap_or_default(),
        max_age_ms: None,
        lease_ms: None,
        lease_ms_max: None,
        stop_hex: None,
        sharing: Sharing::default(),
        attributes: None,
    };
    Ok(merged_service(service, entry, false))
}

fn incomplete(place: &str, what: &str) -> Rejection {
    Rejection::new(Code::BadFile, format!("{place} is new, and the file does not describe it completely"))
        .found(format!("no {what}"))
        .wanted(what)
        .next("ledgerctl export prints a file in this form")
}

/// The description of a robot that is registered.
pub(super) fn spec_of(robot: &RobotAsset) -> RobotSpec {
    let some = |attributes: &Attributes| (!attributes.is_empty()).then(|| attributes.clone());
    let service = |service: &ServiceState| ServiceSpec {
        topic: service.topic.clone(),
        type_name: service.type_name.clone(),
        mode: Some(service.mode.clone()),
        direction: service.direction.known().unwrap_or_default(),
        max_age_ms: Some(service.max_age_ms),
        lease_ms: Some(service.lease_ms),
        lease_ms_max: Some(service.lease_ms_max),
        stop_hex: service.stop_hex.clone(),
        sharing: service.sharing.clone(),
        attributes: some(&service.attributes),
    };
    RobotSpec {
        name: robot.name.clone(),
        attribute_required: robot.attribute_required.clone(),
        trusted: Some(robot.trusted.clone()),
        services: robot.services.iter().map(service).collect(),
        attributes: some(&robot.attributes),
        base: None,
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::super::export::written;
    use super::*;
    use ledger_contract::ShareTerms;

    const HUSKY: &str = r#"{"Name":"Husky","SubTopic":"/cmd_vel","PubTopic":"","owner":"","UnderOp":false,"organisation":"Org2",
        "attribute_required":"Husky=true","trusted":["Org1","Org2"],"version":"v1","attributes":{"kind":"rover","zones":["hall"]},
        "services":[{"service":"Husky/cmd_vel","robot":"Husky","organisation":"Org2","topic":"/cmd_vel",
        "type":"geometry_msgs/msg/Twist","mode":"exclusive","direction":"command","max_age_ms":1500,"lease_ms":10000,
        "lease_ms_max":600000,"stop_hex":"00010000","sharing":{"on_conflict":"queue","queue_wait_max_ms":60000,"confirm":1,
        "delegable":true,"max_linear_mm_s":500},"holder":"","holders":[],"epoch":0,"expires":0,
        "capabilities":{"fencing":"newest","publishing":"grant","sequence":"per_epoch"}}]}"#;

    fn state() -> FleetState {
        let share =
            ShareTerms { until: Some(1_809_181_800_000_000), max_linear: Some("0.3".into()), ..terms("Husky", "Org1") };
        let policy = |id: &str, text: &str| PolicyText { id: id.into(), text: text.into() };
        FleetState {
            organisation: "Org2".into(),
            robots: vec![serde_json::from_str(HUSKY).unwrap()],
            version: 4,
            policies: vec![
                policy("default", "built in"),
                policy("night", "// ä\nforbid (…);\n"),
                policy("share-x", &share.text()),
            ],
            built_in: "built in".into(),
        }
    }

    fn terms(resource: &str, with: &str) -> ShareTerms {
        ShareTerms { resource: resource.into(), with: with.into(), ..ShareTerms::default() }
    }

    fn planned(text: &str, prune: bool) -> FleetPlan {
        plan(&state(), &FleetFile::read(text).unwrap(), prune).unwrap()
    }

    #[test]
    fn what_is_exported_changes_nothing_when_it_is_applied_pruned_or_not() {
        let text = written(&state()).unwrap();
        for prune in [false, true] {
            assert_eq!(planned(&text, prune), FleetPlan::default(), "{text}");
        }
    }

    #[test]
    fn what_a_file_does_not_name_stays_unless_it_is_pruned() {
        assert_eq!(planned("", false), FleetPlan::default());
        let pruned = planned("", true);
        assert_eq!(pruned.removed, [RemovedRobot { name: "Husky".into(), base: "v1".into() }]);
        assert_eq!(pruned.policies.unwrap().policies.unwrap(), []);
        let changed =
            planned("[robot.Husky.service.'/cmd_vel']\nlease = '20s'\n[robot.Husky.attributes]\nkind = 'crane'", false);
        let husky = &changed.robots[0];
        assert_eq!((husky.base.as_deref(), husky.services[0].lease_ms), (Some("v1"), Some(20_000)));
        assert_eq!((husky.services[0].sharing.confirm, husky.attributes.as_ref().unwrap().len()), (Some(1), 2));
        assert_eq!((changed.policies, changed.removed.len()), (None, 0));
    }

    #[test]
    fn a_share_takes_the_place_of_the_one_that_it_is_about() {
        let faster = planned("[[share]]\nresource = 'Husky'\nwith = 'Org1'\nmax-linear = '0.5'", false);
        let set = faster.policies.unwrap();
        let ids: Vec<String> = set.policies.iter().flatten().map(|policy| policy.id.clone()).collect();
        assert_eq!((ids.join(" "), set.base), ("default night share-x".into(), Some(4)));
        let other = planned("[[share]]\nresource = 'Husky'\nwith = 'Org1/Salma'", false).policies.unwrap();
        assert_eq!(other.policies.unwrap().len(), 4);
    }

    #[test]
    fn the_built_in_policy_stays_in_force_beside_the_first_share() {
        let none = FleetState { policies: vec![], version: 0, ..state() };
        let file = FleetFile::read("[[share]]\nresource = 'Husky'\nwith = 'Org1'").unwrap();
        let set = plan(&none, &file, true).unwrap().policies.unwrap().policies.unwrap();
        assert_eq!(set.iter().map(|policy| policy.text.as_str()).next(), Some("built in"));
        assert_eq!(plan(&none, &FleetFile::default(), true).unwrap().policies, None);
    }

    #[test]
    fn a_file_that_cannot_be_meant_is_refused() {
        let refused = |text: &str| plan(&state(), &FleetFile::read(text).unwrap(), false).unwrap_err();
        assert_eq!(refused("organisation = 'Org3'").code, Code::NotOwner);
        assert_eq!(refused("[robot.Spot]\ntrust = 'Org1'").found, "no attr-required");
        assert_eq!(refused("[robot.Husky.service.'/arm']\nmode = 'open'").found, "no type");
        let untrusted = refused("[[share]]\nresource = 'Husky'\nwith = 'Org3'\nattr = 'guest'");
        assert!(untrusted.message.contains("does not trust Org3"), "{untrusted}");
    }
}
