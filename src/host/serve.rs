//! The services of an instance behind the host's listener.

use super::Host;
use super::ledgers::Place;
use crate::config::Limits;
use crate::enrolment::EnrolmentService;
use crate::gateway::GatewayService;
use crate::instance::count;
use crate::peers::PeerService;
use ledger::block::PAYLOAD_BYTES_MAX;
use ledger_api::tls::{TlsIdentity, TrustSource, server_config};
use ledger_api::v1::enrolment_server::EnrolmentServer;
use ledger_api::v1::gateway_server::GatewayServer;
use ledger_api::v1::peer_server::PeerServer;
use ledger_hash::Hash;
use ledger_raft::{PEER_MESSAGE_BYTES_MAX, PeerMessage};
use ledger_rejection::{Code, Rejection};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tonic::transport::Server;

/// Bytes of one stream, and of one connection, that may be on their way: enough for a fast link's delay.
const WINDOW_BYTES: (u32, u32) = (1 << 20, 4 << 20);
/// Space around the payload in a message.
const MESSAGE_EXTRA_BYTES: usize = 64 * 1024;
/// Time that open calls have to end when the node stops.
const STOP_TIME_MAX: Duration = Duration::from_millis(500);

/// Takes a message of another node; false when this one is stopping.
pub(crate) type Deliver = Box<dyn Fn(u64, PeerMessage) -> bool + Send + Sync>;

/// The services of an instance for clients and other nodes.
pub(crate) struct Services {
    /// For clients and bridges.
    pub(crate) gateway: GatewayService,
    /// The API of the CAs.
    pub(crate) enrolment: EnrolmentService,
    /// For other nodes.
    pub(crate) peer: PeerService<Deliver>,
    /// The callers that it accepts.
    pub(crate) trust: Arc<dyn TrustSource>,
}

/// A server that runs.
pub(super) struct Serving {
    place: Place,
    server: JoinHandle<()>,
    stop: watch::Sender<bool>,
}

impl Host {
    /// Serves this network with these services until it is told to stop. The server shows this certificate.
    ///
    /// # Errors
    /// [`Code::BadFile`] if certificate and key cannot be used; [`Code::BadConfiguration`] if the network is served by
    /// another node already.
    pub(super) fn serve(
        &self,
        network: Hash,
        identity: TlsIdentity,
        services: Services,
        limits: &Limits,
    ) -> Result<Serving, Rejection> {
        let Services { gateway, enrolment, peer, trust } = services;
        let server_tls = server_config(identity, Arc::clone(&trust))
            .map_err(|error| Rejection::new(Code::BadFile, error.to_string()))?;
        let (place, connections) = self.ledgers.enter(network, Arc::new(server_tls), trust)?;
        // More than is accepted: what is a little too large gets an answer that says so.
        let message_bytes_max = count(limits.payload_bytes_max).max(PAYLOAD_BYTES_MAX) + MESSAGE_EXTRA_BYTES;
        let (stop, mut stopping) = watch::channel(false);
        let server = Server::builder()
            .tcp_nodelay(true)
            .initial_stream_window_size(WINDOW_BYTES.0)
            .initial_connection_window_size(WINDOW_BYTES.1)
            .http2_keepalive_interval(Some(Duration::from_secs(5)))
            .http2_keepalive_timeout(Some(Duration::from_secs(5)))
            .add_service(GatewayServer::new(gateway).max_decoding_message_size(message_bytes_max))
            .add_service(EnrolmentServer::new(enrolment))
            .add_service(PeerServer::new(peer).max_decoding_message_size(PEER_MESSAGE_BYTES_MAX + MESSAGE_EXTRA_BYTES))
            .serve_with_incoming_shutdown(connections, async move {
                let _stopped = stopping.wait_for(|stop| *stop).await;
            });
        let server = tokio::spawn(async move {
            if let Err(error) = server.await {
                tracing::error!(%error, "the server ended");
            }
        });
        Ok(Serving { place, server, stop })
    }
}

impl Serving {
    /// Says when it stops.
    pub(super) fn stopping(&self) -> watch::Receiver<bool> {
        self.stop.subscribe()
    }

    /// Ends at once.
    pub(super) fn abort(&self) {
        self.server.abort();
    }

    /// No new calls; open ones have [`STOP_TIME_MAX`] to end.
    pub(super) async fn stop(self) {
        let Self { place, mut server, stop } = self;
        drop(place);
        stop.send_replace(true);
        if tokio::time::timeout(STOP_TIME_MAX, &mut server).await.is_err() {
            server.abort();
            let _aborted = server.await;
        }
    }
}
