//! `replay`: publish the messages of a recording in a ROS domain of this machine, in the time in which they came.

mod cast;
mod lookout;
mod summary;

use crate::argument::domain;
use crate::argument::remap::Remap;
use crate::failure::Failure;
use crate::output::{Format, Output};
use crate::recording::Reading;
use cast::Cast;
use ledger_base::progress::{Progress, Step};
use ledger_base::rejection::{Code, Rejection};
use ledger_gate::sample::{SAMPLE_BYTES_MAX, Sample};
use lookout::Lookout;
use ros_bridge::dds::Participant;
use ros_bridge::error::Error;
use ros_bridge::reach::{Reach, Settings};
use std::path::PathBuf;
use std::time::Duration;
use summary::Replayed;
use tokio::time::{Instant, sleep, sleep_until, timeout};

/// The node as `ros2 node list` shows it.
const NODE: &str = "ledgerctl_replay";
/// For so long neighbours are waited for before the first message.
const NEIGHBOURS_WITHIN: Duration = Duration::from_millis(1500);
/// For so long a subscriber on every topic is waited for.
const SUBSCRIBERS_WITHIN: Duration = Duration::from_secs(3);
/// For so long subscribers may take to acknowledge the last messages.
const ACKNOWLEDGED_WITHIN: Duration = Duration::from_secs(2);

/// Publish the messages of a recording in a ROS domain, at their original intervals.
///
/// These messages do not pass the ledger: no grant is needed, and every subscriber of the topic acts on them. So the
/// domain must be named, and the command ends if a bridge uses one of the topics. Bridges of the recorded network never
/// forward replayed messages. Only processes of this machine receive them, unless ROS_AUTOMATIC_DISCOVERY_RANGE or
/// ROS_STATIC_PEERS extend the range.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl replay run.mcap --domain 42
  ledgerctl replay run.mcap --domain 42 --rate 0.5 --topic /Turtlebot4/cmd_vel:=/turtle1/cmd_vel")]
pub(crate) struct Replay {
    /// The recording, or another MCAP file with messages of ROS 2
    file: PathBuf,
    /// The ROS domain to publish in
    #[arg(long, value_name = "N", value_parser = domain::parse)]
    domain: u16,
    /// Speed factor
    #[arg(long, value_name = "X", default_value_t = 1.0, value_parser = rate)]
    rate: f64,
    /// Publish a topic under another name; may be given several times
    #[arg(long = "topic", value_name = "FROM:=TO")]
    remaps: Vec<Remap>,
}

fn rate(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|rate| (0.001..=1000.0).contains(rate))
        .ok_or_else(|| "wanted a factor from 0.001 to 1000, such as 0.5 or 2".to_owned())
}

impl Replay {
    pub(crate) async fn run(self, output: &mut Output) -> Result<(), Failure> {
        let mut cast = Cast::of_file(&self.file, &self.remaps)?;
        let reach = Reach::choose(&Settings::default(), |name| std::env::var(name).ok())?;
        let participant = Participant::join(self.domain, NODE, &reach).await.map_err(Rejection::from)?;
        cast.open(&participant)?;
        output.note(&format!("publishing in ROS domain {} ({reach}): {}", self.domain, cast.told()));
        let mut replayed = Replayed::new(&self.file, self.domain);
        let lookout = Lookout::over(participant.clone(), cast.topics());
        let done = tokio::select! {
            done = self.play(&mut cast, output, &mut replayed) => done,
            found = lookout.bridge(self.domain) => Err(found),
            _ = tokio::signal::ctrl_c() => Ok(()),
        };
        cast.flush(ACKNOWLEDGED_WITHIN).await;
        replayed.topics = cast.into_counts();
        if replayed.messages() > 0 || done.is_ok() {
            output.show(&replayed)?;
        }
        Ok(done?)
    }

    /// Publishes one message after the other, each when its time has come.
    async fn play(&self, cast: &mut Cast, output: &Output, replayed: &mut Replayed) -> Result<(), Rejection> {
        sleep(NEIGHBOURS_WITHIN).await;
        if timeout(SUBSCRIBERS_WITHIN, cast.heard()).await.is_err() {
            output.note(&format!("no subscribers on {}", cast.unheard().join(", ")));
        }
        let mut reading = Reading::open(&self.file)?;
        let of = cast.recorded();
        let (mut progress, mut count) = (Progress::new(output.format() == Format::Table), 0);
        let begun = Instant::now();
        let mut first = None;
        while let Some(found) = reading.next()? {
            let first = *first.get_or_insert(found.log_time);
            let Some(part) = cast.part(found.channel) else { continue };
            let since = Duration::from_nanos(found.log_time.saturating_sub(first)).div_f64(self.rate);
            sleep_until(begun + since).await;
            count += 1;
            progress.tell(Step { count, at: count, of: Some(of) }, |rate| {
                format!("{count} of {of} messages ({rate:.1}/s)")
            });
            let Ok(sample) = Sample::copy_from_wire(&found.data, SAMPLE_BYTES_MAX) else {
                replayed.unusable += 1;
                continue;
            };
            match part.publish(&sample) {
                Ok(()) => {}
                // The subscriber's affair: the next one may find it awake.
                Err(Error::Slow(_)) => replayed.unheard += 1,
                Err(error) => return Err(error.into()),
            }
        }
        progress.clear();
        replayed.is_cut = reading.is_cut();
        Ok(())
    }
}

/// The refusal of a file without anything to publish.
fn nothing(path: &std::path::Path, found: String) -> Rejection {
    Rejection::new(Code::BadFile, format!("{} has nothing to replay", path.display()))
        .found(found)
        .wanted("messages of ROS 2: a channel with the encoding cdr and a type")
        .next("look into it: mcap info FILE, ros2 bag info FILE")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_and_a_domain_are_bounded() {
        assert_eq!((rate("0.5"), domain::parse("232")), (Ok(0.5), Ok(232)));
        for text in ["0", "-1", "nan", "inf", "1e9", "fast"] {
            assert!(rate(text).is_err_and(|told| told.contains("0.001 to 1000")), "{text}");
        }
        for text in ["233", "-1", "x", ""] {
            assert!(domain::parse(text).is_err_and(|told| told.contains("0 to 232")), "{text}");
        }
    }
}
