#![expect(clippy::unwrap_used, reason = "tests")]

use super::*;
use crate::ordering::tests::built as ordering;
use ledger_base::rejection::Code;
use std::path::Path;
use tempfile::TempDir;

/// Ordering and trust of the only node of a network that was founded in this directory.
pub(crate) fn built(place: &Path) -> (Config, Arc<Ordering>, Arc<Trust>) {
    let (config, ordering) = ordering(place);
    let trust = Trust::new(&config, NodeCredentials::read(&config).unwrap(), &ordering).unwrap();
    (config, ordering, trust)
}

#[tokio::test]
async fn the_certificate_and_the_ledger_say_which_node_this_is() {
    let place = TempDir::new().unwrap();
    let (_, ordering, trust) = built(place.path());
    assert_eq!((trust.me.full_name().as_str(), trust.me.id), ("Org1/node1", 1));
    assert!(trust.joined.is_none(), "it has founded the network");
    assert!(trust.organisations.msps().get("Org1").is_some());
    assert!(
        trust.renewer(&ordering, &trust.enrolment(&ordering, "127.0.0.1:7450", || false, || 0)).data.ends_with("node1")
    );
}

#[tokio::test]
async fn a_configuration_of_another_node_is_refused() {
    let place = TempDir::new().unwrap();
    let (mut config, ordering) = ordering(place.path());
    config.member.node = "Org1/node2".into();
    let refused = Trust::new(&config, NodeCredentials::read(&config).unwrap(), &ordering).map(drop).unwrap_err();
    assert_eq!(refused.code, Code::BadConfiguration, "{refused}");
}
