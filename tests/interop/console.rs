//! The console in a real Chromium, while a robot is driven: `console/tests/browser.mjs` is the person in front of it.

use crate::python::Python;
use crate::support::network::now;
use crate::support::{Ctl, programs};
use crate::world::{World, run};
use crate::{call, network, stop_message};
use std::process::Command;

/// The lines until this one.
fn until(browser: &mut Python, line: &str) -> Vec<String> {
    let mut said = Vec::new();
    loop {
        let next = browser.line().unwrap_or_else(|| panic!("the browser never said {line:?}, but {said:#?}"));
        println!("browser: {next}");
        let (is_last, failed) = (next.starts_with(line), next.starts_with("failed"));
        said.push(next);
        assert!(!failed, "{said:#?} {:#?}", std::iter::from_fn(|| browser.line()).collect::<Vec<_>>());
        if is_last {
            return said;
        }
    }
}

#[test]
fn a_person_watches_and_stops_a_robot_in_a_browser_and_everybody_can_use_every_page() {
    if !network::isolated(&|| ()) {
        return;
    }
    run(async {
        let world = World::start("/cmd_vel", "geometry_msgs/msg/Twist").await;
        let ctl = Ctl::at(&world.path("home"));
        let owner = ctl.as_("dev-org2-admin").json(&["console"]);
        let member = ctl.as_("dev-org1-admin").json(&["console", "Tablet"]);
        let _bridges = world.start_bridges("/cmd_vel", "geometry_msgs/msg/Twist");
        let mut robot = Python::start("twist_subscriber.py", &["3", "rt/cmd_vel", "0", "0", "0", "600"]);
        assert_eq!((robot.line().unwrap(), robot.line().unwrap()), ("ready".to_owned(), "matched".to_owned()));

        let mut command = Command::new("node");
        command.current_dir(programs::repository().join("console")).arg("tests/browser.mjs");
        command.args([owner["link"].as_str().unwrap(), member["link"].as_str().unwrap()]);
        command.args(std::env::var_os("LEDGERD_TEST_SCREENSHOTS"));
        let mut browser = Python::run(command);
        until(&mut browser, "wants grant");
        call(&world.salma, "acquire", &["Rover/cmd_vel", "600000"]).await;
        until(&mut browser, "wants driving");
        // It drives until the robot is stopped.
        let _driver = Python::start("twist_publisher.py", &["1", "rt/cmd_vel", "6000", "20", "0", "1000"]);
        until(&mut browser, "stopped");
        let heard = |robot: &mut Python| std::iter::from_fn(|| robot.line()).any(|line| line == stop_message());
        assert!(heard(&mut robot), "the robot's topic never showed the stop message\n{}", world.logs());
        until(&mut browser, "resumed");
        until(&mut browser, "wants task");
        let (soon, later) = (now() + 3_600_000_000, now() + 7_200_000_000);
        let points = r#"[{"x_um":0,"y_um":0},{"x_um":1000000,"y_um":0}]"#;
        let task = format!(r#"{{"points":{points},"not_before":{soon},"deadline":{later}}}"#);
        call(&world.salma, "submit", &["Rover/cmd_vel", &task]).await;
        until(&mut browser, "wants policy");
        let owner = ctl.as_("dev-org2-admin");
        let built_in = owner.json(&["policy", "show", "default"]);
        owner.run(&["policy", "put", "default", built_in["text"].as_str().unwrap()]).ok();
        let weekend = r#"forbid (principal == User::"Org1/Mallory", action == Action::"acquire", resource);"#;
        owner.run(&["policy", "put", "weekend", weekend, "--expect", "Org1/Mallory"]).ok();
        until(&mut browser, "done");
        assert!(browser.finish());
    });
}
