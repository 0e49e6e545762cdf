//! The clients' calls and answers, in real (virtual) time: the oracle judges them in the end.

use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;

/// Everything that all clients did.
#[derive(Debug, Default)]
pub struct History {
    /// In the order in which they were begun.
    pub operations: Vec<Operation>,
    /// Every verdict that a node told a client, also those that came too late to be waited for.
    pub verdicts: Vec<Verdict>,
}

/// One operation of one client.
#[derive(Debug)]
pub struct Operation {
    /// Its owner.
    pub client: usize,
    /// The client's session: it remembers nothing of an earlier one.
    pub session: u64,
    /// When it was begun.
    pub invoked: u64,
    /// When it returned; none while it runs, or if nobody ever knew.
    pub returned: Option<u64>,
    /// The operation.
    pub kind: Kind,
    /// Its outcome.
    pub result: Outcome,
}

/// The kinds of operations.
#[derive(Debug)]
pub enum Kind {
    /// A transaction.
    Submit {
        /// Its id.
        id: Hash,
        /// The signed bytes.
        encoded: Bytes,
    },
    /// A read.
    Read {
        /// The question.
        asks: Asks,
        /// Index of the certificate with which it was asked.
        person: usize,
        /// The service that it is about.
        service: String,
        /// Must it see everything that was acknowledged before?
        linearizable: bool,
        /// The height that the client had seen.
        min_height: u64,
    },
}

/// A question about a service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asks {
    /// Who holds it?
    Holders,
    /// May the caller read its messages?
    MayRead,
    /// Who reads it, of those for whom its messages are encrypted?
    Readers,
}

/// The outcome of an operation, as far as its client knows.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// Nothing yet, or never anything: it may have happened or not.
    Unknown,
    /// It was executed, with this verdict.
    Executed(Verdict),
    /// It was refused.
    Refused {
        /// Why.
        code: Code,
        /// Height and time by which it was judged, if it was.
        judged: Option<(u64, u64)>,
        /// By this code it can never happen.
        never: bool,
    },
    /// The value that was read.
    Read {
        /// The height that it is from.
        height: u64,
        /// The time by which it was judged.
        judged_at: u64,
        /// Whether it could be read.
        code: Code,
        /// Its content.
        response: Bytes,
    },
}

/// A verdict as a client heard it.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// The transaction.
    pub id: Hash,
    /// Where.
    pub height: u64,
    /// Position in the block.
    pub index: u32,
    /// The code.
    pub code: Code,
    /// The response.
    pub response: Bytes,
}

impl History {
    /// Begins an operation; returns its number.
    pub fn begin(&mut self, client: usize, session: u64, now: u64, kind: Kind) -> usize {
        let result = Outcome::Unknown;
        self.operations.push(Operation { client, session, invoked: now, returned: None, kind, result });
        self.operations.len() - 1
    }

    /// Ends it.
    pub fn end(&mut self, number: usize, now: u64, result: Outcome) {
        if let Some(operation) = self.operations.get_mut(number) {
            operation.returned = Some(now);
            operation.result = result;
        }
    }
}
