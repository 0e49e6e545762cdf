//! Questions to the index of the audit.

use criterion::Criterion;
use ledger_storage::audit::{Block, FOLDED_US, Index, Question, Row};
use ledger_storage::state::SledStore;
use std::hint::black_box;

/// Minutes of use by three robots: ten million blocks at 50 a second take 3334 of them. Here are thirty times as many.
const MINUTES: u64 = 100_000;
/// Minutes that are written at once.
const AT_ONCE: u64 = 1000;
/// The block time at which it begins, microseconds.
const BEGINS: u64 = 30_000_000 * FOLDED_US;
const BLOCKS_PER_MINUTE: u64 = 3000;

fn row(minute: u64, robot: u64, decision: &str) -> Row {
    let (time, height) = (BEGINS + minute * FOLDED_US, 1 + minute * BLOCKS_PER_MINUTE);
    let who = format!("Org1/Operator{}", (minute / 60 + robot) % 50);
    Row {
        time,
        height,
        decision: decision.into(),
        who,
        robot: format!("Robot{robot}"),
        subject: format!("Robot{robot}/cmd_vel"),
        code: if decision == "refused" { 3005 } else { 0 },
        count: BLOCKS_PER_MINUTE,
        first: time,
        last: time + FOLDED_US - 1,
        last_height: height + BLOCKS_PER_MINUTE - 1,
        epoch: 1 + minute / 60,
        ..Row::default()
    }
}

fn block(minute: u64) -> Block {
    let mut rows: Vec<Row> = (0..3).map(|robot| row(minute, robot, "used")).collect();
    if minute.is_multiple_of(60) {
        rows.extend((0..3).map(|robot| row(minute, robot, "granted")));
        rows.push(row(minute, 1, "refused"));
    }
    Block { height: 1 + minute * BLOCKS_PER_MINUTE, time: BEGINS + minute * FOLDED_US, rows, ..Block::default() }
}

pub(super) fn questions(criterion: &mut Criterion) {
    let place = tempfile::tempdir().unwrap();
    let index = Index::open(Box::new(SledStore::open(place.path()).unwrap())).unwrap();
    for first in (0..MINUTES).step_by(AT_ONCE as usize) {
        let blocks: Vec<Block> = (first..first + AT_ONCE).map(block).collect();
        index.add(&blocks).unwrap();
    }
    let at = |minute: u64| BEGINS + minute * FOLDED_US;
    let page = Question { most: 1000, ..Question::default() };
    let questions = [
        (
            "one_robot_five_minutes",
            Question { robot: "Robot1".into(), since: at(50_000), until: at(50_005), ..page.clone() },
        ),
        (
            "one_user_a_day",
            Question { user: "Org1/Operator7".into(), since: at(50_000), until: at(51_440), ..page.clone() },
        ),
        ("one_code_a_month", Question { code: 3005, since: at(50_000), until: at(93_200), ..page.clone() }),
        ("everybody_five_minutes", Question { since: at(50_000), until: at(50_005), ..page }),
    ];
    let mut group = criterion.benchmark_group("audit");
    for (name, question) in questions {
        group.bench_function(name, |bencher| {
            bencher.iter(|| black_box(index.find(&question, |_| true).unwrap().rows.len()));
        });
    }
    group.finish();
}
