//! Sharing without a policy language: the policy of a share, what it changes, and what it never gives.

use crate::fleet::{Fleet, HUSKY, SECOND, START, TURTLEBOT, admin1, camera, farhad, identity, owner, salma};
use ledger::Page;
use ledger_abac::{
    Access, DEFAULT_POLICY, Limits, PolicyChange, PolicyCheck, PolicyDraft, PolicyText, RobotAsset, ShareEntry,
    SharePreview, ShareTerms, UnsharePreview,
};
use ledger_base::rejection::Code;
use ledger_identity::{Identity, Role};
use proptest::prelude::*;

/// A member of Org1 without attributes.
fn guest() -> Identity {
    identity("Org1", "Guest", Role::Member, &["guest"], 60)
}

/// A safety officer of Org1.
fn officer() -> Identity {
    identity("Org1", "Officer", Role::Member, &["safety"], 62)
}

/// The network of the paper, whose CAs have certified these people.
fn fleet() -> Fleet {
    let fleet = Fleet::of_the_paper();
    fleet.members.1.lock().unwrap().extend([guest(), officer()]);
    *fleet.members.2.lock().unwrap() =
        vec!["Org1/Farhad", "Org1/Guest", "Org1/Officer", "Org1/Salma", "Org1/admin", "Org2/OptiTrack", "Org2/admin"];
    fleet
}

fn terms(resource: &str, with: &str) -> ShareTerms {
    ShareTerms { resource: resource.to_owned(), with: with.to_owned(), ..ShareTerms::default() }
}

#[track_caller]
fn preview(fleet: &mut Fleet, terms: &ShareTerms) -> SharePreview {
    fleet.get(&owner(), "share_preview", &[&serde_json::to_string(terms).unwrap()])
}

#[track_caller]
fn apply(fleet: &mut Fleet, set: &PolicyDraft) -> PolicyChange {
    fleet.get(&owner(), "policy", &["apply", &serde_json::to_string(set).unwrap()])
}

#[track_caller]
fn share(fleet: &mut Fleet, terms: &ShareTerms) -> SharePreview {
    let preview = preview(fleet, terms);
    apply(fleet, &preview.set);
    preview
}

#[track_caller]
fn unshare(fleet: &mut Fleet, id: &str) -> UnsharePreview {
    let preview: UnsharePreview = fleet.get(&owner(), "unshare_preview", &[id]);
    apply(fleet, &PolicyDraft { means_it: true, ..preview.set.clone() });
    preview
}

fn access(fleet: &mut Fleet, who: &Identity, ask: &str) -> Vec<Access> {
    fleet.get::<Page<Access>>(who, "access", &[ask, "{}"]).items
}

/// The rights of a person: `acquire Husky/cmd_vel`.
fn rights(items: &[Access], who: &str) -> Vec<String> {
    let of = items.iter().filter(|access| access.who == who).flat_map(|access| &access.rights);
    of.map(|right| format!("{} {}", right.action, right.of)).collect()
}

fn shares(fleet: &mut Fleet) -> Vec<ShareEntry> {
    fleet.get(&salma(), "shares", &[])
}

#[test]
fn a_share_lets_those_use_the_robot_whom_it_names_and_gives_no_right_that_must_be_named() {
    let mut fleet = fleet();
    fleet.refused(&guest(), Code::MissingAttribute, "acquire", &[HUSKY]);
    let shown = share(&mut fleet, &ShareTerms { max_linear: Some("0.3".into()), ..terms("Husky", "Org1") });
    assert_eq!(
        shown.meaning[0].meaning,
        "any user of Org1 may acquire, publish on and subscribe to any service of Husky"
    );
    assert_eq!(shown.meaning[0].when, ["it is a command service, or they only subscribe"]);
    let gained: Vec<_> = shown.diff.gained.iter().filter(|gained| gained.who == "Org1/Guest").collect();
    assert_eq!(
        gained.iter().map(|gained| gained.right.action.as_str()).collect::<Vec<_>>(),
        ["acquire", "publish", "subscribe"]
    );
    assert_eq!(gained[0].right.limits.max_linear_mm_s, Some(300));
    assert!(shown.diff.lost.is_empty(), "{:?}", shown.diff.lost);
    let limited: Vec<_> = shown.diff.limited.iter().map(|limited| limited.who.as_str()).collect();
    assert!(limited.contains(&"Org1/Salma") && !limited.contains(&"Org1/Guest"), "{limited:?}");
    fleet.ok(&guest(), "acquire", &[HUSKY]);
    fleet.ok(&guest(), "release", &[HUSKY]);
    for (function, args) in [("take", vec![TURTLEBOT, "mine"]), ("stop", vec!["Husky"]), ("resume", vec!["Husky"])] {
        fleet.refused(&guest(), Code::DeniedByPolicy, function, &args);
    }
    fleet.refused(&guest(), Code::MissingAttribute, "acquire", &[TURTLEBOT]);
}

#[test]
fn the_first_share_of_an_owner_takes_nothing_from_anybody() {
    let mut fleet = fleet();
    let everybody = |fleet: &mut Fleet| -> Vec<Access> {
        ["Husky", "Turtlebot4", "OptiTrack"]
            .into_iter()
            .flat_map(|robot| access(fleet, &owner(), &format!(r#"{{"robot":"{robot}"}}"#)))
            .collect()
    };
    let named = |items: &[Access]| -> Vec<(String, String)> {
        let of = items.iter().flat_map(|access| {
            access.rights.iter().map(|right| (access.who.clone(), format!("{} {}", right.action, right.of)))
        });
        of.collect()
    };
    let before = named(&everybody(&mut fleet));
    assert!(before.contains(&("Org1/Officer".into(), "stop Husky".into())), "{before:?}");
    assert!(before.contains(&("Org2/OptiTrack".into(), "stop OptiTrack".into())), "the robot itself: {before:?}");
    let shown = share(&mut fleet, &terms("Husky", "Org1/Guest"));
    assert!(
        shown.keeps_built_in && shown.set.policies.as_ref().unwrap().iter().any(|policy| policy.text == DEFAULT_POLICY)
    );
    let after = named(&everybody(&mut fleet));
    assert!(before.iter().all(|right| after.contains(right)), "{before:?} {after:?}");
    fleet.ok(&officer(), "stop", &["Husky"]);
    fleet.ok(&camera(), "stop", &["OptiTrack"]);
    // Without its last share the owner has no policy of its own again.
    unshare(&mut fleet, &shown.id);
    assert_eq!(fleet.keys("policy/"), 0);
    assert_eq!(named(&everybody(&mut fleet)), before);
}

#[test]
fn a_share_leaves_the_feeds_of_a_robot_to_their_publisher() {
    let mut fleet = fleet();
    share(&mut fleet, &terms("OptiTrack", "Org1"));
    let of_guest = rights(&access(&mut fleet, &owner(), r#"{"robot":"OptiTrack"}"#), "Org1/Guest");
    assert_eq!(of_guest, ["subscribe OptiTrack/poses"]);
    share(&mut fleet, &ShareTerms { read_only: true, ..terms("Husky", "Org1/Guest") });
    let of_guest = rights(&access(&mut fleet, &owner(), r#"{"robot":"Husky"}"#), "Org1/Guest");
    assert_eq!(of_guest, ["subscribe Husky/cmd_vel"]);
}

#[test]
fn a_share_with_an_attribute_needs_trust_and_one_with_a_name_does_not() {
    let mut fleet = fleet();
    fleet.ok(&owner(), "configure", &["Husky", r#"{"trusted":["Org2"]}"#]);
    let guests = ShareTerms { attribute: Some("guest".into()), ..terms("Husky", "Org1") };
    let refused =
        fleet.refused(&owner(), Code::BadArgument, "share_preview", &[&serde_json::to_string(&guests).unwrap()]);
    assert!(refused.advice().contains("ledgerctl robot set Husky trust=Org2,Org1"), "{}", refused.advice());
    let shown = share(&mut fleet, &terms("Husky", "Org1"));
    assert!(!shown.trusted);
    assert_eq!(fleet.get::<RobotAsset>(&owner(), "robot", &["Husky"]).trusted, ["Org2"], "a share changes no trust");
    fleet.ok(&guest(), "acquire", &[HUSKY]);
    fleet.ok(&guest(), "release", &[HUSKY]);
    unshare(&mut fleet, &shown.id);
    fleet.ok(&owner(), "configure", &["Husky", r#"{"trusted":["Org1","Org2"]}"#]);
    share(&mut fleet, &guests);
    fleet.ok(&guest(), "acquire", &[HUSKY]);
    fleet.refused(&farhad(), Code::MissingAttribute, "acquire", &[HUSKY]);
    // The owner takes the trust back: the attribute counts no more.
    fleet.ok(&owner(), "configure", &["Husky", r#"{"trusted":["Org2"]}"#]);
    fleet.refused(&guest(), Code::DeniedByPolicy, "acquire", &[HUSKY]);
}

#[test]
fn a_share_has_a_time_and_hours_of_the_ledgers_clock() {
    let mut fleet = fleet();
    let (from, until) = (START + 100 * SECOND, START + 200 * SECOND);
    let for_a_while = ShareTerms { from: Some(from), until: Some(until), ..terms("Husky", "Org1/Guest") };
    let shown = share(&mut fleet, &for_a_while);
    assert!(shown.diff.gained.iter().any(|gained| gained.who == "Org1/Guest"), "what it gives once it has begun");
    fleet.refused(&guest(), Code::MissingAttribute, "acquire", &[HUSKY]);
    fleet.time = from;
    fleet.ok(&guest(), "acquire", &[HUSKY]);
    fleet.ok(&guest(), "release", &[HUSKY]);
    fleet.time = until;
    fleet.refused(&guest(), Code::MissingAttribute, "acquire", &[HUSKY]);
    for wrong in [
        for_a_while.clone(),
        ShareTerms { from: Some(until + 2 * SECOND), until: Some(until + SECOND), ..terms("Husky", "Org1") },
    ] {
        fleet.refused(&owner(), Code::BadArgument, "share_preview", &[&serde_json::to_string(&wrong).unwrap()]);
    }
    // It is three minutes past midnight.
    let at_noon = ShareTerms { hours: Some("11:00-13:00 Z".into()), ..terms("Husky", "Org1/Guest") };
    let shown = share(&mut fleet, &at_noon);
    assert_eq!(shown.replaces, shown.id, "in the place of the one before");
    assert_eq!(shown.diff.gained[0].right.closed, ["11:00-13:00 Z"]);
    fleet.refused(&guest(), Code::DeniedByPolicy, "acquire", &[HUSKY]);
    fleet.time = START + 12 * 3600 * SECOND;
    fleet.ok(&guest(), "acquire", &[HUSKY]);
}

#[test]
fn shares_are_listed_with_their_terms_and_one_that_was_edited_with_its_text() {
    let mut fleet = fleet();
    let fast = ShareTerms { max_angular: Some("1.5".into()), rate: Some("20".into()), ..terms(HUSKY, "Org1/Salma") };
    let id = share(&mut fleet, &fast).id;
    let listed = shares(&mut fleet);
    assert_eq!((listed.len(), listed[0].terms.as_ref(), listed[0].organisation.as_str()), (1, Some(&fast), "Org2"));
    let edited = fast.text().replace("Action::\"acquire\"", "Action::\"stop\"");
    fleet.ok(&owner(), "policy", &["put", &id, &edited]);
    let listed = shares(&mut fleet);
    assert!(listed[0].edited && listed[0].terms.is_none(), "{listed:?}");
    // It is no share of these terms, and is not replaced unseen.
    let shown = preview(&mut fleet, &fast);
    assert_eq!((shown.id, shown.replaces.as_str()), (format!("{id}-2"), ""));
}

#[test]
fn a_preview_is_applied_to_the_set_that_it_was_made_from_or_not_at_all() {
    let mut fleet = fleet();
    let shown = preview(&mut fleet, &terms("Husky", "Org1"));
    share(&mut fleet, &terms("Turtlebot4", "Org1"));
    let set = serde_json::to_string(&shown.set).unwrap();
    fleet.refused(&owner(), Code::PoliciesChanged, "policy", &["apply", &set]);
    let again = preview(&mut fleet, &terms("Husky", "Org1"));
    assert!(!again.keeps_built_in && again.set.policies.as_ref().unwrap().len() == 3);
    apply(&mut fleet, &again.set);
    assert_eq!(preview(&mut fleet, &terms("Husky", "Org1")).diff.changed, Vec::<String>::new(), "nothing to change");
}

#[test]
fn unsharing_says_who_may_still_use_the_robot_and_why() {
    let mut fleet = fleet();
    let id = share(&mut fleet, &terms("Husky", "Org1")).id;
    fleet.ok(&guest(), "acquire", &[HUSKY]);
    let shown: UnsharePreview = fleet.get(&owner(), "unshare_preview", &[&id]);
    assert_eq!(shown.diff.ends.iter().map(|end| end.holder.as_str()).collect::<Vec<_>>(), ["Org1/Guest"]);
    assert!(shown.diff.lost.iter().any(|lost| lost.who == "Org1/Guest" && lost.right.action == "acquire"));
    let salma = shown.still.iter().find(|access| access.who == "Org1/Salma").unwrap();
    assert_eq!(salma.rights[0].policies, ["default.policy0"], "by her attribute");
    assert!(!shown.still.iter().any(|access| access.who.starts_with("Org2/")));
    let done = apply(&mut fleet, &shown.set);
    assert_eq!(done.ended.len(), 1);
    fleet.refused(&owner(), Code::NotFound, "unshare_preview", &[&id]);
}

#[test]
fn only_the_owner_shares_its_robots_and_names_that_are_none_are_refused() {
    let mut fleet = fleet();
    let text = |terms: &ShareTerms| serde_json::to_string(terms).unwrap();
    fleet.refused(&admin1(), Code::NotOwner, "share_preview", &[&text(&terms("Husky", "Org1"))]);
    fleet.refused(&salma(), Code::NotAdmin, "share_preview", &[&text(&terms("Husky", "Org1"))]);
    fleet.refused(&owner(), Code::UnknownRobot, "share_preview", &[&text(&terms("Huski", "Org1"))]);
    fleet.refused(&owner(), Code::UnknownService, "share_preview", &[&text(&terms("Husky/none", "Org1"))]);
    for with in ["", "/Salma", "Org1/", "Org1/a/b"] {
        fleet.refused(&owner(), Code::BadArgument, "share_preview", &[&text(&terms("Husky", with))]);
    }
    for (field, value) in [("max_linear", "fast"), ("rate", "0"), ("hours", "08:00-18:00"), ("priority", "1.5")] {
        let mut json = serde_json::to_value(terms("Husky", "Org1")).unwrap();
        json[field] = value.into();
        fleet.refused(&owner(), Code::PolicyInvalid, "share_preview", &[&json.to_string()]);
    }
    let late = preview(&mut fleet, &terms("Husky", "Org1/Late"));
    assert_eq!(late.unknown.iter().map(|name| name.name.as_str()).collect::<Vec<_>>(), ["Org1/Late"]);
    assert_eq!(preview(&mut fleet, &terms("Husky", "Org9")).unknown[0].kind, "Organisation");
    // A name that would end a literal, and the policy.
    let evil = "Org1/x\", action, resource); permit (principal, action, resource) when { \"a\" == \"";
    match fleet.simulate(&owner(), "share_preview", &[text(&terms("Husky", evil)).into()]) {
        Ok(answer) => {
            let shown: SharePreview = serde_json::from_slice(&answer).unwrap();
            assert_eq!((shown.meaning.len(), shown.unknown[0].name.as_str()), (1, evil));
        }
        Err(refused) => assert_eq!(refused.code, Code::PolicyInvalid, "{refused}"),
    }
}

#[test]
fn the_owner_sees_the_rights_of_every_organisation_others_those_of_their_own_people() {
    let mut fleet = fleet();
    let seen = |items: &[Access]| items.iter().map(|access| access.who.clone()).collect::<Vec<_>>();
    let all = access(&mut fleet, &owner(), r#"{"robot":"Husky"}"#);
    // Of others those who may do something.
    assert_eq!(seen(&all), ["Org1/Officer", "Org1/Salma", "Org2/OptiTrack", "Org2/admin"]);
    assert_eq!(rights(&all, "Org1/Officer"), ["confirm Husky/cmd_vel", "stop Husky"]);
    let of_owner = rights(&all, "Org2/admin");
    for right in ["override Husky/cmd_vel", "confirm Husky/cmd_vel", "stop Husky", "resume Husky"] {
        assert!(of_owner.contains(&right.to_owned()), "{right}: {of_owner:?}");
    }
    // An admin whose certificate was issued beside the ledger is listed all the same.
    let known = fleet.members.1.lock().unwrap().clone();
    fleet.members.1.lock().unwrap().retain(|known| known.id() != "Org2/admin");
    assert_eq!(seen(&access(&mut fleet, &owner(), r#"{"robot":"Husky"}"#))[0], "Org2/admin");
    *fleet.members.1.lock().unwrap() = known;
    let own = access(&mut fleet, &admin1(), r#"{"robot":"Husky"}"#);
    assert_eq!(seen(&own), ["Org1/Farhad", "Org1/Guest", "Org1/Officer", "Org1/Salma", "Org1/admin"]);
    assert_eq!(seen(&access(&mut fleet, &salma(), r#"{"robot":"Husky"}"#)), ["Org1/Salma"]);
    assert_eq!(seen(&access(&mut fleet, &salma(), r#"{"robot":"Husky","who":"Org2/admin"}"#)), ["Org2/admin"]);
    // A holder may stop the robot.
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    let holder = access(&mut fleet, &salma(), r#"{"robot":"Husky"}"#);
    let stop = holder[0].rights.iter().find(|right| right.action == "stop").unwrap();
    assert_eq!(stop.rule, "a holder of Husky/cmd_vel");
    assert_eq!(stop.limits, Limits::default());
}

/// A change of what is shared, of policies, or of trust; each may be rejected.
#[derive(Clone, Debug)]
enum Change {
    Share { robot: bool, with: usize, attribute: bool, read_only: bool, slow: bool },
    Unshare(usize),
    Apply(Vec<usize>),
    Put(usize),
    Remove(usize),
    Rollback(u64),
    Trust(bool),
}

/// Policies that name no right that must be named; the last ones name one, for one person.
const POLICIES: [&str; 6] = [
    "permit (principal, action, resource);",
    r#"permit (principal in Organisation::"Org1", action, resource in Robot::"Husky") when { principal.hasTag("guest") };"#,
    r#"forbid (principal == User::"Org1/Farhad", action in [Action::"acquire", Action::"publish"], resource);"#,
    r#"@share("1") permit (principal, action, resource) unless { principal.name == "nobody" };"#,
    r#"permit (principal == User::"Org1/Salma", action == Action::"resume", resource);"#,
    r#"permit (principal == User::"Org1/Salma", action in [Action::"override", Action::"stop"], resource);"#,
];

fn change() -> impl Strategy<Value = Change> {
    let share = (any::<bool>(), 0..4_usize, any::<bool>(), any::<bool>(), any::<bool>());
    let share = share.prop_map(|(robot, with, attribute, read_only, slow)| Change::Share {
        robot,
        with,
        attribute,
        read_only,
        slow,
    });
    prop_oneof![
        4 => share,
        2 => (0..4_usize).prop_map(Change::Unshare),
        1 => prop::collection::vec(0..POLICIES.len(), 0..3).prop_map(Change::Apply),
        1 => (0..POLICIES.len()).prop_map(Change::Put),
        1 => (0..POLICIES.len()).prop_map(Change::Remove),
        1 => (0..8_u64).prop_map(Change::Rollback),
        1 => any::<bool>().prop_map(Change::Trust),
    ]
}

fn make(fleet: &mut Fleet, change: &Change) {
    let owner = owner();
    let draft = |draft: PolicyDraft| vec!["apply".to_owned(), serde_json::to_string(&draft).unwrap()];
    let (function, args) = match change {
        Change::Share { robot, with, attribute, read_only, slow } => {
            let with = ["Org1", "Org1/Guest", "Org1/Farhad", "Org1/Officer"][*with];
            let terms = ShareTerms {
                attribute: attribute.then(|| "guest".to_owned()),
                max_linear: slow.then(|| "0.2".to_owned()),
                read_only: *read_only,
                ..terms(if *robot { "Husky" } else { HUSKY }, with)
            };
            let args = [serde_json::to_string(&terms).unwrap().into()];
            let Ok(answer) = fleet.simulate(&owner, "share_preview", &args) else { return };
            let shown: SharePreview = serde_json::from_slice(&answer).unwrap();
            ("policy", draft(shown.set))
        }
        Change::Unshare(nth) => {
            let shares = shares(fleet);
            let Some(share) = shares.get(*nth) else { return };
            let answer = fleet.simulate(&owner, "unshare_preview", &[share.id.clone().into()]).unwrap();
            let shown: UnsharePreview = serde_json::from_slice(&answer).unwrap();
            ("policy", draft(PolicyDraft { means_it: true, ..shown.set }))
        }
        Change::Apply(several) => {
            let mut policies: Vec<PolicyText> = several
                .iter()
                .map(|nth| PolicyText { id: format!("p{nth}"), text: POLICIES[*nth].to_owned() })
                .collect();
            policies.dedup_by(|one, other| one.id == other.id);
            ("policy", draft(PolicyDraft { policies: Some(policies), means_it: true, ..PolicyDraft::default() }))
        }
        Change::Put(nth) => {
            ("policy", vec!["put".into(), format!("p{nth}"), POLICIES[*nth].into(), "i-mean-it".into()])
        }
        Change::Remove(nth) => ("policy", vec!["remove".into(), format!("p{nth}"), "i-mean-it".into()]),
        Change::Rollback(version) => {
            ("policy", draft(PolicyDraft { restores: Some(*version), means_it: true, ..PolicyDraft::default() }))
        }
        Change::Trust(all) => {
            let trusted = if *all { r#"{"trusted":["Org1","Org2"]}"# } else { r#"{"trusted":["Org2"]}"# };
            ("configure", vec!["Husky".into(), trusted.into()])
        }
    };
    let args: Vec<bytes::Bytes> = args.into_iter().map(bytes::Bytes::from).collect();
    let _rejected = fleet.call(&owner, function, &args);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    /// Salma is named by policies above, the officer by the built-in policy, and no other person by any.
    #[test]
    fn no_sequence_of_shares_and_policies_gives_override_stop_or_resume_to_anybody_who_was_not_named(
        changes in prop::collection::vec(change(), 1..12)
    ) {
        let mut fleet = fleet();
        for change in &changes {
            make(&mut fleet, change);
            let people = [guest(), farhad(), officer(), admin1(), salma()];
            for who in people {
                let mine = access(&mut fleet, &who, &format!(r#"{{"robot":"Husky","who":"{}"}}"#, who.id()));
                for right in mine.iter().flat_map(|access| &access.rights) {
                    let named = match (right.action.as_str(), who.name.as_str()) {
                        ("override" | "resume" | "stop", "Salma") => true,
                        ("stop" | "confirm", "Officer") => true,
                        ("override" | "resume" | "stop" | "confirm", _) => false,
                        _ => true,
                    };
                    prop_assert!(named, "{} has {right:?} after {changes:?}", who.id());
                }
                if !["Salma", "Officer"].contains(&who.name.as_str()) {
                    for (function, args) in [("take", vec![HUSKY, "mine"]), ("stop", vec!["Husky"]), ("resume", vec!["Husky"])] {
                        let done = fleet.simulate(&who, function, &crate::fleet::bytes(&args));
                        prop_assert!(done.is_err(), "{} may {function} after {changes:?}", who.id());
                    }
                }
            }
        }
    }

    /// A name or a value that ends its literal would be a policy of its own.
    #[test]
    fn no_name_or_value_of_a_share_gets_out_of_its_literal(
        (with, attribute) in (any::<String>(), prop::option::of(any::<String>())),
        (hours, limit) in (prop::option::of(any::<String>()), prop::option::of(any::<String>())),
        (robot, read_only) in (any::<bool>(), any::<bool>()),
    ) {
        let attribute = attribute.map(|attribute| if attribute.contains('=') { attribute } else { attribute + "=true" });
        let resource = if robot { "Husky" } else { HUSKY };
        let share = ShareTerms { attribute, hours, max_linear: limit, read_only, ..terms(resource, &with) };
        let text = share.text();
        let read = ShareEntry::of("Org2", "share-x", &text).unwrap();
        prop_assert!(!read.edited, "{text}");
        prop_assert_eq!(read.terms.as_ref(), Some(&share), "{}", &text);
        let checked: PolicyCheck = fleet().get(&owner(), "check", &[&text]);
        prop_assert!(checked.policies.len() <= 1, "{text}");
        for policy in checked.policies {
            prop_assert_eq!(policy.effect.as_str(), "permit");
            for right in ["override", "confirm", "stop", "resume"] {
                let words = policy.meaning.replace(&with, "");
                prop_assert!(!words.contains(right), "{words}");
            }
        }
    }
}
