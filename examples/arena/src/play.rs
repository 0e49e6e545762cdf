//! The paper's experiment with a robot that moves. Real nodes, bridges and DDS; the robot, the cameras
//! and the controllers are simulated ([`crate::model`]). docs/arena.md describes model, runs and numbers.

mod driver;
mod output;
mod poses;
mod rates;
mod run;
mod stage;
mod turtlebot;
mod wire;

use crate::model::claims::{Claim, Runs, judge};
use crate::model::course::{Course, SCALE_MIN, User};
use crate::model::link::Link;
use crate::model::record::Record;
use crate::picture::Rate;
use ledger_api::{Client, Subscription};
use ledger_base::rejection::{Code, Rejection};
use ledgerd::demo::{LINE_UP, Network, Route, failure, is_coloured, is_seen, must_fail, set_up};
use ledgerd::demo::{eprint_line, print_line, stop_signal};
use output::Results;
use run::Kind;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// The poses of the cameras.
const POSES: Route = Route {
    service: "OptiTrack/poses",
    direction: "to_ledger",
    topic: "/poses",
    kind: "geometry_msgs/msg/PoseStamped",
};

/// Plays the paper's experiment with a simulated Turtlebot4 in four runs, and draws it: real nodes, bridges and DDS.
#[derive(clap::Parser)]
#[command(name = "arena", version)]
pub(crate) struct Options {
    /// The directory for the pictures, the page and the numbers.
    #[arg(long, value_name = "DIR", default_value = "arena")]
    out: PathBuf,
    /// Open the page in the browser at the end.
    #[arg(long)]
    open: bool,
    /// Print the result as one line of JSON, and nothing else on standard output.
    #[arg(long)]
    json: bool,
    /// The seed of all random numbers: tyres, cameras, the link.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// The link of the fourth run: the paper's delays, or a Wi-Fi of today.
    #[arg(long, value_enum, default_value_t = LinkName::Paper)]
    link: LinkName,
    /// Size of the course, 0.3 to 1: a smaller one is driven sooner.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = scale)]
    scale: f64,
}

/// The links to choose from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum LinkName {
    /// A pose reaches the controller almost 300 ms later.
    Paper,
    /// Some milliseconds, one segment of a hundred lost.
    Wifi,
}

impl LinkName {
    fn link(self) -> Link {
        match self {
            Self::Paper => Link::PAPER,
            Self::Wifi => Link::WIFI,
        }
    }

    fn described(self) -> String {
        let Link { delay, jitter, loss } = self.link();
        format!(
            "{:.0} ms and {:.0} ms of jitter each way between every bridge and its node, {:.1} % of the segments lost",
            delay * 1e3,
            jitter * 1e3,
            loss * 1e2
        )
    }
}

fn scale(text: &str) -> Result<f64, String> {
    let scale: f64 = text.parse().map_err(|_| format!("{text:?} is no number"))?;
    let within = (SCALE_MIN..=1.0).contains(&scale);
    if within { Ok(scale) } else { Err(format!("{scale} is not within {SCALE_MIN} and 1")) }
}

/// The setting of all runs.
#[derive(Clone, Copy)]
struct Setting {
    course: Course,
    seed: u64,
}

/// The users' clients.
struct Cast {
    salma: Client,
    farhad: Client,
}

impl Cast {
    fn client(&self, user: User) -> &Client {
        match user {
            User::Salma => &self.salma,
            User::Farhad => &self.farhad,
        }
    }
}

/// Everything that was measured.
struct Played {
    records: Runs<Record>,
    rates: Vec<Rate>,
    /// How somebody without the attribute of the cameras was refused.
    reader_refused: String,
}

/// Plays it; Ctrl-C ends everything that was started.
pub(crate) async fn run(options: Options) -> Result<(), Rejection> {
    let output = Results::open(&options.out)?;
    let setting = Setting { course: Course::new(options.scale), seed: options.seed };
    // Dropping the experiment ends its processes and removes its directory.
    let played = tokio::select! {
        played = play(setting, options.link) => played,
        () = stop_signal() => {
            Err(Rejection::new(Code::ShuttingDown, "interrupted; everything that was started has been ended"))
        }
    };
    let played = played.inspect_err(|rejection| {
        if options.json {
            // The exit code and standard error say it as well.
            let _lost = print_line(&failure(rejection));
        }
    })?;
    let figures = played.records.figures();
    let claims = judge(&figures);
    let written = output.write(&options, &played, &figures, &claims)?;
    print_line(&if options.json { written.json } else { written.table })?;
    if options.open {
        output.show();
    }
    check(&claims)
}

/// Fails with every claim that does not hold.
fn check(claims: &[Claim]) -> Result<(), Rejection> {
    let broken: Vec<_> = claims.iter().filter(|claim| !claim.held).collect();
    if broken.is_empty() {
        return Ok(());
    }
    let all = |text: fn(&Claim) -> String| broken.iter().map(|claim| text(claim)).collect::<Vec<_>>().join(" · ");
    Err(Rejection::new(Code::Internal, format!("{} of {} claims do not hold", broken.len(), claims.len()))
        .found(all(|claim| claim.found.clone()))
        .wanted(all(|claim| claim.claim.to_owned()))
        .next("look at the page in the directory of --out; a busy machine may need another try"))
}

async fn play(setting: Setting, link: LinkName) -> Result<Played, Rejection> {
    let tell = Tell::new();
    tell.say("two organisations, each with its CA and its node process: Org1 orders, Org2 follows");
    let mut network = Network::start().await?;
    tell.say(
        "Salma and Farhad of Org1 enrol: both may drive the Turtlebot4 and read the cameras; Farhad has more priority",
    );
    let cast = Cast {
        salma: network.enrol_user("Salma", &["Turtlebot4", "OptiTrack", "rank=1"]).await?,
        farhad: network.enrol_user("Farhad", &["Turtlebot4", "OptiTrack", "rank=2"]).await?,
    };
    set_up(&network.owner).await?;
    let visitor = network.enrol_user("Visitor", &["Turtlebot4"]).await?;
    let refused = refused_reader(&visitor).await?;
    tell.say(&format!("a visitor asks for the poses of the cameras and is refused: {refused}"));

    tell.say("1 of 4: with access control, the tasks one after the other");
    let controlled = run::play(&mut network, &cast, Kind::Controlled, setting, &tell).await?;
    tell.say("2 of 4: without access control: both may drive");
    let open = run::play(&mut network, &cast, Kind::Open, setting, &tell).await?;
    tell.say("3 of 4: preemption by priority, and an emergency stop");
    let preempted = run::play(&mut network, &cast, Kind::Preempted, setting, &tell).await?;
    tell.say(&format!("4 of 4: as the first, over a link: {}", link.described()));
    let delayed = run::play(&mut network, &cast, Kind::Delayed(link.link()), setting, &tell).await?;
    tell.say("latency against frequency, from ROS 2 to ROS 2");
    let rates = rates::measure(&mut network, &cast, setting, &tell).await?;
    network.stop().await?;
    tell.say("everything is cleaned up");
    Ok(Played { records: Runs { controlled, open, preempted, delayed }, rates, reader_refused: refused })
}

/// Somebody without the attribute subscribes to the poses.
async fn refused_reader(visitor: &Client) -> Result<String, Rejection> {
    let wanted = Subscription {
        chaincode: "abac".into(),
        subjects: vec![POSES.service.into()],
        names: vec!["message".into()],
        ..Subscription::default()
    };
    let opened = visitor.subscribe(wanted).open().await;
    must_fail(opened, Code::MissingAttribute, "somebody without the attribute reads the poses of the cameras")
        .map(|rejection| rejection.message)
}

/// Tells the story on standard error.
struct Tell {
    started: Instant,
    /// Does the last line stand for the moment, to be drawn over?
    is_drawn: AtomicBool,
}

impl Tell {
    fn new() -> Self {
        Self { started: Instant::now(), is_drawn: AtomicBool::new(false) }
    }

    /// A line that stays.
    fn say(&self, what: &str) {
        let stamp = format!("{:>5.1} s", self.started.elapsed().as_secs_f64());
        let up = if self.is_drawn.swap(false, Ordering::Relaxed) { LINE_UP } else { "" };
        match is_coloured() {
            true => eprint_line(&format!("{up}\x1b[2m{stamp}\x1b[0m  {what}")),
            false => eprint_line(&format!("{up}{stamp}  {what}")),
        }
    }

    /// A line for the moment, if somebody looks.
    fn show(&self, what: &str) {
        if is_seen() {
            let up = if self.is_drawn.swap(true, Ordering::Relaxed) { LINE_UP } else { "" };
            eprint_line(&format!("{up}         {what}"));
        }
    }
}
