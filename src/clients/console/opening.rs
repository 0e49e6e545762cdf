//! How a page opens and ends a session: JSON over HTTP.
//!
//! | request | answer |
//! |---|---|
//! | `POST /session/challenge` | `{"network","node","challenge","clock"}` |
//! | `POST /session/open` with `{"certificate","challenge","signature"}` | `{"session","id","role","attributes","silence_s"}` |
//! | `POST /session/end` with the session in `authorization` | nothing |
//!
//! Bytes are hexadecimal digits. The signature is over [`to_sign`]. A rejection is that of [`Rejected`].

use super::Shared;
use super::guard::Origin;
use super::sessions::QUIET_MAX;
use crate::clients::http::{self, Rejected};
use crate::process::page_connections::Source;
use axum::Router;
use axum::extract::{ConnectInfo, Extension, Request, State};
use axum::http::header::AUTHORIZATION;
use axum::http::{HeaderMap, StatusCode};
use axum::response::Response;
use axum::routing::post;
use ledger_api::tls::client_identity;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::Certificate;
use ledger_identity::key::PublicKey;
use ledger_identity::{Identity, Role};
use ring::rand::{SecureRandom, SystemRandom};
use rustls_pki_types::CertificateDer;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::net::IpAddr;
use std::sync::{Arc, MutexGuard, PoisonError};
use std::time::Instant;

/// Begins what a key signs to open a session.
const PREFIX: &[u8] = b"ledgerd console session v1\0";
/// How the header `authorization` begins.
const SCHEME: &str = "Session ";
/// Bytes of a token.
const TOKEN_BYTES: usize = 32;

/// The form of a request to open a session.
const OPEN: &str = r#"{"certificate":"…","challenge":"…","signature":"…"}, in hexadecimal digits"#;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Open {
    #[serde(with = "hex")]
    certificate: Vec<u8>,
    #[serde(with = "hex")]
    challenge: Vec<u8>,
    #[serde(with = "hex")]
    signature: Vec<u8>,
}

#[derive(Serialize)]
struct Opened {
    session: String,
    id: String,
    role: Role,
    attributes: std::collections::BTreeMap<String, String>,
    silence_s: u64,
}

/// The endpoints, as docs/http.md lists them.
pub(crate) const SESSION_ENDPOINTS: [(&str, &str); 3] =
    [("POST", "/session/challenge"), ("POST", "/session/open"), ("POST", "/session/end")];

pub(super) fn router(shared: Arc<Shared>) -> Router {
    let handlers = [post(challenge), post(open), post(end)];
    let endpoints = SESSION_ENDPOINTS.into_iter().zip(handlers);
    endpoints.fold(Router::new(), |router, ((_, path), handler)| router.route(path, handler)).with_state(shared)
}

/// The token in the headers of a call.
pub(super) fn token(headers: &HeaderMap) -> Option<Vec<u8>> {
    let told = headers.get(AUTHORIZATION)?.to_str().ok()?.strip_prefix(SCHEME)?;
    hex::decode(told).ok().filter(|token| token.len() == TOKEN_BYTES)
}

/// The bytes that are signed: `PREFIX ‖ network ‖ [node] ‖ [origin] ‖ [challenge]`, where `[x]` is x with its length (`u32` BE) before it.
/// A signature for one node, or for one name of it, is good nowhere else.
fn to_sign(network: &[u8], node: &str, origin: &str, challenge: &[u8]) -> Vec<u8> {
    let mut signed = [PREFIX, network].concat();
    for part in [node.as_bytes(), origin.as_bytes(), challenge] {
        signed.extend_from_slice(&u32::try_from(part.len()).unwrap_or(u32::MAX).to_be_bytes());
        signed.extend_from_slice(part);
    }
    signed
}

impl Shared {
    fn now(&self) -> u64 {
        self.parts.gateway.clock().wall()
    }

    fn node(&self) -> String {
        self.parts.gateway.description.me.full_name()
    }

    fn tries(&self) -> MutexGuard<'_, crate::trust::enrolment::Tries> {
        self.tries.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The identity behind a certificate whose key has signed the challenge.
    fn proven(&self, open: Open, origin: &str) -> Result<Identity, Rejection> {
        let Open { certificate, challenge, signature } = open;
        let refused = |message: &str| {
            Rejection::new(Code::BadSignature, message)
                .next("open the session again; if that does not help, enrol this browser again")
        };
        if !self.challenges.is_good(&challenge, self.now()) {
            return Err(refused("the challenge is not from this node, or has expired"));
        }
        let key = Certificate::parse(&certificate)?.public_key_info;
        let key = PublicKey::from_spki(&key).map_err(|error| refused(&error.to_string()))?;
        let network = self.parts.gateway.ledger().network();
        let signed = to_sign(&network.0, &self.node(), origin, &challenge);
        key.verify(&signed, &signature)
            .map_err(|_| refused("the challenge is not signed by the key of the certificate"))?;
        let chain = [CertificateDer::from(certificate)];
        let identity = client_identity(Some(&chain), self.parts.trust.as_ref());
        let identity = identity.map_err(Rejection::from)?;
        let identity = identity.ok_or_else(|| refused("there is no certificate"))?;
        if !self.challenges.spend(&challenge, self.now()) {
            return Err(refused("the challenge was used before"));
        }
        Ok(identity)
    }

    fn open(&self, open: Open, origin: &str, from: IpAddr) -> Result<Opened, Rejection> {
        self.tries().take(from, self.now())?;
        let identity = Arc::new(self.proven(open, origin)?);
        self.tries().give_back(from);
        let mut token = [0; TOKEN_BYTES];
        let filled = SystemRandom::new().fill(&mut token);
        filled.map_err(|_| Rejection::new(Code::Internal, "the operating system provides no randomness"))?;
        self.sessions.enter(&token, Arc::clone(&identity), Instant::now());
        tracing::info!(identity = identity.id(), "browser session opened");
        let Identity { role, attributes, .. } = (*identity).clone();
        let (session, silence_s) = (hex::encode(token), QUIET_MAX.as_secs());
        Ok(Opened { session, id: identity.id(), role, attributes, silence_s })
    }
}

async fn challenge(State(shared): State<Arc<Shared>>) -> Result<Response, Rejected> {
    let Some(made) = shared.challenges.make(shared.now()) else {
        return Err(Rejection::new(Code::Internal, "the operating system provides no randomness").into());
    };
    let network = shared.parts.gateway.ledger().network();
    http::answer(&json!({
        "network": network, "node": shared.node(), "challenge": hex::encode(made), "clock": shared.now()
    }))
}

async fn open(
    State(shared): State<Arc<Shared>>,
    ConnectInfo(Source(from)): ConnectInfo<Source>,
    Extension(Origin(origin)): Extension<Origin>,
    request: Request,
) -> Result<Response, Rejected> {
    let asked = http::json_body(request, OPEN).await?;
    let opened = shared.open(asked, &origin, from).map_err(|rejection| match rejection.code {
        Code::Overloaded | Code::Internal => Rejected::from(rejection),
        _ => Rejected::from(rejection).with_status(StatusCode::UNAUTHORIZED),
    })?;
    http::answer(&opened)
}

async fn end(State(shared): State<Arc<Shared>>, headers: HeaderMap) -> StatusCode {
    if let Some(token) = token(&headers) {
        shared.sessions.leave(&token);
    }
    StatusCode::NO_CONTENT
}
