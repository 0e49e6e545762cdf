//! `robot show`: one robot with its services.

use super::change::{shown, typed};
use super::rule;
use crate::output::{Facts, Table};
use crate::time;
use ledger_api::json;
use ledger_contract::{RobotAsset, ServiceState, SideDoor, Stopped};
use serde::Serialize;
use serde_json::value::RawValue;
use std::io::{self, Write};

/// A robot exactly as the ledger holds it, whatever fields later versions add.
#[derive(Serialize)]
#[serde(transparent)]
pub(super) struct Asset {
    json: Box<RawValue>,
    /// The moment by which leases are shown, microseconds.
    #[serde(skip)]
    now: u64,
}

impl Asset {
    pub(super) fn new(json: Box<RawValue>, now: u64) -> Self {
        Self { json, now }
    }
}

impl Facts for Asset {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        // Of a much newer node: what it says is better than nothing.
        let Ok(robot) = serde_json::from_str::<RobotAsset>(self.json.get()) else {
            return writeln!(out, "{}", json::pretty(self.json.get()).unwrap_or_default());
        };
        let mut table = Table::pairs();
        table.pair("robot", &robot.name);
        table.pair("owner", &robot.organisation);
        table.pair("requires", format!("attribute {}", robot.attribute_required));
        table.pair("trusts", robot.trusted.join(", "));
        for (name, value) in &robot.attributes {
            table.pair("attribute", format!("{name}={value}"));
        }
        table.pair("state", robot.stopped.as_ref().map_or_else(|| "in service".to_owned(), stopped));
        table.write(out, 0)?;
        robot.services.iter().try_for_each(|service| self.service(service, out))
    }
}

/// `stopped by Org2/admin at …: person in the cell`.
fn stopped(stop: &Stopped) -> String {
    let Stopped { by, reason, since } = stop;
    let why = if reason.is_empty() { String::new() } else { format!(": {reason}") };
    format!("stopped by {by} at {}{why}", time::moment(*since))
}

impl Asset {
    fn service(&self, service: &ServiceState, out: &mut dyn Write) -> io::Result<()> {
        let span = |ms: u64| time::span(ms.saturating_mul(1000));
        writeln!(out, "\n{}", service.service)?;
        let mut table = Table::pairs();
        table.pair("type", &service.type_name);
        table.pair("direction", service.direction.word());
        table.pair("rule", rule(service));
        if service.holders.is_empty() {
            table.pair("holder", "none");
        }
        for holder in &service.holders {
            table.pair("holder", holder);
        }
        table.pair("epoch", service.epoch);
        if service.expires > 0 {
            let (at, from_now) = (time::moment(service.expires), time::relative(service.expires, self.now));
            table.pair("expires", format!("{at} ({from_now})"));
        }
        table.pair("waiting", service.waiting);
        table.pair("readers", service.readers.join(", "));
        table.pair("lease", format!("{}, at most {}", span(service.lease_ms), span(service.lease_ms_max)));
        table.pair("max-age", span(service.max_age_ms));
        table.pair("stop message", service.stop_hex.as_deref().unwrap_or_default());
        for (field, value) in service.sharing.set() {
            table.pair(typed(field), shown(field, &value));
        }
        for (name, value) in &service.attributes {
            table.pair("attribute", format!("{name}={value}"));
        }
        table.pair("rogue publishers", service.side_door.as_ref().map(rogue).unwrap_or_default());
        table.write(out, 2)
    }
}

/// The last report about rogue publishers.
fn rogue(report: &SideDoor) -> String {
    let SideDoor { topic, publishers, by, at, .. } = report;
    format!("{publishers} on {topic}, reported by {by} at {}", time::moment(*at))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn text(json: &str) -> String {
        let mut out = Vec::new();
        Asset::new(serde_json::from_str(json).unwrap(), 1_000_000).text(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn people_read_a_table_in_which_the_owner_is_the_organisation_and_the_holder_is_the_holder() {
        let shown = text(super::super::tests::ASSET);
        let wanted = "\
robot     Turtlebot4
owner     Org2
requires  attribute Turtlebot4=true
trusts    Org1, Org2
state     in service

Turtlebot4/cmd_vel
  type       geometry_msgs/msg/Twist
  direction  command
  rule       exclusive
  holder     Org1/Salma
  epoch      3
  expires    ";
        assert!(shown.starts_with(wanted), "{shown}");
        assert!(
            shown.ends_with(" (in 10 s)\n  waiting    0\n  lease      10 s, at most 10 min\n  max-age    1 s\n"),
            "{shown}"
        );
    }

    #[test]
    fn a_stop_settings_and_rogue_publishers_are_shown_without_numbers_of_microseconds() {
        let sharing = r#""sharing":{"on_conflict":"queue","queue_wait_max_ms":60000,"max_linear_mm_s":500},
            "side_door":{"service":"Turtlebot4/cmd_vel","topic":"/cmd_vel","publishers":2,"by":"Org2/Rover","since":1,
            "at":1700000000000000},"holder":"#;
        let json = super::super::tests::ASSET.replace(r#""holder":"#, sharing);
        let json = json.replace(
            r#""services":["#,
            r#""stopped":{"by":"Org2/Admin","reason":"smoke","since":1700000000000000},"services":["#,
        );
        let shown = text(&json);
        for part in [
            "state     stopped by Org2/Admin at 2023-11-1",
            ": smoke\n",
            "queue-wait-max    1 min\n",
            "max-linear        0.5 m/s\n",
            "rogue publishers  2 on /cmd_vel, reported by Org2/Rover at 2023-11-1",
        ] {
            assert!(shown.contains(part), "{part:?} in {shown}");
        }
        assert!(!shown.contains("1700000000000000") && !shown.contains('{'), "{shown}");
    }

    #[test]
    fn programs_read_the_asset_with_the_fields_of_the_paper_first() {
        let asset = Asset::new(serde_json::from_str(super::super::tests::ASSET).unwrap(), 0);
        let json = serde_json::to_string(&asset).unwrap();
        assert!(
            json.starts_with(r#"{"Name":"Turtlebot4","SubTopic":"/cmd_vel","PubTopic":"","owner":"Org1/Salma","#),
            "{json}"
        );
    }

    #[test]
    fn a_robot_that_this_version_cannot_read_is_shown_as_it_came() {
        assert_eq!(text(r#"{"Name":"Turtlebot9"}"#), "{\n  \"Name\": \"Turtlebot9\"\n}\n");
    }
}
