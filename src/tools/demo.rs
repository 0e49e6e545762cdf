//! The paper's experiment, for real: two organisations with a node each, two users, one robot, ROS 2 messages over DDS.
//!
//! Its network, bridges and ROS 2 nodes are public for other experiments on them, such as `examples/arena`.

mod bridges;
mod graph;
mod measure;
mod messages;
mod network;
mod picture;
mod summary;
mod user;

pub use crate::process::terminal::{eprint_line, print_line, stop_signal};
pub use bridges::{Bridges, Plan, Route, domains};
pub use graph::{DISCOVERY_TIME_MAX, Publisher, Received, Robot, cmd_vel, failed, nobody_there};
pub use measure::{Percentiles, RosToRos};
pub use messages::{Command, Twist, read_twist, twist};
pub use network::Network;
pub use picture::{LINE_UP, is_coloured, is_seen};
pub use summary::{BridgeReport, failure};
pub use user::User;

use crate::tools::dev::paper_robots;
use bytes::Bytes;
use ledger_api::Client;
use ledger_base::rejection::{Code, Rejection};
use measure::Phase;
use picture::Picture;
use std::time::{Duration, Instant};
use summary::Summary;
use tokio::time::interval;

/// The rate of the paper's experiment.
const HZ: u32 = 50;
/// Time for messages that are under way when a phase ends.
pub const SETTLE: Duration = Duration::from_millis(500);
/// How long Salma publishes before the demo looks whether the robot has heard her.
const FIRST_TRY: Duration = Duration::from_millis(100);
/// The service in question.
pub const SERVICE: &str = "Turtlebot4/cmd_vel";
/// The commands of a user.
pub const TO_LEDGER: Route =
    Route { service: SERVICE, direction: "to_ledger", topic: "/cmd_vel", kind: "geometry_msgs/msg/Twist" };
/// The commands that reach the robot.
pub const FROM_LEDGER: Route = Route { direction: "from_ledger", ..TO_LEDGER };

/// `ledgerd demo`
#[derive(clap::Args)]
pub(crate) struct Options {
    /// Length of each of the two phases, in seconds.
    #[arg(long, value_name = "N", default_value_t = 15, value_parser = clap::value_parser!(u64).range(1..=3600))]
    seconds: u64,
    /// Print the result as one line of JSON, and nothing else on standard output.
    #[arg(long)]
    json: bool,
}

/// Plays the experiment; Ctrl-C ends everything that was started.
pub(crate) async fn run(options: Options) -> Result<(), Rejection> {
    let seconds = Duration::from_secs(options.seconds);
    // Dropping the experiment ends its processes and removes its directory.
    let played = tokio::select! {
        played = play(seconds) => played,
        () = stop_signal() => {
            Err(Rejection::new(Code::ShuttingDown, "interrupted; all started processes have been ended"))
        }
    };
    let summary = played.inspect_err(|rejection| {
        if options.json {
            // The exit code and standard error say it as well.
            let _lost = print_line(&failure(rejection));
        }
    })?;
    print_line(&if options.json { summary.json()? } else { summary.table() })?;
    summary.check()
}

async fn play(seconds: Duration) -> Result<Summary, Rejection> {
    let started = Instant::now();
    let say = |what: &str| {
        let stamp = format!("{:>5.1} s", started.elapsed().as_secs_f64());
        match is_coloured() {
            true => eprint_line(&format!("\x1b[2m{stamp}\x1b[0m  {what}")),
            false => eprint_line(&format!("{stamp}  {what}")),
        }
    };
    let mut summary = Summary::default();

    say("two organisations, each with its CA and its node process: Org1 orders, Org2 follows");
    let mut network = Network::start().await?;
    say("Org1 registers Salma (Turtlebot4, Husky) and Farhad (Turtlebot4); both enrol with their one-time secrets");
    let salma = network.enrol_user("Salma", &["Turtlebot4", "Husky"]).await?;
    let farhad = network.enrol_user("Farhad", &["Turtlebot4"]).await?;
    say("Org2's admin registers Turtlebot4, Husky and OptiTrack");
    set_up(&network.owner).await?;

    let refused = must_fail(acquire(&farhad, "Husky").await, Code::MissingAttribute, "Farhad acquired the Husky")?;
    say(&format!("Farhad tries to acquire the Husky and is denied: {}", refused.message));
    summary.refused(&refused);
    acquire(&salma, SERVICE).await?;
    say("Salma acquires the Turtlebot4");
    let refused =
        must_fail(acquire(&farhad, SERVICE).await, Code::Held, "Farhad acquired the Turtlebot4, which Salma holds")?;
    say(&format!("Farhad tries to acquire the Turtlebot4 and is rejected: {}", refused.message));
    summary.refused(&refused);

    say("three ROS 2 graphs start, each with a bridge to its organisation's node: Salma's, Farhad's, the robot's");
    let [of_salma, of_farhad, of_robot] = domains()?;
    let plan = |name, domain, direction| Plan { name, domain, routes: direction, via: None };
    network.start_bridges(&[
        plan("Salma", of_salma, &[TO_LEDGER]),
        plan("Farhad", of_farhad, &[TO_LEDGER]),
        plan("Turtlebot4", of_robot, &[FROM_LEDGER]),
    ])?;
    let mut robot = Robot::open(of_robot).await?;
    let mut salma_node = Publisher::open(of_salma, User::Salma).await?;
    let mut farhad_node = Publisher::open(of_farhad, User::Farhad).await?;
    tokio::try_join!(salma_node.matched(), farhad_node.matched(), robot.matched(), network.bridges.found())?;
    first_heard(&robot, &mut salma_node).await?;

    say(&format!(
        "exclusive: both publish Twist at {HZ} Hz on their own /cmd_vel for {} s; only Salma holds the robot",
        seconds.as_secs()
    ));
    let mut ros_to_ros = RosToRos::default();
    robot.take();
    let (first, times, _) = publish_both(&robot, &mut salma_node, &mut farhad_node, seconds).await?;
    let received = robot.take();
    ros_to_ros.add(User::Salma, first, &times, &received);
    summary.controlled = Phase::count(&received, seconds, Some(User::Farhad));
    network.check()?;

    say(&format!("open: the owner permits both to publish, for {} s (the paper's comparison)", seconds.as_secs()));
    set_mode(&network.owner, "open").await?;
    robot.take();
    let first_farhad = farhad_node.next_number();
    let (first, times, times_farhad) = publish_both(&robot, &mut salma_node, &mut farhad_node, seconds).await?;
    let received = robot.take();
    ros_to_ros.add(User::Salma, first, &times, &received);
    ros_to_ros.add(User::Farhad, first_farhad, &times_farhad, &received);
    summary.open = Phase::count(&received, seconds, None);
    network.check()?;

    say("exclusive again: Salma acquires the robot, releases it (the robot gets a stop message), Farhad acquires it");
    set_mode(&network.owner, "exclusive").await?;
    acquire(&salma, SERVICE).await?;
    robot.take();
    salma.invoke("abac", "release", vec![SERVICE.into()]).await?;
    summary.stopped = wait_for(&robot, |message| message.operator.is_none()).await;
    acquire(&farhad, SERVICE).await?;
    summary.handed_over = hand_over(&robot, &mut farhad_node).await?;
    summary.ros_to_ros_ms = ros_to_ros.percentiles();

    say("collecting the counters of bridges and nodes");
    network.report(&mut summary).await?;
    network.stop().await?;
    say("cleaned up");
    Ok(summary)
}

/// The owner registers the paper's robots.
pub async fn set_up(owner: &Client) -> Result<(), Rejection> {
    let specs = paper_robots("exclusive").into_iter().map(|(_, spec)| Bytes::from(spec.to_string())).collect();
    owner.invoke("abac", "setup", specs).await.map(drop)
}

/// The owner changes how many may drive the robot.
async fn set_mode(owner: &Client, mode: &str) -> Result<(), Rejection> {
    let settings = serde_json::json!({ "mode": mode }).to_string();
    owner.invoke("abac", "configure", vec![SERVICE.into(), settings.into()]).await.map(drop)
}

/// Acquires a service or robot for a user.
pub async fn acquire(user: &Client, service: &str) -> Result<(), Rejection> {
    let args = vec![Bytes::copy_from_slice(service.as_bytes())];
    user.invoke("abac", "acquire", args).await.map(drop)
}

/// A call that must be refused, with its code.
pub fn must_fail(outcome: Result<(), Rejection>, code: Code, otherwise: &str) -> Result<Rejection, Rejection> {
    match outcome {
        Err(rejection) if rejection.code == code => Ok(rejection),
        Err(other) => Err(other),
        Ok(()) => Err(Rejection::new(Code::Internal, otherwise).wanted(format!("a refusal with {code}"))),
    }
}

/// Both publish at once, and it is drawn. Answers with Salma's first number, and when each message of either was
/// published.
async fn publish_both(
    robot: &Robot,
    salma: &mut Publisher,
    farhad: &mut Publisher,
    how_long: Duration,
) -> Result<(usize, Vec<Instant>, Vec<Instant>), Rejection> {
    let first = salma.next_number();
    let mut picture = Picture::new(robot, [salma.published(), farhad.published()]);
    let mut published =
        std::pin::pin!(async { tokio::try_join!(salma.publish(HZ, how_long), farhad.publish(HZ, how_long)) });
    let mut frames = interval(picture::EVERY);
    let (times, times_farhad) = loop {
        tokio::select! {
            done = &mut published => break done?,
            _ = frames.tick() => picture.draw(),
        }
    };
    tokio::time::sleep(SETTLE).await;
    Ok((first, times, times_farhad))
}

/// Salma publishes until the robot hears her: rates are counted from then on, not from somewhere in DDS discovery.
pub async fn first_heard(robot: &Robot, salma: &mut Publisher) -> Result<(), Rejection> {
    let deadline = Instant::now() + DISCOVERY_TIME_MAX;
    while robot.received_from(User::Salma) == 0 {
        if Instant::now() > deadline {
            return Err(nobody_there("the robot"));
        }
        salma.publish(HZ, FIRST_TRY).await?;
    }
    tokio::time::sleep(SETTLE).await;
    Ok(())
}

/// Farhad publishes until the robot hears him.
async fn hand_over(robot: &Robot, farhad: &mut Publisher) -> Result<bool, Rejection> {
    robot.take();
    farhad.publish(HZ, Duration::from_secs(1)).await?;
    Ok(wait_for(robot, |message| message.operator == Some(User::Farhad)).await)
}

/// Waits a moment for a message of some kind.
async fn wait_for(robot: &Robot, wanted: impl Fn(&Received) -> bool) -> bool {
    let deadline = Instant::now() + Duration::from_secs(3);
    while Instant::now() < deadline {
        if robot.take().iter().any(&wanted) {
            return true;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    false
}
