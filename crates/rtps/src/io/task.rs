//! The task of a domain: receives datagrams, and steps the participant when its deadline has come.

use super::membership::Membership;
use super::sources::Hosts;
use super::timer::Timer;
use crate::interface::{Channel, Input};
use crate::limits::DATAGRAM_BYTES_MAX;
use bytes::Bytes;
use std::future::poll_fn;
use std::io::{self, ErrorKind};
use std::net::SocketAddr;
use std::sync::{Arc, Weak};
use std::task::{Context, Poll};
use tokio::net::UdpSocket;
use tokio::task::yield_now;

/// Most datagrams that are taken from one socket before the others have their turn.
const BATCH: usize = 64;

/// Everything that the task owns.
#[derive(Debug)]
pub(super) struct Task {
    /// Weak, so that the domain is left when the last handle is gone.
    membership: Weak<Membership>,
    timer: Arc<Timer>,
    receivers: Vec<(Channel, UdpSocket)>,
    /// From which datagrams are taken. The filter in the kernel has looked at them before.
    hosts: Hosts,
}

/// Why the task was woken.
struct Woken {
    membership: Arc<Membership>,
    has_fired: bool,
}

impl Task {
    /// Only within a runtime of tokio.
    pub(super) fn new(
        membership: &Arc<Membership>,
        timer: Arc<Timer>,
        receivers: Vec<(Channel, std::net::UdpSocket)>,
        hosts: Hosts,
    ) -> io::Result<Self> {
        let registered = receivers.into_iter().map(|(channel, socket)| Ok((channel, UdpSocket::from_std(socket)?)));
        let receivers = registered.collect::<io::Result<_>>()?;
        Ok(Self { membership: Arc::downgrade(membership), timer, receivers, hosts })
    }

    /// Runs until the domain ends.
    pub(super) async fn run(mut self) {
        let mut buffer = vec![0; DATAGRAM_BYTES_MAX];
        while let Some(Woken { membership, has_fired }) = poll_fn(|context| self.poll_woken(context)).await {
            // Datagrams first: after the process stood still, those that wait renew the leases of others.
            let has_more = self.receive(&membership, &mut buffer);
            if has_fired && membership.fired().is_err() {
                break;
            }
            drop(membership);
            if has_more {
                yield_now().await;
            }
        }
    }

    /// Ready when there is something to do; with nothing after the end.
    fn poll_woken(&self, context: &mut Context<'_>) -> Poll<Option<Woken>> {
        let membership = self.membership.upgrade().filter(|membership| !membership.is_ended());
        let Some(membership) = membership else { return Poll::Ready(None) };
        // Pending or not: it wakes the task as long as something waits.
        let _ = membership.poll_flush(context);
        let has_fired = self.timer.poll_fired(context).is_ready();
        // All are polled, so that each of them wakes the task.
        let mut is_woken = has_fired;
        for (_, socket) in &self.receivers {
            is_woken |= matches!(socket.poll_recv_ready(context), Poll::Ready(Ok(())));
        }
        if is_woken { Poll::Ready(Some(Woken { membership, has_fired })) } else { Poll::Pending }
    }

    /// Takes what waits in the sockets. Returns whether there may be more.
    fn receive(&mut self, membership: &Membership, buffer: &mut [u8]) -> bool {
        let Self { receivers, hosts, .. } = self;
        let mut has_more = false;
        for (channel, socket) in receivers {
            has_more |= receive_batch(*channel, socket, hosts, membership, buffer);
        }
        has_more
    }
}

fn receive_batch(
    channel: Channel,
    socket: &UdpSocket,
    hosts: &mut Hosts,
    membership: &Membership,
    buffer: &mut [u8],
) -> bool {
    for _ in 0..BATCH {
        match socket.try_recv_from(buffer) {
            Ok((length, SocketAddr::V4(from))) if hosts.contains(*from.ip()) => {
                // A copy of exactly this size: what is kept of it is counted by its bytes, and must not keep more in memory.
                let bytes = Bytes::copy_from_slice(buffer.get(..length).unwrap_or_default());
                if membership.receive(Input::Datagram { from, channel, bytes }).is_err() {
                    return false;
                }
            }
            Ok((_, from)) => tracing::trace!(%from, "a datagram of another host was dropped"),
            Err(error) if error.kind() == ErrorKind::WouldBlock => return false,
            // Reading an error clears it. The socket stays usable, also where its interface went down.
            Err(error) => tracing::debug!(%error, "cannot receive a datagram"),
        }
    }
    true
}

impl Drop for Task {
    /// Also where the runtime stops or a step panicked: then no datagram is taken any more, and the handles report it.
    fn drop(&mut self) {
        if let Some(membership) = self.membership.upgrade() {
            membership.end();
        }
    }
}
