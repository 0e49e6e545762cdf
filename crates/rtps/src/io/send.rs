//! Sends datagrams, and keeps a bounded number of those for which a socket has no room.

use super::sockets::SendSockets;
use super::sources::Hosts;
use crate::discovery::locators::GROUP;
use bytes::Bytes;
use std::collections::VecDeque;
use std::io::{self, ErrorKind};
use std::net::{Ipv4Addr, SocketAddrV4};
use std::task::{Context, Poll};
use tokio::net::UdpSocket;

/// Most bytes that wait for room in all sockets: one sample of the largest size. A large sample leaves in bursts that are faster than
/// most networks; without this a best-effort one would never arrive whole.
const WAITING_BYTES_MAX: usize = crate::limits::SAMPLE_BYTES_MAX + 1024 * 1024;

/// The sockets that send.
#[derive(Debug)]
pub(super) struct Senders {
    local: Outlet,
    remote: Outlet,
    multicast: Vec<Outlet>,
    /// The addresses of this host.
    host: Vec<Ipv4Addr>,
    /// To which it sends.
    hosts: Hosts,
    backlog: Backlog,
}

#[derive(Debug, Default)]
struct Backlog {
    /// Of the datagrams that wait; at most [`WAITING_BYTES_MAX`].
    bytes: usize,
    /// Datagrams that were not sent.
    dropped: u64,
}

impl Senders {
    /// Only within a runtime of tokio. `host`: the addresses of this host.
    pub(super) fn new(sockets: SendSockets, host: Vec<Ipv4Addr>, hosts: Hosts) -> io::Result<Self> {
        let SendSockets { local, remote, multicast } = sockets;
        let multicast = multicast.into_iter().map(Outlet::new).collect::<io::Result<_>>()?;
        Ok(Self {
            local: Outlet::new(local)?,
            remote: Outlet::new(remote)?,
            multicast,
            host,
            hosts,
            backlog: Backlog::default(),
        })
    }

    /// Sends a datagram, or lets it wait for room. Returns whether it is the first to wait in a socket: then
    /// [`Senders::poll_flush`] has to be polled.
    pub(super) fn send(&mut self, to: SocketAddrV4, datagram: &Bytes) -> bool {
        let Self { local, remote, multicast, host, hosts, backlog } = self;
        let address = *to.ip();
        if address == GROUP {
            let mut waits = false;
            for outlet in multicast {
                waits |= outlet.send(to, datagram, backlog);
            }
            return waits;
        }
        if address.is_loopback() || host.contains(&address) {
            return local.send(to, datagram, backlog);
        }
        if hosts.contains(address) {
            return remote.send(to, datagram, backlog);
        }
        backlog.dropped += 1;
        false
    }

    /// Sends what waits, as far as there is room. Pending until then; ready if nothing waits any more.
    pub(super) fn poll_flush(&mut self, context: &mut Context<'_>) -> Poll<()> {
        let Self { local, remote, multicast, backlog, .. } = self;
        // All are polled, so that each of them wakes the task.
        let polls = multicast.iter_mut().chain([local, remote]).map(|outlet| outlet.poll_flush(context, backlog));
        polls.fold(Poll::Ready(()), |all, one| if one.is_pending() { one } else { all })
    }

    /// How many datagrams were not sent so far: the network was too slow or unreachable, or the host is not one to send to.
    pub(super) fn dropped(&self) -> u64 {
        self.backlog.dropped
    }
}

/// A socket, and what waits for room in it.
#[derive(Debug)]
struct Outlet {
    socket: UdpSocket,
    waiting: VecDeque<(SocketAddrV4, Bytes)>,
}

impl Outlet {
    fn new(socket: std::net::UdpSocket) -> io::Result<Self> {
        Ok(Self { socket: UdpSocket::from_std(socket)?, waiting: VecDeque::new() })
    }

    /// Returns whether it is the first to wait.
    fn send(&mut self, to: SocketAddrV4, datagram: &Bytes, backlog: &mut Backlog) -> bool {
        // The order is kept: a HEARTBEAT must not pass the sample that it announces.
        let is_first = self.waiting.is_empty();
        if is_first && !self.is_full(to, datagram, backlog) {
            return false;
        }
        if backlog.bytes + datagram.len() > WAITING_BYTES_MAX {
            backlog.dropped += 1;
            return false;
        }
        backlog.bytes += datagram.len();
        self.waiting.push_back((to, datagram.clone()));
        is_first
    }

    fn poll_flush(&mut self, context: &mut Context<'_>, backlog: &mut Backlog) -> Poll<()> {
        while let Some((to, datagram)) = self.waiting.front() {
            if self.socket.poll_send_ready(context).is_pending() {
                return Poll::Pending;
            }
            if !self.is_full(*to, datagram, backlog) {
                backlog.bytes -= datagram.len();
                self.waiting.pop_front();
            }
        }
        Poll::Ready(())
    }

    /// Sends a datagram if there is room. One that cannot be sent at all is dropped, as UDP may do.
    fn is_full(&self, to: SocketAddrV4, datagram: &Bytes, backlog: &mut Backlog) -> bool {
        match self.socket.try_send_to(datagram, to.into()) {
            Ok(_) => false,
            Err(error) if error.kind() == ErrorKind::WouldBlock => true,
            Err(error) => {
                tracing::trace!(%to, %error, "a datagram was not sent");
                backlog.dropped += 1;
                false
            }
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use std::future::poll_fn;

    fn senders(hosts: Hosts) -> Senders {
        Senders::new(SendSockets::open(&[], true).unwrap(), Vec::new(), hosts).unwrap()
    }

    #[tokio::test]
    async fn datagrams_that_wait_for_room_are_sent_in_their_order() {
        let receiver = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
        let to = SocketAddrV4::new(Ipv4Addr::LOCALHOST, receiver.local_addr().unwrap().port());
        let mut senders = senders(Hosts::All);
        // A new socket is not known to be writable until the runtime has looked at it.
        let waits: Vec<bool> = (0..3).map(|number: u8| senders.send(to, &Bytes::from(vec![number]))).collect();
        assert_eq!(waits, [true, false, false], "the first one has to be flushed");
        poll_fn(|context| senders.poll_flush(context)).await;
        assert!(!senders.send(to, &Bytes::from_static(&[3])), "there is room now");
        assert_eq!(senders.backlog.bytes, 0);
        for number in 0..4 {
            let mut datagram = [0];
            receiver.recv_from(&mut datagram).await.unwrap();
            assert_eq!(datagram, [number]);
        }
        assert_eq!(senders.dropped(), 0);
    }

    #[tokio::test]
    async fn what_waits_is_bounded_in_bytes_and_the_rest_is_counted() {
        let mut senders = senders(Hosts::All);
        let to = SocketAddrV4::new(Ipv4Addr::LOCALHOST, 9);
        let datagram = Bytes::from(vec![0; 60_000]);
        let fit = WAITING_BYTES_MAX / datagram.len();
        for _ in 0..=fit {
            senders.send(to, &datagram);
        }
        assert_eq!((senders.dropped(), senders.local.waiting.len()), (1, fit));
    }

    #[tokio::test]
    async fn a_local_participant_sends_to_no_other_host() {
        let mut senders = senders(Hosts::new(true, &[], &[]));
        let elsewhere = SocketAddrV4::new(Ipv4Addr::new(192, 0, 2, 1), 7410);
        assert!(!senders.send(elsewhere, &Bytes::from_static(b"hello")));
        assert_eq!((senders.dropped(), senders.remote.waiting.len()), (1, 0));
    }
}
