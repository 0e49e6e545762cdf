//! The guarded topics, services and actions of a robot: a bridge delivers commands there, and nobody else in the local graph should.

use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Direction, RobotAsset, ServiceState};

use crate::{
    graph::names::{Interface, TopicName},
    routes::{discovery, kind::RouteConfig},
};

/// A topic, a service or an action of the robot's graph on which a bridge delivers commands.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Guarded {
    /// Its local name.
    pub name: TopicName,
    /// The way in which nodes use it.
    pub interface: Interface,
    /// The service on the ledger, e.g. `Turtlebot4/cmd_vel`.
    pub service: String,
}

/// All that a bridge with these routes guards, given the robots on the ledger; each once.
///
/// # Errors
/// [`Code::UnknownService`] if a route is set for a service that no robot offers; [`Code::BadName`] if the topic of one
/// is no name of ROS 2.
pub(super) fn all(
    set: &[RouteConfig],
    discover: Option<&discovery::Settings>,
    robots: &[RobotAsset],
) -> Result<Vec<Guarded>, Rejection> {
    let discovered = discover.into_iter().flat_map(|settings| discovery::offered(settings, robots));
    let is_set = |route: &RouteConfig| set.iter().any(|own| own.service == route.service);
    let routes: Vec<RouteConfig> = discovered.filter(|route| !is_set(route)).collect();
    let delivering = set.iter().chain(&routes).filter(|route| !route.kind.takes_in());
    let mut found = Vec::new();
    for route in delivering {
        let service = robots.iter().flat_map(|robot| &robot.services).find(|of| of.service == route.service);
        let service = service.ok_or_else(|| unknown(route))?;
        if service.direction.known() == Some(Direction::Command) {
            found.push(guarded(route, service)?);
        }
    }
    found.sort();
    found.dedup();
    Ok(found)
}

fn guarded(route: &RouteConfig, service: &ServiceState) -> Result<Guarded, Rejection> {
    let name = route.topic.clone().map_or_else(|| TopicName::parse(&service.topic), Ok)?;
    Ok(Guarded { name, interface: route.message.interface(), service: route.service.clone() })
}

fn unknown(route: &RouteConfig) -> Rejection {
    Rejection::new(Code::UnknownService, format!("{} is a service of no robot", route.service))
        .found("a route of the configuration")
        .wanted("a service that a robot on the ledger offers")
        .next("ledgerctl robot list shows them")
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::path::Path;

    use serde_json::json;

    use super::*;
    use crate::config::Config;

    /// A robot with a command, a feed, a service and an action.
    fn rover() -> RobotAsset {
        let service = |topic: &str, of: &str, direction: &str| {
            json!({
                "service": format!("Rover{topic}"), "robot": "Rover", "organisation": "Org2", "topic": topic, "type": of,
                "mode": "exclusive", "direction": direction, "max_age_ms": 300, "lease_ms": 10_000, "lease_ms_max": 60_000,
                "stop_hex": null, "holder": "", "holders": [], "epoch": 0, "expires": 0,
                "capabilities": { "fencing": "newest", "publishing": "grant", "sequence": "per_epoch" }
            })
        };
        let services = [
            service("/cmd_vel", "geometry_msgs/msg/Twist", "command"),
            service("/odom", "nav_msgs/msg/Odometry", "feed"),
            service("/light", "std_srvs/srv/SetBool", "command"),
            service("/light/_reply", "std_srvs/srv/SetBool", "feed"),
            service("/go", "nav2_msgs/action/NavigateToPose", "command"),
        ];
        let robot = json!({
            "Name": "Rover", "SubTopic": "", "PubTopic": "", "owner": "", "UnderOp": false, "organisation": "Org2",
            "attribute_required": "Rover", "trusted": [], "services": services
        });
        serde_json::from_value(robot).unwrap()
    }

    fn names(text: &str) -> Result<Vec<String>, Rejection> {
        let config = Config::parse(text, Path::new("bridge.toml"), |_| ()).unwrap();
        let guarded = config.guarded(&[rover()])?;
        Ok(guarded.into_iter().map(|one| format!("{} {}", one.interface.name(), one.name)).collect())
    }

    #[test]
    fn the_doors_of_a_discovering_bridge_are_the_commands_services_and_actions_of_its_robot() {
        let all = ["msg /cmd_vel", "action /go", "srv /light"];
        assert_eq!(names("[discover]\nrobot = 'Rover'").unwrap(), all);
        let some = "[discover]\nrobot = 'Rover'\nnamespace = '/r'\ndeny = { action_client = ['.*'] }";
        assert_eq!(names(some).unwrap(), ["msg /r/cmd_vel", "srv /r/light"]);
        assert_eq!(names("[discover]").unwrap(), [""; 0], "on a user's side nobody moves by it");
    }

    #[test]
    fn a_set_route_guards_its_own_topic_else_the_services_and_counts_before_a_discovered_one() {
        let route = |of: &str| format!("[[route]]\nservice = 'Rover/cmd_vel'\ntype = 'geometry_msgs/msg/Twist'\n{of}");
        assert_eq!(names(&route("direction = 'from_ledger'")).unwrap(), ["msg /cmd_vel"]);
        let other = route("direction = 'from_ledger'\ntopic = '/base/drive'");
        assert_eq!(names(&other).unwrap(), ["msg /base/drive"]);
        let both =
            format!("{other}\n[discover]\nrobot = 'Rover'\nallow = {{ service_client = [], action_client = [] }}");
        assert_eq!(names(&both).unwrap(), ["msg /base/drive"]);
        assert_eq!(names(&route("direction = 'to_ledger'")).unwrap(), [""; 0]);
    }

    #[test]
    fn a_route_to_a_service_of_no_robot_is_refused() {
        let route = "[[route]]\nservice = 'Rover/arm'\ntype = 'geometry_msgs/msg/Twist'\ndirection = 'from_ledger'";
        assert_eq!(names(route).unwrap_err().code, Code::UnknownService);
    }
}
