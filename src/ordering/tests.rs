#![expect(clippy::unwrap_used, reason = "tests")]

use super::*;
use crate::storage::tests::{founded, opened};
use ledger_base::rejection::Code;
use ledger_raft::Input;
use std::path::Path;
use tempfile::TempDir;

/// Ordering of the only node of a network that was founded in this directory, without an engine.
pub(crate) fn built(place: &Path) -> (Config, Arc<Ordering>) {
    let config = founded(place);
    let storage = opened(&config).unwrap();
    let ordering = Ordering::new(&config, &storage, Machine::start(), Meters::default()).unwrap();
    (config, ordering)
}

#[tokio::test]
async fn without_an_engine_calls_are_refused_and_nothing_is_handed_over() {
    let place = TempDir::new().unwrap();
    let (_, ordering) = built(place.path());
    let refused = ordering.slot.input(Input::ReadIndex { context: 1 }).unwrap_err();
    assert_eq!(refused.code, Code::Behind, "{refused}");
    ordering.hand_over().await;
    ordering.slot.stop();
    let refused = ordering.slot.input(Input::ReadIndex { context: 1 }).unwrap_err();
    assert_eq!(refused.code, Code::ShuttingDown, "{refused}");
}

#[tokio::test]
async fn the_members_are_those_of_the_ledger_and_what_is_executed_can_be_read() {
    let place = TempDir::new().unwrap();
    let (_, ordering) = built(place.path());
    assert_eq!(
        ordering.directory.members().iter().map(|member| member.full_name()).collect::<Vec<_>>(),
        ["Org1/node1"]
    );
    ordering.reads.reach_height(0).await.unwrap();
}
