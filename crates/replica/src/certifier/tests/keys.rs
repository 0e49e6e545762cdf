//! The keys of a node.

use super::*;
use ledger_light::Complaint;

pub(super) struct Keys(pub(super) u64, pub(super) User);

impl Signing for Keys {
    fn sign(&self, statement: &Statement) -> Result<Signed, Rejection> {
        statement.sign(self.0, self.1.certificate.clone(), &self.1.key)
    }

    fn sign_vote(&self, vote: &Vote) -> Result<Signature, Rejection> {
        vote.sign(self.1.certificate.clone(), &self.1.key)
    }

    fn sign_transfer(&self, transfer: &Transfer) -> Result<Signature, Rejection> {
        transfer.sign(self.1.certificate.clone(), &self.1.key)
    }

    fn sign_complaint(&self, complaint: &Complaint) -> Result<Signature, Rejection> {
        complaint.sign(self.1.certificate.clone(), &self.1.key)
    }

    fn sign_head(&self, head: &Head) -> Result<Signature, Rejection> {
        head.sign(self.1.certificate.clone(), &self.1.key)
    }

    fn identify(&self, msps: &Arc<Msps>, certificate: &[u8], time: u64) -> Result<Identity, Rejection> {
        msps.verify(certificate, &[], time).map_err(Rejection::from)
    }
}
