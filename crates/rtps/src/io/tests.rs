//! Participants over the sockets of this host. Each test has a domain of its own.

#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

mod warnings;

use super::*;
use crate::guid::SequenceNumber;
use crate::interface::{OutgoingSample, TopicDescription};
use crate::qos::{Qos, Reliability};
use std::time::Duration;
use tokio::time::timeout;

/// Beyond any time that a test needs.
const LONG: Duration = Duration::from_secs(20);
const LIMITS: QueueLimits = QueueLimits { bytes: 10_000_000, samples: 100 };

async fn join(domain: u16) -> Domain {
    let settings = DomainSettings {
        domain,
        only_local: true,
        interfaces: Some(vec![Ipv4Addr::LOCALHOST]),
        static_peers: Vec::new(),
        lease: Duration::from_secs(6),
        name: "test".to_owned(),
        user_data: Bytes::new(),
    };
    Domain::join(settings).await.unwrap()
}

fn endpoint() -> EndpointSettings {
    let topic = TopicDescription { name: "rt/x".to_owned(), type_name: "X_".to_owned(), keyed: false };
    let qos = Qos { reliability: Reliability::Reliable, ..Qos::default() };
    EndpointSettings { topic, qos, user_data: Bytes::new(), without_history: false }
}

fn sample(payload: Vec<u8>) -> OutgoingSample {
    OutgoingSample { payload: payload.into(), timestamp: None, related: None }
}

async fn matched(matches: &watch::Receiver<Matches>, count: usize) {
    let mut matches = matches.clone();
    timeout(LONG, matches.wait_for(|matches| matches.endpoints.len() == count)).await.unwrap().unwrap();
}

#[tokio::test]
async fn a_domain_out_of_range_is_not_joined() {
    let settings = DomainSettings {
        domain: 233,
        only_local: true,
        interfaces: None,
        static_peers: Vec::new(),
        lease: Duration::from_secs(6),
        name: String::new(),
        user_data: Bytes::new(),
    };
    assert_eq!(Domain::join(settings).await.unwrap_err().kind(), ErrorKind::InvalidInput);
}

#[tokio::test]
async fn samples_of_all_sizes_go_from_one_participant_to_another() {
    let [first, second] = [join(228).await, join(228).await];
    let writer = first.writer(endpoint()).unwrap();
    let mut reader = second.reader(endpoint(), LIMITS).unwrap();
    matched(writer.matches(), 1).await;
    matched(reader.matches(), 1).await;
    assert_eq!(second.endpoint(writer.guid()).unwrap().topic.name, "rt/x");
    assert_eq!(first.subscribers().iter().map(|reader| reader.guid).collect::<Vec<_>>(), [reader.guid()]);
    for (number, size) in [(1, 8), (2, 3_000_000)] {
        let payload: Vec<u8> = (0_u8..=250).cycle().take(size).collect();
        assert_eq!(writer.write(sample(payload.clone())).unwrap(), SequenceNumber(number));
        let received = timeout(LONG, reader.next()).await.unwrap().unwrap();
        assert_eq!((received.writer, received.sequence), (writer.guid(), SequenceNumber(number)));
        assert!(received.payload == payload, "{size} bytes");
        timeout(LONG, writer.acknowledged()).await.unwrap().unwrap();
        assert_eq!(writer.unacknowledged_bytes(), 0);
    }
    drop(writer);
    matched(reader.matches(), 0).await;
}

#[tokio::test]
async fn a_sample_above_the_limit_is_not_written() {
    let writer = join(227).await.writer(endpoint()).unwrap();
    let size = crate::limits::SAMPLE_BYTES_MAX + 1;
    assert_eq!(writer.write(sample(vec![0; size])), Err(WriteError::TooLarge(size)));
}

#[tokio::test]
async fn all_handles_report_the_end_of_the_domain() {
    let domain = join(230).await;
    let writer = domain.writer(endpoint()).unwrap();
    let mut reader = domain.reader(endpoint(), LIMITS).unwrap();
    let mut changes = domain.changes();
    domain.clone().end();
    assert!(changes.changed().await.is_err());
    assert!(reader.next().await.is_none());
    assert!(reader.matches().has_changed().is_err() && writer.matches().has_changed().is_err());
    assert_eq!(writer.write(sample(vec![0; 4])), Err(WriteError::Ended(Ended)));
    assert_eq!(domain.writer(endpoint()).unwrap_err(), Ended);
    assert!(domain.reader(endpoint(), LIMITS).is_err());
    assert_eq!((domain.publishers(), domain.subscribers()), (Vec::new(), Vec::new()));
    assert_eq!(domain.unsent(), Err(Ended));
}

#[test]
fn all_handles_report_that_their_runtime_has_ended() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let domain = runtime.block_on(join(226));
    assert!(domain.unsent().is_ok());
    drop(runtime);
    assert_eq!(domain.unsent(), Err(Ended));
}

#[tokio::test]
async fn a_domain_is_left_when_its_last_handle_is_dropped() {
    let domain = join(229).await;
    let other = domain.clone();
    drop(domain);
    assert!(other.unsent().is_ok());
    drop(other);
    // The task gives the ports back as soon as it has its turn.
    let ports_are_free = async {
        while ReceiveSockets::open(229, &[], None).unwrap().participant_id != 0 {
            tokio::task::yield_now().await;
        }
    };
    timeout(LONG, ports_are_free).await.unwrap();
}

#[test]
fn every_participant_has_a_prefix_of_its_own() {
    let [first, second] = [new_prefix().unwrap(), new_prefix().unwrap()];
    assert_ne!(first, second);
    assert_eq!(first.0.first_chunk(), Some(&VendorId::OWN.0));
}

#[test]
fn the_own_host_is_asked_without_multicast_and_only_once() {
    let peer = Ipv4Addr::new(10, 0, 0, 7);
    assert_eq!(with_own_host(&[Ipv4Addr::LOCALHOST, peer]), [Ipv4Addr::LOCALHOST, peer]);
}
