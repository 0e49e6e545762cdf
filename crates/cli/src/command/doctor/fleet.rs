//! The robots: ways around the ledger, stops, rules, and policies that do not hold.

use super::finding::Finding;
use crate::answer;
use crate::command::policy::unknown::shown;
use crate::session::{ABAC, Session};
use crate::time;
use bytes::Bytes;
use ledger_base::rejection::Rejection;
use ledger_contract::{PolicyCheck, PolicyEntry, PolicyFault, PolicyMeaning, RobotAsset, UnknownName};

/// Looks at what is on the ledger about robots.
pub(super) async fn look(session: &Session, findings: &mut Vec<Finding>) {
    match session.list::<RobotAsset>(ABAC, "robots").await {
        Ok(robots) => {
            findings.extend(side_doors(&robots, time::now()));
            findings.extend(stops(&robots, time::now()));
        }
        Err(refused) => findings.push(Finding::refused("side doors", &refused)),
    }
    match policies(session).await {
        Ok(found) => findings.extend(found),
        Err(refused) => findings.push(Finding::refused("policy", &refused)),
    }
}

/// Publishers beside the robots' bridges.
fn side_doors(robots: &[RobotAsset], now: u64) -> Vec<Finding> {
    let doors = robots.iter().flat_map(|robot| &robot.services).filter_map(|service| service.side_door.as_ref());
    let open: Vec<Finding> = doors
        .filter(|door| door.publishers > 0)
        .map(|door| {
            let others =
                if door.publishers == 1 { "1 publishes".to_owned() } else { format!("{} publish", door.publishers) };
            let message = format!(
                "{others} on {} of {} in addition to the bridge, reported by {} {}: they bypass the ledger",
                door.topic,
                door.service,
                door.by,
                time::relative(door.at, now)
            );
            let repair = format!(
                "on the robot: ros2 topic info -v {}; docs/bridge.md, \"Restricting the command topics\"",
                door.topic
            );
            Finding::wrong("side doors", message, repair)
        })
        .collect();
    match open.is_empty() {
        true => vec![Finding::ok("side doors", format!("none reported for {} robots", robots.len()))],
        false => open,
    }
}

/// Robots that somebody has stopped.
fn stops(robots: &[RobotAsset], now: u64) -> Vec<Finding> {
    let stopped = robots.iter().filter_map(|robot| Some((&robot.name, robot.stopped.as_ref()?)));
    let told = stopped.map(|(name, stop)| {
        let message = format!("{name} was stopped by {} {}", stop.by, time::relative(stop.since, now));
        Finding::advice("stops", message, format!("when it is safe: ledgerctl resume {name}"))
    });
    told.collect()
}

/// The policies of the own organisation, checked as the node would check them now.
async fn policies(session: &Session) -> Result<Vec<Finding>, Rejection> {
    let own = &session.context().organisation;
    let all: Vec<PolicyEntry> = session.list(ABAC, "policies").await?;
    let ours: Vec<&PolicyEntry> = all.iter().filter(|entry| entry.organisation == *own).collect();
    if ours.is_empty() {
        return Ok(vec![Finding::ok(
            "policy",
            format!("{own} has no policies of its own: the built-in policy decides"),
        )]);
    }
    let mut found = Vec::new();
    for entry in &ours {
        let response = session.ask(ABAC, "check", vec![Bytes::from(entry.text.clone())]).await?;
        let checked: PolicyCheck = answer::parse(&response, "the faults of a policy")?;
        found.extend(checked.faults.iter().map(|fault| faulty(entry, fault)));
        found.extend(checked.unknown.iter().map(|name| nameless(entry, name)));
        found.extend(checked.policies.iter().filter(|policy| policy.unmatched).map(|policy| unmatched(entry, policy)));
    }
    if found.is_empty() {
        found.push(Finding::ok("policy", format!("{} of {own}, none with errors", ours.len())));
    }
    Ok(found)
}

/// A policy that names what the network does not know today.
fn nameless(PolicyEntry { organisation, id, .. }: &PolicyEntry, name: &UnknownName) -> Finding {
    let message =
        format!("{organisation}/{id} names {}, which does not exist: the condition never matches", shown(name));
    Finding::advice(
        "policy",
        message,
        format!("if it is a typo: ledgerctl policy show {id}, then ledgerctl policy put {id} @FILE"),
    )
}

/// A policy that applies to nobody of today.
fn unmatched(PolicyEntry { organisation, id, .. }: &PolicyEntry, policy: &PolicyMeaning) -> Finding {
    let message =
        format!("{organisation}/{id} line {} applies to no current identity: {}", policy.line, policy.meaning);
    Finding::advice(
        "policy",
        message,
        format!("if it should apply: ledgerctl policy show {id}; ledgerctl can WHO ACTION SERVICE prints the reason"),
    )
}

fn faulty(entry: &PolicyEntry, fault: &PolicyFault) -> Finding {
    let place = if fault.line == 0 { String::new() } else { format!(" line {}", fault.line) };
    let message = format!("{}/{}{place}: {}", entry.organisation, entry.id, fault.message);
    let repair = match fault.help.is_empty() {
        true => format!("ledgerctl policy show {0}, then ledgerctl policy put {0} @FILE", entry.id),
        false => format!("{}; then ledgerctl policy put {} @FILE", fault.help, entry.id),
    };
    Finding::wrong("policy", message, repair)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::super::finding::State;
    use super::*;

    fn robot(publishers: u64) -> RobotAsset {
        let text = r#"{"Name":"T","SubTopic":"/c","PubTopic":"","owner":"","UnderOp":false,"organisation":"Org2",
            "attribute_required":"T=true","trusted":[],"services":[{"service":"T/c","robot":"T","organisation":"Org2",
            "topic":"/c","type":"a/msg/B","mode":"exclusive","direction":"command","max_age_ms":1,"lease_ms":1,
            "lease_ms_max":1,"stop_hex":null,"holder":"","holders":[],"epoch":0,"expires":0,
            "capabilities":{"fencing":"newest","publishing":"grant","sequence":"per_epoch"},"side_door":
            {"service":"T/c","topic":"/c","publishers":PUBLISHERS,"by":"Org2/T","since":1,"at":2}}]}"#;
        serde_json::from_str(&text.replace("PUBLISHERS", &publishers.to_string())).unwrap()
    }

    #[test]
    fn a_side_door_is_wrong_while_somebody_stands_in_it() {
        let states = |publishers| side_doors(&[robot(publishers)], 5)[..].iter().map(|f| f.state).collect::<Vec<_>>();
        assert_eq!((states(0), states(2)), (vec![State::Ok], vec![State::Wrong]));
    }

    #[test]
    fn a_fault_of_a_policy_names_its_line_and_the_way_to_replace_it() {
        let entry = PolicyEntry { organisation: "Org2".into(), id: "night".into(), text: String::new() };
        let fault = |line, help: &str| PolicyFault {
            message: "m".into(),
            help: help.into(),
            line,
            column: 1,
            length: 1,
            text: String::new(),
        };
        let told = faulty(&entry, &fault(7, "write x"));
        assert_eq!(told.message, "Org2/night line 7: m");
        assert_eq!(told.r#try, "write x; then ledgerctl policy put night @FILE");
        assert!(faulty(&entry, &fault(0, "")).r#try.contains("policy show night"));
        let name = UnknownName { line: 1, kind: "Robot".into(), name: "Turtelbot4".into(), near: String::new() };
        let told = nameless(&entry, &name);
        assert_eq!(told.state, State::Advice);
        assert!(told.message.contains("names Robot::\"Turtelbot4\", which does not exist"), "{}", told.message);
    }
}
