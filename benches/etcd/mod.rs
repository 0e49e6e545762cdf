//! etcd beside us: the same load as puts on a cluster of one or three nodes with mutual TLS, data on the same disk.
//! It verifies no signature per message and decides on no attributes; it is what a distributed log costs at least.
#![allow(dead_code, clippy::allow_attributes, reason = "each bench uses its own part")]

use crate::founding::bench_directory;
use bytes::Bytes;
use rcgen::{BasicConstraints, CertificateParams, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair};
use rustls::pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer, ServerName};
use rustls::{ClientConfig, RootCertStore};
use std::fs::{File, write};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tonic::client::Grpc;
use tonic::codegen::http::uri::PathAndQuery;
use tonic::transport::{Channel, Endpoint, Uri};
use tonic_prost::ProstCodec;

/// Time for a cluster to answer after it was started.
const START_TIME_MAX: Duration = Duration::from_secs(20);

/// `etcdserverpb.PutRequest`, as far as it is used here.
#[derive(Clone, PartialEq, prost::Message)]
struct PutRequest {
    #[prost(bytes = "bytes", tag = "1")]
    key: Bytes,
    #[prost(bytes = "bytes", tag = "2")]
    value: Bytes,
}

/// `etcdserverpb.PutResponse`; nothing of it is looked at.
#[derive(Clone, PartialEq, prost::Message)]
struct PutResponse {}

/// `etcdserverpb.StatusResponse`, as far as it is used here.
#[derive(Clone, PartialEq, prost::Message)]
struct StatusResponse {
    #[prost(message, optional, tag = "1")]
    header: Option<Header>,
    #[prost(uint64, tag = "4")]
    leader: u64,
}

#[derive(Clone, Copy, PartialEq, prost::Message)]
struct Header {
    #[prost(uint64, tag = "2")]
    member_id: u64,
}

/// A running cluster; its processes and directory end with it.
pub(crate) struct Etcd {
    processes: Vec<Child>,
    /// Where its leader is.
    leader: String,
    tls: Arc<ClientConfig>,
    value_bytes: usize,
    _directory: TempDir,
}

/// A client of its leader.
pub(crate) struct Puts {
    channel: Channel,
    value: Bytes,
    next: AtomicU64,
}

impl Etcd {
    /// The version that is installed; none if there is no etcd.
    pub(crate) fn version() -> Option<String> {
        let output = Command::new("etcd").arg("--version").output().ok()?;
        String::from_utf8(output.stdout).ok()?.lines().next().map(str::to_owned)
    }

    /// Starts a cluster and waits until it has a leader. Puts will have `value_bytes` bytes.
    pub(crate) async fn start(nodes: usize, value_bytes: usize) -> Self {
        let directory = tempfile::Builder::new().prefix("etcd").tempdir_in(bench_directory()).unwrap();
        let tls = certificates(directory.path());
        // All ports are held until all are known, so that they differ.
        let held: Vec<_> = (0..2 * nodes).map(|_| TcpListener::bind("127.0.0.1:0").unwrap()).collect();
        let urls: Vec<_> =
            held.iter().map(|port| format!("https://127.0.0.1:{}", port.local_addr().unwrap().port())).collect();
        drop(held);
        let cluster: Vec<_> = (0..nodes).map(|node| format!("n{node}={}", urls[2 * node + 1])).collect();
        let processes = (0..nodes).map(|node| {
            let log = File::create(directory.path().join(format!("n{node}.log"))).unwrap();
            let file = |name: &str| directory.path().join(name);
            let mut command = Command::new("etcd");
            command.arg("--name").arg(format!("n{node}")).arg("--data-dir").arg(file(&format!("n{node}")));
            for (option, url) in [("listen-client-urls", 0), ("advertise-client-urls", 0)]
                .into_iter()
                .chain([("listen-peer-urls", 1), ("initial-advertise-peer-urls", 1)])
            {
                command.arg(format!("--{option}={}", urls[2 * node + url]));
            }
            for peer in ["", "peer-"] {
                command.arg(format!("--{peer}client-cert-auth"));
                command.arg(format!("--{peer}trusted-ca-file={}", file("ca.pem").display()));
                command.arg(format!("--{peer}cert-file={}", file("node.pem").display()));
                command.arg(format!("--{peer}key-file={}", file("node.key").display()));
            }
            command.arg(format!("--initial-cluster={}", cluster.join(",")));
            command.stdin(Stdio::null()).stdout(log.try_clone().unwrap()).stderr(log).spawn().unwrap()
        });
        let processes: Vec<_> = processes.collect();
        let address = |node: usize| urls[2 * node].trim_start_matches("https://").to_owned();
        let deadline = Instant::now() + START_TIME_MAX;
        let leader = loop {
            let mut asked = None;
            for node in 0..nodes {
                if leads(&connect(address(node), Arc::clone(&tls)).await).await {
                    asked = Some(node);
                }
            }
            match asked {
                Some(node) => break address(node),
                None => assert!(Instant::now() < deadline, "etcd has no leader"),
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        };
        Self { processes, leader, tls, value_bytes, _directory: directory }
    }

    /// A client of the leader, on the runtime of the caller.
    pub(crate) async fn client(&self) -> Puts {
        let channel = connect(self.leader.clone(), Arc::clone(&self.tls)).await;
        Puts { channel, value: vec![7; self.value_bytes].into(), next: AtomicU64::new(0) }
    }

    /// The processes' ids.
    pub(crate) fn processes(&self) -> Vec<u32> {
        self.processes.iter().map(Child::id).collect()
    }
}

impl Puts {
    /// One put; keys repeat after a thousand, as robots do.
    pub(crate) fn put(&self) -> impl Future<Output = ()> + Send + 'static + use<> {
        let key = format!("robot/{}", self.next.fetch_add(1, Ordering::Relaxed) % 1000);
        let request = PutRequest { key: key.into(), value: self.value.clone() };
        let channel = self.channel.clone();
        async move {
            let PutResponse {} = call(&channel, "/etcdserverpb.KV/Put", request).await.unwrap();
        }
    }
}

/// Does the node at the other end lead?
async fn leads(channel: &Channel) -> bool {
    let status: Result<StatusResponse, _> = call(channel, "/etcdserverpb.Maintenance/Status", ()).await;
    status.is_ok_and(|status| status.leader != 0 && status.header.is_some_and(|of| of.member_id == status.leader))
}

async fn call<Q, A>(channel: &Channel, path: &'static str, request: Q) -> Result<A, tonic::Status>
where
    Q: prost::Message + Send + Sync + 'static,
    A: prost::Message + Default + Send + Sync + 'static,
{
    let mut client = Grpc::new(channel.clone());
    client.ready().await.map_err(|error| tonic::Status::unavailable(error.to_string()))?;
    let codec = ProstCodec::<Q, A>::default();
    client
        .unary(tonic::Request::new(request), PathAndQuery::from_static(path), codec)
        .await
        .map(tonic::Response::into_inner)
}

impl Drop for Etcd {
    fn drop(&mut self) {
        for process in &mut self.processes {
            let _gone = process.kill();
            let _status = process.wait();
        }
    }
}

async fn connect(address: String, tls: Arc<ClientConfig>) -> Channel {
    let connector = TlsConnector::from(tls);
    let dial = tower::service_fn(move |_: Uri| {
        let (connector, address) = (connector.clone(), address.clone());
        async move {
            let socket = TcpStream::connect(&address).await?;
            socket.set_nodelay(true)?;
            let name = ServerName::try_from("etcd.invalid").map_err(std::io::Error::other)?;
            Ok::<_, std::io::Error>(hyper_util::rt::TokioIo::new(connector.connect(name, socket).await?))
        }
    });
    Endpoint::from_static("http://etcd.invalid").connect_with_connector_lazy(dial)
}

/// Writes the files that nodes need; answers with the client's side.
fn certificates(directory: &Path) -> Arc<ClientConfig> {
    let authority_key = KeyPair::generate().unwrap();
    let mut authority = CertificateParams::new(Vec::new()).unwrap();
    authority.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    let root = authority.self_signed(&authority_key).unwrap();
    let issuer = Issuer::new(authority, authority_key);
    let key = KeyPair::generate().unwrap();
    let names = ["127.0.0.1", "localhost", "etcd.invalid"].map(str::to_owned).to_vec();
    let mut params = CertificateParams::new(names).unwrap();
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
    let certificate = params.signed_by(&key, &issuer).unwrap();
    write(directory.join("ca.pem"), root.pem()).unwrap();
    write(directory.join("node.pem"), certificate.pem()).unwrap();
    write(directory.join("node.key"), key.serialize_pem()).unwrap();
    let mut roots = RootCertStore::empty();
    roots.add(root.der().clone()).unwrap();
    let key = PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(key.serialize_der()));
    let mut config = ClientConfig::builder_with_provider(Arc::new(rustls::crypto::ring::default_provider()))
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_client_auth_cert(vec![CertificateDer::from(certificate.der().to_vec())], key)
        .unwrap();
    config.alpn_protocols = vec![b"h2".to_vec()];
    Arc::new(config)
}
