//! The door of a process: it accepts TCP connections and completes TLS handshakes beside each other. It hands each
//! connection to the server of the ledger that the client means, together with the caller's identity.

use super::ledgers::{Ledgers, Served};
use ledger_api::tls::client_identity;
use ledger_identity::Identity;
use std::io;
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio_rustls::LazyConfigAcceptor;
use tokio_rustls::rustls::server::Acceptor;
use tokio_rustls::server::TlsStream;
use tonic::transport::server::Connected;

/// Longest time that a handshake may take.
const HANDSHAKE_TIME_MAX: Duration = Duration::from_secs(5);
/// Most handshakes at a time; more wait in the operating system's queue.
const HANDSHAKES_MAX: usize = 64;
/// How long, and for how many bytes, a refused client is listened to until it closes its side.
const LINGER_TIME_MAX: Duration = Duration::from_millis(500);
const LINGER_BYTES_MAX: u64 = 64 * 1024;
/// Pause after the operating system refuses to accept, for example because all file descriptors are in use.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// The record of TLS that refuses a client which means no ledger of this listener: a fatal alert of this name, RFC 8446.
const UNRECOGNISED_NAME: [u8; 7] = [21, 3, 3, 0, 2, 2, 112];

/// The caller; the extension of every request.
#[derive(Clone, Debug)]
pub(crate) struct Caller {
    /// The verified identity; none for a client without a certificate, which can only enrol.
    pub identity: Option<Arc<Identity>>,
    /// Where the connection comes from: who has no certificate is counted by this.
    pub source: IpAddr,
}

/// An established connection.
pub(super) struct Connection {
    stream: TlsStream<TcpStream>,
    caller: Caller,
}

/// Accepts connections for these ledgers, as long as it is polled. A failed handshake is logged and costs nobody else
/// anything. Nothing is accepted while there is no ledger.
pub(super) async fn accept(listener: TcpListener, ledgers: Ledgers) {
    let handshakes = Arc::new(Semaphore::new(HANDSHAKES_MAX));
    loop {
        let Ok(permit) = Arc::clone(&handshakes).acquire_owned().await else { return };
        ledgers.any().await;
        let (socket, address) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(error) => {
                tracing::warn!(%error, "cannot accept a connection");
                tokio::time::sleep(ACCEPT_PAUSE).await;
                continue;
            }
        };
        let ledgers = ledgers.clone();
        tokio::spawn(async move {
            match tokio::time::timeout(HANDSHAKE_TIME_MAX, handshake(socket, address.ip(), &ledgers)).await {
                Ok(Ok((served, connection))) => {
                    let _closing = served.established.send(Ok(connection)).await;
                }
                Ok(Err(reason)) => tracing::info!(%address, %reason, "connection refused"),
                Err(_) => {
                    tracing::info!(%address, limit_s = HANDSHAKE_TIME_MAX.as_secs(), "the handshake took too long")
                }
            }
            drop(permit);
        });
    }
}

async fn handshake(socket: TcpStream, source: IpAddr, ledgers: &Ledgers) -> Result<(Served, Connection), String> {
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
        return Err(format!("no ledger of this listener is meant by the name {name:?}"));
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
    Ok((served, Connection { stream, caller }))
}

/// Closes a refused connection so that the client can read the alert that says why. While bytes from it wait unread,
/// closing would reset the connection, and a reset discards bytes that the client has not read yet.
async fn linger(mut socket: TcpStream) {
    if socket.shutdown().await.is_err() {
        return;
    }
    let mut unread = (&mut socket).take(LINGER_BYTES_MAX);
    let _reset = tokio::time::timeout(LINGER_TIME_MAX, tokio::io::copy(&mut unread, &mut tokio::io::sink())).await;
}

impl Connected for Connection {
    type ConnectInfo = Caller;

    fn connect_info(&self) -> Caller {
        self.caller.clone()
    }
}

impl AsyncRead for Connection {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.get_mut().stream).poll_read(cx, buf)
    }
}

impl AsyncWrite for Connection {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.get_mut().stream).poll_write(cx, buf)
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.get_mut().stream).poll_write_vectored(cx, bufs)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.get_mut().stream).poll_flush(cx)
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.get_mut().stream).poll_shutdown(cx)
    }
}
