//! `robot set`, `robot add --replace`: changing what is registered, with a summary of what changed and what ended.

use crate::answer;
use crate::argument::capability::{self, Capability};
use crate::argument::setting::{self, KEYS, Setting};
use crate::command::message::enter;
use crate::failure::Failure;
use crate::output::{Facts, Output, Table};
use crate::session::{self, ABAC, Session};
use crate::time;
use crate::words::{self, Words, decimal};
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Reason, Released, RobotAsset, RobotChange, SettingChange, Told};
use serde::Serialize;
use std::io::{self, Write};

/// Change settings of a robot of your organisation; for admins.
///
/// Other settings stay unchanged, as do the grants that the new settings permit. The output lists the changes and the
/// grants that ended.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Settings of a service:
  mode=open|exclusive|limited, direction=command|feed, lease=10s, lease-max=10m, max-age=500ms, stop=HEX,
  type=PACKAGE/msg/NAME
Who wins when several want a service (docs/conflict.md); `default` as the value takes a setting back:
  publishers=N (with mode=limited), on-conflict=deny|queue|preempt, queue-max=N, queue-wait-max=10m,
  priority=attribute:NAME|policy|fixed:N, aging=30s, min-hold=5s, idle-release=1m
Who can read its messages (docs/policies.md):
  confidential=true encrypts them for those whom policies permit to subscribe
How fast the robot may be asked to go, m/s and rad/s, whatever policies say:
  max-linear=0.5, max-angular=1.5
How much all its publishers together may send, at most the quota of your organisation (docs/operations.md):
  bytes-per-s=N, messages-per-s=N
Settings of the robot:
  attr-required=KEY[=VALUE], trust=ORG[,ORG]
Attributes for policies, of the robot, or of the service if one is named (docs/policies.md):
  --attribute kind=crane (a text), --attribute payload_kg=20 (a number), --attribute zones=a,b (a set),
  --attribute kind= (removes it)

Example:
  ledgerctl robot set Turtlebot4/cmd_vel mode=open max-age=500ms
  ledgerctl robot set Turtlebot4/cmd_vel on-conflict=preempt priority=attribute:rank min-hold=5s
  ledgerctl robot set Husky --attribute payload_kg=75 --attribute zones=
  ledgerctl robot set Husky trust=Org1,Org2 --dry-run")]
pub(crate) struct Set {
    /// The service; the robot alone if it offers exactly one, and for the robot's own settings
    #[arg(value_name = "ROBOT[/TOPIC]")]
    target: String,
    /// Settings to change, such as mode=open
    #[arg(value_name = "KEY=VALUE", required_unless_present = "attributes")]
    settings: Vec<Setting>,
    /// Set an attribute; without a value, remove it
    #[arg(long = "attribute", value_name = "NAME=[VALUE]")]
    attributes: Vec<Capability>,
    /// Only show the changes and the grants that would end
    #[arg(long)]
    dry_run: bool,
}

impl Set {
    pub(super) async fn run(self, session: &Session, output: &mut Output) -> Result<(), Failure> {
        let mut settings = setting::collect(&self.settings).map_err(|problem| {
            Rejection::new(Code::BadArgument, "the settings cannot be read")
                .found(problem)
                .wanted(format!("each of these at most once: {}", setting::listed(|_| true)))
                .next("ledgerctl robot set --help")
        })?;
        if !self.attributes.is_empty() {
            settings.attributes = Some(capability::changes(&self.attributes).map_err(unreadable_attributes)?);
        }
        let args = vec![Bytes::from(self.target.clone()), session::argument(&settings)?];
        let response = match self.dry_run {
            true => session.ask(ABAC, "configure", args).await,
            false => session.call(ABAC, "configure", args).await.map(|done| done.response),
        };
        let response = response.map_err(in_words_of_the_command_line)?;
        let change: RobotChange = answer::parse(&response, "a change of a robot")?;
        if !self.dry_run && settings.sharing.is_confidential() {
            enter_readers(session, &change.robot, output).await?;
        }
        output.show(&Changed { name: self.target, change, dry_run: self.dry_run })
    }
}

/// The refusal of attributes that contradict each other.
pub(super) fn unreadable_attributes(problem: String) -> Rejection {
    Rejection::new(Code::BadArgument, "the attributes cannot be read")
        .found(problem)
        .wanted("each name once: kind=crane for a text, payload_kg=20 for a number, zones=a,b for a set")
        .next("ledgerctl robot set --help")
}

/// Puts a whole description in the place of a robot's present one.
pub(super) async fn replace(session: &Session, name: &str, spec: Bytes, output: &mut Output) -> Result<(), Failure> {
    let done = session.call(ABAC, "replace", vec![spec]).await.map_err(in_words_of_the_command_line)?;
    let changes: Vec<RobotChange> = answer::parse(&done.response, "changes of robots")?;
    for change in changes {
        enter_readers(session, &change.robot, output).await?;
        output.show(&Changed { name: name.to_owned(), change, dry_run: false })?;
    }
    Ok(())
}

/// Enters the caller, an admin of the owner, as a reader of the robot's confidential services: without one nobody can publish there.
pub(super) async fn enter_readers(session: &Session, robot: &RobotAsset, output: &Output) -> Result<(), Failure> {
    for service in robot.services.iter().filter(|service| service.sharing.is_confidential()) {
        if enter(session, &service.service).await? {
            output.note(&format!("{} is confidential, and you are now one of its readers", service.service));
        }
    }
    Ok(())
}

/// The words of the command line where the chaincode has other names.
const WORDS: Words = Words {
    arguments: &[("ROBOT[/TOPIC]", "the robot"), ("ROBOT_JSON", "the description"), ("SETTINGS_JSON", "the settings")],
    help: "ledgerctl robot",
};

/// The refusal with the names that people type where the ledger has others.
pub(super) fn in_words_of_the_command_line(refused: Rejection) -> Rejection {
    let typed = |text: String| {
        let text = words::spans(&text);
        // The longer name first: it begins with the shorter one.
        let mut keys: Vec<_> = KEYS.iter().filter(|key| key.name != key.field).collect();
        keys.sort_by_key(|key| std::cmp::Reverse(key.field.len()));
        keys.iter().fold(text, |text, key| text.replace(key.field, key.name))
    };
    let told = WORDS.told(refused);
    let next = typed(told.own_advice().to_owned());
    let Rejection { code, message, found, wanted, .. } = told;
    Rejection::new(code, typed(message)).found(typed(found)).wanted(typed(wanted)).next(next)
}

#[derive(Serialize)]
struct Changed {
    #[serde(skip)]
    name: String,
    #[serde(flatten)]
    change: RobotChange,
    dry_run: bool,
}

impl Facts for Changed {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Self { name, change: RobotChange { robot, changed, ended }, dry_run } = self;
        if changed.is_empty() {
            return writeln!(out, "nothing to change: {name} has these settings already");
        }
        writeln!(out, "{} {}", robot.name, if *dry_run { "would change" } else { "is changed" })?;
        settings(out, changed)?;
        if ended.is_empty() {
            return writeln!(out, "no grant {}", if *dry_run { "would end" } else { "ended by it" });
        }
        ends(out, ended, if *dry_run { "would end" } else { "ended" })
    }
}

/// Settings before and after, in the words that people type.
pub(in crate::command) fn settings(out: &mut dyn Write, changed: &[SettingChange]) -> io::Result<()> {
    let mut table = Table::pairs();
    for SettingChange { topic, setting, before, after } in changed {
        let (before, after) = (shown(setting, before), shown(setting, after));
        table.row([topic.clone(), typed(setting).to_owned(), before, "->".to_owned(), after]);
    }
    table.write(out, 2)
}

/// Grants that end, each with the reason.
pub(in crate::command) fn ends(out: &mut dyn Write, ended: &[Released], end: &str) -> io::Result<()> {
    for grant in ended {
        let (service, holder, epoch) = (&grant.service, &grant.holder, grant.epoch);
        writeln!(out, "{end}: the grant of {service} to {holder} (epoch {epoch}): {}", why(&grant.reason))?;
    }
    Ok(())
}

/// The name that people type.
pub(super) fn typed(setting: &str) -> &str {
    KEYS.iter().find(|key| key.field == setting).map_or(setting, |key| key.name)
}

pub(super) fn shown(setting: &str, value: &str) -> String {
    match value.parse::<u64>() {
        Ok(ms) if setting.ends_with("_ms") || setting == "lease_ms_max" => time::span(ms.saturating_mul(1000)),
        Ok(speed) if setting.ends_with("_mm_s") => format!("{} m/s", decimal(speed)),
        Ok(speed) if setting.ends_with("_mrad_s") => format!("{} rad/s", decimal(speed)),
        _ if value.is_empty() => "none".to_owned(),
        _ => value.to_owned(),
    }
}

fn why(reason: &Told<Reason>) -> &str {
    match reason.known() {
        Some(Reason::Policy) => "the robot no longer permits this holder",
        Some(Reason::Taken) => "the mode has no slot for this holder",
        Some(Reason::RobotRemoved) => "the robot no longer offers this service",
        Some(Reason::Released) => "its holder released it",
        Some(Reason::Expired) => "its lease expired",
        Some(Reason::Revoked) => "its holder's certificate is revoked",
        Some(Reason::Preempted) => "a contender with a higher priority preempted it",
        Some(Reason::Idle) => "its holder published nothing for too long",
        Some(Reason::Stopped) => "the robot is stopped",
        Some(Reason::Delegated) => "its holder delegated it",
        Some(Reason::Recalled) => "it was recalled",
        Some(Reason::TaskEnded) => "its task ended",
        Some(Reason::Overridden) => "an emergency operator overrode it",
        Some(_) | None => reason.word(),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn text(changed: Vec<SettingChange>, ended: Vec<Released>, dry_run: bool) -> String {
        let robot: RobotAsset = serde_json::from_str(
            r#"{"Name":"Husky","SubTopic":"/cmd_vel","PubTopic":"","owner":"","UnderOp":false,"organisation":"Org2",
                "attribute_required":"Husky=true","trusted":["Org1"],"services":[]}"#,
        )
        .unwrap();
        let mut out = Vec::new();
        let change = RobotChange { robot, changed, ended };
        Changed { name: "Husky".into(), change, dry_run }.text(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    fn setting(topic: &str, setting: &str, before: &str, after: &str) -> SettingChange {
        SettingChange { topic: topic.into(), setting: setting.into(), before: before.into(), after: after.into() }
    }

    #[test]
    fn a_change_says_what_is_different_and_what_ended_and_why() {
        let changed =
            vec![setting("/cmd_vel", "lease_ms", "10000", "20000"), setting("", "trusted", "Org1, Org2", "Org2")];
        let ended = vec![Released {
            service: "Husky/cmd_vel".into(),
            holder: "Org1/Salma".into(),
            epoch: 3,
            reason: Reason::Policy.into(),
            by: None,
            goes_on: false,
        }];
        assert_eq!(
            text(changed, ended, false),
            "Husky is changed\n  /cmd_vel  lease  10 s        ->  20 s\n            trust  Org1, Org2  ->  Org2\n\
             ended: the grant of Husky/cmd_vel to Org1/Salma (epoch 3): the robot no longer permits this holder\n"
        );
    }

    #[test]
    fn nothing_that_changes_is_said_too() {
        assert_eq!(text(vec![], vec![], false), "nothing to change: Husky has these settings already\n");
        let dry = text(vec![setting("/cmd_vel", "stop_hex", "00010000", "")], vec![], true);
        assert_eq!(dry, "Husky would change\n  /cmd_vel  stop  00010000  ->  none\nno grant would end\n");
    }

    #[test]
    fn refusals_name_what_people_type() {
        let refused = Rejection::new(Code::BadArgument, "lease_ms_max of service /cmd_vel is out of range")
            .next("lease_ms is 20 ms, and lease_ms_max must not be shorter: set both");
        let refused = in_words_of_the_command_line(refused);
        assert_eq!(refused.message, "lease-max of service /cmd_vel is out of range");
        assert_eq!(refused.advice(), "lease is 20 ms, and lease-max must not be shorter: set both");
    }
}
