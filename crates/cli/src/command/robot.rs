//! `robot add|set|list|show|remove`: what organisations registered.

pub(in crate::command) mod change;
mod show;

use crate::answer;
use crate::argument::capability::{self, Capability};
use crate::argument::service;
use crate::command::identity::Invitation;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table};
use crate::session::{self, ABAC, Session};
use crate::time;
use crate::words::Words;
use bytes::Bytes;
use ledger_api::SECRET_LIFE;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Direction, Released, RobotAsset, RobotSpec, ServiceSpec, ServiceState};
use ledger_identity::Role;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, Write};

/// Register and show robots.
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Robot {
    Add(Add),
    Set(change::Set),
    List(List),
    Show(Show),
    Remove(Remove),
}

/// Register a robot of your organisation; for admins.
///
/// A name that is registered already is rejected: `robot set` changes settings of that robot, `--replace` all of it.
///
/// Without --trust, only attributes of your own organisation count. To let others use the robot: `ledgerctl share`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl robot add Turtlebot4 --attr-required Turtlebot4 --service /cmd_vel=geometry_msgs/msg/Twist,mode=exclusive --enrol
  ledgerctl robot add OptiTrack --attr-required OptiTrack --service /pose=geometry_msgs/msg/PoseStamped,direction=feed
  ledgerctl robot add Husky --attr-required level=3 --service /cmd_vel=geometry_msgs/msg/Twist,lease=10s --trust Org1
  ledgerctl robot add Spot --attr-required Spot --service /cmd_vel=geometry_msgs/msg/Twist,on-conflict=queue
  ledgerctl robot add Crane --attr-required Crane --service /hook=std_msgs/msg/Float64 --attribute kind=crane --attribute zones=a,b
  ledgerctl robot add Arm --attr-required Arm --service /home=std_srvs/srv/Trigger
  ledgerctl robot add Nav --attr-required Nav --service /navigate_to_pose=nav2_msgs/action/NavigateToPose

The last two are a ROS 2 service and an action: users call them, and the robot replies on /home/_reply and
/navigate_to_pose/_reply, which are registered with them.")]
pub(crate) struct Add {
    /// Name of the robot
    name: String,
    /// The attribute that a user's certificate must carry; KEY alone means KEY=true
    #[arg(long, value_name = "KEY[=VALUE]")]
    attr_required: String,
    #[arg(
        long = "service",
        value_name = "SERVICE",
        required = true,
        value_parser = service::parse,
        help = "TOPIC=TYPE[,KEY=VALUE]…, such as mode=limited,publishers=2; the keys are those of `robot set`"
    )]
    services: Vec<ServiceSpec>,
    /// An organisation whose attributes count; by default only your own, with --replace those that counted before
    #[arg(long = "trust", value_name = "ORG")]
    trusted: Vec<String>,
    /// An attribute for policies: kind=crane is a text, payload_kg=20 a number, zones=a,b a set; may be given several
    /// times
    #[arg(long = "attribute", value_name = "NAME=VALUE")]
    attributes: Vec<Capability>,
    /// Replace the existing description of the robot; grants that the new one does not permit end
    #[arg(long)]
    replace: bool,
    /// Also register the robot's identity, and print the command with which the robot's machine enrols
    #[arg(long)]
    enrol: bool,
}

/// List the robots with their holders.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl robot list")]
pub(crate) struct List {}

/// Show one robot with its services, their settings and their holders.
///
/// With `-o json` it is the asset on the ledger. Its field `owner`, as in the paper, is the holder; `organisation` is the owner.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl robot show Turtlebot4")]
pub(crate) struct Show {
    /// Name of the robot
    name: String,
}

/// Remove a robot; its grants end. For admins of its owner.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl robot remove Husky")]
pub(crate) struct Remove {
    /// Name of the robot
    name: String,
}

/// The words of the command line where the chaincode has other names.
const WORDS: Words = Words {
    arguments: &[("NAME", "the name of the robot"), ("ROBOT", "the name of the robot")],
    help: "ledgerctl robot",
};

impl Robot {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        match self {
            Self::Add(add) => {
                let (name, replace, enrol) = (add.name.clone(), add.replace, add.enrol);
                let spec = session::argument(&add.into_spec()?)?;
                if replace {
                    change::replace(&session, &name, spec, output).await?;
                } else {
                    let done =
                        session.call(ABAC, "setup", vec![spec]).await.map_err(change::in_words_of_the_command_line)?;
                    let robots: Vec<RobotAsset> = answer::parse(&done.response, "robots")?;
                    for robot in &robots {
                        change::enter_readers(&session, robot, output).await?;
                    }
                    output.show(&Robots(robots, time::now()))?;
                }
                if enrol { output.show(&identity_of(&session, name).await?) } else { Ok(()) }
            }
            Self::Set(set) => set.run(&session, output).await,
            Self::List(_) => output.show(&Robots(session.list(ABAC, "robots").await?, time::now())),
            Self::Show(show) => {
                let response = session.ask(ABAC, "robot", vec![Bytes::from(show.name)]).await;
                let response = response.map_err(|refused| WORDS.told(refused))?;
                output.show(&show::Asset::new(answer::parse(&response, "a robot")?, time::now()))
            }
            Self::Remove(remove) => {
                let name = remove.name;
                let done = session.call(ABAC, "remove", vec![Bytes::from(name.clone())]).await;
                let done = done.map_err(|refused| WORDS.told(refused))?;
                output.show(&Removed { robot: name, released: answer::parse(&done.response, "ended grants")? })
            }
        }
    }
}

/// The identity of a robot that is registered: it has the robot's exact name.
async fn identity_of(session: &Session, name: String) -> Result<Invitation, Rejection> {
    let made = Invitation::make(session, name.clone(), (Role::Robot, false), BTreeMap::new(), SECRET_LIFE).await;
    made.map_err(|mut refused| {
        refused.message = format!("the robot is registered, but its identity is not: {}", refused.message);
        match refused.code {
            Code::AlreadyRegistered if refused.found.starts_with("role robot") => {
                refused.next(format!("create a new secret for it: ledgerctl identity register {name} --reissue"))
            }
            Code::AlreadyRegistered => refused,
            _ => refused.next(format!("try again: ledgerctl identity register {name} --role robot")),
        }
    })
}

impl Add {
    fn into_spec(self) -> Result<RobotSpec, Rejection> {
        let attributes = capability::attributes(&self.attributes).map_err(change::unreadable_attributes)?;
        Ok(RobotSpec {
            name: self.name,
            attribute_required: self.attr_required,
            trusted: (!self.trusted.is_empty()).then_some(self.trusted),
            services: with_replies(self.services),
            attributes: (!attributes.is_empty()).then_some(attributes),
            base: None,
        })
    }
}

/// The services, each that users call with the one for its replies, unless that is given.
pub(in crate::command) fn with_replies(given: Vec<ServiceSpec>) -> Vec<ServiceSpec> {
    let topics: Vec<String> = given.iter().map(|service| service.topic.clone()).collect();
    let replies = |service: &ServiceSpec| service.for_replies().filter(|replies| !topics.contains(&replies.topic));
    given
        .into_iter()
        .flat_map(|service| {
            let replies = replies(&service);
            std::iter::once(service).chain(replies)
        })
        .collect()
}

/// Robots, and the moment by which their leases are told.
struct Robots(Vec<RobotAsset>, u64);

impl Serialize for Robots {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(serializer)
    }
}

impl Facts for Robots {
    /// One row for each service.
    fn rows(&self) -> serde_json::Result<String> {
        serde_json::to_string(&self.0.iter().flat_map(|robot| &robot.services).collect::<Vec<_>>())
    }

    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.0.is_empty() {
            return writeln!(out, "no robot is registered");
        }
        let mut table =
            Table::new(["SERVICE", "TYPE", "RULE", "OWNER", "REQUIRES", "HOLDER", "EPOCH", "EXPIRES", "WAITING"]);
        for robot in &self.0 {
            for service in &robot.services {
                let expires =
                    if service.expires == 0 { String::new() } else { time::relative(service.expires, self.1) };
                table.row([
                    service.service.clone(),
                    service.type_name.clone(),
                    rule(service),
                    robot.organisation.clone(),
                    robot.attribute_required.clone(),
                    holders(robot, service),
                    service.epoch.to_string(),
                    expires,
                    if service.waiting == 0 { String::new() } else { service.waiting.to_string() },
                ]);
                if service.sharing.subscribers.is_some() {
                    let readers = if service.readers.is_empty() { "-".to_owned() } else { service.readers.join(", ") };
                    let mut cells = [const { String::new() }; 9];
                    cells[0] = ledger_contract::readers(&service.service);
                    cells[2] = rule(service);
                    cells[5] = readers;
                    table.row(cells);
                }
            }
        }
        table.write(out, 0)
    }
}

/// The mode of a service, and the treatment of a contender without a free place, if its owner has set one.
fn rule(service: &ServiceState) -> String {
    let on_conflict = service.sharing.on_conflict.as_ref().map(|on_conflict| format!(", {on_conflict}"));
    let confidential = if service.sharing.is_confidential() { ", confidential" } else { "" };
    format!("{}{}{confidential}", service.mode, on_conflict.unwrap_or_default())
}

/// The holders of a service; of a stopped robot, who stopped it.
fn holders(robot: &RobotAsset, service: &ServiceState) -> String {
    match &robot.stopped {
        Some(stop) if service.direction == Direction::Command => format!("stopped by {}", stop.by),
        _ if service.holders.is_empty() => "-".to_owned(),
        _ => service.holders.join(", "),
    }
}

#[derive(Serialize)]
struct Removed {
    robot: String,
    released: Vec<Released>,
}

impl Facts for Removed {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "removed {}", self.robot)?;
        for grant in &self.released {
            writeln!(out, "  ended the grant of {} by {} (epoch {})", grant.service, grant.holder, grant.epoch)?;
        }
        Ok(())
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    pub(super) const ASSET: &str = r#"{"Name":"Turtlebot4","SubTopic":"/cmd_vel","PubTopic":"","owner":"Org1/Salma",
        "UnderOp":true,"organisation":"Org2","attribute_required":"Turtlebot4=true","trusted":["Org1","Org2"],
        "services":[{"service":"Turtlebot4/cmd_vel","robot":"Turtlebot4","organisation":"Org2","topic":"/cmd_vel",
        "type":"geometry_msgs/msg/Twist","mode":"exclusive","direction":"command","max_age_ms":1000,"lease_ms":10000,
        "lease_ms_max":600000,"stop_hex":null,"holder":"Org1/Salma","holders":["Org1/Salma"],"epoch":3,
        "expires":11000000,
        "capabilities":{"fencing":"newest","publishing":"grant","sequence":"per_epoch"}}]}"#;

    fn text(facts: &impl Facts) -> String {
        let mut out = Vec::new();
        facts.text(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn a_service_or_an_action_of_ros_2_comes_with_one_for_its_replies() {
        let topics = |given: &[&str]| {
            let given = given.iter().map(|text| service::parse(text).unwrap()).collect();
            let services = with_replies(given).into_iter();
            services.map(|service| (service.topic, service.direction, service.max_age_ms)).collect::<Vec<_>>()
        };
        let light = || ("/light".to_owned(), Direction::Command, Some(500));
        let replies = |age| ("/light/_reply".to_owned(), Direction::Feed, age);
        let given = "/light=std_srvs/srv/SetBool,mode=exclusive,max-age=500ms";
        assert_eq!(topics(&[given]), [light(), replies(Some(500))]);
        let own = "/light/_reply=std_srvs/srv/SetBool,direction=feed";
        assert_eq!(topics(&[given, own]), [light(), replies(None)], "as the owner wants them");
        assert_eq!(topics(&["/navigate=nav2_msgs/action/NavigateToPose"]).len(), 2);
        assert_eq!(topics(&["/cmd_vel=geometry_msgs/msg/Twist"]).len(), 1);
    }

    #[test]
    fn the_list_says_who_holds_what_until_when() {
        let robots = Robots(vec![serde_json::from_str(ASSET).unwrap()], 1_000_000);
        let wanted = "\
SERVICE             TYPE                     RULE       OWNER  REQUIRES         HOLDER      EPOCH  EXPIRES  WAITING
Turtlebot4/cmd_vel  geometry_msgs/msg/Twist  exclusive  Org2   Turtlebot4=true  Org1/Salma  3      in 10 s
";
        assert_eq!(text(&robots), wanted);
        let json: serde_json::Value = serde_json::to_value(&robots).unwrap();
        assert_eq!(json.as_array().unwrap().len(), 1);
        for (on_conflict, rule) in [("queue", "  exclusive, queue  "), ("deny", "  exclusive, deny  ")] {
            let sharing = format!(r#""sharing":{{"on_conflict":"{on_conflict}"}},"holder":"#);
            let robots =
                Robots(vec![serde_json::from_str(&ASSET.replace(r#""holder":"#, &sharing)).unwrap()], 1_000_000);
            assert!(text(&robots).contains(rule), "{}", text(&robots));
        }
    }

    #[test]
    fn what_a_newer_node_tells_is_shown_as_it_came() {
        let (before, _) = ASSET.split_once(r#""capabilities":"#).unwrap();
        let newer = before.replace("exclusive", "limited") + r#""capabilities":{"places":"2"}}]}"#;
        let robots = Robots(vec![serde_json::from_str(&newer).unwrap()], 1_000_000);
        assert!(text(&robots).contains("  limited  "), "{}", text(&robots));
        let json = serde_json::to_string(&robots).unwrap();
        assert!(json.contains(r#""mode":"limited""#) && json.contains(r#""capabilities":{"places":"2"}"#), "{json}");
    }
}
