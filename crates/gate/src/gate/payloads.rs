//! The samples of a call. Those of confidential services are opened here, because limits ask for what they say.

use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_confidential::{Keyring, Unreadable};
use ledger_contract::Share;

use super::{Delivered, Gate, call::Call, refused::Refused};
use crate::{ABAC, sample::Sample};

/// Longest JSON of a share that is read, in bytes.
const SHARE_BYTES_MAX: usize = 64 * 1024;
/// How much longer an envelope is than its message, in bytes, and more.
const ENVELOPE_BYTES: usize = 64;

impl Gate {
    /// Reads confidential messages with these keys, and with those that publishers share.
    pub fn read_with(&mut self, keyring: Keyring) {
        self.keyring = Some(keyring);
    }

    /// Takes the content key that a publisher has shared in the block of this height. The name of the height is a node's word: a
    /// key under a wrong one opens nothing.
    ///
    /// # Errors
    /// The rule that its transaction breaks.
    pub fn keyed(&mut self, height: u64, delivered: Delivered<'_>) -> Result<(), Refused> {
        if self.keyring.is_none() {
            return Ok(());
        }
        let transaction = self.decode(delivered)?;
        let share = read_share(&transaction, &self.id)?;
        let publisher = self.identities.creator(&transaction, delivered.certificate, delivered.block_time)?.id();
        if let Some(keyring) = &mut self.keyring {
            keyring.learn(&self.id, &publisher, height, &share);
        }
        Ok(())
    }

    /// The messages of a service that is not confidential.
    pub(super) fn read_samples(&self, payloads: &[Bytes]) -> Result<Vec<Sample>, Refused> {
        let bytes_max = self.settings.sample_bytes_max;
        if payloads.iter().any(|payload| payload.len() > bytes_max) {
            return Err(Refused::TooLarge);
        }
        let sample = |payload: &Bytes| Sample::from_wire(payload.clone(), bytes_max).map_err(|_| Refused::BadPayload);
        payloads.iter().map(sample).collect()
    }

    /// The messages of a call on a confidential service.
    pub(super) fn open_samples(&self, publisher: &str, call: &Call<'_>) -> Result<Vec<Sample>, Refused> {
        let keyring = self.keyring.as_ref().ok_or(Refused::NoKey)?;
        let bytes_max = self.settings.sample_bytes_max;
        if call.payloads.iter().any(|payload| payload.len() > bytes_max.saturating_add(ENVELOPE_BYTES)) {
            return Err(Refused::TooLarge);
        }
        let numbered = (call.first_seq..=call.last_seq).zip(call.payloads);
        let open = |(sequence, payload): (u64, &Bytes)| {
            let opened = keyring.open(&self.id, publisher, call.epoch, sequence, payload);
            let message = opened.map_err(|unreadable| match unreadable {
                Unreadable::NoKey(_) => Refused::NoKey,
                Unreadable::NotSealed | Unreadable::Changed => Refused::Unreadable,
            })?;
            Sample::from_wire(message, bytes_max).map_err(|_| Refused::BadPayload)
        };
        numbered.map(open).collect()
    }
}

/// Reads `abac share SERVICE EPOCH SHARE_JSON`.
fn read_share(transaction: &Transaction, service: &str) -> Result<Share, Refused> {
    let body = transaction.body();
    let [named, _epoch, share] = body.args.as_slice() else { return Err(Refused::WrongCall) };
    if body.chaincode != ABAC || body.function != "share" || named != service.as_bytes() {
        return Err(Refused::WrongCall);
    }
    let share = Some(share).filter(|share| share.len() <= SHARE_BYTES_MAX).ok_or(Refused::TooLarge)?;
    serde_json::from_slice(share).map_err(|_| Refused::Malformed)
}
