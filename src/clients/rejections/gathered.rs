//! Refusals that are not on the ledger yet: one line for each identity, function, service and code, and one for the rest.

use ledger::msp::{REFUSALS_BYTES_MAX, REFUSALS_MAX, REFUSED_TEXT_MAX, Refused, TellRefusals};
use ledger::transaction::NAME_BYTES_MAX;
use ledger_base::hash::Hash;
use std::collections::BTreeMap;

/// Bytes that a line takes beside who, chaincode and subject, at most: three texts, numbers, a hash, and names of fields.
const LINE_BYTES: usize = 2 * REFUSED_TEXT_MAX + NAME_BYTES_MAX + 320;
/// Bytes of lines with an identity.
const NAMED_BYTES_MAX: usize = REFUSALS_BYTES_MAX - 2 * LINE_BYTES;
/// Lines with an identity. The last one of a telling is for all others.
const NAMED_MAX: usize = REFUSALS_MAX - 1;

/// A refusal: who, chaincode, subject, function and number of the code.
type Key = (String, String, String, String, u32);

/// One refusal, as it came.
#[derive(Clone, Debug, Default)]
pub(super) struct One {
    pub who: String,
    pub chaincode: String,
    pub function: String,
    pub subject: String,
    pub code: u32,
    /// The node's time, microseconds.
    pub time: u64,
    pub sample: Option<Hash>,
    pub why: String,
    pub found: String,
}

/// Refusals that were not told yet.
#[derive(Clone, Debug, Default)]
pub(crate) struct Gathered {
    named: BTreeMap<Key, Refused>,
    /// Bytes of `named`, at most.
    bytes: usize,
    /// Those beyond so many different ones.
    others: Option<Refused>,
}

impl Gathered {
    pub(super) fn add(&mut self, one: One) {
        let One { who, chaincode, function, subject, code, time, sample, why, found } = one;
        let [who, chaincode, function, subject, why, found] =
            [who, chaincode, function, subject, why, found].map(|text| bounded(&text));
        let (count, first, last) = (1, time, time);
        self.fold(Refused { who, chaincode, function, subject, code, count, first, last, sample, why, found });
    }

    /// Takes them back: they could not be told.
    pub(crate) fn take_back(&mut self, told: TellRefusals) {
        told.refusals.into_iter().for_each(|refused| self.fold(refused));
    }

    /// All of them, and forgets them; none if there are none.
    pub(crate) fn take(&mut self) -> Option<TellRefusals> {
        let Self { named, others, .. } = std::mem::take(self);
        let refusals: Vec<_> = named.into_values().chain(others).collect();
        if refusals.is_empty() { None } else { Some(TellRefusals { refusals }) }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.named.is_empty() && self.others.is_none()
    }

    fn fold(&mut self, refused: Refused) {
        let Refused { who, chaincode, subject, function, code, .. } = &refused;
        let key = (who.clone(), chaincode.clone(), subject.clone(), function.clone(), *code);
        if let Some(known) = self.named.get_mut(&key) {
            return join(known, refused);
        }
        let bytes = self.bytes + LINE_BYTES + key.0.len() + key.1.len() + key.2.len();
        if refused.code != 0 && self.named.len() < NAMED_MAX && bytes <= NAMED_BYTES_MAX {
            self.bytes = bytes;
            self.named.insert(key, refused);
            return;
        }
        match &mut self.others {
            Some(others) => join(others, rest(refused)),
            None => self.others = Some(rest(refused)),
        }
    }
}

/// Without what differs from one to the other.
fn rest(refused: Refused) -> Refused {
    let Refused { count, first, last, sample, .. } = refused;
    let [who, chaincode, function, subject, found] = std::array::from_fn(|_| String::new());
    let why = "further refusals of other identities, services or codes".to_owned();
    Refused { who, chaincode, function, subject, code: 0, count, first, last, sample, why, found }
}

/// Counts are never lost; words and sample are those of the last one.
fn join(known: &mut Refused, more: Refused) {
    known.count = known.count.saturating_add(more.count);
    known.first = known.first.min(more.first);
    if more.last >= known.last {
        known.last = more.last;
        known.sample = more.sample.or(known.sample);
        (known.why, known.found) = (more.why, more.found);
    }
}

/// The text as it may stand on the ledger.
fn bounded(text: &str) -> String {
    let mut made = String::new();
    for c in text.chars() {
        // Nothing that JSON would write in more bytes.
        let c = match c {
            '"' | '\\' => '\'',
            c if c.is_control() => '?',
            c => c,
        };
        if made.len() + c.len_utf8() > REFUSED_TEXT_MAX {
            break;
        }
        made.push(c);
    }
    made
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn one() -> impl Strategy<Value = One> {
        (0..100u32, 0..4u32, 3001..3003u32, 0..1000u64, "[a-z\\n\"]{0,300}").prop_map(
            |(who, subject, code, time, why)| One {
                who: format!("Org1/P{who}"),
                chaincode: "abac".into(),
                function: "acquire".into(),
                subject: format!("R{subject}"),
                code,
                time,
                why,
                ..One::default()
            },
        )
    }

    fn sum(told: &TellRefusals) -> u64 {
        told.refusals.iter().map(|refused| refused.count).sum()
    }

    proptest! {
        #[test]
        fn counts_are_never_lost_and_a_telling_is_bounded_however_many_are_refused(
            refused in proptest::collection::vec(one(), 1..500),
            fails_at in 0..500usize,
        ) {
            let mut gathered = Gathered::default();
            let mut told = 0;
            for (at, one) in refused.iter().cloned().enumerate() {
                gathered.add(one);
                if at == fails_at {
                    let taken = gathered.take().unwrap();
                    gathered.take_back(taken);
                } else if at % 97 == 96 {
                    told += sum(&gathered.take().unwrap());
                }
            }
            let (first, last) = (refused.iter().map(|one| one.time).min(), refused.iter().map(|one| one.time).max());
            if let Some(rest) = gathered.take() {
                told += sum(&rest);
                prop_assert!(rest.refusals.len() <= REFUSALS_MAX);
                prop_assert!(serde_json::to_vec(&rest).unwrap().len() <= REFUSALS_BYTES_MAX);
                for line in &rest.refusals {
                    prop_assert!(Some(line.first) >= first && Some(line.last) <= last && line.first <= line.last);
                    prop_assert!(line.why.len() <= REFUSED_TEXT_MAX && !line.why.contains('\n'));
                }
            }
            prop_assert_eq!(told, refused.len() as u64);
            prop_assert!(gathered.is_empty());
        }
    }

    #[test]
    fn alike_ones_are_one_line_with_the_first_and_the_last_time_and_the_last_sample() {
        let mut gathered = Gathered::default();
        for (time, byte) in [(5, 1), (9, 2), (7, 3)] {
            let sample = Some(Hash([byte; 32]));
            gathered.add(One { who: "Org1/Farhad".into(), code: 3001, time, sample, ..One::default() });
        }
        let told = gathered.take().unwrap().refusals;
        assert_eq!(told.len(), 1);
        let line = &told[0];
        assert_eq!((line.count, line.first, line.last, line.sample), (3, 5, 9, Some(Hash([2; 32]))));
    }

    #[test]
    fn refusals_of_two_functions_are_two_lines_so_that_each_says_what_was_refused() {
        let mut gathered = Gathered::default();
        for function in ["take", "acquire", "take"] {
            let (who, subject) = ("Org1/Farhad".into(), "Husky/cmd_vel".into());
            gathered.add(One { who, subject, function: function.into(), code: 3002, ..One::default() });
        }
        let told = gathered.take().unwrap().refusals;
        let lines: Vec<_> = told.iter().map(|line| (line.function.as_str(), line.count)).collect();
        assert_eq!(lines, [("acquire", 1), ("take", 2)]);
    }
}
