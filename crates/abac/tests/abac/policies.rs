//! Policies on the ledger: whose they are, what they change, and how hostile ones fare.

use crate::fleet::{Fleet, HUSKY, OPTITRACK, SECOND, START, TURTLEBOT, admin1, farhad, identity, owner, robot, salma};
use bytes::Bytes;
use ledger_abac::{DEFAULT_POLICY, Grant, POLICY_BYTES_MAX, PolicyChange, PolicyEntry};
use ledger_base::rejection::Code;
use ledger_identity::Role;

const ALL: &str = "permit (principal, action, resource);";

#[test]
fn the_default_policy_is_acceptable_as_a_policy_and_decides_the_same() {
    let mut fleet = Fleet::of_the_paper();
    let change: PolicyChange = fleet.get(&owner(), "policy", &["put", "default", DEFAULT_POLICY]);
    assert!(!change.default_in_force);
    fleet.refused(&farhad(), Code::MissingAttribute, "acquire", &[HUSKY]);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
}

#[test]
fn only_admins_change_policies_and_only_for_their_own_robots() {
    let mut fleet = Fleet::of_the_paper();
    fleet.refused(&salma(), Code::NotAdmin, "policy", &["put", "all", ALL]);
    // The other organisation's policies say nothing about these robots, for or against.
    fleet.ok(&admin1(), "policy", &["put", "all", ALL]);
    fleet.refused(&farhad(), Code::MissingAttribute, "acquire", &[HUSKY]);
    fleet.ok(&admin1(), "policy", &["put", "all", "forbid (principal, action, resource);"]);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    fleet.refused(&owner(), Code::NotFound, "policy", &["remove", "all"]);
    let entries: Vec<PolicyEntry> = fleet.get(&salma(), "policies", &[]);
    let listed: Vec<_> = entries.iter().map(|entry| (entry.organisation.as_str(), entry.id.as_str())).collect();
    assert_eq!(listed, [("", "default"), ("Org1", "all")]);
}

#[test]
fn a_policy_opens_what_the_default_denies_and_its_removal_restores_that() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "policy", &["put", "all", ALL]);
    fleet.ok(&farhad(), "acquire", &[HUSKY]);
    let change: PolicyChange = fleet.get(&owner(), "policy", &["remove", "all"]);
    assert!(change.default_in_force);
    assert_eq!(
        change.ended.iter().map(|r| (r.service.as_str(), r.reason.word())).collect::<Vec<_>>(),
        [(HUSKY, "policy")]
    );
    fleet.refused(&farhad(), Code::MissingAttribute, "acquire", &[HUSKY]);
}

#[test]
fn a_policy_change_ends_the_grants_it_no_longer_permits_and_no_others() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    let without = format!("{DEFAULT_POLICY}\nforbid (principal == User::\"Org1/Farhad\", action, resource);");
    let since = fleet.events.len();
    fleet.ok(&owner(), "policy", &["put", "default", &without]);
    assert_eq!(fleet.told(since), [("released", TURTLEBOT), ("policy", "Org2")]);
    fleet.set(&salma(), HUSKY, 1, 1, 1).unwrap();
    let refusal = fleet.set_refused(&farhad(), Code::DeniedByPolicy, TURTLEBOT, 1, 1);
    assert!(refusal.found.starts_with("forbidden by default.policy"), "{refusal}");
}

#[test]
fn a_grant_needs_the_right_to_publish_as_well() {
    let mut fleet = Fleet::of_the_paper();
    let text = format!(
        "{ALL} forbid (principal, action == Action::\"publish\", resource) unless {{ principal.role == \"admin\" }};"
    );
    fleet.ok(&owner(), "policy", &["put", "p", &text]);
    fleet.refused(&salma(), Code::DeniedByPolicy, "acquire", &[HUSKY]);
    fleet.ok(&owner(), "acquire", &[HUSKY]);
}

#[test]
fn policies_speak_of_everything_the_schema_names() {
    let mut fleet = Fleet::of_the_paper();
    let text = r#"
        permit (principal in Organisation::"Org1", action == Action::"acquire", resource in Robot::"Husky") when {
            principal.organisation == "Org1" && principal.name == "Farhad" && principal.role == "member" &&
            principal.getTag("Turtlebot4") == "true" && resource.robot == "Husky" && resource.topic == "/cmd_vel" &&
            resource.type == "geometry_msgs/msg/Twist" && resource.mode == "exclusive" && resource.owner == "Org2" &&
            resource.direction == "command" && resource.requiredAttribute == "Husky" &&
            resource.requiredValue == "true" && resource.trusted == ["Org1", "Org2"] && context.time > 0 &&
            resource in Organisation::"Org2"
        };
        permit (principal, action in [Action::"publish", Action::"subscribe"], resource == Service::"Husky/cmd_vel");"#;
    let guarded = text.replace("principal.getTag", "principal.hasTag(\"Turtlebot4\") && principal.getTag");
    let refusal = fleet.refused(&owner(), Code::PolicyInvalid, "policy", &["put", "p", text]);
    assert!(refusal.found.contains("tag"), "an unguarded tag passes strict validation: {refusal}");
    fleet.ok(&owner(), "policy", &["put", "p", &guarded]);
    fleet.ok(&farhad(), "acquire", &[HUSKY]);
    fleet.refused(&salma(), Code::DeniedByPolicy, "acquire", &["OptiTrack"]);
}

#[test]
fn a_policy_that_looks_at_the_time_is_asked_again_as_time_passes() {
    let mut fleet = Fleet::of_the_paper();
    let noon = (START + 60 * SECOND) / 1000;
    let text = format!("{DEFAULT_POLICY} forbid (principal, action, resource) when {{ context.time >= {noon} }};");
    fleet.ok(&owner(), "policy", &["put", "p", &text]);
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    let mut seq = 0;
    while fleet.time < START + 55 * SECOND {
        fleet.time += 5 * SECOND;
        seq += 1;
        fleet.set(&salma(), HUSKY, 1, seq, 1).unwrap();
    }
    // From then on use no longer renews the lease; it runs out.
    fleet.time += 6 * SECOND;
    fleet.set(&salma(), HUSKY, 1, 100, 1).unwrap();
    fleet.refused(&salma(), Code::DeniedByPolicy, "renew", &[HUSKY]);
    fleet.time += 5 * SECOND;
    fleet.set_refused(&salma(), Code::DeniedByPolicy, HUSKY, 1, 101);
    fleet.refused(&salma(), Code::DeniedByPolicy, "acquire", &[HUSKY]);
}

#[test]
fn a_forbid_that_errors_denies() {
    let mut fleet = Fleet::of_the_paper();
    // Overflows when evaluated; Cedar alone would skip the policy and permit.
    let text = r#"permit (principal, action, resource);
        forbid (principal, action, resource) when { context.time * 9223372036854775807 > 0 };"#;
    let change: PolicyChange = fleet.get(&owner(), "policy", &["put", "p", text]);
    assert!(change.ended.is_empty());
    let refusal = fleet.refused(&salma(), Code::PolicyError, "acquire", &[HUSKY]);
    assert!(refusal.found.contains("overflow"), "{refusal}");
}

#[test]
fn a_simulated_change_of_policies_teaches_the_caches_nothing_false() {
    let mut fleet = Fleet::of_the_paper();
    let args = |text: &str| crate::fleet::bytes(&["put", "p", text]);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    fleet.simulate(&owner(), "policy", &args("forbid (principal, action, resource);")).unwrap();
    fleet.call(&owner(), "policy", &args(ALL)).unwrap();
    assert_eq!(fleet.get::<Vec<Grant>>(&owner(), "grants", &[]).len(), 1);
    fleet.ok(&farhad(), "acquire", &[HUSKY]);
}

#[test]
fn hostile_policies_are_refused_and_change_nothing() {
    let mut fleet = Fleet::of_the_paper();
    let condition = |text: &str| format!("permit (principal, action, resource) when {{ {text} }};");
    // Brackets of the condition and of the scope are on the same level.
    let nested = |depth: usize| condition(&format!("{}true{}", "(".repeat(depth - 1), ")".repeat(depth - 1)));
    let cases = [
        (String::new(), "argument"),
        ("// only a comment".to_owned(), "no policy"),
        (format!("{ALL}//{}", "x".repeat(POLICY_BYTES_MAX - ALL.len() - 1)), "8193 bytes"),
        (nested(33), "nesting of 33"),
        (nested(4000), "nesting of 4000"),
        (condition(&format!("{}true", "[".repeat(4000))), "nesting"),
        (condition(&format!("{}true", "if true then true else ".repeat(33))), "nesting of 33"),
        ("permit (principal, action, resource) when { \"".to_owned(), ""),
        ("permit (principal, action, resource) when { \"\\".to_owned(), ""),
        ("permit (principal, action, resource".to_owned(), ""),
        (condition(&"!".repeat(4000)), ""),
        (condition(&"-".repeat(4000)), ""),
        (condition("principal.colour == \"red\""), "colour"),
        (condition("principal.role == 7"), ""),
        (condition("principal.getTag(\"Husky\") == \"true\""), "tag"),
        ("permit (principal == ?principal, action, resource);".to_owned(), "template"),
        ("permit (principal, action == Action::\"fly\", resource);".to_owned(), ""),
        (condition("ｔｒｕｅ"), ""),
        ("\u{feff}\u{202e}permit🦀".to_owned(), ""),
        ("@id(\"x\")".repeat(900), ""),
    ];
    for (text, expected) in cases {
        let args = ["put", "p", text.as_str()].map(|arg| Bytes::copy_from_slice(arg.as_bytes()));
        let shown: String = text.chars().take(60).collect();
        let refusal = fleet.call(&owner(), "policy", &args).expect_err(&shown);
        assert_eq!(refusal.code, Code::PolicyInvalid, "{shown}: {refusal}");
        assert!(expected == "argument" || refusal.found.contains(expected), "{shown}: {refusal}");
        assert!(refusal.to_string().len() < 4096, "{shown}: {} bytes of message", refusal.to_string().len());
    }
    assert_eq!(fleet.get::<Vec<PolicyEntry>>(&owner(), "policies", &[]).len(), 1);
    fleet.ok(&owner(), "policy", &["put", "p", &nested(32)]);
    let unicode = condition("principal.name == \"Fárhad 🦀 \u{202e}\"");
    fleet.ok(&owner(), "policy", &["put", "p", &unicode]);
}

#[test]
fn brackets_and_ifs_in_strings_and_comments_do_not_nest() {
    let mut fleet = Fleet::of_the_paper();
    let text = format!(
        "// {}\npermit (principal, action, resource) when {{ principal.name != \"{}\\\" if if\" }};",
        "(".repeat(100),
        "[".repeat(100)
    );
    fleet.ok(&owner(), "policy", &["put", "p", &text]);
}

#[test]
fn chains_are_limited_to_what_every_stack_has_room_for() {
    let mut fleet = Fleet::of_the_paper();
    let condition = |text: &str| format!("permit (principal, action, resource) when {{ {text} }};");
    let chains = |links: usize| {
        [
            format!("true{}", "&&true".repeat(links)),
            format!("false{}||true", "||false".repeat(links - 1)),
            format!("principal.name!=\"x\"{}", "&&true".repeat(links - 1)),
            format!("1{} > 0", "+1".repeat(links)),
            format!("1{} > 0", "*1".repeat(links)),
            format!("1{} < 9", "-1".repeat(links)),
            format!("{}true", "true&&(true||".repeat(16)) + &")".repeat(16) + &"&&true".repeat(links - 32),
        ]
    };
    for chain in chains(1024) {
        fleet.ok(&owner(), "policy", &["put", "p", &condition(&chain)]);
        fleet.ok(&farhad(), "acquire", &[HUSKY]);
        fleet.ok(&farhad(), "release", &[HUSKY]);
    }
    let attributes = [format!("principal{}", ".a".repeat(1025)), format!("principal{}", "[\"a\"]".repeat(1025))];
    for chain in chains(1025).into_iter().chain(attributes) {
        let refusal = fleet.refused(&owner(), Code::PolicyInvalid, "policy", &["put", "p", &condition(&chain)]);
        assert_eq!(refusal.found, "1025 operators", "{}", &chain[..40]);
    }
    // Strict validation has an end as well.
    let attributes = condition(&format!("principal{}", ".a".repeat(1024)));
    fleet.refused(&owner(), Code::PolicyInvalid, "policy", &["put", "p", &attributes]);
}

#[test]
fn an_organisation_has_a_bounded_number_of_policies() {
    let mut fleet = Fleet::empty();
    for n in 0..64 {
        fleet.ok(&owner(), "policy", &["put", &format!("p{n}"), ALL]);
    }
    fleet.refused(&owner(), Code::QuotaReached, "policy", &["put", "p64", ALL]);
    fleet.ok(&owner(), "policy", &["put", "p63", "forbid (principal, action, resource);"]);
    fleet.ok(&owner(), "policy", &["remove", "p0"]);
    fleet.ok(&owner(), "policy", &["put", "p64", ALL]);
    fleet.ok(&owner(), "policy", &["remove", "p1"]);
    fleet.refused(&owner(), Code::BadName, "policy", &["put", "a/b", ALL]);
}

#[test]
fn a_policy_change_that_ends_very_many_grants_ends_all_of_them_at_once() {
    let mut fleet = Fleet::empty();
    fleet.ok(&owner(), "setup", &[&robot("Turtlebot4", "open"), &robot("Husky", "open"), OPTITRACK]);
    for n in 0..200_u16 {
        let mut user = salma();
        user.name = format!("user{n}");
        user.serial = n.to_be_bytes().to_vec();
        user.fingerprint[..2].copy_from_slice(&n.to_be_bytes());
        fleet.ok(&user, "acquire", &[TURTLEBOT, "600000"]);
        fleet.ok(&user, "acquire", &[HUSKY, "600000"]);
    }
    let change: PolicyChange = fleet.get(&owner(), "policy", &["put", "p", "forbid (principal, action, resource);"]);
    assert_eq!(change.ended.len(), 256);
    assert_eq!(fleet.get::<Vec<Grant>>(&owner(), "grants", &[]), []);
    fleet.tick();
    let released: Vec<_> = fleet.events.iter().filter(|event| event.name == "released").collect();
    assert_eq!(released.len(), 400);
    assert!(released.iter().all(|event| event.payload.windows(6).any(|part| part == b"policy")));
    assert_eq!(fleet.next_deadline(), None);
}

#[test]
fn attributes_of_a_fabric_ca_about_itself_give_nothing_unless_a_policy_names_them() {
    let mut fleet = Fleet::of_the_paper();
    let rover = identity("Org1", "Rover", Role::Member, &["hf.Affiliation", "hf.Registrar.Roles"], 9);
    fleet.refused(&rover, Code::MissingAttribute, "acquire", &[TURTLEBOT]);
    let named = r#"permit (principal, action, resource) when { principal.hasTag("hf.Affiliation") };"#;
    fleet.ok(&owner(), "policy", &["put", "department", named]);
    fleet.ok(&rover, "acquire", &[TURTLEBOT]);
    fleet.refused(&farhad(), Code::DeniedByPolicy, "acquire", &[HUSKY]);
}
