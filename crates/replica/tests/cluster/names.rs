//! Votes that are signed by writing them down: which keys sign them does not matter to a cluster of honest nodes.

use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::{Ballot, Ballots};

pub(crate) struct Names;

impl Ballots for Names {
    fn sign(&self, ballot: Ballot) -> Result<Bytes, Rejection> {
        Ok(format!("{ballot:?}").into())
    }

    fn check(&self, ballot: Ballot, signed: &[u8], _now: u64) -> Result<(), Rejection> {
        let good = format!("{ballot:?}").as_bytes() == signed;
        good.then_some(()).ok_or_else(|| Rejection::new(Code::BadSignature, "another vote was signed"))
    }
}
