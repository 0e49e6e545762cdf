//! A link in user space: connections to a node through a relay that delivers late, as the model of the link says.

use crate::model::link::{Direction, Link};
use crate::model::noise::Noise;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use std::time::{Duration, Instant};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc;
use tokio::task::{JoinHandle, JoinSet};

/// Most bytes that cross the link as one segment.
const SEGMENT_BYTES_MAX: usize = 16 * 1024;
/// Most segments under way in one direction; beyond it the sender waits, as it does for a full window.
const SEGMENTS_MAX: usize = 4096;

/// A relay to a node. Dropping it cuts every connection.
pub(crate) struct Wire {
    /// Where it listens.
    pub address: String,
    relay: JoinHandle<()>,
}

impl Wire {
    /// Opens the link `name` to a node.
    pub(crate) async fn open(node: &str, link: Link, seed: u64, name: &str) -> Result<Self, Rejection> {
        let failed = |error: std::io::Error| {
            Rejection::new(Code::Internal, format!("no port on 127.0.0.1 for the link {name}: {error}"))
        };
        let listener = TcpListener::bind("127.0.0.1:0").await.map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?.to_string();
        let relay = tokio::spawn(relay(listener, node.to_owned(), link, Noise::named(seed, name)));
        Ok(Self { address, relay })
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        self.relay.abort();
    }
}

/// Takes connections; they end with it.
async fn relay(listener: TcpListener, node: String, link: Link, mut noise: Noise) {
    let mut connections = JoinSet::new();
    while let Ok((near, _)) = listener.accept().await {
        let directions = [(); 2].map(|()| Direction::new(link, noise.fork()));
        let node = node.clone();
        connections.spawn(async move {
            // A node that cannot be reached looks like one through any relay: the connection ends.
            if let Ok(far) = TcpStream::connect(node).await {
                connection(near, far, directions).await;
            }
        });
        while connections.try_join_next().is_some() {}
    }
}

async fn connection(near: TcpStream, far: TcpStream, [there, back]: [Direction; 2]) {
    // Without it the kernel holds small segments back, beyond what the model says.
    let _unchanged = (near.set_nodelay(true), far.set_nodelay(true));
    let ((near_read, near_write), (far_read, far_write)) = (near.into_split(), far.into_split());
    tokio::join!(carry(near_read, far_write, there), carry(far_read, near_write, back));
}

/// Carries one direction until its sender ends it, or its receiver is gone.
async fn carry(mut from: impl AsyncRead + Unpin, mut to: impl AsyncWrite + Unpin, mut direction: Direction) {
    let (sender, mut under_way) = mpsc::channel::<(Instant, Bytes)>(SEGMENTS_MAX);
    let began = Instant::now();
    let send = async move {
        let mut buffer = vec![0; SEGMENT_BYTES_MAX];
        while let Ok(bytes @ 1..) = from.read(&mut buffer).await {
            let due = began + Duration::from_secs_f64(direction.deliver(began.elapsed().as_secs_f64()));
            let segment = Bytes::copy_from_slice(buffer.get(..bytes).unwrap_or_default());
            if sender.send((due, segment)).await.is_err() {
                break;
            }
        }
    };
    let deliver = async move {
        while let Some((due, segment)) = under_way.recv().await {
            tokio::time::sleep_until(due.into()).await;
            if to.write_all(&segment).await.is_err() {
                break;
            }
        }
        let _closed = to.shutdown().await;
    };
    tokio::join!(send, deliver);
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[tokio::test]
    async fn bytes_arrive_whole_in_order_and_not_before_the_delay() {
        let node = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let link = Link { delay: 0.05, jitter: 0.002, loss: 0.02 };
        let wire = Wire::open(&node.local_addr().unwrap().to_string(), link, 1, "test").await.unwrap();
        let echo = tokio::spawn(async move {
            let (mut stream, _) = node.accept().await.unwrap();
            let (mut read, mut write) = stream.split();
            tokio::io::copy(&mut read, &mut write).await.unwrap()
        });
        let mut stream = TcpStream::connect(&wire.address).await.unwrap();
        let sent: Vec<u8> = (0..100_000_u32).map(|number| number as u8).collect();
        let began = Instant::now();
        stream.write_all(&sent).await.unwrap();
        stream.shutdown().await.unwrap();
        let mut received = Vec::new();
        stream.read_to_end(&mut received).await.unwrap();
        assert!(began.elapsed() >= Duration::from_millis(100), "there and back: {:?}", began.elapsed());
        assert!(received == sent, "{} bytes of {}", received.len(), sent.len());
        assert_eq!(echo.await.unwrap(), 100_000);
    }

    #[tokio::test]
    async fn a_node_that_is_gone_ends_the_connection() {
        let node = TcpListener::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap().to_string();
        let wire = Wire::open(&node, Link::WIFI, 1, "test").await.unwrap();
        let mut stream = TcpStream::connect(&wire.address).await.unwrap();
        assert_eq!(stream.read(&mut [0; 8]).await.unwrap_or_default(), 0);
    }
}
