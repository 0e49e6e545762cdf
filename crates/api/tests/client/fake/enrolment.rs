//! The enrolment of the fake node.

use super::Shared;
use ledger_api::v1;
use ledger_api::v1::enrolment_server::Enrolment;
use ledger_base::rejection::{Code, Rejection};
use std::sync::atomic::Ordering;
use tonic::{Request, Response, Status};

#[tonic::async_trait]
impl Enrolment for Shared {
    async fn network(&self, _request: Request<v1::NetworkRequest>) -> Result<Response<v1::NetworkResponse>, Status> {
        Ok(Response::new(self.0.describe()))
    }

    async fn enrol(&self, request: Request<v1::EnrolRequest>) -> Result<Response<v1::EnrolResponse>, Status> {
        let request = request.into_inner();
        if request.secret != "secret" {
            let refused =
                Rejection::new(Code::EnrolmentRefused, "the secret is wrong").next("ask an admin for another");
            let verdict = Some(v1::Verdict::from(&refused));
            return Ok(Response::new(v1::EnrolResponse { verdict, ..Default::default() }));
        }
        let name = self.0.name.lock().unwrap().clone().unwrap_or(request.name);
        let fixed = self.0.certificate.lock().unwrap().clone();
        Ok(Response::new(v1::EnrolResponse {
            verdict: Some(v1::Verdict::default()),
            certificate: fixed.unwrap_or_else(|| self.0.authority.certify(&name, &request.request)),
            chain: Vec::new(),
            organisation: "Org1".into(),
            network: Some(self.0.describe()),
            carriers: Vec::new(),
        }))
    }

    async fn renew(&self, request: Request<v1::RenewRequest>) -> Result<Response<v1::EnrolResponse>, Status> {
        self.0.renewals.fetch_add(1, Ordering::SeqCst);
        if let Some(refused) = &*self.0.no_renewal.lock().unwrap() {
            let verdict = Some(v1::Verdict::from(refused));
            return Ok(Response::new(v1::EnrolResponse { verdict, ..Default::default() }));
        }
        Ok(Response::new(v1::EnrolResponse {
            verdict: Some(v1::Verdict::default()),
            certificate: self.0.authority.certify("Salma", &request.into_inner().request),
            organisation: "Org1".into(),
            ..Default::default()
        }))
    }

    async fn genesis(&self, _: Request<v1::GenesisRequest>) -> Result<Response<v1::GenesisResponse>, Status> {
        Err(Status::unimplemented("genesis"))
    }

    async fn join_organisation(
        &self,
        _: Request<v1::JoinOrganisationRequest>,
    ) -> Result<Response<v1::JoinOrganisationResponse>, Status> {
        Err(Status::unimplemented("joining"))
    }

    async fn offer_ca(&self, _: Request<v1::OfferCaRequest>) -> Result<Response<v1::OfferCaResponse>, Status> {
        Err(Status::unimplemented("offering"))
    }

    async fn seal_ca(&self, _: Request<v1::SealCaRequest>) -> Result<Response<v1::SealCaResponse>, Status> {
        Err(Status::unimplemented("sealing"))
    }

    async fn take_ca(&self, _: Request<v1::TakeCaRequest>) -> Result<Response<v1::TakeCaResponse>, Status> {
        Err(Status::unimplemented("taking"))
    }

    async fn copy_ca(&self, _: Request<v1::CopyCaRequest>) -> Result<Response<v1::CopyCaResponse>, Status> {
        Err(Status::unimplemented("copying"))
    }

    async fn restore_ca(&self, _: Request<v1::RestoreCaRequest>) -> Result<Response<v1::RestoreCaResponse>, Status> {
        Err(Status::unimplemented("restoring"))
    }

    async fn drop_ca(&self, _: Request<v1::DropCaRequest>) -> Result<Response<v1::DropCaResponse>, Status> {
        Err(Status::unimplemented("dropping"))
    }
}
