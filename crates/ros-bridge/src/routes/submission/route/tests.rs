//! Samples out of a queue, before a ledger that accepts all of them.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::time::SystemTime;

use bytes::Bytes;
use futures::future::join;
use ledger_gate::{
    fixture::shared,
    sample::{CDR_LE, Sample},
};
use tokio::{
    sync::watch,
    time::{sleep, timeout},
};

use super::*;
use crate::{
    graph::queue::{Limits, Queue},
    ledger::fake::Fake,
};

const DEADLINE: Duration = Duration::from_secs(20);
/// Longer than a machine stalls.
const MAX_AGE: Duration = Duration::from_secs(60);
const TOO_LONG: Duration = Duration::from_secs(61);

fn incoming(number: u8, received: Instant, waited: Duration) -> Incoming {
    let sample = Sample::new(CDR_LE, &[number; 48]).unwrap();
    Incoming { sample, source: [1; 16], sequence: u64::from(number), received, wall: SystemTime::now(), waited }
}

/// A route, with both ends.
struct Bench {
    fake: Arc<Fake>,
    queue: Arc<Queue>,
    counters: Counters,
    route: ToLedger,
}

async fn bench(max_age: Option<Duration>, batch_max: usize, max_rate_hz: Option<u32>) -> Bench {
    let counters = Counters::new("T/cmd_vel", "to_ledger");
    let (fake, queue) = (Fake::new("open", shared()), Queue::new(&Limits::default()));
    let settings = Settings { batch_max, max_rate_hz, ..Settings::default() };
    let inlet = Inlet::Calls(Arc::clone(&queue));
    let gateway = Arc::clone(&fake) as Arc<dyn Gateway>;
    let route = ToLedger::open(gateway, "T/cmd_vel", inlet, &settings, counters.clone()).await.unwrap();
    Bench { fake, queue, counters, route: ToLedger { max_age, ..route } }
}

/// The first bytes of the messages of each call.
fn numbers(fake: &Fake) -> Vec<Vec<u8>> {
    let first = |message: &Bytes| *message.get(4).unwrap();
    fake.sets.borrow().iter().map(|set| set.iter().skip(3).map(first).collect()).collect()
}

#[tokio::test]
async fn a_command_that_waited_for_longer_than_its_service_allows_is_dropped_and_counted_and_never_signed() {
    let alone: Vec<Vec<u8>> = vec![vec![2], vec![4]];
    for (batch_max, wanted) in [(1, alone), (4, vec![vec![2, 4]])] {
        let Bench { fake, queue, counters, route } = bench(Some(MAX_AGE), batch_max, None).await;
        let now = Instant::now();
        let before = now.checked_sub(TOO_LONG).unwrap();
        // In the queue of the bridge; or, by the clock of its publisher, on the way there.
        for (number, received, waited) in [(1, before, Duration::ZERO), (2, now, Duration::ZERO), (3, now, TOO_LONG)] {
            queue.push(incoming(number, received, waited));
        }
        queue.push(incoming(4, now, Duration::from_secs(1)));
        queue.close();
        let (_told, stop) = watch::channel(false);
        timeout(DEADLINE, route.run(stop)).await.unwrap();
        assert_eq!(numbers(&fake), wanted);
        let summary = counters.summary();
        assert_eq!((summary.samples_in, summary.submitted), (4, 2));
        assert_eq!(summary.gate.into_iter().collect::<Vec<_>>(), [("too_old", 2)]);
    }
}

#[tokio::test]
async fn what_is_no_command_is_never_too_old() {
    let Bench { fake, queue, counters, route } = bench(None, 1, None).await;
    queue.push(incoming(1, Instant::now().checked_sub(TOO_LONG).unwrap(), TOO_LONG));
    queue.close();
    let (_told, stop) = watch::channel(false);
    timeout(DEADLINE, route.run(stop)).await.unwrap();
    assert_eq!(numbers(&fake), vec![vec![1_u8]]);
    assert!(counters.summary().gate.is_empty());
}

#[tokio::test]
async fn a_command_grows_old_while_it_waits_for_its_turn_too() {
    let Bench { fake, queue, counters, route } = bench(Some(MAX_AGE), 1, Some(1)).await;
    let now = Instant::now();
    queue.push(incoming(1, now, Duration::ZERO));
    // Its turn is a second after the first.
    queue.push(incoming(2, now, MAX_AGE.saturating_sub(Duration::from_millis(500))));
    let (tell, stop) = watch::channel(false);
    let dropped = async {
        while !counters.lock().summary.gate.contains_key(TOO_OLD) {
            sleep(Duration::from_millis(5)).await;
        }
        tell.send_replace(true);
    };
    timeout(DEADLINE, join(route.run(stop), dropped)).await.unwrap();
    assert_eq!(numbers(&fake), vec![vec![1_u8]]);
}
