//! Traces of messages across processes, for collectors of OpenTelemetry.
//!
//! Nothing new crosses the ledger: a trace is named by the id of the transaction, which every process knows. Each one tells its
//! own steps, and all of them choose the same messages, because the id alone decides.
//!
//! ```text
//! lib        which messages are traced, and their steps
//! settings   the section [traces]
//! otlp       steps as messages of the OpenTelemetry protocol
//! send       hands them to the collector, beside the work
//! ```
//!
//! Without a collector nothing is done. With one, telling a step never waits: it is left out where the collector is too slow.

mod otlp;
mod send;
mod settings;

pub use settings::Settings;

use ledger_base::hash::Hash;
use opentelemetry_proto::tonic::trace::v1::Span;
use std::fmt;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};
use tokio::sync::mpsc;

/// Most steps that wait for the collector. More are left out.
const WAITING_MAX: usize = 4096;

/// Where the steps of messages are told; nowhere, if no collector is set. Clones tell the same one.
#[derive(Clone, Default)]
pub struct Tracer(Option<Arc<Telling>>);

struct Telling {
    /// One message in so many is traced.
    one_in: u64,
    /// The process among others of its program, such as `Org1/node1`.
    instance: String,
    steps: mpsc::Sender<Span>,
}

/// A step of a message in this process.
#[derive(Clone, Debug)]
pub struct Step {
    /// Its name.
    pub name: &'static str,
    /// When it began.
    pub begun: SystemTime,
    /// When it was over.
    pub ended: SystemTime,
    /// Is it the whole way, of which all others are parts?
    pub is_whole: bool,
    /// The name of the code with which it failed; none if it went well.
    pub failed: Option<&'static str>,
    /// More about it: names and values.
    pub facts: Vec<(&'static str, String)>,
}

impl Step {
    /// One that is over now.
    pub fn since(name: &'static str, begun: SystemTime) -> Self {
        Self { name, begun, ended: SystemTime::now(), is_whole: false, failed: None, facts: Vec::new() }
    }

    /// The same with a fact more.
    #[must_use]
    pub fn with(mut self, name: &'static str, value: impl ToString) -> Self {
        self.facts.push((name, value.to_string()));
        self
    }
}

/// The wall clock at a moment that has passed.
pub fn wall(moment: Instant) -> SystemTime {
    let now = SystemTime::now();
    now.checked_sub(moment.elapsed()).unwrap_or(now)
}

/// The wall clock at so many microseconds since the UNIX epoch.
pub fn wall_at(us: u64) -> SystemTime {
    SystemTime::UNIX_EPOCH + Duration::from_micros(us)
}

impl Tracer {
    /// Begins to tell steps to the collector of these settings; tells none if there is none. `program` and `instance` name this
    /// process for people. Must be called inside a tokio runtime.
    pub fn start(settings: &Settings, program: &'static str, instance: &str) -> Self {
        let Some(endpoint) = settings.endpoint() else { return Self::default() };
        let (steps, told) = mpsc::channel(WAITING_MAX);
        tokio::spawn(send::run(endpoint, otlp::resource(program, instance), told));
        tracing::info!(collector = settings.endpoint, one_in = settings.one_in, "messages are traced");
        Self(Some(Arc::new(Telling { one_in: settings.one_in.into(), instance: instance.to_owned(), steps })))
    }

    /// Is nothing told at all?
    pub fn is_off(&self) -> bool {
        self.0.is_none()
    }

    /// Tells a step of the message of this transaction, if it is one of those that are traced.
    pub fn tell(&self, transaction: &Hash, step: impl FnOnce() -> Step) {
        let Some(telling) = self.0.as_deref().filter(|telling| takes(telling.one_in, transaction)) else { return };
        // A collector that is too slow gets fewer.
        drop(telling.steps.try_send(otlp::span(transaction, &telling.instance, step())));
    }
}

impl fmt::Debug for Tracer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Tracer")
    }
}

/// Is this message traced? With one in fewer, all those are taken that others take, too. Bytes that are no transaction have no id.
fn takes(one_in: u64, transaction: &Hash) -> bool {
    *transaction != Hash::ZERO && u64::from_be_bytes(part(transaction, 8)) <= u64::MAX / one_in.max(1)
}

/// Eight bytes of an id, from this one on.
fn part(id: &Hash, from: usize) -> [u8; 8] {
    let bytes = id.0.get(from..).and_then(<[u8]>::first_chunk);
    bytes.copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn id(number: u64) -> Hash {
        Hash::of(&[&number.to_be_bytes()])
    }

    #[test]
    fn the_id_alone_decides_which_messages_are_traced_and_who_takes_more_takes_the_same_ones_too() {
        let taken = |one_in| (0..20_000).filter(move |number| takes(one_in, &id(*number))).collect::<Vec<_>>();
        let (all, some, few) = (taken(1), taken(10), taken(100));
        assert_eq!(all.len(), 20_000);
        assert!((1700..2300).contains(&some.len()) && (130..280).contains(&few.len()), "{} {}", some.len(), few.len());
        assert!(few.iter().all(|number| some.contains(number)));
        assert!(!takes(1, &Hash::ZERO), "bytes in a block that are no transaction");
    }

    #[test]
    fn without_a_collector_a_step_is_not_even_made() {
        let tracer = Tracer::default();
        assert!(tracer.is_off());
        tracer.tell(&id(1), || unreachable!("nobody hears it"));
    }

    #[tokio::test]
    async fn a_step_that_does_not_fit_any_more_is_left_out_and_nobody_waits() {
        let (steps, mut told) = mpsc::channel(1);
        let tracer = Tracer(Some(Arc::new(Telling { one_in: 1, instance: "Org1/node1".to_owned(), steps })));
        for name in ["first", "second"] {
            tracer.tell(&id(1), || Step::since(name, SystemTime::now()));
        }
        assert_eq!(told.recv().await.map(|span| span.name), Some("first".to_owned()));
        assert!(told.try_recv().is_err());
    }
}
