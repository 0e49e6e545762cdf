//! Latched topics, such as `/tf_static`: who comes late hears what several publishers said before. CycloneDDS is at both ends.

use crate::python::Python;
use crate::sharing::owner_of;
use crate::world::{self, World};
use crate::{call, network};
use std::collections::BTreeSet;
use std::time::{Duration, Instant};

const TYPE: &str = "geometry_msgs/msg/Twist";

fn bridge(domain: u16, direction: &str) -> String {
    format!(
        "domain_id = {domain}\nshared_memory = false\n[[route]]\nservice = 'Rover/static'\ndirection = '{direction}'\n\
         type = '{TYPE}'\n"
    )
}

/// Hears until it has heard all of them, whatever comes twice.
fn hears(world: &World, domain: &str, wanted: &BTreeSet<String>) -> Python {
    let mut listener = Python::start("latched.py", &["hear", domain, "rt/static"]);
    let mut heard = BTreeSet::new();
    while !heard.is_superset(wanted) {
        let line = listener.line().unwrap_or_else(|| panic!("only {heard:?} of {wanted:?}\n{}", world.logs()));
        assert!(wanted.contains(&line), "{line} is of nobody in {wanted:?}");
        heard.insert(line);
    }
    listener
}

/// Waits until the last call of the robot's bridge has so many messages.
async fn is_said(world: &World, count: u64) {
    let deadline = Instant::now() + Duration::from_secs(60);
    loop {
        let answer = world.farhad.query("abac", "latest", vec!["Rover/static".into()]).await.unwrap();
        let latest: serde_json::Value = serde_json::from_slice(&answer.response).unwrap();
        if latest[0]["count"] == count {
            return;
        }
        assert!(Instant::now() < deadline, "{latest}\n{}", world.logs());
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[test]
fn a_bridge_that_starts_later_than_the_robots_gets_what_several_latched_publishers_said() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/static", TYPE).await;
        let owner = owner_of(&world).await;
        call(&owner, "configure", &["Rover/static", r#"{"direction":"feed","mode":"open","max_age_ms":1000}"#]).await;
        let mut talkers = ["1", "2"].map(|number| Python::start("latched.py", &["say", "3", "rt/static", number]));
        let mut said: BTreeSet<String> = talkers.each_mut().map(|talker| talker.line().unwrap()).into();
        let rover = world.start_bridge_as("Rover", &bridge(3, "to_ledger"), &[]);
        world.line("Rover", &["reliable, transient_local: as the others on /static"]).await;
        is_said(&world, 2).await;
        // Older than any message that may be news.
        tokio::time::sleep(Duration::from_secs(2)).await;

        let _salma = world.start_bridge_as("Salma", &bridge(1, "from_ledger"), &[]);
        let first = hears(&world, "1", &said);
        // One more, also for those who listen already.
        let mut third = Python::start("latched.py", &["say", "3", "rt/static", "3"]);
        said.insert(third.line().unwrap());
        hears(&world, "1", &said);
        drop(first);

        // The robot's bridge is gone, and another user's comes.
        let report = rover.report();
        assert_eq!(report["routes"][0]["refused"], serde_json::json!({}), "{report}");
        let settings = "domain_id = 2\nshared_memory = false\n[discover]\nremap = { 'Rover/static' = '/static' }\n";
        let _farhad = world.start_bridge_as("Farhad", settings, &[]);
        hears(&world, "2", &said);
    });
}
