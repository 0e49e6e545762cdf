//! Policies as owners use them: checked, tested, compared and asked about, with `ledgerctl` and a real node.

use crate::support::Dev;
use std::path::PathBuf;

/// The trained may drive what carries little.
const TRAINED: &str = r#"permit (principal, action, resource) when {
    principal.hasTag("trained") &&
    resource.hasTag("payload_kg") && resource.getTag("payload_kg") has number &&
    resource.getTag("payload_kg").number <= 50
};
"#;

const CASES: &str = r#"
[[case]]
who = "Org1/Salma"
action = "acquire"
service = "Husky/cmd_vel"
expect = "allow"

[[case]]
who = "Org1/Farhad"
action = "acquire"
service = "Husky/cmd_vel"
expect = "DENIED_BY_POLICY"
"#;

#[test]
fn an_owner_checks_tests_compares_and_puts_policies_and_everybody_learns_why_not() {
    let dev = Dev::start();
    let owner = dev.owner();
    let (salma, farhad) = (dev.user("Salma", &["Husky", "trained"], "ed25519"), dev.user("Farhad", &["Husky"], "p256"));
    let directory = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| -> PathBuf {
        let path = directory.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let [trained, cases] = [file("trained.cedar", TRAINED), file("cases.toml", CASES)];
    let [trained, cases] = [trained.to_str().unwrap(), cases.to_str().unwrap()];

    // An attribute of the robot, with its type.
    let changed = owner.run(&["robot", "set", "Husky", "--attribute", "payload_kg=20", "--attribute", "kind=rover"]);
    assert!(changed.ok().stdout.contains("attribute payload_kg"));
    let shown = farhad.json(&["robot", "show", "Husky"]);
    assert_eq!((&shown["attributes"]["payload_kg"], &shown["attributes"]["kind"]), (&20.into(), &"rover".into()));

    // Faults have a place.
    owner.run(&["policy", "check", trained]).ok();
    let wrong = file("wrong.cedar", &TRAINED.replace("number <= 50", "number <= \"50\""));
    let faults = owner.run(&["policy", "check", wrong.to_str().unwrap()]);
    assert_eq!(faults.code, 3, "{faults:?}");
    assert!(faults.stdout.contains("wrong.cedar:4:") && faults.stdout.contains("^^^"), "{faults:?}");

    // Cases against files, and against what is in force.
    owner.run(&["policy", "test", cases, "--policy", trained]).ok();
    let now = owner.run(&["policy", "test", cases]);
    assert_eq!(now.code, 1, "{now:?}");
    assert!(now.stdout.contains("1 passed, 1 failed") && now.stdout.contains("FAILED"), "{now:?}");

    // What would end, ends.
    farhad.run(&["acquire", "Husky"]).ok();
    let diff = owner.json(&["policy", "diff", trained]);
    assert_eq!((&diff["added"][0], &diff["ends"][0]["holder"]), (&"trained".into(), &"Org1/Farhad".into()));
    let put = ["policy", "put", "trained", &format!("@{trained}")];
    owner.run(&put).ok();
    assert_eq!(owner.run(&["policy", "show", "trained"]).ok().stdout.trim(), TRAINED.trim());
    owner.run(&["policy", "test", cases]).ok();

    // The refusal and the answer say the same.
    farhad.run(&["acquire", "Husky"]).refused(2, &["LGR-3002", r#"principal has no "trained""#]);
    let no = dev.admin().run(&["can", "Farhad", "acquire", "Husky/cmd_vel", "--who-could"]);
    assert_eq!(no.code, 2, "{no:?}");
    for part in [r#"found   principal has no "trained""#, "policy trained:", "of your organisation, Org1/Salma could"] {
        assert!(no.stdout.contains(part), "{part:?} in {no:?}");
    }
    let yes = salma.json(&["can", "Org1/Salma", "acquire", "Husky/cmd_vel"]);
    assert_eq!((&yes["allowed"], &yes["policies"][0]), (&true.into(), &"trained".into()));
    let matrix = dev.admin().run(&["can", "--matrix"]).ok().stdout;
    let salmas = matrix.lines().find(|line| line.contains("Org1/Salma") && line.contains("Husky/cmd_vel")).unwrap();
    assert!(salmas.contains("acquire, publish, subscribe"), "{matrix}");
    farhad.run(&["can", "Farhad", "acquire", "Husky", "--who-could"]).refused(2, &["read the registered identities"]);
}

#[test]
fn sets_of_policies_have_numbers_are_rolled_back_and_need_the_agreement_that_they_ask_for() {
    let dev = Dev::start();
    let (owner, salma) = (dev.owner(), dev.user("Salma", &["Husky"], "ed25519"));
    let directory = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| -> String {
        let path = directory.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let default = owner.run(&["policy", "show", "default"]).ok().stdout;
    let (open, closed) = (file("open.cedar", &default), file("closed.cedar", "forbid (principal, action, resource);"));

    let applied = owner.json(&["policy", "apply", &open, "-m", "as it was"]);
    assert_eq!((&applied["version"], &applied["message"]), (&1.into(), &"as it was".into()));
    let grant = salma.json(&["acquire", "Husky", "--for", "10m"]);
    assert_eq!(grant["policy_version"], 1, "{grant}");
    owner.run(&["policy", "apply", &open, &closed]).refused(5, &["LGR-3024", "found   Husky", "--i-mean-it"]);
    let ended = owner.json(&["policy", "apply", &open, &closed, "--i-mean-it"]);
    assert_eq!(ended["ended"][0]["holder"], "Org1/Salma", "{ended}");
    salma.run(&["acquire", "Husky"]).refused(2, &["LGR-3002", "(policies of Org2, version 2: closed)"]);
    owner.run(&["policy", "rollback", "1", "--base", "1"]).refused(5, &["LGR-3023", "version 2 in force"]);
    owner.run(&["policy", "rollback", "1", "-m", "too strict"]).ok();
    salma.run(&["acquire", "Husky", "--for", "10m"]).ok();
    let history = owner.run(&["policy", "history"]).ok().stdout;
    assert!(history.contains("version 1 again: too strict"), "{history}");
    let text = owner.run(&["policy", "show", "closed", "--version", "2"]).ok().stdout;
    assert_eq!(text.trim(), "forbid (principal, action, resource);");

    // From here on two organisations must agree.
    owner.run(&["policy", "apply", &open, "--approvals", "organisations = 2"]).ok();
    owner.run(&["policy", "put", "closed", &format!("@{closed}"), "--i-mean-it"]).refused(2, &["LGR-3018", "1 more"]);
    let proposed = owner.json(&["policy", "propose", &closed, "--i-mean-it", "-m", "closed for works"]);
    let id = proposed["id"].as_str().unwrap();
    owner.run(&["policy", "apply", "--proposal", &id[..8]]).refused(2, &["LGR-3018", "policy approve"]);
    owner.run(&["policy", "apply", "--proposal", id, "--break-glass"]).refused(2, &["LGR-3018", "72 hours"]);
    let shown = dev.admin().run(&["policy", "proposals", &id[..8]]).ok().stdout;
    assert!(shown.contains("closed for works") && shown.contains("forbid (principal"), "{shown}");
    salma.run(&["policy", "approve", id]).refused(2, &["LGR-3010"]);
    dev.admin().run(&["policy", "apply", "--proposal", id]).refused(2, &["LGR-3009"]);
    dev.admin().run(&["policy", "approve", &id[..8]]).ok();
    let applied = owner.json(&["policy", "apply", "--proposal", &id[..8]]);
    assert_eq!((&applied["version"], &applied["ended"][0]["holder"]), (&5.into(), &"Org1/Salma".into()), "{applied}");
    let rules = owner.run(&["policy", "approvals"]).ok().stdout;
    assert!(rules.contains("Org2") && rules.contains("organisations = 2"), "{rules}");
}
