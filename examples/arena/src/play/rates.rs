//! Latency against frequency: one user publishes faster and faster, from ROS 2 to ROS 2 through the ledger.

use super::run::call;
use super::{Cast, Setting, Tell};
use crate::model::course::User;
use crate::picture::Rate;
use ledger_base::rejection::Rejection;
use ledgerd::demo::Network;
use ledgerd::demo::RosToRos;
use ledgerd::demo::{FROM_LEDGER, SERVICE, SETTLE, TO_LEDGER, acquire, first_heard};
use ledgerd::demo::{Plan, domains};
use ledgerd::demo::{Publisher, Robot};
use std::time::Duration;

/// The frequencies (Hz).
const RATES: [u32; 6] = [5, 20, 50, 100, 200, 400];
/// How long each is held, on the whole course.
const EACH: Duration = Duration::from_secs(2);

/// Measures each frequency.
pub(crate) async fn measure(
    network: &mut Network,
    cast: &Cast,
    setting: Setting,
    tell: &Tell,
) -> Result<Vec<Rate>, Rejection> {
    let each = EACH.mul_f64(setting.course.scale());
    let settings = r#"{"mode":"exclusive","clear":["on_conflict","priority","queue_max"]}"#;
    call(&network.owner, "configure", &[SERVICE, settings]).await?;
    let [of_salma, of_robot] = domains()?;
    network.start_bridges(&[
        Plan { name: "Salma", domain: of_salma, routes: &[TO_LEDGER], via: None },
        Plan { name: "Turtlebot4", domain: of_robot, routes: &[FROM_LEDGER], via: None },
    ])?;
    let mut robot = Robot::open(of_robot).await?;
    let mut salma = Publisher::open(of_salma, User::Salma).await?;
    tokio::try_join!(salma.matched(), robot.matched(), network.bridges.found())?;
    acquire(cast.client(User::Salma), SERVICE).await?;
    first_heard(&robot, &mut salma).await?;
    let mut rates = Vec::new();
    for hz in RATES {
        tell.show(&format!("Salma publishes at {hz} Hz"));
        robot.take();
        let first = salma.next_number();
        let times = salma.publish(hz, each).await?;
        tokio::time::sleep(SETTLE).await;
        let mut latencies = RosToRos::default();
        latencies.add(User::Salma, first, &times, &robot.take());
        let percentiles = latencies.percentiles();
        rates.push(Rate {
            hz: f64::from(hz),
            published: times.len(),
            received: latencies.count(),
            p50_ms: percentiles.p50,
            p99_ms: percentiles.p99,
        });
        network.check()?;
    }
    call(cast.client(User::Salma), "release", &[SERVICE]).await?;
    network.bridges.stop().await?;
    Ok(rates)
}
