//! `record`: write the messages of services into a file, from the past, as they come, or both.

mod selection;
mod summary;
mod taking;
mod window;

use crate::answer;
use crate::argument::message::Definitions;
use crate::argument::moment::Moment;
use crate::command::message::{Opening, Place};
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Format, Output};
use crate::recording::{self, Recording};
use crate::session::{ABAC, Session};
use bytes::Bytes;
use ledger_api::{EventStream, Subscription};
use ledger_base::progress::{Progress, Step};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::Grant;
use selection::Selection;
use std::path::{Path, PathBuf};
use std::time::Duration;
use summary::{Counts, Ending, size};
use taking::Taking;
use tokio::signal::unix::{SignalKind, signal};
use tokio::time::{interval, sleep};
use window::Window;

/// How often the node says that it is alive while there is nothing to record, in milliseconds.
const HEARTBEAT_MS: u32 = 1_000;
/// So much of a recording is lost at most if this process is killed.
const FLUSH_EVERY: Duration = Duration::from_secs(1);
/// The events that tell who held what, and the messages.
const EVENTS: [&str; 11] = [
    "delegated",
    "granted",
    "keyed",
    "message",
    "reader",
    "released",
    "renewed",
    "resumed",
    "robot",
    "side_door",
    "stopped",
];

/// Record the messages of services in an MCAP file, which `ros2 bag play` and Foxglove can read.
///
/// Without --since, it records from now on, until Ctrl-C. With --since, it records the stored messages and ends; with
/// --follow as well, it continues with new ones. The file has one channel per service, and also /ledger/records
/// (sender, epoch and block of each message) and /ledger/events (grants, their ends, stops). Log time is block time.
/// The sender's signature of each message is verified. Messages of confidential services are recorded decrypted; those
/// for other readers are counted and omitted.
///
/// -o FILE.mcap names the file; with -o json, use --to FILE.mcap.
///
/// A MOMENT is a span before now (10m), a time of today (14:30), a time (2027-05-01T14:30:00+02:00), or the height of a
/// block.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl record Turtlebot4 -o run.mcap
  ledgerctl record Turtlebot4/cmd_vel OptiTrack/poses --since 10m -o run.mcap
  ledgerctl record Turtlebot4 --since 14:30 --until 14:45:30 -o run.mcap --force
  ledgerctl record Arm/grip --since 0 --follow --msg arm_msgs/msg/Grip=Grip.msg -o grip.mcap")]
pub(crate) struct Record {
    /// Services; a robot alone means all its services
    #[arg(value_name = "ROBOT[/TOPIC]", required = true)]
    services: Vec<String>,
    /// Start with the first block at or after this moment; 0 for the first stored block
    #[arg(long, value_name = "MOMENT")]
    since: Option<Moment>,
    /// End with the last block at or before this moment
    #[arg(long, value_name = "MOMENT")]
    until: Option<Moment>,
    /// Continue with new messages, until Ctrl-C or --until
    #[arg(long)]
    follow: bool,
    /// The file; -o FILE.mcap is the same
    #[arg(long, value_name = "FILE.mcap")]
    to: Option<PathBuf>,
    /// Replace an existing file
    #[arg(long)]
    force: bool,
    /// Name the channels like the topics of the robots, /cmd_vel instead of /Turtlebot4/cmd_vel
    #[arg(long)]
    plain_topics: bool,
    #[command(flatten)]
    definitions: Definitions,
}

impl Record {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let path = self.file(global)?;
        if path.exists() && !self.force {
            return Err(recording::taken(&path).into());
        }
        self.definitions.check(output)?;
        let session = Session::open(global).await?;
        let selection = Selection::find(&session, &self.services, self.plain_topics).await?;
        let window = Window::find(&session, &selection, self.since, self.until, self.follow).await?;
        let mut places = Vec::new();
        for chosen in &selection.services {
            places.push(Place::take(&session, &chosen.service, output).await?);
        }
        let done = self.fill(&path, &session, (&selection, window), &places, global.format()).await;
        for place in &places {
            place.give_back().await;
        }
        let (summary, ended) = done?;
        output.show(&summary)?;
        ended
    }

    /// The file to write.
    fn file(&self, global: &Global) -> Result<PathBuf, Rejection> {
        let file = self.to.as_deref().or_else(|| global.output.file()).map(Path::to_owned);
        file.ok_or_else(|| {
            Rejection::new(Code::BadArgument, "a recording needs a file")
                .found("no file")
                .wanted("the name of a file that ends with .mcap")
                .next("-o FILE.mcap")
        })
    }

    /// Opens stream and file, and records. A file that was begun is ended, whatever ends the recording.
    async fn fill(
        &self,
        path: &Path,
        session: &Session,
        (selection, mut window): (&Selection, Window),
        places: &[Place<'_>],
        format: Format,
    ) -> Result<(summary::Recorded, Result<(), Failure>), Failure> {
        let subjects = selection.services.iter().map(|chosen| chosen.service.service.clone());
        let mut stream = session.client.subscribe(Subscription {
            from_height: window.first,
            chaincode: ABAC.to_owned(),
            subjects: subjects.chain(selection.robots.iter().cloned()).collect(),
            names: EVENTS.map(str::to_owned).to_vec(),
            heartbeat: HEARTBEAT_MS,
            ..Subscription::default()
        });
        // Who may not read hears it before there is a file.
        stream.open().await?;
        let node = session.client.status().await?;
        let mut held = Vec::new();
        for chosen in selection.services.iter().filter(|_| window.begins_now) {
            let name = Bytes::from(chosen.service.service.clone());
            let told = session.client.query(ABAC, "grants", vec![name]).await?;
            held.push((answer::parse::<Vec<Grant>>(&told.response, "grants")?, told.height, told.time));
        }
        let library = self.definitions.library()?;
        let recording = Recording::create(path, self.force, session.context().network, library)?;
        let services = selection.services.iter().map(|chosen| &chosen.service);
        let opening = Opening::enter(session, services).await?;
        let mut taking = Taking::begin(recording, (session, opening), selection, node)?;
        for (grants, height, time) in &held {
            taking.held(grants, *height, *time)?;
        }
        let mut progress = Progress::new(format == Format::Table);
        let ended = follow(session, &mut stream, &mut taking, &mut window, places, &mut progress).await;
        progress.clear();
        let (ending, result) = match ended {
            Ok(ending) => (ending, Ok(())),
            Err(refused) => (Ending::Refused, Err(refused.into())),
        };
        // A disk that is full has the word before anything that came of it.
        match (taking.end(path, ending), result) {
            (Ok(summary), result) => Ok((summary, result)),
            (Err(_), Err(first)) => Err(first),
            (Err(refused), Ok(())) => Err(refused.into()),
        }
    }
}

/// Takes down what comes, until the window ends or somebody ends it.
async fn follow(
    session: &Session,
    stream: &mut EventStream,
    taking: &mut Taking<'_>,
    window: &mut Window,
    places: &[Place<'_>],
    progress: &mut Progress,
) -> Result<Ending, Rejection> {
    let mut flush = interval(FLUSH_EVERY);
    let cannot = |error: std::io::Error| Rejection::new(Code::Internal, "no signals").found(error.to_string());
    let (mut interrupt, mut terminate) =
        (signal(SignalKind::interrupt()).map_err(cannot)?, signal(SignalKind::terminate()).map_err(cannot)?);
    let mut lost = places.iter().map(|place| Box::pin(place.keep())).collect::<Vec<_>>();
    while !window.is_over(stream.next_height()) {
        let deadline =
            window.ends_at.map_or(Duration::MAX, |at| Duration::from_micros(at.saturating_sub(session.client.now())));
        tokio::select! {
            delivery = stream.next() => {
                let delivery = delivery?;
                if window.is_behind(delivery.height, delivery.time) && !delivery.events.is_empty() {
                    return Ok(Ending::Reached);
                }
                taking.take(&delivery).await?;
            }
            _ = flush.tick() => {
                taking.flush()?;
                let counts = taking.counts();
                let step = Step { count: counts.messages, at: counts.height, of: window.last };
                progress.tell(step, |rate| line(counts, window.last, rate));
            }
            () = sleep(deadline), if window.ends_at.is_some() => window.end_now(session).await?,
            _ = interrupt.recv() => return Ok(Ending::Interrupted),
            _ = terminate.recv() => return Ok(Ending::Interrupted),
            refused = first(&mut lost) => return Err(refused),
        }
    }
    Ok(Ending::Reached)
}

/// How far a recording is.
fn line(counts: &Counts, last: Option<u64>, rate: f64) -> String {
    let Counts { messages, events, bytes, height, .. } = counts;
    let of = last.map(|last| format!(" of {last}")).unwrap_or_default();
    format!("{messages} messages ({rate:.1}/s), {events} events, {}, block {height}{of}", size(*bytes))
}

/// The first of these that ends; never, if there are none.
async fn first<F: Future<Output = Rejection> + Unpin>(waiting: &mut [F]) -> Rejection {
    std::future::poll_fn(|context| {
        for one in waiting.iter_mut() {
            if let std::task::Poll::Ready(refused) = std::pin::Pin::new(one).poll(context) {
                return std::task::Poll::Ready(refused);
            }
        }
        std::task::Poll::Pending
    })
    .await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_tells_rate_size_and_block() {
        let counts = Counts { messages: 150, events: 3, bytes: 1_250, height: 40, ..Counts::default() };
        assert_eq!(line(&counts, Some(80), 50.0), "150 messages (50.0/s), 3 events, 1.2 kB, block 40 of 80");
        assert!(line(&counts, None, 0.0).ends_with("(0.0/s), 3 events, 1.2 kB, block 40"));
    }
}
