//! How often a node wakes processors. Counted by the kernel, so nothing here depends on how fast the machine is.

use crate::support::network::{SERVICE, register_robots};
use crate::support::{Fleet, Process, connect, eventually};
use ledger_identity::Role;
use std::collections::BTreeMap;
use std::fs;
use std::io::Read;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Requests that are refused: as many as a flood sends in a second.
const REFUSED: usize = 500;
/// How long an idle node is watched. A slow machine makes it longer, which the count allows for.
const IDLE: Duration = Duration::from_secs(5);
/// How many times it is watched at most. A time without a disturbance shows that it rests.
const WINDOWS: usize = 5;
/// As often as a single loop that looks every 20 ms would wake a node, in a second. The timers of all threads together make
/// about 20.
const POLLS: f64 = 50.0;
/// How long a node has for what it was given before.
const SETTLE: Duration = Duration::from_secs(3);

/// How often each thread of this name, of all names if none is given, has waited since it started. A thread that waits has
/// been woken before, so this counts wake-ups.
fn waits(process: &Process, name: Option<&str>) -> BTreeMap<PathBuf, u64> {
    let tasks = fs::read_dir(format!("/proc/{}/task", process.id())).unwrap().map(|task| task.unwrap().path());
    let of_name = tasks.filter(|task| {
        name.is_none_or(|name| fs::read_to_string(task.join("comm")).is_ok_and(|comm| comm.trim_end() == name))
    });
    let count = of_name.filter_map(|task| {
        let status = fs::read_to_string(task.join("status")).ok()?;
        let line = status.lines().find_map(|line| line.strip_prefix("voluntary_ctxt_switches:"))?;
        Some((task, line.trim().parse::<u64>().unwrap()))
    });
    count.collect()
}

/// How often a node wakes in a second, now. A thread that has ended meanwhile takes nothing away from the others.
async fn wakes_per_second(node: &Process) -> f64 {
    let (start, before) = (Instant::now(), waits(node, None));
    tokio::time::sleep(IDLE).await;
    let (after, seconds) = (waits(node, None), start.elapsed().as_secs_f64());
    let woken = |(task, count): (&PathBuf, &u64)| count.saturating_sub(before.get(task).copied().unwrap_or(0));
    after.iter().map(woken).sum::<u64>() as f64 / seconds
}

/// The kernel's device for the longest time that waking up may take.
const DEVICE: &str = "/dev/cpu_dma_latency";

/// Does anybody on this machine wish that no processor sleeps? None if this process may not ask.
fn kept_awake() -> Option<bool> {
    let mut latency = [0; 4];
    let mut device = fs::File::open(DEVICE).ok()?;
    device.read_exact(&mut latency).unwrap();
    Some(i32::from_ne_bytes(latency) == 0)
}

#[tokio::test]
async fn refused_requests_keep_no_processor_awake_and_an_admitted_one_does() {
    let fleet = Fleet::found(1);
    let (owner, salma) = (fleet.owner(), fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]));
    let mallory = fleet.issue("Org1", "Mallory", Role::Member, &[]);
    fleet.nodes[0].configure("profile = \"low-latency\"");
    let node = fleet.nodes[0].start();
    register_robots(&connect(&owner).await, "exclusive").await;
    let (salma, mallory) = (connect(&salma).await, connect(&mallory).await);
    let acquire = || vec![SERVICE.into(), "600000".into()];

    if kept_awake().is_none() {
        // A machine without the device, or a user that may not open it: the node says so and serves all the same.
        assert!(node.stderr().contains(DEVICE), "{}", node.stderr());
        salma.invoke("abac", "acquire", acquire()).await.unwrap();
        return;
    }
    eventually("the processors rest", || (kept_awake() == Some(false)).then_some(()));
    for _ in 0..REFUSED {
        mallory.invoke("abac", "acquire", acquire()).await.unwrap_err();
    }
    assert_eq!(kept_awake(), Some(false), "what is refused keeps nothing awake");
    salma.invoke("abac", "acquire", acquire()).await.unwrap();
    assert_eq!(kept_awake(), Some(true), "what is admitted does");
    eventually("the processors rest again", || (kept_awake() == Some(false)).then_some(()));
}

#[tokio::test]
async fn a_node_with_the_balanced_profile_keeps_no_processor_awake() {
    let fleet = Fleet::found(1);
    let owner = fleet.owner();
    let node = fleet.nodes[0].start();
    register_robots(&connect(&owner).await, "exclusive").await;
    assert_eq!(waits(&node, Some("awake")).values().sum::<u64>(), 0);
}

#[tokio::test]
async fn an_idle_node_waits_instead_of_polling() {
    let fleet = Fleet::found(1);
    let owner = fleet.owner();
    let node = fleet.nodes[0].start();
    register_robots(&connect(&owner).await, "exclusive").await;
    // What was begun is finished: the state is stored, the log is zeroed ahead, the connection is closed.
    tokio::time::sleep(SETTLE).await;
    let mut rate = f64::INFINITY;
    for _ in 0..WINDOWS {
        rate = wakes_per_second(&node).await;
        println!("power: an idle node wakes {rate:.1} times a second");
        if rate < POLLS {
            break;
        }
    }
    assert!(rate < POLLS, "{rate} times a second");
}
