//! The floor: what any signed, durable answer costs at least. A client signs and sends a message over mutual TLS 1.3, a
//! server verifies it, writes it with `fdatasync` into space that was written before, and answers. No ordering, no
//! framing, no access decision, no execution, one thread at each end.
#![allow(dead_code, clippy::allow_attributes, reason = "each bench uses its own part")]

use crate::founding::bench_directory;
use rcgen::{BasicConstraints, CertificateParams, IsCa, Issuer, KeyPair};
use ring::signature::{ED25519, Ed25519KeyPair, KeyPair as _, UnparsedPublicKey};
use rustls::pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer, ServerName};
use rustls::server::WebPkiClientVerifier;
use rustls::{ClientConfig, ClientConnection, RootCertStore, ServerConfig, ServerConnection, StreamOwned};
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::FileExt;
use std::sync::Arc;
use std::thread::JoinHandle;

/// Bytes of the signature at the end of a message.
const SIGNATURE_BYTES: usize = 64;
/// Bytes of an answer: about those of a verdict.
const ANSWER_BYTES: usize = 64;
/// Space that is written beforehand, as the log does.
const ZEROED_BYTES: usize = 16 << 20;

/// A client and its server; the server ends with it.
pub(crate) struct Floor {
    stream: Option<StreamOwned<ClientConnection, TcpStream>>,
    key: Ed25519KeyPair,
    message: Vec<u8>,
    server: Option<JoinHandle<()>>,
}

impl Floor {
    /// For messages of so many bytes, signature included.
    pub(crate) fn new(message_bytes: usize) -> Self {
        let document = Ed25519KeyPair::generate_pkcs8(&ring::rand::SystemRandom::new()).unwrap();
        let key = Ed25519KeyPair::from_pkcs8(document.as_ref()).unwrap();
        let public = key.public_key().as_ref().to_vec();
        let (client_tls, server_tls) = mutual_tls();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let server = std::thread::spawn(move || serve(&listener, server_tls, &public, message_bytes));
        let socket = TcpStream::connect(address).unwrap();
        socket.set_nodelay(true).unwrap();
        let name = ServerName::try_from("floor.invalid").unwrap();
        let stream = StreamOwned::new(ClientConnection::new(client_tls, name).unwrap(), socket);
        let mut floor = Self { stream: Some(stream), key, message: vec![7; message_bytes], server: Some(server) };
        // Handshake and warm caches.
        for _ in 0..100 {
            floor.once();
        }
        floor
    }

    /// One message and its answer.
    pub(crate) fn once(&mut self) {
        let stream = self.stream.as_mut().unwrap();
        let body_bytes = self.message.len() - SIGNATURE_BYTES;
        let (body, place) = self.message.split_at_mut(body_bytes);
        body[0] = body[0].wrapping_add(1);
        place.copy_from_slice(self.key.sign(body).as_ref());
        stream.write_all(&self.message).unwrap();
        stream.flush().unwrap();
        stream.read_exact(&mut [0; ANSWER_BYTES]).unwrap();
    }
}

impl Drop for Floor {
    fn drop(&mut self) {
        // The server ends when the connection does.
        drop(self.stream.take());
        if let Some(server) = self.server.take() {
            let _ended = server.join();
        }
    }
}

fn serve(listener: &TcpListener, tls: Arc<ServerConfig>, public: &[u8], message_bytes: usize) {
    let file = tempfile::tempfile_in(bench_directory()).unwrap();
    file.write_all_at(&vec![0; ZEROED_BYTES], 0).unwrap();
    file.sync_all().unwrap();
    let public = UnparsedPublicKey::new(&ED25519, public);
    let (socket, _) = listener.accept().unwrap();
    socket.set_nodelay(true).unwrap();
    let mut stream = StreamOwned::new(ServerConnection::new(tls).unwrap(), socket);
    let (mut message, mut end) = (vec![0; message_bytes], 0);
    while stream.read_exact(&mut message).is_ok() {
        let (body, signature) = message.split_at(message_bytes - SIGNATURE_BYTES);
        public.verify(body, signature).unwrap();
        file.write_all_at(&message, end).unwrap();
        file.sync_data().unwrap();
        end = (end + message_bytes as u64) % (ZEROED_BYTES - message_bytes) as u64;
        if stream.write_all(&[1; ANSWER_BYTES]).and_then(|()| stream.flush()).is_err() {
            return;
        }
    }
}

/// Both ends of mutual TLS 1.3 under a CA of their own.
fn mutual_tls() -> (Arc<ClientConfig>, Arc<ServerConfig>) {
    let authority_key = KeyPair::generate().unwrap();
    let mut authority = CertificateParams::new(Vec::new()).unwrap();
    authority.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    let root = authority.self_signed(&authority_key).unwrap();
    let issuer = Issuer::new(authority, authority_key);
    let end = || {
        let key = KeyPair::generate().unwrap();
        let params = CertificateParams::new(vec!["floor.invalid".to_owned()]).unwrap();
        let certificate = params.signed_by(&key, &issuer).unwrap();
        let key = PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(key.serialize_der()));
        (vec![CertificateDer::from(certificate.der().to_vec())], key)
    };
    let mut roots = RootCertStore::empty();
    roots.add(root.der().clone()).unwrap();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let verifier =
        WebPkiClientVerifier::builder_with_provider(Arc::new(roots.clone()), Arc::clone(&provider)).build().unwrap();
    let (chain, key) = end();
    let server = ServerConfig::builder_with_provider(Arc::clone(&provider))
        .with_protocol_versions(&[&rustls::version::TLS13])
        .unwrap()
        .with_client_cert_verifier(verifier)
        .with_single_cert(chain, key)
        .unwrap();
    let (chain, key) = end();
    let client = ClientConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&rustls::version::TLS13])
        .unwrap()
        .with_root_certificates(roots)
        .with_client_auth_cert(chain, key)
        .unwrap();
    (Arc::new(client), Arc::new(server))
}
