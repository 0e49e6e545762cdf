//! The call of a message: `abac set`.

use super::refused::Refused;
use crate::ABAC;
use bytes::Bytes;
use ledger::transaction::Transaction;

/// Arguments of `set` before the payloads: service, epoch, first sequence number.
const SET_ARGUMENTS: usize = 3;

/// The arguments of `set`.
pub(super) struct Call<'a> {
    pub(super) epoch: u64,
    pub(super) first_seq: u64,
    pub(super) last_seq: u64,
    pub(super) payloads: &'a [Bytes],
}

impl<'a> Call<'a> {
    /// Reads a call that must be `abac set SERVICE EPOCH FIRST_SEQ PAYLOAD...`, with the service's full id.
    ///
    /// # Errors
    /// [`Refused::WrongCall`], [`Refused::Malformed`].
    pub(super) fn read(transaction: &'a Transaction, service: &str) -> Result<Self, Refused> {
        let body = transaction.body();
        let [named, epoch, first_seq, ..] = body.args.as_slice() else { return Err(Refused::WrongCall) };
        if body.chaincode != ABAC || body.function != "set" || named != service.as_bytes() {
            return Err(Refused::WrongCall);
        }
        let payloads = body.args.get(SET_ARGUMENTS..).unwrap_or_default();
        let count = u64::try_from(payloads.len()).ok().filter(|count| *count > 0).ok_or(Refused::Malformed)?;
        let (epoch, first_seq) = (number(epoch)?, number(first_seq)?);
        let last_seq = first_seq.checked_add(count - 1).ok_or(Refused::Malformed)?;
        Ok(Self { epoch, first_seq, last_seq, payloads })
    }
}

/// A decimal number as the ledger reads it: digits only.
fn number(text: &[u8]) -> Result<u64, Refused> {
    let digits = text.iter().all(u8::is_ascii_digit);
    let parsed = std::str::from_utf8(text).ok().filter(|_| digits).and_then(|text| text.parse().ok());
    parsed.ok_or(Refused::Malformed)
}
