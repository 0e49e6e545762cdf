//! Connections below the Rust client: bytes, TLS, single gRPC calls.

use hyper_util::rt::TokioIo;
use ledger_api::tls::{ServerTrust, TlsIdentity, client_config};
use ledger_api::v1::SubmitResponse;
use ledger_api::v1::gateway_client::GatewayClient;
use ledger_api::{Context, v1};
use std::io;
use std::sync::Arc;
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tonic::transport::{Channel, Endpoint, Uri};

/// A TLS connection to the node of a context, as that identity or as nobody.
pub async fn tls(context: &Context, named: bool) -> io::Result<TlsStream<TcpStream>> {
    let identity = named.then(|| TlsIdentity::new(context.chain.clone(), Arc::clone(&context.key)).unwrap());
    let config = client_config(identity, ServerTrust::Roots(Arc::clone(&context.msps))).unwrap();
    let socket = TcpStream::connect(&context.nodes[0]).await?;
    let name = rustls_pki_types::ServerName::try_from("node.test").unwrap();
    TlsConnector::from(Arc::new(config)).connect(name, socket).await
}

/// A gRPC channel over such a connection.
pub async fn channel(context: &Context, named: bool) -> Channel {
    let mut stream = Some(tls(context, named).await.unwrap());
    let connector = tower::service_fn(move |_: Uri| {
        std::future::ready(stream.take().map(TokioIo::new).ok_or_else(|| io::Error::other("closed")))
    });
    Endpoint::from_static("http://node.test").connect_with_connector(connector).await.unwrap()
}

/// Submits bytes that need be no transaction.
pub async fn submit(channel: &Channel, transaction: impl Into<bytes::Bytes>) -> Result<SubmitResponse, tonic::Status> {
    submit_from(channel, transaction, 0).await
}

/// As [`submit`], without the promise that no other node has it.
pub async fn submit_again(
    channel: &Channel,
    transaction: impl Into<bytes::Bytes>,
) -> Result<SubmitResponse, tonic::Status> {
    let request = v1::SubmitRequest { transaction: transaction.into(), ..v1::SubmitRequest::default() };
    GatewayClient::new(channel.clone()).submit(request).await.map(tonic::Response::into_inner)
}

/// As [`submit`], to be looked at from a height on.
pub async fn submit_from(
    channel: &Channel,
    transaction: impl Into<bytes::Bytes>,
    min_height: u64,
) -> Result<SubmitResponse, tonic::Status> {
    let request = v1::SubmitRequest { transaction: transaction.into(), min_height, first_attempt: true };
    let mut client = GatewayClient::new(channel.clone()).max_encoding_message_size(64 << 20);
    client.submit(request).await.map(tonic::Response::into_inner)
}

/// As [`submit_from`], on a stream, whose first answer it is.
pub async fn submit_on_stream(channel: &Channel, transaction: bytes::Bytes, min_height: u64) -> SubmitResponse {
    let request = v1::SubmitRequest { transaction, min_height, first_attempt: true };
    // The stream stays open, as that of a client does.
    let requests = tokio_stream::StreamExt::chain(tokio_stream::once(request), tokio_stream::pending());
    let answers = GatewayClient::new(channel.clone()).submit_stream(requests).await.unwrap();
    answers.into_inner().message().await.unwrap().unwrap()
}

/// The number of the code of an answer.
pub fn code(answer: &SubmitResponse) -> u32 {
    answer.verdict.as_ref().unwrap().code
}
