//! Refusals that are not on the ledger yet: one line for each identity, function, service and code.
//!
//! A report has a bounded number of lines. When they are used up, those of the organisation with the most lines are folded, and within it those of the identity with the most. They become one line of that identity, then one line of that organisation. So many different
//! refusals of one identity hide no refusal of another organisation, and none of another identity while that has fewer lines.

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
    /// Those of more organisations than there are lines.
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
        // These are not signed, so they are in no identity's share.
        if who.is_empty() && *code == 0 {
            return self.add_others(refused);
        }
        while !self.named.contains_key(&key) && !self.has_room(&key) {
            let group = self.largest(&key.0);
            match self.named.keys().filter(|key| group.has(&key.0)).count() {
                // There are more organisations than lines.
                0 => return self.add_others(refused),
                1 => {
                    self.fold_lines(&group, 1);
                    return self.add_rest(&group.line(), refused);
                }
                _ => {
                    let has_line = self.named.contains_key(&rest_key(&group.line()));
                    self.fold_lines(&group, if has_line { 1 } else { 2 });
                }
            }
        }
        self.add_line(key, refused);
    }

    /// Is a line with this key within the bounds?
    fn has_room(&self, key: &Key) -> bool {
        self.named.len() < NAMED_MAX && self.bytes + bytes(key) <= NAMED_BYTES_MAX
    }

    fn add_line(&mut self, key: Key, refused: Refused) {
        match self.named.get_mut(&key) {
            Some(known) => join(known, refused),
            None => {
                self.bytes += bytes(&key);
                self.named.insert(key, refused);
            }
        }
    }

    fn add_others(&mut self, refused: Refused) {
        let rest = rest(refused, "");
        match &mut self.others {
            Some(others) => join(others, rest),
            None => self.others = Some(rest),
        }
    }

    /// Adds them to the line of a group.
    fn add_rest(&mut self, line: &str, refused: Refused) {
        match line {
            "" => self.add_others(refused),
            line => self.add_line(rest_key(line), rest(refused, line)),
        }
    }

    /// The group whose lines are folded for a line of `newcomer`: of the organisation with the most lines, the identity with the most.
    /// Where each identity has one line, it is the organisation. The newcomer's line counts, and of two groups its own is taken.
    fn largest(&self, newcomer: &str) -> Group {
        let (crowd, _) = self.most(newcomer, |who| Some(organisation(who)));
        match self.most(newcomer, |who| (organisation(who) == crowd).then_some(who)) {
            (identity, lines) if lines > 1 => Group::Identity(identity),
            _ => Group::Organisation(crowd),
        }
    }

    fn most<'a>(&'a self, newcomer: &'a str, group: impl Fn(&'a str) -> Option<&'a str>) -> (String, usize) {
        let mut lines: BTreeMap<&str, usize> = BTreeMap::new();
        let all = self.named.keys().map(|key| &*key.0).chain([newcomer]);
        all.filter_map(&group).for_each(|name| *lines.entry(name).or_default() += 1);
        let own = group(newcomer);
        let most = lines.into_iter().max_by_key(|(name, lines)| (*lines, Some(*name) == own));
        most.map_or_else(Default::default, |(name, lines)| (name.to_owned(), lines))
    }

    /// Folds N lines of a group into its own one, those with the fewest refusals first.
    fn fold_lines(&mut self, group: &Group, count: usize) {
        let line = group.line();
        let rest_key = rest_key(&line);
        let of_group = self.named.iter().filter(|(key, _)| group.has(&key.0) && **key != rest_key);
        let mut keys: Vec<_> = of_group.map(|(key, refused)| (refused.count, key.clone())).collect();
        keys.sort_by_key(|(count, _)| *count);
        for (_, key) in keys.into_iter().take(count) {
            if let Some(refused) = self.named.remove(&key) {
                self.bytes -= bytes(&key);
                self.add_rest(&line, refused);
            }
        }
    }
}

/// Lines that are folded together.
enum Group {
    /// Those of an identity; empty where no signature was verified.
    Identity(String),
    /// Those of all identities of an organisation.
    Organisation(String),
}

impl Group {
    fn has(&self, who: &str) -> bool {
        match self {
            Self::Identity(identity) => who == identity,
            Self::Organisation(name) => organisation(who) == name,
        }
    }

    /// The name of their line.
    fn line(&self) -> String {
        match self {
            Self::Organisation(name) if !name.is_empty() => format!("{name}/*"),
            Self::Organisation(name) | Self::Identity(name) => name.clone(),
        }
    }
}

/// The key of the line of a group.
fn rest_key(line: &str) -> Key {
    (line.to_owned(), String::new(), String::new(), String::new(), 0)
}

/// Bytes of a line, at most.
fn bytes(key: &Key) -> usize {
    LINE_BYTES + key.0.len() + key.1.len() + key.2.len()
}

/// The organisation of an identity; empty if no signature was verified.
fn organisation(who: &str) -> &str {
    who.split('/').next().unwrap_or_default()
}

/// The same refusals without what differs from one to the other, as those of this name.
fn rest(refused: Refused, who: &str) -> Refused {
    let Refused { count, first, last, sample, .. } = refused;
    let [chaincode, function, subject, found] = std::array::from_fn(|_| String::new());
    let why = match who {
        "" => "further rejections of other identities, services or codes",
        _ => "further rejections with other services, functions or codes",
    };
    let (who, why) = (who.to_owned(), why.to_owned());
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

    fn refusal(who: &str, subject: usize) -> One {
        let (who, subject) = (who.to_owned(), format!("Robot{subject}/cmd_vel"));
        One { who, subject, function: "acquire".into(), code: 3002, ..One::default() }
    }

    /// The lines of an identity that name a service, and the refusals in all its lines.
    fn told_of(told: &TellRefusals, who: &str) -> (usize, u64) {
        let lines = told.refusals.iter().filter(|line| line.who == who);
        (lines.clone().filter(|line| line.code != 0).count(), lines.map(|line| line.count).sum())
    }

    #[test]
    fn an_accomplice_with_many_different_refusals_hides_none_of_somebody_else() {
        for accomplice in ["Org1/Accomplice", "Org2/Accomplice", ""] {
            for thief_first in [true, false] {
                let mut gathered = Gathered::default();
                let order: Vec<(&str, usize)> = match thief_first {
                    true => (0..28).map(|at| ("Org1/Thief", at)).chain((0..90).map(|at| (accomplice, at))).collect(),
                    false => (0..90).map(|at| (accomplice, at)).chain((0..28).map(|at| ("Org1/Thief", at))).collect(),
                };
                order.iter().for_each(|(who, subject)| gathered.add(refusal(who, *subject)));
                let told = gathered.take().unwrap();
                assert_eq!(told_of(&told, "Org1/Thief"), (28, 28), "{accomplice:?} {thief_first}");
                assert_eq!(told_of(&told, accomplice).1, 90, "{accomplice:?} {thief_first}");
                assert!(told.refusals.len() <= REFUSALS_MAX);
            }
        }
    }

    #[test]
    fn many_identities_of_one_organisation_hide_no_refusal_of_another_one() {
        let mut gathered = Gathered::default();
        (0..28).for_each(|at| gathered.add(refusal("Org1/Thief", at)));
        (0..200).for_each(|at| gathered.add(refusal(&format!("Org2/Puppet{at}"), at)));
        let told = gathered.take().unwrap();
        assert_eq!(told_of(&told, "Org1/Thief"), (28, 28));
        let of_puppets = told.refusals.iter().filter(|line| line.who.starts_with("Org2/"));
        assert_eq!(of_puppets.map(|line| line.count).sum::<u64>(), 200);
        assert!(told.refusals.iter().any(|line| line.who == "Org2/*" && line.count > 1));
    }

    #[test]
    fn a_folded_line_keeps_the_name_of_its_identity_and_no_line_is_of_two_organisations() {
        let mut gathered = Gathered::default();
        for org in 0..90 {
            (0..3).for_each(|at| gathered.add(refusal(&format!("Org{org}/P{at}"), at)));
        }
        let told = gathered.take().unwrap();
        assert_eq!(sum(&told), 270);
        let of = |org: usize| told.refusals.iter().filter(|line| line.who.starts_with(&format!("Org{org}/"))).count();
        assert!((0..NAMED_MAX).all(|org| of(org) == 1), "{told:?}");
        let mut alone = Gathered::default();
        (0..90).for_each(|at| alone.add(refusal("Org1/Thief", at)));
        assert_eq!(told_of(&alone.take().unwrap(), "Org1/Thief").1, 90, "nothing of it is anonymous");
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
