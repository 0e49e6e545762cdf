//! Tasks, as people use them: with `ledgerctl` and a real node.

use crate::support::{Ctl, Dev, eventually};
use serde_json::Value;

fn state(ctl: &Ctl, id: &str) -> String {
    ctl.json(&["task", "show", id])["state"].as_str().unwrap().to_owned()
}

#[test]
fn tasks_of_two_users_run_one_after_the_other() {
    let mut dev = Dev::start();
    let [salma, farhad] = ["Salma", "Farhad"].map(|name| dev.user(name, &["Turtlebot4"], "ed25519"));
    dev.owner().run(&["robot", "set", "Turtlebot4/cmd_vel", "on-conflict=queue", "lease=10m"]).ok();
    let submit = ["task", "submit", "Turtlebot4", "--points"];
    salma.run(&[&submit[..], &["nan,0"]].concat()).refused(64, &["x \"nan\" is not finite", "x,y,yaw"]);
    assert!(salma.run(&["task", "list"]).ok().stdout.contains("there are no tasks"));

    let first = salma.json(&[&submit[..], &["1,0;1,-2.5,1.570796", "--deadline", "1h"]].concat());
    assert_eq!((&first["task"]["id"], &first["task"]["state"]), (&1.into(), &"running".into()), "{first}");
    assert_eq!(first["grant"]["task"], 1, "{first}");
    let point = &first["task"]["points"][1];
    assert_eq!((&point["y_um"], &point["yaw_urad"]), (&(-2_500_000).into(), &1_570_796.into()));
    let told = farhad.run(&[&submit[..], &["-1,0.000001", "--service", "cmd_vel"]].concat()).ok().stdout;
    for part in ["task 2 for Turtlebot4/cmd_vel is waiting", "position  1", "ledgerctl task cancel 2"] {
        assert!(told.contains(part), "{part:?} in {told}");
    }
    let queue = salma.run(&["queue", "Turtlebot4"]).ok().stdout;
    assert!(queue.contains("Org1/Salma (task 1)") && queue.contains("Org1/Farhad (task 2)"), "{queue}");

    farhad.run(&["task", "progress", "1", "1"]).refused(2, &["may not report on task 1", "Org1/Salma"]);
    farhad.run(&["task", "progress", "2", "1"]).refused(3, &["task 2 is not running"]);
    let half = salma.run(&["task", "progress", "1", "1"]).ok().stdout;
    assert!(half.contains("task 1 for Turtlebot4/cmd_vel is running; 1 of 2 points reached"), "{half}");
    salma.run(&["task", "progress", "1", "3"]).refused(3, &["the point is not usable", "1 to 2"]);
    assert_eq!(salma.json(&["task", "progress", "1", "2"])["state"], "done");
    eventually("the second task runs", || (state(&farhad, "2") == "running").then_some(()));
    farhad.run(&["task", "progress", "2", "1"]).ok();

    let third = farhad.json(&[&submit[..], &["0,0", "--not-before", "1h"]].concat());
    assert_eq!(third["task"]["state"], "scheduled", "{third}");
    salma.run(&["task", "cancel", "3"]).refused(2, &["may not cancel task 3", "Org1/Farhad"]);
    farhad.run(&["task", "cancel", "3"]).ok();
    farhad.run(&[&submit[..], &["0,0"]].concat()).ok();
    farhad.run(&["task", "fail", "4", "--reason", "the door is locked"]).ok();
    let shown = salma.run(&["task", "show", "4"]).ok().stdout;
    for part in ["is failed", "submitter  Org1/Farhad", "0 of 1", "the door is locked"] {
        assert!(shown.contains(part), "{part:?} in {shown}");
    }
    let listed = salma.json(&["task", "list"]);
    let states: Vec<&Value> = listed.as_array().unwrap().iter().map(|task| &task["state"]).collect();
    assert_eq!(states, ["done", "done", "cancelled", "failed"], "{listed}");
    salma.run(&["task", "show", "9"]).refused(3, &["there is no task 9", "ledgerctl task list"]);
    dev.process.check();
    dev.process.interrupt();
}
