//! Events as they happen.

use super::parameters::Parameters;
use super::rejections::Rejected;
use super::shape::DeliveryFacts;
use super::{Api, access::call, lines};
use crate::process::caller::Caller;
use axum::extract::{Extension, State};
use axum::http::Uri;
use axum::response::Response;
use ledger_api::v1;
use ledger_api::v1::gateway_server::Gateway;
use ledger_base::hash::Hash;
use std::collections::HashMap;
use std::sync::Arc;

/// Most signers that a stream remembers.
const NAMES_MAX: usize = 1024;

const FILTERS: [&str; 7] = ["from_height", "chaincode", "subject", "name", "heartbeat_ms", "early", "proofs"];

pub(super) async fn events(
    State(api): State<Arc<Api>>,
    Extension(caller): Extension<Caller>,
    uri: Uri,
) -> Result<Response, Rejected> {
    let given = Parameters::read(&uri, &FILTERS)?;
    let request = v1::SubscribeRequest {
        from_height: given.number("from_height")?,
        chaincode: given.text("chaincode")?,
        subjects: given.all("subject"),
        names: given.all("name"),
        heartbeat_ms: given.number("heartbeat_ms")?,
        early: given.is_on("early")?,
        proofs: given.is_on("proofs")?,
        heads: false,
    };
    let deliveries = api.gateway.subscribe(call(caller, request)).await?.into_inner();
    let mut names = HashMap::new();
    let shape = move |delivery| DeliveryFacts::of(delivery, |certificate| name(&api, &mut names, certificate));
    Ok(lines::answer(deliveries, shape))
}

/// The owner of a certificate; empty if it is not known. A stream verifies each certificate once.
fn name(api: &Api, known: &mut HashMap<Hash, String>, certificate: &Hash) -> String {
    if let Some(name) = known.get(certificate) {
        return name.clone();
    }
    let name = api.gateway.ledger().creator_name(certificate).unwrap_or_default();
    if known.len() == NAMES_MAX {
        known.clear();
    }
    known.insert(*certificate, name.clone());
    name
}
