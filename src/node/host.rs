//! A host: what the process gives to the ledgers that run in it. It listens at one address, and hands each connection to
//! the ledger that the client means.
//!
//! ```text
//! serve     the services of one ledger
//! ledgers   the ledgers behind the listener
//! door      TCP connections, and TLS handshakes beside each other
//!   sources      addresses from which members have come
//!   descriptors  how many connections there may be
//! ```

mod connection;
mod descriptors;
mod door;
mod ledgers;
mod serve;
mod sources;

pub(crate) use serve::Services;
pub(super) use serve::Serving;

use crate::process::caller::Members;
use crate::process::clock::Machine;
use descriptors::Connections;
use ledger_base::invariant::vital_task;
use ledger_base::rejection::{Code, Rejection};
use ledgers::Ledgers;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::Arc;
use tokio::net::TcpListener;
use tokio::task::JoinSet;

/// A listener, and the ledgers behind it. Clones share it; it ends with the last one.
///
/// A client names the network that it wants in the first message of TLS. While there is one ledger only, every client
/// gets that one.
#[derive(Clone)]
pub struct Host {
    /// The clocks of all ledgers.
    clocks: Machine,
    address: SocketAddr,
    ledgers: Ledgers,
    connections: Connections,
    accepting: Arc<JoinSet<()>>,
}

impl Host {
    /// Listens at this address, `HOST:PORT`. Connections wait until there is a ledger.
    ///
    /// # Errors
    /// [`Code::BadConfiguration`] if nothing can listen there.
    pub async fn listen(address: &str) -> Result<Self, Rejection> {
        let listener = TcpListener::bind(address).await.map_err(|error| {
            Rejection::new(Code::BadConfiguration, format!("cannot listen on {address}: {error}"))
                .next("choose another address with the setting listen, or end the process that uses this one")
        })?;
        Self::of(listener)
    }

    /// Listens on a socket that is bound already. To be called inside a runtime.
    ///
    /// # Errors
    /// [`Code::Internal`] if the socket is none that can be waited for.
    pub(crate) fn on(listener: std::net::TcpListener) -> Result<Self, Rejection> {
        let waitable = listener.set_nonblocking(true).and_then(|()| TcpListener::from_std(listener));
        Self::of(waitable.map_err(|error| Rejection::new(Code::Internal, error.to_string()))?)
    }

    fn of(listener: TcpListener) -> Result<Self, Rejection> {
        let address = listener.local_addr().map_err(|error| Rejection::new(Code::Internal, error.to_string()))?;
        let (ledgers, mut accepting) = (Ledgers::default(), JoinSet::new());
        let connections = descriptors::divide();
        accepting.spawn(vital_task(door::accept(listener, ledgers.clone(), connections)));
        Ok(Self { clocks: Machine::start(), address, ledgers, connections, accepting: Arc::new(accepting) })
    }

    /// Where it listens; the port is the real one where the address said 0.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The same, where an operator has confirmed the machine's clock.
    pub(crate) fn trusting_its_clock(mut self) -> Self {
        self.clocks.is_confirmed = true;
        self
    }

    /// The clocks of this machine.
    pub(crate) fn clocks(&self) -> Machine {
        self.clocks
    }

    /// Places for the members of one ledger.
    pub(crate) fn members(&self) -> Arc<Members> {
        door::members(self.connections.members)
    }

    /// Where this machine reaches the host.
    pub(crate) fn own_gateway(&self) -> String {
        reachable(self.address).to_string()
    }

    /// Ends the use of the host; the last one that leaves closes the listener.
    pub(super) async fn leave(self) {
        if let Some(mut accepting) = Arc::into_inner(self.accepting) {
            accepting.shutdown().await;
        }
    }
}

/// Where this machine reaches a node that may listen on all its addresses.
fn reachable(mut address: SocketAddr) -> SocketAddr {
    if address.ip().is_unspecified() {
        address.set_ip(if address.is_ipv4() { Ipv4Addr::LOCALHOST.into() } else { Ipv6Addr::LOCALHOST.into() });
    }
    address
}
