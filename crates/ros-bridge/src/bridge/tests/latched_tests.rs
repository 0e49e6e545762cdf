//! Routes that follow the quality of service of the others on their topic, and latched topics.

use super::*;
use crate::graph::{
    choice::MiddlewareChoice,
    local::LocalGraph,
    loop_filter::LoopFilter,
    mark::Mark,
    qos::{Durability, Reliability},
    reach::Reach,
};
use ledger_base::hash::Hash;
use tokio::sync::watch;

const HOUR_US: u64 = 3_600_000_000;

fn qos(reliability: Reliability, durability: Durability) -> Qos {
    Qos { reliability, durability, ..Qos::default() }
}

fn latched() -> Qos {
    qos(Reliability::Reliable, Durability::TransientLocal)
}

fn feed(fake: &Fake) {
    fake.set_direction("feed");
}

/// The messages of a call of `set`.
fn payloads(set: &[Bytes]) -> Vec<Bytes> {
    set[3..].to_vec()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_route_hears_a_best_effort_publisher_unless_it_is_set_to_be_reliable() {
    if !network::isolated(&|| ()) {
        return;
    }
    let best_effort = qos(Reliability::BestEffort, Durability::Volatile);
    let (topic, message) = names();
    let route = bench("open", "direction = 'to_ledger'", |_| ()).await;
    let writer = route.graph.writer(&topic, &message, &best_effort).await.unwrap();
    assert!(tokio::time::timeout(DEADLINE, writer.matched().at_least(1)).await.unwrap());
    // The writer knows the reader; what it sends before the reader knows it is lost.
    let writes = async {
        loop {
            writer.write(&twist(4)).unwrap();
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    let sets = tokio::select! {
        sets = route.sets(1) => sets,
        () = writes => unreachable!("it writes without end"),
    };
    assert_eq!(payloads(&sets[0])[0], *twist(4).wire());
    drop((writer, route));

    let set = bench("open", "direction = 'to_ledger'\nqos = { reliability = 'reliable' }", |_| ()).await;
    let writer = set.graph.writer(&topic, &message, &best_effort).await.unwrap();
    let refused = async {
        while writer.matched().now().incompatible == 0 {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    tokio::time::timeout(DEADLINE, refused).await.unwrap();
    assert_eq!(writer.matched().now().matched, 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn what_a_reader_has_heard_comes_first_from_the_one_that_takes_its_place() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (topic, message) = names();
    let local = LocalGraph::join(DOMAIN, (&MiddlewareChoice::Dds, &Reach::default()), "bridge", false).await.unwrap();
    let mark = Mark::new(&Hash([1; 32]), "T/cmd_vel");
    let filter = Arc::new(LoopFilter::new(mark, "T/cmd_vel", DEADLINE, Arc::clone(local.delivered())));
    let limits = Limits { queue_samples_max: 1, ..Limits::default() };
    let (tell, follows) = watch::channel(Qos::default());
    let mut input = local.input(&topic, &message, follows, limits, filter).await.unwrap();
    let graph = Beside::open("beside").await;
    let writer = graph.writer(&topic, &message, &Qos::default()).await.unwrap();
    for end in [input.matched(), writer.matched()] {
        assert!(tokio::time::timeout(DEADLINE, end.at_least(1)).await.unwrap());
    }
    writer.write(&twist(1)).unwrap();
    writer.write(&twist(2)).unwrap();
    // The second one waits as soon as it has taken the place of the first.
    let waits = async {
        while input.dropped() == 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    tokio::time::timeout(DEADLINE, waits).await.unwrap();
    tell.send_replace(qos(Reliability::BestEffort, Durability::Volatile));
    input.follow().await;
    assert_eq!(input.try_next().unwrap().sample, twist(2));
    assert_eq!(input.dropped(), 1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn what_several_latched_publishers_said_before_the_bridge_came_goes_to_the_ledger_in_one_call() {
    if !network::isolated(&|| ()) {
        return;
    }
    let (topic, message) = names();
    let graphs = [Beside::open("one").await, Beside::open("two").await];
    let kept = latched();
    let writers = graphs.iter().map(|graph| graph.writer(&topic, &message, &kept));
    let writers: Vec<Writer> = futures::future::try_join_all(writers).await.unwrap();
    for (number, writer) in (1..).zip(&writers) {
        writer.write(&twist(number)).unwrap();
    }
    let bench = bench("open", "direction = 'to_ledger'", feed).await;
    let both = async |wanted: [u8; 2]| {
        let mut wanted = wanted.map(|number| twist(number).wire().clone());
        wanted.sort();
        let is_last = |sets: &Vec<Vec<Bytes>>| {
            let mut said = sets.last().map_or_else(Vec::new, |last| payloads(last));
            said.sort();
            said == wanted
        };
        let mut sets = bench.fake.sets.subscribe();
        let told = tokio::time::timeout(DEADLINE, sets.wait_for(is_last)).await.is_ok();
        assert!(told, "{:?}", bench.fake.sets.borrow());
    };
    both([1, 2]).await;
    writers[0].write(&twist(7)).unwrap();
    both([7, 2]).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn samples_of_a_latched_topic_for_which_a_call_has_no_room_are_counted() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("open", "direction = 'to_ledger'\nlatched_depth = 100", feed).await;
    let (topic, message) = names();
    // A hundred of each are more than the 512 of a call.
    let mut writers = Vec::new();
    for own in 1_u64..=6 {
        writers.push((own, bench.graph.writer(&topic, &message, &latched()).await.unwrap()));
    }
    let counted = async {
        let mut due = tokio::time::interval(Duration::from_millis(10));
        for number in 1_u64.. {
            due.tick().await;
            for (own, writer) in &writers {
                // No publisher repeats another one.
                let body: Vec<u8> = [*own, number, 0, 0, 0, 0].into_iter().flat_map(u64::to_le_bytes).collect();
                writer.write(&Sample::new(CDR_LE, &body).unwrap()).unwrap();
            }
            if bench.bridge.summary().routes[0].gate.contains_key("left_out") {
                return;
            }
        }
    };
    tokio::time::timeout(DEADLINE, counted).await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn commands_of_latched_publishers_go_to_the_ledger_one_by_one_and_are_never_said_again() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("open", "direction = 'to_ledger'", |_| ()).await;
    let (topic, message) = names();
    for number in 1..4 {
        let writer = bench.graph.writer(&topic, &message, &latched()).await.unwrap();
        assert!(tokio::time::timeout(DEADLINE, writer.matched().at_least(1)).await.unwrap());
        writer.write(&twist(number)).unwrap();
        let sets = bench.sets(usize::from(number)).await;
        assert_eq!(payloads(sets.last().unwrap()), [twist(number).wire().clone()]);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn who_comes_late_to_a_latched_feed_hears_what_was_said_last_and_no_made_up_message() {
    if !network::isolated(&|| ()) {
        return;
    }
    let bench = bench("open", "direction = 'from_ledger'", feed).await;
    let (robot, salma) = (&bench.network.robot, &bench.network.salma);
    let long_ago = micros() - HOUR_US;
    let said = |user: &User, seq, number| {
        let signed = sign(user, 0, seq, &twist(number), long_ago);
        (signed, user.certificate.clone())
    };
    let (last, certificate) = said(robot, 5, 3);
    bench.fake.keep(400, long_ago, &last, &certificate);
    // A user publishes on no feed.
    let (forged, certificate) = said(salma, 9, 6);
    bench.fake.keep(401, long_ago, &forged, &certificate);
    let (topic, message) = names();
    let mut heard = Vec::new();
    for _ in 0..2 {
        let mut reader = bench.graph.reader(&topic, &message, &latched(), Limits::default()).await.unwrap();
        heard.push(tokio::time::timeout(DEADLINE, reader.next()).await.unwrap().unwrap().sample);
    }
    assert_eq!(heard, [twist(3), twist(3)]);
    bench.until(|route| route.gate.get("not_owner") == Some(&1)).await;
    assert_eq!(bench.bridge.stop().await.routes[0].published, 1);
}
