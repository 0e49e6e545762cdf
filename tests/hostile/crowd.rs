//! Connections that crowd the node's door: silent ones, ones without a certificate, ones of a revoked certificate.

use crate::support::connect;
use crate::support::wire;
use crate::target::Target;
use ledger_api::Context;
use ledger_identity::Role;
use ledger_identity::certificate::Certificate;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

/// The end of a connection, whichever way it comes.
async fn closed(stream: &mut (impl AsyncRead + Unpin)) {
    let mut byte = [0];
    loop {
        match stream.read(&mut byte).await {
            Ok(0) | Err(_) => return,
            Ok(_) => {}
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn connections_that_say_nothing_keep_nobody_out() {
    let mut target = Target::start().await;
    let address = target.salma.nodes[0].clone();
    // More than there are places for handshakes: the first ones lose theirs long before the deadline.
    let mut silent = Vec::new();
    for _ in 0..2_000 {
        silent.push(TcpStream::connect(&address).await.unwrap());
    }
    connect(&target.salma).await.status().await.unwrap();
    closed(&mut silent[0]).await;
    target.survived("two thousand silent connections").await;
    drop(silent);
    target.end("silence");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn connections_without_a_certificate_are_few_and_leave_the_disk_its_descriptors() {
    let mut target = Target::start().await;
    let files = |target: &Target| std::fs::read_dir(format!("/proc/{}/fd", target.node.id())).unwrap().count();
    let before = files(&target);
    let mut strangers = Vec::new();
    for _ in 0..600 {
        strangers.push(wire::tls(&target.salma, false).await.unwrap());
    }
    closed(&mut strangers[0]).await;
    assert!(files(&target) < before + 200, "{} descriptors, {before} before", files(&target));
    connect(&target.salma).await.status().await.unwrap();
    target.survived("six hundred connections without a certificate").await;
    drop(strangers);
    target.end("strangers");
}

/// The calls at a time that the node allows on a connection, from the settings with which it begins (RFC 9113, 6.5).
async fn calls_at_a_time(context: &Context, named: bool) -> Option<u32> {
    const MAX_CONCURRENT_STREAMS: u16 = 3;
    let mut stream = wire::tls(context, named).await.unwrap();
    stream.write_all(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0").await.unwrap();
    let mut head = [0; 9];
    stream.read_exact(&mut head).await.unwrap();
    assert_eq!(head[3], 4, "the first frame is SETTINGS");
    let mut settings = vec![0; usize::from(u16::from_be_bytes([head[1], head[2]]))];
    stream.read_exact(&mut settings).await.unwrap();
    let mut settings = settings.chunks_exact(6).map(|setting| {
        (u16::from_be_bytes([setting[0], setting[1]]), u32::from_be_bytes(setting[2..].try_into().unwrap()))
    });
    settings.find(|(name, _)| *name == MAX_CONCURRENT_STREAMS).map(|(_, value)| value)
}

#[tokio::test]
async fn without_a_certificate_a_connection_has_a_handful_of_calls() {
    let target = Target::start().await;
    let (stranger, member) =
        (calls_at_a_time(&target.salma, false).await.unwrap(), calls_at_a_time(&target.salma, true).await);
    assert!(stranger < 10 && member.is_none_or(|member| member > 100), "{stranger} {member:?}");
    target.end("calls");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_revoked_certificate_loses_its_connections_also_one_that_only_listens() {
    let mut target = Target::start().await;
    let farhad = target.fleet.issue("Org1", "Farhad", Role::Member, &[]);
    let mut listening = wire::tls(&farhad, true).await.unwrap();
    let mut other = wire::tls(&target.salma, true).await.unwrap();
    let certificate = Certificate::parse(&farhad.chain[0]).unwrap();
    let issuer = hex::encode(certificate.issuer_name.hash().0);
    let revoked = vec![issuer.into(), hex::encode(&certificate.serial).into()];
    connect(&target.admin).await.invoke("msp", "revoke", revoked).await.unwrap();
    closed(&mut listening).await;
    assert!(tokio::time::timeout(Duration::from_millis(100), closed(&mut other)).await.is_err(), "another identity's");
    target.survived("a revoked certificate").await;
    target.end("revocation");
}
