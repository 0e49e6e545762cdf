//! The connections of pages over HTTP: plain or TLS, so many at a time, each for so long.

use crate::process::caller::network_of;
use crate::process::connection_limiter::{ConnectionLimiter, Permit};
use axum::extract::connect_info::Connected;
use axum::serve::{IncomingStream, Listener};
use ledger_base::rejection::{Code, Rejection};
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::{Sleep, sleep, timeout};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;

/// Longest handshake.
const HANDSHAKE_MAX: Duration = Duration::from_secs(5);
/// Pause after a fault of the listener, such as too few descriptors.
const FAULT_PAUSE: Duration = Duration::from_millis(100);

/// The room for connections, and how they are secured.
pub(crate) struct Room {
    /// Most connections at a time. One that is too many takes the place of the oldest of whoever has the most.
    pub(crate) all_max: usize,
    /// Most of one address.
    pub(crate) each_max: usize,
    /// Longest life of one.
    pub(crate) life_max: Duration,
    /// TLS; none for plain HTTP.
    pub(crate) tls: Option<ServerConfig>,
    /// Is a client without a certificate turned away?
    pub(crate) wants_certificate: bool,
}

/// The connections that were accepted.
pub(crate) struct Doors {
    address: SocketAddr,
    accepted: mpsc::Receiver<(Connection, SocketAddr)>,
    _accepting: JoinSet<()>,
}

/// Where a request comes from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Source(pub(crate) IpAddr);

impl Connected<IncomingStream<'_, Doors>> for Source {
    fn connect_info(stream: IncomingStream<'_, Doors>) -> Self {
        Self(stream.remote_addr().ip())
    }
}

impl Doors {
    /// Listens at `HOST:PORT`, for the page that this setting names.
    ///
    /// # Errors
    /// [`Code::BadConfiguration`] if nothing can listen there.
    pub(crate) async fn listen(address: &str, setting: &str) -> Result<(TcpListener, SocketAddr), Rejection> {
        let refused = |error: io::Error| {
            Rejection::new(Code::BadConfiguration, format!("cannot listen on {address}: {error}")).next(format!(
                "choose another address with the setting {setting}, or end the process that uses this one"
            ))
        };
        let listener = TcpListener::bind(address).await.map_err(refused)?;
        let address = listener.local_addr().map_err(refused)?;
        Ok((listener, address))
    }

    /// Accepts what comes to the listener.
    pub(crate) fn open((listener, address): (TcpListener, SocketAddr), room: Room) -> Self {
        let (entered, accepted) = mpsc::channel(1);
        let mut accepting = JoinSet::new();
        accepting.spawn(accept(listener, room, entered));
        Self { address, accepted, _accepting: accepting }
    }
}

async fn accept(listener: TcpListener, room: Room, entered: mpsc::Sender<(Connection, SocketAddr)>) {
    let Room { all_max, each_max, life_max, tls, wants_certificate } = room;
    let (limiter, tls) = (ConnectionLimiter::new(all_max, each_max), tls.map(|tls| TlsAcceptor::from(Arc::new(tls))));
    let mut handshakes = JoinSet::new();
    loop {
        let Ok((stream, from)) = listener.accept().await else {
            sleep(FAULT_PAUSE).await;
            continue;
        };
        while handshakes.try_join_next().is_some() {}
        let (mut permit, _left) = limiter.enter(network_of(from.ip()));
        let (tls, entered) = (tls.clone(), entered.clone());
        handshakes.spawn(async move {
            let secured = timeout(HANDSHAKE_MAX, secured(stream, tls, wants_certificate));
            let io = tokio::select! {
                secured = secured => secured.ok().flatten(),
                () = permit.over() => None,
            };
            if let Some(io) = io {
                let connection = Connection { io, ends: Box::pin(sleep(life_max)), permit };
                let _stopped = entered.send((connection, from)).await;
            }
        });
    }
}

/// The connection after the handshake; none without a certificate where one is wanted.
async fn secured(stream: TcpStream, tls: Option<TlsAcceptor>, wants_certificate: bool) -> Option<Box<dyn Duplex>> {
    stream.set_nodelay(true).ok()?;
    let Some(tls) = tls else { return Some(Box::new(stream)) };
    let stream = tls.accept(stream).await.ok()?;
    if wants_certificate {
        stream.get_ref().1.peer_certificates()?;
    }
    Some(Box::new(stream))
}

impl Listener for Doors {
    type Io = Connection;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Connection, SocketAddr) {
        match self.accepted.recv().await {
            Some(accepted) => accepted,
            // The task is gone, which happens when the page ends.
            None => std::future::pending().await,
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        Ok(self.address)
    }
}

/// Bytes in both directions.
trait Duplex: AsyncRead + AsyncWrite + Send + Unpin {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin> Duplex for T {}

/// A connection that has an end.
pub(crate) struct Connection {
    io: Box<dyn Duplex>,
    ends: Pin<Box<Sleep>>,
    permit: Permit<IpAddr>,
}

impl Connection {
    /// Has it come to its end, or been pushed out?
    fn is_over(&mut self, cx: &mut Context<'_>) -> bool {
        self.permit.poll_over(cx).is_ready() || self.ends.as_mut().poll(cx).is_ready()
    }
}

impl AsyncRead for Connection {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        if self.is_over(cx) {
            return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
        }
        Pin::new(&mut self.io).poll_read(cx, buffer)
    }
}

impl AsyncWrite for Connection {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        if self.is_over(cx) {
            return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
        }
        Pin::new(&mut self.io).poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_shutdown(cx)
    }
}
