//! Votes that are signed by writing them down: which keys sign them does not matter to a cluster of honest nodes.

use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::{Ballot, Ballots, Handover, LogHead};
use std::fmt::Debug;

pub(crate) struct Names;

impl Ballots for Names {
    fn sign(&self, ballot: Ballot) -> Result<Bytes, Rejection> {
        Ok(format!("{ballot:?}").into())
    }

    fn check(&self, ballot: Ballot, signed: &[u8], _now: u64) -> Result<(), Rejection> {
        is_same(&ballot, signed)
    }

    fn sign_handover(&self, handover: Handover) -> Result<Bytes, Rejection> {
        Ok(format!("{handover:?}").into())
    }

    fn check_handover(&self, handover: Handover, signed: &[u8], _now: u64) -> Result<(), Rejection> {
        is_same(&handover, signed)
    }

    fn sign_head(&self, head: LogHead) -> Result<(Bytes, Bytes), Rejection> {
        Ok((Bytes::new(), format!("{head:?}").into()))
    }

    fn check_head(&self, head: LogHead, _vote: &[u8], signature: &[u8], _now: u64) -> Result<(), Rejection> {
        is_same(&head, signature)
    }
}

fn is_same(wanted: &impl Debug, signed: &[u8]) -> Result<(), Rejection> {
    let good = format!("{wanted:?}").as_bytes() == signed;
    good.then_some(()).ok_or_else(|| Rejection::new(Code::BadSignature, "something else was signed"))
}
