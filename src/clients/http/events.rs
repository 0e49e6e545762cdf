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
use std::sync::Arc;

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
    Ok(lines::answer(deliveries, DeliveryFacts::from))
}
