//! A byte stream that remembers how it broke.
//!
//! HTTP/2 hands a broken connection to each of its streams as a text without cause. The TLS alert in which a node
//! says what is wrong with our certificate would be lost; so it is noted here, below HTTP/2.

use rustls::AlertDescription;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

/// How a connection broke.
#[derive(Clone, Debug)]
pub(super) enum Fault {
    /// The other side ended it with a TLS alert.
    Alert(AlertDescription),
    /// Anything else, in words.
    Broken(String),
}

impl Fault {
    pub(super) fn of(error: &io::Error) -> Self {
        match error.get_ref().and_then(|inner| inner.downcast_ref()) {
            Some(rustls::Error::AlertReceived(alert)) => Self::Alert(*alert),
            _ => Self::Broken(error.to_string()),
        }
    }
}

/// Wraps a stream; the first fault while reading goes into `fault`.
pub(super) struct Watched<S> {
    stream: S,
    fault: Arc<Mutex<Option<Fault>>>,
}

impl<S> Watched<S> {
    pub(super) fn new(stream: S, fault: Arc<Mutex<Option<Fault>>>) -> Self {
        Self { stream, fault }
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Watched<S> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, to: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let read = Pin::new(&mut self.stream).poll_read(cx, to);
        if let Poll::Ready(Err(error)) = &read {
            self.fault.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_with(|| Fault::of(error));
        }
        read
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Watched<S> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, from: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(cx, from)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        from: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write_vectored(cx, from)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}
