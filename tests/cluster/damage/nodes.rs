//! Damage to one voter while the others go on: with the real program it catches up to the same digest, or it ends and
//! names file and byte.

use super::{FILL_A_SEGMENT, History};
use crate::audit::audit;
use crate::cluster::VOTERS;
use crate::load::Load;
use crate::rounds;
use crate::support::directory::copy;
use crate::support::network::NodePlace;
use crate::support::{Dice, until};
use ledger_storage::layout::STATE_DIRECTORY;
use std::fs;
use std::path::PathBuf;

/// The damage to the files of a voter that does not run.
#[derive(Clone, Copy, Debug)]
enum Damage {
    /// A bit in the oldest segment.
    BitInTheLog,
    /// A bit in the header of the newest segment.
    BitInAHeader,
    /// The last bytes of the log are gone: a torn write, or a lie of the disk.
    LogCut,
    /// A bit in the state store.
    BitInTheState,
    /// Half of the largest file of the state store is gone.
    StateCut,
    /// No state store.
    StateGone,
}

const ALL: [Damage; 6] = [
    Damage::BitInTheLog,
    Damage::BitInAHeader,
    Damage::LogCut,
    Damage::BitInTheState,
    Damage::StateCut,
    Damage::StateGone,
];

impl Damage {
    /// Damages the files; answers with the file.
    fn strike(self, place: &NodePlace, dice: &mut Dice) -> PathBuf {
        let segments = place.segments();
        let state = place.data.join(STATE_DIRECTORY);
        let largest = || {
            let files = super::state::files(&state);
            files.into_iter().max_by_key(|path| fs::metadata(path).unwrap().len()).unwrap()
        };
        let change = |path: &PathBuf, change: &mut dyn FnMut(&mut Vec<u8>)| {
            let mut content = fs::read(path).unwrap();
            change(&mut content);
            fs::write(path, content).unwrap();
            path.clone()
        };
        let written = |content: &[u8]| content.iter().rposition(|byte| *byte != 0).unwrap() as u64;
        match self {
            Self::BitInTheLog => change(&segments[0], &mut |content| {
                let end = written(content);
                content[dice.below(end) as usize] ^= 1 << dice.below(8);
            }),
            Self::BitInAHeader => change(segments.last().unwrap(), &mut |content| {
                content[dice.below(96) as usize] ^= 1 << dice.below(8);
            }),
            Self::LogCut => change(segments.last().unwrap(), &mut |content| {
                let end = written(content);
                content[(end - dice.below(40)) as usize..].fill(0);
            }),
            Self::BitInTheState => change(&largest(), &mut |content| {
                let end = written(content);
                content[dice.below(end) as usize] ^= 1 << dice.below(8);
            }),
            Self::StateCut => change(&largest(), &mut |content| content.truncate(content.len() / 2)),
            Self::StateGone => {
                fs::remove_dir_all(&state).unwrap();
                state
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_damaged_voter_catches_up_to_the_same_digest_or_ends_and_names_file_and_byte() {
    let mut dice = Dice::roll("damaged nodes");
    let History { mut cluster, .. } = History::new(FILL_A_SEGMENT).await;
    let load = Load::start(&cluster).await;
    let (mut strikes, mut caught_up, mut refused) = (0, 0, 0);
    for round in 0..rounds() {
        for damage in ALL {
            let (leader, _) = cluster.leader_among(&[0, 1, 2]).await;
            let victim = (leader + 1 + (round as usize % 2)) % VOTERS;
            load.more("before the damage", 5, &mut cluster).await;
            cluster.kill(victim);
            let place = &cluster.fleet.nodes[victim];
            let kept = cluster.fleet.path().join("kept");
            copy(&place.data, &kept);
            let path = damage.strike(place, &mut dice);
            let file = path.file_name().unwrap().to_string_lossy().into_owned();
            strikes += 1;
            let before = place.logged().len();
            cluster.start(victim);
            let target = cluster.observer(leader).status().await.unwrap().height;
            let what = format!("{damage:?} in {file}: the node catches up or ends");
            // A start does not read what is finished: it may come back, and ends as soon as it has found the damage.
            let came_back =
                cluster.reaches_or_ends(&what, victim, target).await && !matches!(damage, Damage::BitInTheLog);
            if came_back {
                caught_up += 1;
            } else {
                let mut process = cluster.ended(victim);
                let (status, log) = (process.wait(), process.stderr().split_off(before));
                assert_eq!(status.code(), Some(1), "{damage:?}: {log}");
                // What is cut off the end leaves no trace in the file: the others know that it was there.
                let named = matches!(damage, Damage::LogCut) || log.contains(&file);
                assert!(log.contains("LGR-50") && named, "{damage:?} in {file}: {log}");
                process.no_panic();
                refused += 1;
                // As the operator is told: from a copy.
                let place = &cluster.fleet.nodes[victim];
                if matches!(damage, Damage::BitInTheLog) {
                    // Only this file: the node may have acknowledged more since.
                    fs::copy(kept.join(path.strip_prefix(&place.data).unwrap()), &path).unwrap();
                } else {
                    fs::remove_dir_all(&place.data).unwrap();
                    copy(&kept, &place.data);
                }
                cluster.start(victim);
            }
            fs::remove_dir_all(&kept).unwrap();
            load.more("after the damage", 10, &mut cluster).await;
            until("the victim follows", || async { (cluster.status(victim).await?.height >= target).then_some(()) })
                .await;
        }
    }
    let told = load.finish().await;
    audit(&mut cluster, &told).await;
    println!(
        "faults injected: {strikes} damaged voters, {caught_up} caught up, {refused} refused with file and byte; \
         {} acknowledged transactions",
        told.acknowledged.len()
    );
    assert!(strikes > 0 && caught_up > 0 && refused > 0);
}
