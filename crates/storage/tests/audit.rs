//! The index of the audit against a plain list of rows: nothing is missing, nothing is made up, however it is asked.
#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use ledger_storage::audit::{Block, FOLDED_US, Holder, Index, Question, Row};
use ledger_storage::state::SledStore;
use proptest::prelude::*;
use std::path::Path;

const NAMES: [&str; 4] = ["Org1/Salma", "Org1/Farhad", "Org2/Admin", ""];
const ROBOTS: [&str; 3] = ["Husky", "Turtlebot4", ""];

fn open(place: &Path) -> Index {
    Index::open(Box::new(SledStore::open(place).unwrap())).unwrap()
}

/// A row of a block that follows `seconds` after the one before.
fn row() -> impl Strategy<Value = (u64, Row)> {
    (0..90u64, 0..4usize, 0..4usize, 0..3usize, 0..3u32, 0..4u8).prop_map(|(seconds, who, by, robot, code, kind)| {
        let decision = ["granted", "used", "refused", "released"][kind as usize].to_owned();
        let code = if decision == "refused" { 3001 + code } else { 0 };
        let robot = ROBOTS[robot].to_owned();
        let row = Row {
            decision,
            who: NAMES[who].into(),
            by: NAMES[by].into(),
            subject: robot.clone(),
            robot,
            code,
            count: 1,
            ..Row::default()
        };
        (seconds * 1_000_000, row)
    })
}

fn chain(rows: Vec<(u64, Row)>) -> Vec<Block> {
    let mut time = 1_800_000_000_000_000;
    let blocks = (1u64..).zip(rows).map(|(height, (after, row))| {
        time += after;
        let row = Row { time, height, first: time, last: time, last_height: height, ..row };
        Block { height, time, rows: vec![row], ..Block::default() }
    });
    blocks.collect()
}

/// All pages of an answer.
fn all(index: &Index, question: &Question) -> Vec<Row> {
    let (mut rows, mut question) = (Vec::new(), Question { most: 3, ..question.clone() });
    loop {
        let page = index.find(&question, |_| true).unwrap();
        rows.extend(page.rows);
        question.after = page.after;
        if !page.more {
            return rows;
        }
    }
}

fn total(rows: &[Row]) -> u64 {
    rows.iter().map(|row| row.count).sum()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn every_question_finds_what_a_look_at_all_rows_finds(
        rows in proptest::collection::vec(row(), 1..60),
        cut in 0..60usize,
        (who, robot, code, since, length) in (0..4usize, 0..3usize, 0..3u32, 0..1000u64, 0..1000u64),
    ) {
        let blocks = chain(rows);
        let (one, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let cut = cut.min(blocks.len());
        open(one.path()).add(&blocks[..cut]).unwrap();
        // A start between two blocks, perhaps within a minute.
        let index = open(one.path());
        for block in &blocks[cut..] {
            index.add(std::slice::from_ref(block)).unwrap();
        }
        // Made again from the beginning, it is the same.
        let again = open(other.path());
        again.add(&blocks).unwrap();
        let everything = Question::default();
        prop_assert_eq!(all(&index, &everything), all(&again, &everything));
        prop_assert_eq!(index.known(), again.known());
        prop_assert_eq!(total(&all(&index, &everything)), blocks.len() as u64, "nothing is lost");

        let begin = blocks[0].time + since * 1_000_000;
        let question = Question {
            user: NAMES[who].into(),
            robot: ROBOTS[robot].into(),
            code: if code == 0 { 0 } else { 3000 + code },
            organisation: if who == 3 { "Org1".into() } else { String::new() },
            since: begin,
            until: begin + length * 1_000_000,
            ..Question::default()
        };
        let wanted: Vec<Row> = all(&again, &everything).into_iter().filter(|row| {
            (question.user.is_empty() || row.identities().any(|name| name == question.user))
                && (question.robot.is_empty() || row.robot == question.robot)
                && (question.code == 0 || row.code == question.code)
                && (question.organisation.is_empty() || row.organisations().any(|name| name == question.organisation))
                && row.last >= question.since && row.first <= question.until
        }).collect();
        prop_assert_eq!(all(&index, &question), wanted);
    }
}

#[test]
fn commands_of_one_minute_are_one_row_and_refusals_that_a_node_tells_stay_as_it_told_them() {
    let place = tempfile::tempdir().unwrap();
    let index = open(place.path());
    let used =
        Row { decision: "used".into(), who: "Org1/Salma".into(), subject: "T/c".into(), count: 2, ..Row::default() };
    let told = Row { decision: "refused".into(), told_by: "Org1/node1".into(), count: 5, ..used.clone() };
    let minute = 30_000_000 * FOLDED_US;
    for (height, second) in [(1, 0), (2, 30), (3, 59), (4, 61)] {
        let time = minute + second * 1_000_000;
        let at = |row: &Row| Row { time, height, first: time, last: time, last_height: height, ..row.clone() };
        index.add(&[Block { height, time, rows: vec![at(&used), at(&told)], ..Block::default() }]).unwrap();
    }
    let rows = all(&index, &Question::default());
    let counts =
        |decision: &str| rows.iter().filter(|row| row.decision == decision).map(|row| row.count).collect::<Vec<_>>();
    assert_eq!((counts("used"), counts("refused")), (vec![6, 2], vec![5, 5, 5, 5]));
    assert_eq!((rows[0].height, rows[0].last_height), (1, 3));
}

#[test]
fn a_grant_names_the_policies_of_its_commands_and_old_rows_are_dropped_with_their_blocks() {
    let place = tempfile::tempdir().unwrap();
    let index = open(place.path());
    let grant = |epoch| Row {
        decision: "granted".into(),
        who: "Org1/Salma".into(),
        robot: "T".into(),
        subject: "T/c".into(),
        epoch,
        policy_version: epoch + 10,
        policies: vec!["day".into(), "night".into()],
        count: 1,
        ..Row::default()
    };
    let blocks: Vec<Block> = (1..=4000u64)
        .map(|height| Block {
            height,
            time: height * 1000,
            rows: vec![Row { time: height * 1000, height, last: height * 1000, ..grant(height) }],
            ..Block::default()
        })
        .collect();
    index.add(&blocks).unwrap();
    let (by, nobody) = (vec!["day".to_owned(), "night".to_owned()], (0, Vec::new()));
    assert_eq!(index.policies_of("T/c", 7).unwrap(), (17, by.clone()));
    assert_eq!(index.policies_of("T/c", 4001).unwrap(), nobody);
    while index.prune(3000, 3_000_000).unwrap() {}
    let known = index.known().unwrap();
    assert_eq!((known.from, known.height), (3000, 4000));
    let left = all(&index, &Question { robot: "T".into(), ..Question::default() });
    assert_eq!((left.len(), left[0].height), (1001, 3000));
    assert_eq!(index.policies_of("T/c", 2999).unwrap(), nobody);
    assert_eq!(index.policies_of("T/c", 3000).unwrap(), (3010, by));
    assert!(!index.prune(3000, 3_000_000).unwrap(), "nothing is left to drop");
}

#[test]
fn commands_without_a_grant_name_the_policies_that_permitted_them_also_after_a_start() {
    let place = tempfile::tempdir().unwrap();
    let row = |who: &str, decision: &str, policies: &[&str]| Row {
        decision: decision.into(),
        who: who.into(),
        robot: "T".into(),
        subject: "T/c".into(),
        policy_version: policies.len() as u64,
        policies: policies.iter().map(|id| (*id).to_owned()).collect(),
        count: 1,
        ..Row::default()
    };
    let used = |who: &str| row(who, "used", &[]);
    // All within a minute, and written in two turns.
    let turns = [
        vec![row("Org1/Salma", "permitted", &["day"]), used("Org1/Salma"), used("Org1/Farhad"), used("Org1/Salma")],
        vec![used("Org1/Salma"), row("Org1/Salma", "permitted", &["day", "rain"]), used("Org1/Salma")],
    ];
    for (height, rows) in (1u64..).zip(turns) {
        let time = 1_800_000_000_000_000 + height;
        let at = |row: Row| Row { time, height, first: time, last: time, last_height: height, ..row };
        let rows = rows.into_iter().map(at).collect();
        open(place.path()).add(&[Block { height, time, rows, ..Block::default() }]).unwrap();
    }
    let found = all(&open(place.path()), &Question::default());
    let used: Vec<_> = found
        .iter()
        .filter(|row| row.decision == "used")
        .map(|row| (row.who.as_str(), row.policies.join(" "), row.policy_version, row.count))
        .collect();
    let wanted = [
        ("Org1/Salma", "day".to_owned(), 1, 3),
        ("Org1/Farhad", String::new(), 0, 1),
        ("Org1/Salma", "day rain".to_owned(), 2, 1),
    ];
    assert_eq!(used, wanted);
}

#[test]
fn refusals_of_two_actions_on_one_service_are_two_rows() {
    let place = tempfile::tempdir().unwrap();
    let refused = |action: &str| Row {
        decision: "refused".into(),
        who: "Org1/Farhad".into(),
        subject: "T".into(),
        code: 3002,
        action: action.into(),
        count: 1,
        ..Row::default()
    };
    let rows = ["acquire", "stop", "acquire"].map(refused).into();
    let index = open(place.path());
    index.add(&[Block { height: 1, time: FOLDED_US, rows, ..Block::default() }]).unwrap();
    let rows = all(&index, &Question::default());
    let told: Vec<_> = rows.iter().map(|row| (row.action.as_str(), row.count)).collect();
    assert_eq!(told, [("acquire", 2), ("stop", 1)]);
}

#[test]
fn a_certificate_that_is_revoked_by_its_number_is_found_by_its_holder_also_after_a_start() {
    let place = tempfile::tempdir().unwrap();
    let revoked = |certificate: &'static [u8]| Row {
        decision: "revoked".into(),
        by: "Org1/Boss".into(),
        certificate: certificate.into(),
        count: 1,
        ..Row::default()
    };
    let holder = |certificate: &'static [u8], name: &str| Holder { certificate: certificate.into(), name: name.into() };
    let blocks = [
        (vec![holder(b"one", "Org1/Salma")], vec![revoked(b"one"), revoked(b"two")]),
        (vec![holder(b"two", "Org1/Farhad")], vec![]),
        (vec![], vec![revoked(b"two"), revoked(b"three")]),
    ];
    for (height, (holders, rows)) in (1u64..).zip(blocks) {
        let time = 1_800_000_000_000_000 + height;
        let at = |row: Row| Row { time, height, first: time, last: time, last_height: height, ..row };
        let rows = rows.into_iter().map(at).collect();
        open(place.path()).add(&[Block { height, time, rows, holders }]).unwrap();
    }
    let index = open(place.path());
    let of = |user: &str| all(&index, &Question { user: user.into(), ..Question::default() });
    let told = |user: &str| of(user).into_iter().map(|row| (row.height, row.who)).collect::<Vec<_>>();
    assert_eq!(told("Org1/Salma"), [(1, "Org1/Salma".to_owned())]);
    assert_eq!(told("Org1/Farhad"), [(3, "Org1/Farhad".to_owned())]);
    assert_eq!(of("Org1/Boss").len(), 4, "the author is found in each");
}

#[test]
fn an_index_of_another_form_is_refused() {
    let place = tempfile::tempdir().unwrap();
    let store = SledStore::open(place.path()).unwrap();
    ledger_storage::state::Store::write(&store, &Default::default(), (b"m", &[9; 32])).unwrap();
    let refused = Index::open(Box::new(store)).err().unwrap();
    assert_eq!(refused.code, ledger_base::rejection::Code::Corrupt);
}
