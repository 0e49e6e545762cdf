//! The first contact of a client: the network, and a certificate for a one-time secret.

use super::body;
use super::parameters::Parameters;
use super::rejections::{Rejected, answer};
use super::shape::NetworkFacts;
use super::{Api, access::call};
use crate::process::caller::Caller;
use axum::extract::{Extension, Request, State};
use axum::http::Uri;
use axum::response::Response;
use ledger_api::v1;
use ledger_api::v1::enrolment_server::Enrolment;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::sync::Arc;

/// The form of a request to enrol.
const ENROL: &str = r#"{"name":"Org1/Tablet","secret":"…","request":"hexadecimal digits of a signing request"}"#;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Enrol {
    name: String,
    secret: String,
    #[serde(with = "hex")]
    request: Vec<u8>,
}

#[derive(Serialize)]
struct Enrolled {
    organisation: String,
    certificate: String,
    chain: Vec<String>,
    network: NetworkFacts,
}

pub(super) async fn network(
    State(api): State<Arc<Api>>,
    Extension(caller): Extension<Caller>,
    uri: Uri,
) -> Result<Response, Rejected> {
    Parameters::read(&uri, &[])?;
    let network = api.enrolment.network(call(caller, v1::NetworkRequest {})).await?;
    answer(&NetworkFacts::from(network.into_inner()))
}

pub(super) async fn enrol(
    State(api): State<Arc<Api>>,
    Extension(caller): Extension<Caller>,
    request: Request,
) -> Result<Response, Rejected> {
    let (_, request) = body::before(request, |request| Parameters::read(request.uri(), &[])).await?;
    let Enrol { name, secret, request } = body::json(request, body::NEWCOMER_BODY_BYTES_MAX, ENROL).await?;
    let request = v1::EnrolRequest { name, secret, request: request.into() };
    let told = api.enrolment.enrol(call(caller, request)).await?.into_inner();
    if let Err(rejection) = ledger_api::accepted(told.verdict.as_ref()) {
        return Err(Rejected::from(rejection).with(json!({ "carriers": told.carriers })));
    }
    answer(&Enrolled {
        organisation: told.organisation,
        certificate: hex::encode(told.certificate),
        chain: told.chain.iter().map(hex::encode).collect(),
        network: told.network.unwrap_or_default().into(),
    })
}
