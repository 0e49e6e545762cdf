//! The services of an instance behind the host's listener.

use super::Host;
use super::ledgers::Listed;
use crate::clients::gateway::GatewayService;
use crate::clients::health;
use crate::clients::http::{self, Api, Names};
use crate::peers::service::PeerService;
use crate::process::caller::Members;
use crate::process::config::Limits;
use crate::process::config::count;
use crate::trust::enrolment::EnrolmentService;
use ledger::block::PAYLOAD_BYTES_MAX;
use ledger_api::tls::{TlsIdentity, TrustSource, server_config, server_name};
use ledger_api::v1::enrolment_server::EnrolmentServer;
use ledger_api::v1::gateway_server::GatewayServer;
use ledger_api::v1::peer_server::PeerServer;
use ledger_base::hash::Hash;
use ledger_base::invariant::vital_task;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::PEER_MESSAGE_BYTES_MAX;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tonic::service::Routes;
use tonic::transport::Server;

/// Bytes of one stream, and of one connection, that may be on their way: enough for a fast link's delay.
const WINDOW_BYTES: (u32, u32) = (1 << 20, 4 << 20);
/// The same of a client without a certificate, which only enrols.
const STRANGER_WINDOW_BYTES: (u32, u32) = (32 << 10, 64 << 10);
/// Calls at a time of a client without a certificate.
const STRANGER_CALLS_MAX: u32 = 4;
/// Most bytes of a message of such a client: a signing request and a secret take a few hundred.
const STRANGER_MESSAGE_BYTES_MAX: usize = 32 << 10;
/// Most bytes of the headers of a call of such a client.
const STRANGER_HEADER_BYTES_MAX: u32 = 8 << 10;
/// Most bytes of a message about enrolment: what tonic takes where nothing is said.
const ENROLMENT_BYTES_MAX: usize = 4 << 20;
/// Space around the payload in a message.
const MESSAGE_EXTRA_BYTES: usize = 64 * 1024;
/// Time that open calls have to end when the node stops.
const STOP_TIME_MAX: Duration = Duration::from_millis(500);

/// The services of an instance for clients and other nodes.
pub(crate) struct Services {
    /// For clients and bridges.
    pub(crate) gateway: GatewayService,
    /// The API of the CAs.
    pub(crate) enrolment: EnrolmentService,
    /// For other nodes.
    pub(crate) peer: PeerService,
    /// The callers that it accepts.
    pub(crate) trust: Arc<dyn TrustSource>,
    /// Those of them that are connected.
    pub(crate) members: Arc<Members>,
}

/// A server that runs.
pub(in crate::node) struct Serving {
    listed: Listed,
    server: JoinHandle<()>,
    stop: watch::Sender<bool>,
}

impl Host {
    /// Serves this network with these services until it is told to stop. The server shows this certificate.
    ///
    /// # Errors
    /// [`Code::BadFile`] if certificate and key cannot be used; [`Code::BadConfiguration`] if the network is served by
    /// another node already.
    pub(in crate::node) fn serve(
        &self,
        network: Hash,
        identity: TlsIdentity,
        services: Services,
        limits: &Limits,
    ) -> Result<Serving, Rejection> {
        let Services { gateway, enrolment, peer, trust, members } = services;
        let server_tls = server_config(identity, Arc::clone(&trust))
            .map_err(|error| Rejection::new(Code::BadFile, error.to_string()))?;
        let (listed, of_members, of_strangers) = self.ledgers.enter(network, Arc::new(server_tls), (trust, members))?;
        // More than is accepted: what is a little too large gets an answer that says so.
        let message_bytes_max = count(limits.payload_bytes_max).max(PAYLOAD_BYTES_MAX) + MESSAGE_EXTRA_BYTES;
        let (gateway, enrolment, peer) = (Arc::new(gateway), Arc::new(enrolment), Arc::new(peer));
        let services = |message_bytes_max: usize, peer_bytes_max: usize| {
            let gateway = GatewayServer::from_arc(Arc::clone(&gateway)).max_decoding_message_size(message_bytes_max);
            let peer = PeerServer::from_arc(Arc::clone(&peer)).max_decoding_message_size(peer_bytes_max);
            let enrolment = EnrolmentServer::from_arc(Arc::clone(&enrolment));
            (gateway, enrolment.max_decoding_message_size(message_bytes_max.min(ENROLMENT_BYTES_MAX)), peer)
        };
        let (stop, stopping) = watch::channel(false);
        let health = health::health(Arc::clone(&gateway.description), stopping.clone());
        let (reflection, reflection_alpha) = health::reflection()?;
        let (gateway_server, enrolment_server, peer_server) =
            services(message_bytes_max, PEER_MESSAGE_BYTES_MAX + MESSAGE_EXTRA_BYTES);
        let for_members = server(WINDOW_BYTES)
            .add_routes(routes(&gateway, &enrolment))
            .add_service(gateway_server)
            .add_service(enrolment_server)
            .add_service(peer_server)
            .add_service(health.clone())
            .add_service(reflection)
            .add_service(reflection_alpha)
            .serve_with_incoming_shutdown(of_members, told(stopping.clone()));
        // The same services, as all but one of their calls say that they want a certificate.
        let (gateway_server, enrolment_server, peer_server) =
            services(STRANGER_MESSAGE_BYTES_MAX, STRANGER_MESSAGE_BYTES_MAX);
        let for_strangers = server(STRANGER_WINDOW_BYTES)
            .max_concurrent_streams(STRANGER_CALLS_MAX)
            .http2_max_header_list_size(STRANGER_HEADER_BYTES_MAX)
            .add_routes(routes(&gateway, &enrolment))
            .add_service(gateway_server)
            .add_service(enrolment_server)
            .add_service(peer_server)
            .add_service(health)
            .serve_with_incoming_shutdown(of_strangers, told(stopping));
        let server = tokio::spawn(vital_task(async move {
            if let Err(error) = tokio::try_join!(for_members, for_strangers) {
                tracing::error!(%error, "server failed");
            }
        }));
        Ok(Serving { listed, server, stop })
    }
}

/// The HTTP API beside the services of gRPC.
fn routes(gateway: &Arc<GatewayService>, enrolment: &Arc<EnrolmentService>) -> Routes {
    let (node, network) = (&gateway.description.me, gateway.ledger().network());
    let tls_name = server_name(Some(&network)).map(|name| name.to_str().into_owned()).unwrap_or_default();
    let names = Names::new([node.name.clone(), http::host_of(&node.address).to_owned(), tls_name], true);
    let api = Api { gateway: Arc::clone(gateway), enrolment: Arc::clone(enrolment) };
    let mut routes = Routes::default();
    let grpc = std::mem::take(routes.axum_router_mut());
    *routes.axum_router_mut() = grpc.merge(http::for_certificates(http::router(api), names)).fallback(http::elsewhere);
    routes
}

/// A server with windows of so many bytes for each stream and for each connection.
fn server((stream_bytes, connection_bytes): (u32, u32)) -> Server {
    Server::builder()
        .tcp_nodelay(true)
        .initial_stream_window_size(stream_bytes)
        .initial_connection_window_size(connection_bytes)
        .http2_keepalive_interval(Some(Duration::from_secs(5)))
        .http2_keepalive_timeout(Some(Duration::from_secs(5)))
}

/// Waits until the server is to stop.
async fn told(mut stopping: watch::Receiver<bool>) {
    let _stopped = stopping.wait_for(|stop| *stop).await;
}

impl Serving {
    /// Says when it stops.
    pub(in crate::node) fn stopping(&self) -> watch::Receiver<bool> {
        self.stop.subscribe()
    }

    /// Ends at once.
    pub(in crate::node) fn abort(&self) {
        self.server.abort();
    }

    /// No new calls; open ones have [`STOP_TIME_MAX`] to end.
    pub(in crate::node) async fn stop(self) {
        let Self { listed, mut server, stop } = self;
        drop(listed);
        stop.send_replace(true);
        if tokio::time::timeout(STOP_TIME_MAX, &mut server).await.is_err() {
            server.abort();
            let _aborted = server.await;
        }
    }
}
