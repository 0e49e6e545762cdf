//! The door of a process: it accepts TCP connections and completes TLS handshakes beside each other. It hands each
//! connection to the server of the ledger that the client means, together with the caller's identity.
//!
//! Nobody keeps the others out. Every connection is accepted at once; one that crowds the door pushes out another one of
//! its own address ([`ConnectionLimiter`]). Addresses from which members have come have places of their own. A connection without a
//! certificate can only enrol, and ends after [`STRANGER_TIME_MAX`].

use super::connection::{Connection, Staying};
use super::descriptors::Connections;
use super::ledgers::{Ledgers, Served};
use super::sources::Sources;
use crate::process::caller::{Caller, Members, Named, network_of};
use crate::process::connection_limiter::{ConnectionLimiter, Permit};
use ledger_api::tls::client_identity;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::{Instant, sleep, timeout};
use tokio_rustls::LazyConfigAcceptor;
use tokio_rustls::rustls::server::Acceptor;

/// Longest time that a handshake may take.
const HANDSHAKE_TIME_MAX: Duration = Duration::from_secs(5);
/// Longest time that a connection without a certificate may last: enrolling takes seconds.
const STRANGER_TIME_MAX: Duration = Duration::from_secs(60);
/// Of all places for handshakes, and for connections without a certificate, the part that one address may have.
const PART_OF_ONE: usize = 4;
/// Most connections of one identity.
const MEMBER_EACH_MAX: usize = 256;
/// Pause between two warnings that the door is crowded.
const WARNING_PAUSE: Duration = Duration::from_secs(10);
/// How long, and for how many bytes, a refused client is listened to until it closes its side.
const LINGER_TIME_MAX: Duration = Duration::from_millis(500);
const LINGER_BYTES_MAX: u64 = 64 * 1024;
/// Pause after the operating system refuses to accept, for example because all file descriptors are in use.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// The record of TLS that refuses a client which means no ledger of this listener: a fatal alert of this name, RFC 8446.
const UNRECOGNISED_NAME: [u8; 7] = [21, 3, 3, 0, 2, 2, 112];

/// The places of a listener.
struct Places {
    handshakes: Arc<ConnectionLimiter<IpAddr>>,
    known_handshakes: Arc<ConnectionLimiter<IpAddr>>,
    strangers: Arc<ConnectionLimiter<IpAddr>>,
    sources: Sources,
    /// When a warning said last that the door is crowded.
    warned: Mutex<Option<Instant>>,
}

impl Places {
    fn new(most: Connections) -> Self {
        Self {
            handshakes: ConnectionLimiter::new(most.handshakes, most.handshakes / PART_OF_ONE),
            known_handshakes: ConnectionLimiter::new(most.known_handshakes, most.known_handshakes),
            strangers: ConnectionLimiter::new(most.strangers, most.strangers / PART_OF_ONE),
            sources: Sources::default(),
            warned: Mutex::default(),
        }
    }

    /// A place for a handshake.
    fn handshake(&self, source: IpAddr) -> Permit<IpAddr> {
        let limiter = if self.sources.is_known(source) { &self.known_handshakes } else { &self.handshakes };
        let (permit, left) = limiter.enter(source);
        self.warn(left);
        permit
    }

    /// A place for a connection without a certificate.
    fn stranger(&self, source: IpAddr) -> Permit<IpAddr> {
        let (permit, left) = self.strangers.enter(source);
        self.warn(left);
        permit
    }

    fn warn(&self, left: Option<IpAddr>) {
        let Some(source) = left else { return };
        let mut warned = self.warned.lock().unwrap_or_else(PoisonError::into_inner);
        if warned.is_none_or(|warned| warned.elapsed() >= WARNING_PAUSE) {
            *warned = Some(Instant::now());
            tracing::warn!(%source, "too many connections without a certificate; closing the oldest ones of this \
                                     address");
        }
    }
}

/// The connections of the members of one ledger: so many together at most.
pub(crate) fn members(most: usize) -> Arc<Members> {
    ConnectionLimiter::new(most, MEMBER_EACH_MAX.min(most))
}

/// Accepts connections for these ledgers, as long as it is polled. A failed handshake is logged and costs nobody else
/// anything. Nothing is accepted while there is no ledger.
pub(super) async fn accept(listener: TcpListener, ledgers: Ledgers, most: Connections) {
    let places = Arc::new(Places::new(most));
    loop {
        ledgers.any().await;
        let (socket, address) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(error) => {
                tracing::warn!(%error, "cannot accept a connection");
                sleep(ACCEPT_PAUSE).await;
                continue;
            }
        };
        let (ledgers, places) = (ledgers.clone(), Arc::clone(&places));
        let mut permit = places.handshake(network_of(address.ip()));
        tokio::spawn(async move {
            let shaken = tokio::select! {
                biased;
                () = permit.over() => return tracing::debug!(%address, "connection closed: slot given to a newer one"),
                shaken = timeout(HANDSHAKE_TIME_MAX, handshake(socket, address.ip(), &ledgers, &places)) => shaken,
            };
            match shaken {
                Ok(Ok((served, connection))) => {
                    let to = match connection.caller.identity {
                        Some(_) => &served.members_established,
                        None => &served.strangers_established,
                    };
                    let _closing = to.send(Ok(connection)).await;
                }
                Ok(Err(reason)) => tracing::info!(%address, reason, "connection rejected"),
                Err(_) => {
                    tracing::info!(%address, limit_s = HANDSHAKE_TIME_MAX.as_secs(), "handshake timed out")
                }
            }
        });
    }
}

async fn handshake(
    socket: TcpStream,
    source: IpAddr,
    ledgers: &Ledgers,
    places: &Places,
) -> Result<(Served, Connection), String> {
    socket.set_nodelay(true).map_err(|error| error.to_string())?;
    let mut acceptor = LazyConfigAcceptor::new(Acceptor::default(), socket);
    let hello = match (&mut acceptor).await {
        Ok(hello) => hello,
        Err(error) => {
            if let Some(socket) = acceptor.take_io() {
                linger(socket).await;
            }
            return Err(error.to_string());
        }
    };
    let name = hello.client_hello().server_name().map(str::to_owned);
    let Some(served) = ledgers.find(name.as_deref()) else {
        let mut socket = hello.io;
        if socket.write_all(&UNRECOGNISED_NAME).await.is_ok() {
            linger(socket).await;
        }
        return Err(format!("no ledger of this listener has the name {name:?}"));
    };
    let stream = match hello.into_stream(Arc::clone(&served.tls)).into_fallible().await {
        Ok(stream) => stream,
        Err((error, socket)) => {
            linger(socket).await;
            return Err(error.to_string());
        }
    };
    let identity = client_identity(stream.get_ref().1.peer_certificates(), served.trust.as_ref())
        .map_err(|refusal| refusal.to_string())?;
    let caller = Caller { identity: identity.map(Arc::new), source };
    let staying = match &caller.identity {
        Some(identity) => {
            places.sources.note(network_of(source));
            Staying::Member(served.members.enter(Named(Arc::clone(identity))).0)
        }
        None => Staying::Stranger(places.stranger(network_of(source)), Box::pin(sleep(STRANGER_TIME_MAX))),
    };
    Ok((served, Connection { stream, caller, staying }))
}

/// Closes a refused connection so that the client can read the alert that says why. While bytes from it wait unread,
/// closing would reset the connection, and a reset discards bytes that the client has not read yet.
async fn linger(mut socket: TcpStream) {
    if socket.shutdown().await.is_err() {
        return;
    }
    let mut unread = (&mut socket).take(LINGER_BYTES_MAX);
    let _reset = timeout(LINGER_TIME_MAX, tokio::io::copy(&mut unread, &mut tokio::io::sink())).await;
}
