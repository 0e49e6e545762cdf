//! A bridge that loses its middleware.

use super::*;
use crate::{
    bridge::run::Started,
    monitor::{BridgeMonitor, BridgeView},
};
use futures::FutureExt;
use tokio::sync::{mpsc, oneshot};

#[tokio::test(flavor = "multi_thread", worker_threads = 1)]
async fn a_bridge_that_loses_the_local_graph_joins_it_again_and_carries_messages() {
    if !network::isolated(&|| ()) {
        return;
    }
    let network = Network::until(2900);
    let fake = Fake::new("exclusive", &network);
    fake.set_holder("Org1/Salma", 3, 60_000);
    beside::prepare().await;
    let transport = beside::transport();
    let text = format!(
        "domain_id = {DOMAIN}\n{transport}\nshared_memory = false\n[[route]]\nservice = 'T/cmd_vel'\n\
         type = 'geometry_msgs/msg/Twist'\ndirection = 'from_ledger'\ncommand_timeout_ms = 0"
    );
    let config = Config::parse(&text, Path::new(""), |_| ()).unwrap();
    let (tell, mut started) = mpsc::unbounded_channel();
    let (end, ended) = oneshot::channel::<()>();
    let (at, beside) = (context(&network), Arc::clone(&fake));
    let start = async move |config: &Config| {
        let bridge = Bridge::start_with(config.clone(), beside.clone(), &at).await?;
        let own = bridge.roster.slots()[0].counters.matched();
        tell.send((bridge.local.middleware().clone(), own.unwrap())).unwrap();
        Ok::<Started, _>((bridge, std::future::pending().boxed()))
    };
    let monitor = BridgeMonitor::default();
    assert!(matches!(monitor.look(), BridgeView::Waits(None)));
    let running = keep_running(config, futures::stream::pending(), async { drop(ended.await) }, start, &monitor);
    let graph = Beside::open("beside").await;
    let (topic, message) = names();
    let reader = graph.reader(&topic, &message, &Qos::default(), Limits::default()).await.unwrap();
    let mut robot = Robot { reader, stands: true };
    let test = async {
        for seq in 1..=3 {
            let (middleware, own) = tokio::time::timeout(DEADLINE, started.recv()).await.unwrap().unwrap();
            assert!(tokio::time::timeout(DEADLINE, own.at_least(1)).await.unwrap());
            let now = micros();
            let signed = sign(&network.salma, 3, seq, &twist(7), now);
            fake.deliver(now, "message", &json!({}), Some((&signed, &network.salma.certificate)));
            while next(&mut robot).await != twist(7) {}
            let BridgeView::Runs(standing) = monitor.look() else { unreachable!("the bridge carries messages") };
            let route = &standing.routes[0];
            assert_eq!((standing.domain, route.is_open, route.is_held, route.takes_in), (DOMAIN, true, true, false));
            assert_eq!((route.age.count(), route.commit.count()), (1, 0), "{route:?}");
            if seq < 3 {
                middleware.break_down();
            }
        }
        end.send(()).unwrap();
    };
    let (summary, ()) = futures::future::join(running, test).await;
    let route = summary.unwrap().unwrap().routes.pop().unwrap();
    assert_eq!(route.published, 1, "since the graph was joined last: {route:?}");
}
