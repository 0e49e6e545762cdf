//! A ledger that answers what a test says.

use std::{
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    task::Poll,
};

use bytes::Bytes;
use futures::{FutureExt, StreamExt, future::BoxFuture, stream::poll_fn};
use ledger::transaction::Transaction;
use ledger_api::{
    Answer, Subscription,
    v1::{Delivery, EventRecord},
};
use ledger_rejection::{Code, Rejection};
use serde_json::{Value, json};
use tokio::sync::{mpsc, watch};
use tokio_stream::wrappers::UnboundedReceiverStream;

use crate::gateway::{Deliveries, Gateway, Verdict};

/// The fate of a sample.
#[derive(Clone)]
pub(super) enum Fate {
    Committed,
    Refused(Code),
    /// No verdict ever comes.
    Lost,
}

/// The other end of a subscription.
type Sender = mpsc::UnboundedSender<Result<Delivery, Rejection>>;

pub(super) struct Fake {
    service: Mutex<Value>,
    grants: Mutex<Value>,
    own: Mutex<Value>,
    fate: Mutex<Fate>,
    /// Arguments of every `set`.
    pub(super) sets: watch::Sender<Vec<Vec<Bytes>>>,
    streams: Mutex<Vec<(Subscription, Sender)>>,
    /// Signs of life come without an end.
    pub(super) floods: AtomicBool,
}

impl Fake {
    /// A ledger with one service, held by nobody.
    pub(super) fn new(mode: &str) -> Arc<Self> {
        let fake = Self {
            service: Mutex::new(Value::Null),
            grants: Mutex::new(json!([])),
            own: Mutex::new(json!({ "epoch": 0, "next_seq": 0 })),
            fate: Mutex::new(Fate::Committed),
            sets: watch::Sender::new(Vec::new()),
            streams: Mutex::default(),
            floods: AtomicBool::new(false),
        };
        fake.set_mode(mode);
        Arc::new(fake)
    }

    pub(super) fn set_mode(&self, mode: &str) {
        *self.service.lock().unwrap() = json!({
            "service": "T/cmd_vel", "robot": "T", "organisation": "Org2", "topic": "/cmd_vel",
            "type": "geometry_msgs/msg/Twist", "mode": mode, "direction": "command", "max_age_ms": 1000, "lease_ms": 10000,
            "lease_ms_max": 600_000, "stop_hex": null, "holder": "", "holders": [], "epoch": 3, "expires": 0,
        });
    }

    pub(super) fn set_holder(&self, holder: &str, epoch: u64, lease_ms: u64) {
        *self.grants.lock().unwrap() =
            json!([{ "service": "T/cmd_vel", "holder": holder, "epoch": epoch, "lease_ms": lease_ms }]);
    }

    pub(super) fn set_own_epoch(&self, epoch: u64) {
        *self.own.lock().unwrap() = json!({ "epoch": epoch, "next_seq": 0 });
    }

    pub(super) fn set_fate(&self, fate: Fate) {
        *self.fate.lock().unwrap() = fate;
    }

    /// Delivers an event to whoever subscribed to it.
    pub(super) fn deliver(
        &self,
        block_time: u64,
        name: &str,
        payload: &Value,
        caused_by: Option<(&Transaction, &Bytes)>,
    ) {
        let (transaction, certificate) = caused_by
            .map(|(transaction, certificate)| (transaction.encoded().clone(), certificate.clone()))
            .unwrap_or_default();
        let chaincode = if name == "revoked" { "msp" } else { "abac" };
        let event = EventRecord {
            chaincode: chaincode.into(),
            name: name.into(),
            payload: Bytes::from(payload.to_string()),
            transaction,
            certificate,
            ..EventRecord::default()
        };
        self.send(
            name,
            chaincode,
            Delivery { height: 1, time: block_time, events: vec![event], ..Delivery::default() },
        );
    }

    /// A sign of life without events.
    pub(super) fn heartbeat(&self, block_time: u64) {
        self.send("message", "abac", heartbeat(block_time));
    }

    fn send(&self, name: &str, chaincode: &str, delivery: Delivery) {
        for (wanted, stream) in self.streams.lock().unwrap().iter() {
            if wanted.chaincode == chaincode && wanted.names.iter().any(|wanted| wanted == name) {
                let _gone = stream.send(Ok(delivery.clone()));
            }
        }
    }
}

fn heartbeat(block_time: u64) -> Delivery {
    Delivery { height: 1, time: block_time, ..Delivery::default() }
}

impl Gateway for Fake {
    fn query(
        &self,
        height: u64,
        _chaincode: &str,
        function: &str,
        _args: Vec<Bytes>,
    ) -> BoxFuture<'static, Result<Answer, Rejection>> {
        let value = match function {
            "service" => self.service.lock().unwrap().clone(),
            "grants" => self.grants.lock().unwrap().clone(),
            "authorize" => self.own.lock().unwrap().clone(),
            "GetSubmittingClientIdentity" => json!({ "id": "Org1/Salma" }),
            "revocations" => json!({ "items": [] }),
            _ => json!([]),
        };
        std::future::ready(Ok(Answer { response: Bytes::from(value.to_string()), height, time: 0, stale_for: 0 }))
            .boxed()
    }

    fn node(&self) -> String {
        "fake:1".to_owned()
    }

    fn height(&self) -> BoxFuture<'static, Result<u64, Rejection>> {
        std::future::ready(Ok(0)).boxed()
    }

    fn subscribe(&self, wanted: Subscription) -> Deliveries {
        let (sender, mut stream) = mpsc::unbounded_channel();
        let floods = self.floods.load(Ordering::Relaxed) && wanted.chaincode == "abac";
        self.streams.lock().unwrap().push((wanted, sender));
        if !floods {
            return UnboundedReceiverStream::new(stream).boxed();
        }
        // Never pending: whoever looks here first looks at nothing else.
        poll_fn(move |context| match stream.poll_recv(context) {
            Poll::Pending => Poll::Ready(Some(Ok(heartbeat(super::micros())))),
            delivery => delivery,
        })
        .boxed()
    }

    fn set(&self, args: Vec<Bytes>) -> Verdict {
        self.sets.send_modify(|sets| sets.push(args));
        match self.fate.lock().unwrap().clone() {
            Fate::Committed => std::future::ready(Ok(())).boxed(),
            Fate::Refused(code) => std::future::ready(Err(Rejection::new(code, "no"))).boxed(),
            Fate::Lost => std::future::pending().boxed(),
        }
    }
}
