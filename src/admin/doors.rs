//! The connections to the page: plain on loopback, TLS elsewhere. They are few and short.

use axum::serve::Listener;
use ledger_api::tls::{TlsIdentity, TrustSource, server_config};
use ledger_rejection::{Code, Rejection};
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio::task::JoinSet;
use tokio::time::{Sleep, sleep, timeout};
use tokio_rustls::TlsAcceptor;

/// Most connections at a time.
const OPEN_MAX: usize = 32;
/// Longest life of one. A program that watches connects again.
const LIFE_MAX: Duration = Duration::from_secs(60);
/// Longest handshake.
const HANDSHAKE_MAX: Duration = Duration::from_secs(5);
/// Pause after a fault of the listener, such as too few descriptors.
const FAULT_PAUSE: Duration = Duration::from_millis(100);

/// The connections that were accepted.
pub(super) struct Doors {
    address: SocketAddr,
    accepted: mpsc::Receiver<(Connection, SocketAddr)>,
    _accepting: JoinSet<()>,
}

impl Doors {
    /// Accepts what comes to the listener.
    ///
    /// # Errors
    /// [`Code::BadFile`] if the certificate cannot be used.
    pub(super) fn open(
        listener: TcpListener,
        address: SocketAddr,
        identity: TlsIdentity,
        trust: Arc<dyn TrustSource>,
    ) -> Result<Self, Rejection> {
        let tls = match address.ip().is_loopback() {
            true => None,
            false => {
                let mut config =
                    server_config(identity, trust).map_err(|error| Rejection::new(Code::BadFile, error.to_string()))?;
                config.alpn_protocols = vec![b"http/1.1".to_vec()];
                Some(TlsAcceptor::from(Arc::new(config)))
            }
        };
        let (entered, accepted) = mpsc::channel(1);
        let mut accepting = JoinSet::new();
        accepting.spawn(accept(listener, tls, entered));
        Ok(Self { address, accepted, _accepting: accepting })
    }
}

async fn accept(listener: TcpListener, tls: Option<TlsAcceptor>, entered: mpsc::Sender<(Connection, SocketAddr)>) {
    let places = Arc::new(Semaphore::new(OPEN_MAX));
    let mut handshakes = JoinSet::new();
    while let Ok(place) = Arc::clone(&places).acquire_owned().await {
        let Ok((stream, from)) = listener.accept().await else {
            sleep(FAULT_PAUSE).await;
            continue;
        };
        while handshakes.try_join_next().is_some() {}
        let (tls, entered) = (tls.clone(), entered.clone());
        handshakes.spawn(async move {
            if let Ok(Some(io)) = timeout(HANDSHAKE_MAX, secured(stream, tls)).await {
                let connection = Connection { io, ends: Box::pin(sleep(LIFE_MAX)), _place: place };
                let _stopped = entered.send((connection, from)).await;
            }
        });
    }
}

/// The connection after the handshake; none without a certificate of the network.
async fn secured(stream: TcpStream, tls: Option<TlsAcceptor>) -> Option<Box<dyn Duplex>> {
    let Some(tls) = tls else { return Some(Box::new(stream)) };
    let stream = tls.accept(stream).await.ok()?;
    stream.get_ref().1.peer_certificates()?;
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
pub(super) struct Connection {
    io: Box<dyn Duplex>,
    ends: Pin<Box<Sleep>>,
    _place: OwnedSemaphorePermit,
}

impl AsyncRead for Connection {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        if self.ends.as_mut().poll(cx).is_ready() {
            return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
        }
        Pin::new(&mut self.io).poll_read(cx, buffer)
    }
}

impl AsyncWrite for Connection {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        if self.ends.as_mut().poll(cx).is_ready() {
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
