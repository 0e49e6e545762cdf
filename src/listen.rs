//! The node's door: accepts TCP connections, completes TLS handshakes beside each other, and hands the connections to
//! the gRPC server together with who is calling.

use ledger_api::tls::{TrustSource, client_identity};
use ledger_identity::Identity;
use std::io;
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, mpsc};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::server::Connected;

/// Longest time that a handshake may take.
const HANDSHAKE_TIME_MAX: Duration = Duration::from_secs(5);
/// Most handshakes at a time; more wait in the operating system's queue.
const HANDSHAKES_MAX: usize = 64;
/// Most connections that are established and not yet taken over by the server.
const ESTABLISHED_MAX: usize = 64;
/// How long, and for how many bytes, a refused client is listened to until it closes its side.
const LINGER_TIME_MAX: Duration = Duration::from_millis(500);
const LINGER_BYTES_MAX: u64 = 64 * 1024;
/// Pause after the operating system refuses to accept, for example because all file descriptors are in use.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// Who is calling; the extension of every request.
#[derive(Clone, Debug)]
pub(crate) struct Caller {
    /// The verified identity; none for a client without a certificate, which can only enrol.
    pub identity: Option<Arc<Identity>>,
    /// Where the connection comes from: who has no certificate is counted by this.
    pub source: IpAddr,
}

/// An established connection.
pub(crate) struct Connection {
    stream: TlsStream<TcpStream>,
    caller: Caller,
}

/// Accepts connections until the receiver is dropped. A failed handshake is logged and costs nobody else anything.
pub(crate) fn accept(
    listener: TcpListener,
    tls: TlsAcceptor,
    trust: Arc<dyn TrustSource>,
) -> ReceiverStream<io::Result<Connection>> {
    let (established, connections) = mpsc::channel(ESTABLISHED_MAX);
    tokio::spawn(async move {
        let handshakes = Arc::new(Semaphore::new(HANDSHAKES_MAX));
        loop {
            let Ok(permit) = Arc::clone(&handshakes).acquire_owned().await else { return };
            let (socket, address) = tokio::select! {
                accepted = listener.accept() => match accepted {
                    Ok(accepted) => accepted,
                    Err(error) => {
                        tracing::warn!(%error, "cannot accept a connection");
                        tokio::time::sleep(ACCEPT_PAUSE).await;
                        continue;
                    }
                },
                () = established.closed() => return,
            };
            let (tls, trust, established) = (tls.clone(), Arc::clone(&trust), established.clone());
            tokio::spawn(async move {
                match tokio::time::timeout(HANDSHAKE_TIME_MAX, handshake(socket, address.ip(), &tls, &*trust)).await {
                    Ok(Ok(connection)) => {
                        let _closing = established.send(Ok(connection)).await;
                    }
                    Ok(Err(reason)) => tracing::info!(%address, %reason, "connection refused"),
                    Err(_) => {
                        tracing::info!(%address, limit_s = HANDSHAKE_TIME_MAX.as_secs(), "the handshake took too long")
                    }
                }
                drop(permit);
            });
        }
    });
    ReceiverStream::new(connections)
}

async fn handshake(
    socket: TcpStream,
    source: IpAddr,
    tls: &TlsAcceptor,
    trust: &dyn TrustSource,
) -> Result<Connection, String> {
    socket.set_nodelay(true).map_err(|error| error.to_string())?;
    let stream = match tls.accept(socket).into_fallible().await {
        Ok(stream) => stream,
        Err((error, socket)) => {
            linger(socket).await;
            return Err(error.to_string());
        }
    };
    let identity =
        client_identity(stream.get_ref().1.peer_certificates(), trust).map_err(|refusal| refusal.to_string())?;
    Ok(Connection { stream, caller: Caller { identity: identity.map(Arc::new), source } })
}

/// Closes a refused connection so that the client can read the alert that says why: while bytes from it wait unread,
/// closing would reset the connection, and a reset discards what the client has not read yet.
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
