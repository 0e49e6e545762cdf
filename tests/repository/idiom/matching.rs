//! Finds the phrases of the rules in sentences.

use super::rules::{MACHINES, NO_HEADINGS, RULES, Rule};
use crate::words::{Paragraph, sentences};
use std::collections::BTreeSet;

/// A word without its signs.
struct Word {
    text: String,
    /// Does a sign follow that ends a clause?
    ends: bool,
    is_machine: bool,
}

/// A phrase in a text: where, which words, and the rule.
pub(crate) struct Hit {
    pub(crate) line: usize,
    pub(crate) phrase: String,
    pub(crate) instead: &'static str,
    /// The sentence around it.
    pub(crate) sentence: String,
}

impl Hit {
    /// The fault, for people.
    pub(crate) fn shown(&self, file: &str) -> String {
        let Self { line, phrase, instead, sentence } = self;
        format!("{file}:{line}: {phrase:?}; write: {instead}\n    {sentence}")
    }
}

fn word(raw: &str, machines: &BTreeSet<&str>) -> Word {
    let ends = raw.ends_with([',', ';', ':', '.', '!', '?', ')', '"', '—']);
    let bare = raw.trim_matches(['(', ')', ',', ';', ':', '.']);
    if bare.len() > 1 && bare.starts_with('"') && bare.ends_with('"') {
        // A value: "forever".
        return Word { text: String::new(), ends, is_machine: false };
    }
    let text = raw.trim_matches(|c: char| !c.is_alphanumeric()).to_lowercase().replace('’', "'");
    let text = text.strip_suffix("'s").unwrap_or(&text).to_owned();
    Word { ends, is_machine: machines.contains(text.as_str()), text }
}

/// A pattern in parts: the alternatives of each word.
struct Pattern {
    at_begin: bool,
    not_after: Option<&'static str>,
    parts: Vec<Vec<&'static str>>,
    instead: &'static str,
}

impl Pattern {
    fn of(rule: &Rule) -> Self {
        let (at_begin, rest) = rule.pattern.strip_prefix("^ ").map_or((false, rule.pattern), |rest| (true, rest));
        let not_after = rest.strip_prefix('!').and_then(|rest| rest.split_once(' '));
        let parts = not_after.map_or(rest, |(_, rest)| rest).split(' ').map(|part| part.split('|').collect()).collect();
        Self { at_begin, not_after: not_after.map(|(word, _)| word), parts, instead: rule.instead }
    }

    /// The places in a sentence at which it begins.
    fn places(&self, words: &[Word]) -> Vec<usize> {
        let is_there = |found: &[Word]| {
            let inside = found.split_last().is_none_or(|(_, before)| before.iter().all(|word| !word.ends));
            inside && found.iter().zip(&self.parts).all(|(word, part)| part.iter().any(|one| matches(one, word)))
        };
        let found = words.windows(self.parts.len()).enumerate().filter(|(_, found)| is_there(found)).map(|(at, _)| at);
        let before = |at: usize| at.checked_sub(1).and_then(|at| words.get(at)).map(|word| word.text.as_str());
        found
            .filter(|at| !self.at_begin || *at == 0)
            .filter(|at| self.not_after.is_none_or(|not| before(*at) != Some(not)))
            .collect()
    }
}

/// Is it this word of a pattern?
fn matches(one: &str, word: &Word) -> bool {
    match one {
        "$machine" => word.is_machine,
        "#" => word.text.chars().all(|c| c.is_ascii_digit() || c == '.') && !word.text.is_empty(),
        one => one.strip_suffix('*').map_or(word.text == one, |begin| word.text.starts_with(begin)),
    }
}

/// The phrases in these paragraphs that a rule rejects.
pub(crate) fn hits(paragraphs: &[Paragraph]) -> Vec<Hit> {
    let machines: BTreeSet<&str> = MACHINES.split('|').collect();
    let patterns: Vec<Pattern> = RULES.iter().map(Pattern::of).collect();
    let mut found = Vec::new();
    for Paragraph { line, text } in paragraphs {
        for sentence in sentences(text) {
            let words: Vec<Word> = sentence.iter().map(|raw| word(raw, &machines)).collect();
            for pattern in &patterns {
                found.extend(pattern.places(&words).into_iter().map(|at| {
                    let phrase: Vec<_> =
                        words.iter().skip(at).take(pattern.parts.len()).map(|word| word.text.as_str()).collect();
                    Hit {
                        line: *line,
                        phrase: phrase.join(" "),
                        instead: pattern.instead,
                        sentence: sentence.join(" "),
                    }
                }));
            }
        }
    }
    found
}

/// The headings of a page that begin a clause, in place of a noun phrase.
pub(crate) fn headings(page: &[Paragraph]) -> Vec<Hit> {
    let hit = |Paragraph { line, text }: &Paragraph| {
        let first = word(text.split(' ').next().unwrap_or_default(), &BTreeSet::new()).text;
        let hit = Hit {
            line: *line,
            phrase: first.clone(),
            instead: "a noun phrase that a search finds",
            sentence: text.clone(),
        };
        NO_HEADINGS.split('|').any(|word| word == first).then_some(hit)
    };
    page.iter().filter_map(hit).collect()
}
