//! Leadership: reads that ask the leader, transfers on demand and at the end of a node, clients that go on.

use crate::support::network::{NodeWish, free_address, message, now, register_robots};
use crate::support::process::Process;
use crate::support::{Fleet, connect, until};
use ledger_api::v1::StatusResponse;
use ledger_api::{Client, Committed, Context, Leadership, Options};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio::task::JoinHandle;

/// Three voters of both organisations, and a learner.
struct Network {
    nodes: Vec<Option<Process>>,
    owner: Context,
    salma: Context,
    fleet: Fleet,
}

impl Network {
    fn start() -> Self {
        let wish = |name: &str, organisation: &str, voter| NodeWish {
            name: name.into(),
            organisation: organisation.into(),
            voter,
            address: free_address(),
        };
        let wishes = [
            wish("node1", "Org1", true),
            wish("node2", "Org2", true),
            wish("node3", "Org1", true),
            wish("node4", "Org2", false),
        ];
        let fleet = Fleet::found_with(&wishes, now());
        let owner = fleet.owner();
        let salma = fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]);
        let nodes = fleet.nodes.iter().map(|place| Some(place.start())).collect();
        Self { nodes, owner, salma, fleet }
    }

    /// A person at one node only.
    async fn at(&self, person: &Context, node: usize) -> Client {
        connect(&Context { nodes: vec![self.fleet.nodes[node].address.clone()], ..person.clone() }).await
    }

    /// A person who knows all nodes and begins at this one.
    async fn from(&self, person: &Context, node: usize) -> Client {
        let address = |at: usize| self.fleet.nodes[(node + at) % self.fleet.nodes.len()].address.clone();
        connect(&Context { nodes: (0..self.fleet.nodes.len()).map(address).collect(), ..person.clone() }).await
    }

    /// Starts a node that has ended, and waits until it follows again.
    async fn restart(&mut self, node: usize, observer: &Client) {
        let height = observer.status().await.unwrap().height;
        self.nodes[node] = Some(self.fleet.nodes[node].start());
        let back = self.at(&self.owner, node).await;
        until("the node is back", || async {
            let status = back.status().await.ok()?;
            (status.height > height && status.leader_id != 0).then_some(())
        })
        .await;
    }

    fn process(&mut self, node: usize) -> &mut Process {
        self.nodes[node].as_mut().unwrap()
    }
}

/// Waits until this node knows of a leader other than `not`.
async fn leader(client: &Client, not: u64) -> StatusResponse {
    until("there is a leader", || async {
        let status = client.status().await.ok()?;
        (status.leader_id != 0 && status.leader_id != not).then_some(status)
    })
    .await
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_query_sees_what_anybody_was_told_and_without_a_leader_only_who_takes_what_is_old_is_answered() {
    let mut network = Network::start();
    let (voter, learner) = (network.at(&network.owner, 0).await, network.at(&network.owner, 3).await);
    register_robots(&voter, "exclusive").await;
    let salma = network.at(&network.salma, 0).await;
    for round in 0..20 {
        let grant = salma.invoke("abac", "acquire", vec!["Turtlebot4".into(), "600000".into()]).await.unwrap();
        let answer = learner.query("abac", "grants", Vec::new()).await.unwrap();
        assert!(answer.height >= grant.height, "round {round}: {} after {}", answer.height, grant.height);
        salma.invoke("abac", "release", vec!["Turtlebot4".into()]).await.unwrap();
    }
    let asked = learner.query("abac", "robots", Vec::new()).await.unwrap();
    // Nobody can confirm that the leader leads when the majority is gone: the learner still answers from its own
    // state, but not as if that were the newest.
    for node in 0..2 {
        network.process(node).kill();
    }
    let hasty = Options { deadline: Duration::from_secs(2), ..Options::default() };
    let nodes = vec![network.fleet.nodes[3].address.clone()];
    let learner = until("the learner is there", || async {
        Client::connect_with(nodes.clone(), network.owner.credentials().unwrap(), hasty).await.ok()
    })
    .await;
    assert_eq!(asked.stale_for, 0);
    let own = until("the learner says how old its answer is", || async {
        let own = learner.query_at(0, "abac", "robots", Vec::new()).await.ok()?;
        (own.stale_for >= 1_000_000).then_some(own)
    })
    .await;
    assert!(own.response == asked.response && own.time >= asked.time, "{own:?}");
    let there =
        Context { name: "there".into(), nodes: vec![network.fleet.nodes[3].address.clone()], ..network.owner.clone() };
    there.save(&network.fleet.home()).unwrap();
    let ran = network.fleet.ctl().as_("there").run(&["query", "--stale", "abac", "robots"]).ok();
    assert!(ran.stderr.contains("no contact with a leader for"), "{ran:?}");
    until("the learner says that nobody leads", || async {
        let refused = learner.query("abac", "robots", Vec::new()).await.unwrap_err();
        (refused.code == Code::NoLeader).then_some(())
    })
    .await;
    for node in 0..2 {
        network.nodes[node] = Some(network.fleet.nodes[node].start());
    }
    until("a leader confirms again", || async { learner.query("abac", "robots", Vec::new()).await.ok() }).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_admin_chooses_who_leads() {
    let network = Network::start();
    let owner = network.at(&network.owner, 3).await;
    let first = leader(&owner, 0).await.leader_id;
    let to = first % 3 + 1;
    // Asked at the learner: the client finds the leader.
    let chosen = transfer(&owner, to).await;
    assert_eq!(chosen.leader, to);
    // On a busy machine somebody else may be elected between the calls: the term tells.
    let again = until("it is already so", || async {
        let before = leader(&owner, 0).await;
        match owner.transfer_leadership(to).await {
            Ok(already) => Some(already),
            Err(refused) => {
                let after = leader(&owner, 0).await;
                let still = (before.leader_id, before.term) == (to, after.term);
                assert!(!still || is_for_a_moment(&refused), "{refused}");
                None
            }
        }
    })
    .await;
    assert_eq!(again.leader, to, "already so");
    let (before, best) = until("the leader hands over to another one", || async {
        let before = leader(&owner, 0).await;
        let best = transfer(&owner, 0).await;
        (best.term == before.term + 1).then_some((before, best))
    })
    .await;
    assert_ne!(best.leader, before.leader_id);
    assert!(best.term > chosen.term);
    assert_eq!(refusal(&owner, 4).await, Code::BadArgument, "a learner cannot lead");
    let salma = network.at(&network.salma, 3).await;
    assert_eq!(refusal(&salma, to).await, Code::NotAdmin);
}

/// Nobody leads for a moment, or the other node does not take over in time: on a busy machine, that may be.
fn is_for_a_moment(refused: &Rejection) -> bool {
    matches!(refused.code, Code::NoLeader | Code::Timeout)
}

/// Why somebody may not give the leadership to that node.
async fn refusal(somebody: &Client, to: u64) -> Code {
    until("it is refused", || async {
        let refused = somebody.transfer_leadership(to).await.unwrap_err();
        (!is_for_a_moment(&refused)).then_some(refused.code)
    })
    .await
}

/// Demands a transfer until the leader has led for long enough.
async fn transfer(admin: &Client, to: u64) -> Leadership {
    until("the leader may hand over", || async {
        match admin.transfer_leadership(to).await {
            Err(refused) if refused.code == Code::Overloaded || is_for_a_moment(&refused) => None,
            done => Some(done.unwrap()),
        }
    })
    .await
}

/// Somebody who publishes one message after the other.
struct Load {
    running: Arc<AtomicBool>,
    /// Longest time between two verdicts since it was looked at last, in microseconds.
    gap: Arc<AtomicU64>,
    user: JoinHandle<Vec<Committed>>,
}

impl Load {
    fn start(client: Client) -> Self {
        let (running, gap) = (Arc::new(AtomicBool::new(true)), Arc::new(AtomicU64::new(0)));
        let user = tokio::spawn({
            let (running, gap) = (Arc::clone(&running), Arc::clone(&gap));
            async move {
                let (mut done, mut last) = (Vec::new(), Instant::now());
                while running.load(Ordering::Relaxed) {
                    let seq = done.len() as u64;
                    done.push(client.invoke("abac", "set", message(0, seq + 1, &seq.to_be_bytes())).await.unwrap());
                    gap.fetch_max(last.elapsed().as_micros() as u64, Ordering::Relaxed);
                    last = Instant::now();
                }
                done
            }
        });
        Self { running, gap, user }
    }

    fn longest_gap(&self) -> Duration {
        Duration::from_micros(self.gap.swap(0, Ordering::Relaxed))
    }

    async fn finish(self) -> Vec<Committed> {
        self.running.store(false, Ordering::Relaxed);
        self.user.await.unwrap()
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_node_restarts_in_turn_and_a_client_goes_on_exactly_once() {
    let mut network = Network::start();
    let owner = network.from(&network.owner, 3).await;
    register_robots(&owner, "open").await;
    let load = Load::start(network.from(&network.salma, 1).await);
    let mut handed_over = 0;
    for node in [0, 1, 2] {
        for tries in 1.. {
            let leads = leader(&owner, 0).await.leader_id == node as u64 + 1;
            let before = network.process(node).stderr().len();
            network.process(node).interrupt();
            let log = network.process(node).stderr().split_off(before);
            let handed = log.matches("leadership transferred").count();
            handed_over += handed;
            network.restart(node, &owner).await;
            if !leads || handed > 0 {
                break;
            }
            // On a busy machine somebody else leads by then, or does not take over in time: it leads, and stops, once more.
            assert!(tries < 5, "a leader that stops hands over:\n{log}");
            transfer(&owner, node as u64 + 1).await;
        }
    }
    // The leader has changed while nodes stopped; the one that leads now stops as well.
    let leading = usize::try_from(leader(&owner, 0).await.leader_id - 1).unwrap();
    network.process(leading).interrupt();
    handed_over += 1;
    network.restart(leading, &owner).await;
    let rolling = load.longest_gap();
    for _ in 0..2 {
        let leading = usize::try_from(leader(&owner, 0).await.leader_id - 1).unwrap();
        network.process(leading).kill();
        leader(&owner, leading as u64 + 1).await;
        network.restart(leading, &owner).await;
    }
    let killing = load.longest_gap();
    let done = load.finish().await;
    let last = done.last().unwrap().height;
    for node in 0..4 {
        let observer = network.at(&network.owner, node).await;
        until("the node is at the last height", || async {
            (observer.status().await.ok()?.height >= last).then_some(())
        })
        .await;
        for committed in &done {
            let found = observer.transaction(committed.id).await.unwrap();
            assert_eq!((found.height, found.index), (committed.height, committed.index), "node {node}");
        }
    }
    let mut places: Vec<_> = done.iter().map(|committed| (committed.height, committed.index)).collect();
    assert!(places.is_sorted(), "one after the other");
    places.dedup();
    assert_eq!(places.len(), done.len(), "no two at one place");
    println!(
        "leadership: {} transactions; {handed_over} leaders stopped, longest gap {rolling:?}; 2 killed, longest gap {killing:?}",
        done.len()
    );
}
