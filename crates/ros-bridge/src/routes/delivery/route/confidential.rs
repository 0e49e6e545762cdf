//! A confidential service: its content keys come before its messages.

use std::{sync::Arc, time::Instant};

use ledger_api::v1::Delivery;
use ledger_base::rejection::Rejection;
use ledger_confidential::{Keyring, ReadingKey};
use ledger_gate::guard::Block;

use super::FromLedger;
use crate::{log::one_line, routes::delivery::reader_keys::ReaderKeys};

impl FromLedger {
    /// Takes what the service is now: a reader's keys are there from when it is confidential.
    pub(super) fn read_confidential(&mut self) -> Result<(), Rejection> {
        if !self.service.confidential || self.reading.is_some() {
            return Ok(());
        }
        let own = ReadingKey::from_secret(&self.context.reading_secret()?)?;
        let name = format!("{}/{}", self.context.organisation, self.context.certificate()?.name()?);
        let keyring = Keyring::new(self.context.network, name, own);
        self.reading = Some(ReaderKeys::new(keyring.public_hex()));
        self.guard.read_with(keyring);
        Ok(())
    }

    /// When to look next whether all content keys are here.
    pub(super) fn keys_due(&self) -> Option<Instant> {
        self.reading.as_ref().and_then(ReaderKeys::due)
    }

    /// Looks whether all content keys are here.
    pub(super) fn look_for_keys(&mut self) {
        if let Some(reading) = &mut self.reading {
            reading.look(Arc::clone(&self.gateway), self.route.service.clone());
        }
    }

    /// Takes the content keys that were fetched.
    pub(super) async fn take_keys(&mut self, fetched: Result<Vec<Delivery>, Rejection>) {
        let deliveries = match fetched {
            Ok(deliveries) => deliveries,
            Err(refused) => {
                let reason = one_line(&refused);
                if let Some(not_logged) = self.log_limiter.admit("keys", Instant::now()) {
                    let service = &self.route.service;
                    tracing::warn!(
                        service,
                        code = refused.code.name(),
                        reason,
                        not_logged,
                        "the bridge cannot read this confidential service"
                    );
                }
                self.counters.lock().live.waiting = Some(format!("no content key of the service: {reason}"));
                return;
            }
        };
        for delivery in deliveries {
            self.judge(Block::latched(delivery.height, delivery.time), &delivery).await;
        }
    }
}
