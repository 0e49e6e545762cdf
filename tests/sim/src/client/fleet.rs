//! The robots that everybody knows, and their services.

/// The services of the simulated robots.
pub const SERVICES: [&str; 3] = ["Turtlebot4/cmd_vel", "Husky/cmd_vel", "Husky/arm"];

/// The robots as their owner registers them.
pub fn robots(open: bool) -> [String; 2] {
    let service = |topic: &str, mode: &str| {
        format!(
            r#"{{"topic":"{topic}","type":"geometry_msgs/msg/Twist","mode":"{mode}","lease_ms":3000,"lease_ms_max":20000}}"#
        )
    };
    let robot = |name: &str, services: &str| {
        format!(
            r#"{{"name":"{name}","attribute_required":"{name}","trusted":["Org1","Org2"],"services":[{services}]}}"#
        )
    };
    let arm = service("/arm", if open { "open" } else { "exclusive" });
    [
        robot("Turtlebot4", &service("/cmd_vel", "exclusive")),
        robot("Husky", &format!("{},{arm}", service("/cmd_vel", "exclusive"))),
    ]
}
