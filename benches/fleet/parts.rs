//! The things of which there may be more, except blocks.

use crate::Bench;
use crate::drivers::{Drivers, register, robot, salma};
use crate::founding::{Founding, OWNERS, PAPER, Shape};
use crate::network::{Arrivals, Network};
use crate::point::{Load, Point};
use bytes::Bytes;
use ledger::msp::QUOTAS_MAX;
use ledger_abac::DEFAULT_POLICY;
use ledger_api::{Client, Context, Subscription};
use ledger_contract::{PolicyDraft, PolicyText};
use serde_json::json;
use std::time::{Duration, Instant};

/// Rate of one robot: the paper's.
const ROBOT_HZ: f64 = 50.0;
/// The highest rate of robots together, and the rate above which their messages are put together.
const ROBOTS_HZ_MAX: f64 = 2000.0;
const BATCHED_HZ: f64 = 1000.0;
/// Rules of one policy text: as many as its length admits.
const RULES_PER_TEXT: usize = 160;
/// Event streams of one connection.
const STREAMS_PER_CONNECTION: usize = 100;
/// Deliveries a second that a node and this bench can make on one machine.
const DELIVERIES_HZ_MAX: f64 = 20_000.0;
/// Time for subscriptions to be accepted.
const SUBSCRIBE_TIME_MAX: Duration = Duration::from_secs(30);

/// A network on which one robot is driven.
struct Site {
    network: Network,
    owner: Client,
    drivers: Drivers,
    arrivals: Arrivals,
}

impl Site {
    fn start(bench: &Bench, founding: Founding) -> Self {
        bench.runtime.block_on(async {
            let network = start(founding).await;
            let owner = network.owner_at(0).await;
            let (drivers, arrivals) = (salma(&network).await, network.listen("Turtlebot4").await);
            Self { network, owner, drivers, arrivals }
        })
    }

    fn measure(&self, bench: &Bench, x: usize, load: Load) -> Point {
        Point::measure(bench, &self.network, &self.drivers, &self.arrivals, x, load)
    }

    fn at_all_rates(&self, bench: &Bench, x: usize) -> Vec<Point> {
        bench.rates().into_iter().map(|hz| self.measure(bench, x, Load::hz(hz))).collect()
    }
}

/// A network whose organisations allow the owner of the robots as many as any may have.
async fn start(founding: Founding) -> Network {
    let network = Network::start_founded(founding, "").await;
    let quota = json!({ "organisation": OWNERS, "robots": QUOTAS_MAX.robots }).to_string();
    let operator = network.connect(&network.founding().operator).await;
    for admin in [network.owner_at(0).await, operator] {
        admin.invoke("msp", "set_quota", vec![Bytes::from(quota.clone())]).await.unwrap();
    }
    network
}

/// Robots that are driven, each by a holder of its own. They share rates, and each runs at 50 Hz, with as many messages
/// in a transaction as bring all to 1000 transactions a second.
pub(crate) fn robots(bench: &Bench) -> Vec<Point> {
    let counts = bench.counts(&[1, 10, 100, 1000]);
    let founding = Founding::new(PAPER);
    let people = with_robots(&founding, *counts.last().unwrap(), |number| format!("Robot{number}"));
    let network = bench.runtime.block_on(start(founding));
    let arrivals = bench.runtime.block_on(network.listen_to(Vec::new()));
    let mut drivers = Drivers::new(vec![bench.runtime.block_on(network.connect(&people[0].0))]);
    let mut points = Vec::new();
    for count in counts {
        let more = &people[drivers.len()..count];
        bench.runtime.block_on(async {
            let robots = more.iter().map(|(_, name)| robot(name, "exclusive")).collect();
            register(&network.owner_at(0).await, robots).await;
            drivers.acquire(more).await;
        });
        let all_hz = ROBOT_HZ * count as f64;
        let hz = all_hz.min(BATCHED_HZ);
        let messages = (all_hz / hz).ceil() as usize;
        let each = Load { name: "50 Hz each, batched".into(), hz, messages, comparable: false };
        let loads = bench.rates().into_iter().chain([ROBOTS_HZ_MAX]).map(Load::hz).chain([each]);
        let loads = loads.take(if bench.smoke { 1 } else { usize::MAX });
        points.extend(loads.map(|load| Point::measure(bench, &network, &drivers, &arrivals, count, load)));
    }
    points
}

/// Users with a key and a connection each, who publish in turn on one service that is open to them.
pub(crate) fn users(bench: &Bench) -> Vec<Point> {
    let counts = bench.counts(&[1, 10, 100, 1000]);
    let founding = Founding::new(PAPER);
    let people = founding.members(*counts.last().unwrap(), &["Fleet"]);
    let mut site = Site::start(bench, founding);
    bench.runtime.block_on(register(&site.owner, vec![robot("Arena", "open")]));
    site.arrivals = bench.runtime.block_on(site.network.listen("Arena"));
    site.drivers = Drivers::new(Vec::new());
    let mut points = Vec::new();
    for count in counts {
        let more = &people[site.drivers.len()..count];
        bench.runtime.block_on(async {
            for who in more {
                site.drivers.connect(site.network.connect(who).await);
            }
            site.drivers.share(more, "Arena/cmd_vel").await;
        });
        points.extend(site.at_all_rates(bench, count));
    }
    points
}

/// Robots that are registered and stand still.
pub(crate) fn registered(bench: &Bench) -> Vec<Point> {
    let site = Site::start(bench, Founding::new(PAPER));
    let mut known = 0;
    let counts = bench.counts(&[1, 10, 100, 1000]).into_iter();
    counts
        .flat_map(|count| {
            let robots = (known..count).map(|number| robot(&format!("Idle{number}"), "exclusive")).collect();
            known = count;
            bench.runtime.block_on(register(&site.owner, robots));
            site.at_all_rates(bench, count)
        })
        .collect()
}

/// Users who wait in the line of the robot that is driven.
pub(crate) fn waiting(bench: &Bench) -> Vec<Point> {
    let counts = bench.counts(&[1, 10, 100, 1000]);
    let founding = Founding::new(PAPER);
    let people = with_robots(&founding, *counts.last().unwrap(), |_| "Turtlebot4".to_owned());
    let site = Site::start(bench, founding);
    bench.runtime.block_on(queue_for(&site.owner, "Turtlebot4"));
    let mut known = 0;
    let measured = counts.into_iter().flat_map(|count| {
        bench.runtime.block_on(site.drivers.wait(&people[known..count]));
        known = count;
        site.at_all_rates(bench, count)
    });
    measured.collect()
}

/// Robots with a line: one user holds each, another waits. They stand still while another robot is driven.
pub(crate) fn lines(bench: &Bench) -> Vec<Point> {
    let counts = bench.counts(&[1, 10, 100, 1000]);
    let founding = Founding::new(PAPER);
    let most = *counts.last().unwrap();
    let people = with_robots(&founding, 2 * most, |number| format!("Wanted{}", number % most));
    let (holders, contenders) = people.split_at(most);
    let site = Site::start(bench, founding);
    let mut idle = Drivers::new(vec![bench.runtime.block_on(site.network.connect(&holders[0].0))]);
    let mut points = Vec::new();
    for count in counts {
        let more = idle.len()..count;
        bench.runtime.block_on(async {
            let robots = more.clone().map(|number| robot(&holders[number].1, "exclusive")).collect();
            register(&site.owner, robots).await;
            for number in more.clone() {
                queue_for(&site.owner, &holders[number].1).await;
            }
            idle.acquire(&holders[more.clone()]).await;
            idle.wait(&contenders[more]).await;
        });
        points.extend(site.at_all_rates(bench, count));
    }
    points
}

/// Members who carry the attributes of the paper's robot and of all others, with the robot that each wants.
fn with_robots(founding: &Founding, count: usize, robot: impl Fn(usize) -> String) -> Vec<(Context, String)> {
    let people = founding.members(count, &["Fleet", "Turtlebot4"]).into_iter().enumerate();
    people.map(|(number, who)| (who, robot(number))).collect()
}

/// Gives a robot's service a line of the greatest length.
async fn queue_for(owner: &Client, robot: &str) {
    let settings = r#"{"sharing":{"on_conflict":"queue","queue_max":1024,"queue_wait_max_ms":86400000}}"#;
    let args = [format!("{robot}/cmd_vel"), settings.to_owned()].map(Bytes::from).to_vec();
    owner.invoke("abac", "configure", args).await.unwrap();
}

/// Rules in the policies of the robots' owner.
pub(crate) fn policies(bench: &Bench) -> Vec<Point> {
    let site = Site::start(bench, Founding::new(PAPER));
    let apply = async |policies: Vec<PolicyText>| {
        let set = PolicyDraft { policies: Some(policies), ..PolicyDraft::default() };
        let args = ["apply".to_owned(), serde_json::to_string(&set).unwrap()].map(Bytes::from).to_vec();
        site.owner.invoke("abac", "policy", args).await.unwrap();
    };
    let counts = bench.counts(&[1, 10, 100, 1000, 10_000]).into_iter();
    counts
        .flat_map(|count| {
            let rules: Vec<_> =
                (0..count).map(|rule| format!("forbid(principal==User::\"O/{rule}\",action,resource);")).collect();
            let mut set = vec![PolicyText { id: "built-in".to_owned(), text: DEFAULT_POLICY.to_owned() }];
            for (number, rules) in rules.chunks(RULES_PER_TEXT).enumerate() {
                set.push(PolicyText { id: format!("rules{number}"), text: rules.concat() });
            }
            bench.runtime.block_on(apply(set));
            site.at_all_rates(bench, count)
        })
        .collect()
}

/// Organisations; all but two of them have no node.
pub(crate) fn organisations(bench: &Bench) -> Vec<Point> {
    let counts = bench.counts(&[2, 4, 8, 16, 32]).into_iter();
    counts.flat_map(|count| Site::start(bench, Founding::with(PAPER, count - 2)).at_all_rates(bench, count)).collect()
}

/// Subscribers at the robots' node of one robot each, which stands still while another is driven.
pub(crate) fn bystanders(bench: &Bench) -> Vec<Point> {
    let site = Site::start(bench, Founding::new(PAPER));
    let mut known = 0;
    let counts = bench.counts(&[1, 10, 100, 1000]).into_iter();
    counts
        .flat_map(|count| {
            let names: Vec<_> = (known..count).map(|number| format!("Idle{number}")).collect();
            known = count;
            bench.runtime.block_on(async {
                register(&site.owner, names.iter().map(|name| robot(name, "exclusive")).collect()).await;
                subscribe(&site.network, names.iter().map(|name| format!("{name}/cmd_vel")).collect()).await;
            });
            site.at_all_rates(bench, count)
        })
        .collect()
}

/// Subscribers at the robots' node that all hear the robot that is driven.
pub(crate) fn subscribers(bench: &Bench) -> Vec<Point> {
    let site = Site::start(bench, Founding::new(PAPER));
    let mut known = 0;
    let counts = bench.counts(&[1, 10, 100, 1000]).into_iter();
    counts
        .flat_map(|count| {
            // The one that notes arrivals is the first.
            let more = count - known.max(1);
            known = count;
            bench.runtime.block_on(subscribe(&site.network, vec!["Turtlebot4/cmd_vel".to_owned(); more]));
            let within = |hz: f64| hz.min(DELIVERIES_HZ_MAX / count as f64);
            let load = |hz: f64| Load { name: format!("up to {hz} Hz"), ..Load::hz(within(hz)) };
            bench.rates().into_iter().map(|hz| site.measure(bench, count, load(hz))).collect::<Vec<_>>()
        })
        .collect()
}

/// Nodes that follow one voter.
pub(crate) fn learners(bench: &Bench) -> Vec<Point> {
    let shape = |learners| Shape { name: "learners", voters: 1, learners };
    let counts = bench.counts(&[1, 2, 4, 8]).into_iter();
    counts.flat_map(|count| Site::start(bench, Founding::new(shape(count))).at_all_rates(bench, count)).collect()
}

/// Nodes that order, and one that follows.
pub(crate) fn voters(bench: &Bench) -> Vec<Point> {
    let shape = |voters| Shape { name: "voters", voters, learners: 1 };
    let counts = bench.counts(&[1, 3, 5]).into_iter();
    counts.flat_map(|count| Site::start(bench, Founding::new(shape(count))).at_all_rates(bench, count)).collect()
}

/// Opens a stream of messages for each of these services at the last node, and waits until all are open.
async fn subscribe(network: &Network, services: Vec<String>) {
    let last = network.founding().nodes.len() - 1;
    let observer = network.owner_at(last).await;
    let wanted = observer.status().await.unwrap().subscribers + services.len() as u64;
    for services in services.chunks(STREAMS_PER_CONNECTION) {
        let client = network.owner_at(last).await;
        for service in services {
            let mut events = client.subscribe(Subscription {
                chaincode: "abac".into(),
                subjects: vec![service.clone()],
                names: vec!["message".into()],
                ..Subscription::default()
            });
            tokio::spawn(async move { while events.next().await.is_ok() {} });
        }
    }
    let deadline = Instant::now() + SUBSCRIBE_TIME_MAX;
    while observer.status().await.unwrap().subscribers < wanted {
        assert!(Instant::now() < deadline, "not all of {wanted} subscribers were accepted");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}
