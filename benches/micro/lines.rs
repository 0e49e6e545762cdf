//! Lines: what joining one costs, what publishing costs beside it, and what the start of a block does, with few and with
//! many who wait.

use bytes::Bytes;
use criterion::{BatchSize, BenchmarkId, Criterion};
use ledger::{Chaincode, Context, Environment};
use ledger_identity::Role;
use std::hint::black_box;

use crate::access::{Fleet, NOW, OWNERS, identity, owner_name, robot_name, user_name};

/// Contenders for one service.
const LENGTHS: [usize; 4] = [0, 10, 100, 1000];
/// The owner allows as many.
const QUEUE: &str = r#"{"sharing":{"on_conflict":"queue","queue_max":1024,"queue_wait_max_ms":86400000}}"#;

impl Fleet {
    /// The robot of that number has a line, in which so many wait.
    fn wait_for(&self, robot: usize, contenders: usize) {
        let admin = identity(&owner_name(robot % OWNERS), "admin", Role::Admin, 0);
        self.call(&admin, "configure", vec![(robot_name(robot) + "/cmd_vel").into(), QUEUE.into()]);
        for number in 0..contenders {
            // A certificate of its own: it waits in a bounded number of lines.
            let serial = (robot * 10_000 + number + 1) as u64;
            let who = identity("Users", &format!("Waiter{robot}-{number}"), Role::Member, serial);
            self.call(&who, "acquire", vec![robot_name(robot).into()]);
        }
    }

    /// The start of a block after the call of that person.
    fn begin_block(&self, bencher: &mut criterion::Bencher<'_>, before: Option<(&str, &str)>) {
        let environment = |time| Environment { submitter: None, time, ..self.environment(&self.holders[0].0) };
        bencher.iter_batched(
            || {
                let mut overlay = self.overlay();
                if let Some((function, service)) = before {
                    self.invoke(&mut overlay, &self.holders[0].0, function, &[Bytes::from(service.to_owned())]);
                }
                overlay
            },
            |mut overlay| {
                let mut events = Vec::new();
                let mut ctx = Context::new(environment(NOW + 1), "abac", &mut overlay, &mut events);
                self.abac.begin_block(&mut ctx);
                black_box(events.len())
            },
            BatchSize::SmallInput,
        );
    }
}

/// One service, with more and more who wait for it.
pub(crate) fn one_service(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("line");
    for length in LENGTHS {
        let mut fleet = Fleet::made(10);
        fleet.wait_for(0, length);
        fleet.store();
        let (who, service, epoch) = fleet.holders[0].clone();
        let (mut overlay, mut events) = (fleet.overlay(), Vec::new());
        group.bench_function(BenchmarkId::new("publish", length), |bencher| {
            let ctx = Context::new(fleet.environment(&who), "abac", &mut overlay, &mut events);
            bencher.iter(|| fleet.abac.may_publish(&ctx, black_box(&service), epoch).unwrap());
        });
        let newcomer = identity("Users", &user_name(7), Role::Member, 9);
        group.bench_function(BenchmarkId::new("join", length), |bencher| {
            let args = [Bytes::from(service.clone())];
            bencher.iter_batched(
                || fleet.overlay(),
                |mut overlay| fleet.invoke(&mut overlay, &newcomer, "acquire", &args),
                BatchSize::SmallInput,
            );
        });
        group.bench_function(BenchmarkId::new("turn", length), |bencher| {
            fleet.begin_block(bencher, Some(("release", &service)));
        });
    }
    group.finish();
}

/// 1000 robots with a line each, and nothing to do.
pub(crate) fn many_services(criterion: &mut Criterion) {
    let mut fleet = Fleet::made(10);
    for robot in 0..fleet.holders.len() {
        fleet.wait_for(robot, 1);
    }
    fleet.store();
    criterion.bench_function("line/idle_block_1000_lines", |bencher| fleet.begin_block(bencher, None));
}
