//! Where the time goes: the parts of one command in flight beside the whole, in turns within one run.
//!
//! The parts take turns as they do in a commit, on processors that are awake, so each finds caches as the others left them.
//! And the disk is left alone between two writes for as long as by the whole: one that was left alone for longer answers
//! later. A bench of one part alone, over and over, shows neither.

use crate::World;
use crate::busy::Busy;
use crate::founding::{ONE_VOTER, PAPER};
use crate::network::{Network, Operator};
use crate::ordering::{Engines, Ordered};
use crate::report;
use serde_json::json;
use std::hint::spin_loop;
use std::sync::mpsc;
use std::time::{Duration, Instant};
use thread_priority::{
    NormalThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy, set_thread_priority_and_policy, thread_native_id,
};
use tokio::runtime::{Builder, Runtime};

/// Rounds of all parts and the whole.
const ROUNDS: usize = 10;
/// Measurements of each in a round.
const SAMPLES: usize = 200;
/// From the gateway to the order thread, which executes what comes alone, and back to the gateway.
const HAND_OVERS: u32 = 2;
/// How long a command may travel.
const TTL: Duration = Duration::from_secs(60);

/// One part: its name, how often a command in flight goes through it, how long it took each time.
struct Part {
    name: &'static str,
    times: u32,
    samples: Vec<Duration>,
}

/// Measures, prints the table and writes `target/bench/where_the_time_goes.json`.
pub(crate) fn where_the_time_goes(smoke: bool) {
    let (rounds, samples) = if smoke { (1, 2) } else { (ROUNDS, SAMPLES) };
    let mut bench = Bench::new();
    let mut parts = [
        ("sign: build, sign, encode", 1),
        ("gRPC over TLS: there and back, for a command that is known already", 1),
        ("admit: decode, identify, verify, simulate", 1),
        ("hand over to another thread", HAND_OVERS),
        ("order: a block, the log, commit, the message to the learner", 1),
        ("write and fdatasync", 1),
        ("execute", 1),
    ]
    .map(|(name, times)| Part { name, times, samples: Vec::new() });
    let (mut whole, mut alone) = (Vec::new(), Vec::new());
    for _ in 0..rounds {
        // The node keeps processors awake for itself.
        whole.extend((0..samples).map(|_| bench.whole(0)));
        alone.extend((0..samples).map(|_| bench.whole(1)));
        let awake = awake();
        let known = bench.known();
        let cycle = median(&whole);
        let [sign, network, admit, hand_over, order, write, execute] = &mut parts;
        for _ in 0..samples {
            sign.samples.push(bench.sign());
            network.samples.push(bench.ask_again(&known));
            admit.samples.push(bench.admit());
            hand_over.samples.push(bench.hand_over());
            let pause = cycle.saturating_sub(write.samples.last().copied().unwrap_or_default());
            let Ordered { engine, disk } = bench.order(pause);
            order.samples.push(engine);
            write.samples.push(disk);
            execute.samples.push(bench.execute());
        }
        drop(awake);
    }
    print(&parts, &whole, &alone, smoke);
}

fn print(parts: &[Part], whole: &[Duration], alone: &[Duration], smoke: bool) {
    let us = |time: Duration| time.as_secs_f64() * 1e6;
    let cost = |part: &Part| us(median(&part.samples)) * f64::from(part.times);
    println!("\none command in flight, voter and learner: where the time goes (medians, us)");
    for part in parts {
        println!("{:10.1}  {} x {}", cost(part), part.times, part.name);
    }
    let (whole, alone) = (us(median(whole)), us(median(alone)));
    // It writes, verifies and executes the same for itself while the next command is on its way.
    let learner = (whole - alone).max(0.0);
    println!("{learner:10.1}  1 x a learner on the same processors and disk: with it less without it");
    let sum = parts.iter().map(cost).sum::<f64>() + learner;
    println!("{sum:10.1}  the parts together: {:.0} % of the whole\n{whole:10.1}  the whole", 100.0 * sum / whole);
    if !smoke {
        let parts = parts.iter().map(|part| json!({ "part": part.name, "times": part.times, "us": cost(part) }));
        let parts: Vec<_> = parts.collect();
        report::write(
            "where_the_time_goes",
            &json!({ "parts": parts, "learner_us": learner, "sum_us": sum, "whole_us": whole }),
        );
    }
}

fn median(samples: &[Duration]) -> Duration {
    let mut sorted = samples.to_vec();
    sorted.sort_unstable();
    sorted[sorted.len() / 2]
}

fn time<T>(body: impl FnOnce() -> T) -> Duration {
    let start = Instant::now();
    std::hint::black_box(body());
    start.elapsed()
}

/// The tools that measure the parts, and the network of the whole.
struct Bench {
    world: World,
    engines: Engines,
    /// When the last write ended.
    written: Instant,
    echo: Echo,
    runtime: Runtime,
    /// With a learner, and without one.
    operators: [Operator; 2],
    _networks: [Network; 2],
}

impl Bench {
    fn new() -> Self {
        // The client on one thread: no wake-up but by the network.
        let runtime = Builder::new_current_thread().enable_all().build().unwrap();
        let networks = [PAPER, ONE_VOTER].map(|shape| runtime.block_on(Network::start(shape)));
        let operators = networks.each_ref().map(|network| runtime.block_on(network.operator("Husky")));
        Self {
            world: World::new(),
            engines: Engines::start(),
            written: Instant::now(),
            echo: Echo::start(),
            runtime,
            operators,
            _networks: networks,
        }
    }

    fn sign(&mut self) -> Duration {
        time(|| self.world.command())
    }

    fn admit(&mut self) -> Duration {
        let command = self.world.command();
        time(|| self.world.admit(&command))
    }

    fn execute(&mut self) -> Duration {
        let command = self.world.command();
        self.world.admit(&command);
        let entry = self.world.entry(&[command]);
        time(|| self.world.ledger.apply(&entry).unwrap())
    }

    fn hand_over(&self) -> Duration {
        time(|| self.echo.once()) / 2
    }

    /// Writes not before the disk was left alone for so long.
    fn order(&mut self, pause: Duration) -> Ordered {
        let (command, written) = (self.world.command(), self.written);
        let ordered = self.engines.order(command.encoded(), || {
            while written.elapsed() < pause {
                spin_loop();
            }
        });
        self.written = Instant::now();
        ordered
    }

    fn whole(&self, network: usize) -> Duration {
        time(|| self.runtime.block_on(self.operators[network].command()).unwrap())
    }

    /// A command that was executed: asked again, the node answers from what it knows.
    fn known(&self) -> ledger::transaction::Transaction {
        let command = self.operators[0].signed(TTL);
        self.runtime.block_on(self.operators[0].send(&command)).unwrap();
        command
    }

    fn ask_again(&self, known: &ledger::transaction::Transaction) -> Duration {
        time(|| self.runtime.block_on(self.operators[0].send(known)).unwrap())
    }
}

/// A thread that answers.
struct Echo {
    question: mpsc::SyncSender<()>,
    answer: mpsc::Receiver<()>,
}

impl Echo {
    fn start() -> Self {
        let (question, questions) = mpsc::sync_channel(1);
        let (answers, answer) = mpsc::sync_channel(1);
        std::thread::spawn(move || questions.iter().try_for_each(|()| answers.send(())));
        Self { question, answer }
    }

    fn once(&self) {
        self.question.send(()).unwrap();
        self.answer.recv().unwrap();
    }
}

/// Keeps all processors awake, as a node does while something is in flight.
pub(crate) fn awake() -> Busy {
    Busy::on_every_processor(|| {
        let idle = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Idle);
        set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Min, idle).unwrap();
    })
}
