//! The own grant, and the numbers of what is submitted under it; without IO.

use bytes::Bytes;
use ledger_api::v1::Delivery;
use ledger_base::rejection::Rejection;
use ledger_confidential::Sealer;
use ledger_contract::Grant;
use ledger_gate::service::{Released, read};

use crate::graph::queue::Incoming;

/// The own grant as far as it is known, and the next sequence number.
#[derive(Debug)]
pub(super) struct OwnGrant {
    pub(super) service: String,
    /// `Org1/Salma`.
    pub(super) me: String,
    /// 0 without a grant.
    pub(super) epoch: u64,
    /// The largest sequence number used or known to be used.
    pub(super) last_seq: u64,
    /// Height of the newest knowledge about the grant.
    pub(super) as_of: u64,
}

impl OwnGrant {
    /// Arguments of `set` for these samples, in order. Numbers go on from the clock, so that a restarted bridge, or
    /// another one of the same user, goes on above what was used before.
    ///
    /// With a sealer each of them is encrypted.
    ///
    /// # Errors
    /// Those of [`Sealer::seal`].
    pub(super) fn call(
        &mut self,
        wall_us: u64,
        samples: &[Incoming],
        sealer: Option<&Sealer>,
    ) -> Result<Vec<Bytes>, Rejection> {
        let first = self.last_seq.saturating_add(1).max(wall_us);
        self.last_seq = first.saturating_add(samples.len() as u64).saturating_sub(1);
        let head = [self.service.clone(), self.epoch.to_string(), first.to_string()];
        let payload = |(number, incoming): (u64, &Incoming)| match sealer {
            Some(sealer) => sealer.seal(self.epoch, number, incoming.sample.wire()),
            None => Ok(incoming.sample.wire().clone()),
        };
        head.into_iter().map(Bytes::from).map(Ok).chain((first..).zip(samples).map(payload)).collect()
    }

    /// Events about the own grant.
    pub(super) fn hear(&mut self, delivery: &Delivery) {
        for event in &delivery.events {
            match event.name.as_str() {
                "granted" | "renewed" => {
                    if let Some(grant) = read::<Grant>(&event.payload).filter(|grant| grant.holder == self.me) {
                        self.learn(delivery.height, grant.epoch, grant.next_seq);
                    }
                }
                "released" => {
                    let own = |released: &Released| released.holder == self.me && released.epoch == self.epoch;
                    if read::<Released>(&event.payload).is_some_and(|released| own(&released)) {
                        self.learn(delivery.height, 0, 0);
                    }
                }
                _ => {}
            }
        }
        self.as_of = self.as_of.max(delivery.height);
    }

    /// Takes over what is newer than what is known.
    pub(super) fn learn(&mut self, height: u64, epoch: u64, next_seq: u64) {
        if height < self.as_of {
            return;
        }
        self.as_of = height;
        self.last_seq = self.last_seq.max(next_seq.saturating_sub(1));
        if self.epoch != epoch {
            tracing::info!(service = self.service, epoch, "{}", if epoch == 0 { "grant ended" } else { "grant held" });
            self.epoch = epoch;
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_api::v1::EventRecord;
    use ledger_gate::sample::{CDR_LE, Sample};
    use std::time::{Duration, Instant, SystemTime};

    fn publishing() -> OwnGrant {
        OwnGrant { service: "T/cmd_vel".into(), me: "Org1/Salma".into(), epoch: 0, last_seq: 0, as_of: 0 }
    }

    fn samples(count: u64) -> Vec<Incoming> {
        let sample = Sample::new(CDR_LE, &[7]).unwrap();
        let (received, wall) = (Instant::now(), SystemTime::now());
        let incoming = |sequence| Incoming {
            sample: sample.clone(),
            source: [0; 16],
            sequence,
            received,
            wall,
            waited: Duration::ZERO,
        };
        (1..=count).map(incoming).collect()
    }

    fn event(height: u64, name: &str, holder: &str, epoch: u64) -> Delivery {
        let payload = match name {
            "released" => {
                serde_json::json!({ "service": "T/cmd_vel", "holder": holder, "epoch": epoch, "reason": "x" })
            }
            _ => serde_json::json!(ledger_gate::fixture::grant(holder, epoch)),
        };
        let payload = Bytes::from(payload.to_string());
        let event = EventRecord { name: name.into(), payload, ..EventRecord::default() };
        Delivery { height, events: vec![event], ..Delivery::default() }
    }

    #[test]
    fn numbers_follow_the_clock_and_never_repeat() {
        let mut publishing = publishing();
        let number = |args: Vec<Bytes>| String::from_utf8(args.get(2).unwrap().to_vec()).unwrap();
        assert_eq!(number(publishing.call(1000, &samples(3), None).unwrap()), "1000");
        assert_eq!(number(publishing.call(1001, &samples(1), None).unwrap()), "1003", "the three before end with 1002");
        assert_eq!(number(publishing.call(500, &samples(1), None).unwrap()), "1004", "the clock went back");
        publishing.learn(1, 4, 9000);
        assert_eq!(number(publishing.call(2000, &samples(1), None).unwrap()), "9000", "the ledger knows larger ones");
    }

    #[test]
    fn the_epoch_is_that_of_the_own_grant_only() {
        let mut publishing = publishing();
        publishing.hear(&event(5, "granted", "Org1/Farhad", 3));
        assert_eq!(publishing.epoch, 0);
        publishing.hear(&event(6, "granted", "Org1/Salma", 4));
        assert_eq!(publishing.epoch, 4);
        publishing.hear(&event(7, "released", "Org1/Salma", 3));
        assert_eq!(publishing.epoch, 4, "an older grant ended");
        publishing.learn(6, 3, 0);
        assert_eq!(publishing.epoch, 4, "an answer from an older state changes nothing");
        publishing.hear(&event(8, "released", "Org1/Salma", 4));
        assert_eq!(publishing.epoch, 0);
        let args = publishing.call(1, &samples(1), None).unwrap();
        assert_eq!(args.get(1).unwrap(), "0");
    }
}
