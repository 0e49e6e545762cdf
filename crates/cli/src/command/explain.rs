//! `explain`: the paragraph of a code.

use crate::failure::Failure;
use crate::output::{Facts, Output};
use ledger_base::rejection::{Code, Rejection};
use serde::Serialize;
use std::io::{self, Write};

/// The book of codes, as it stands in the repository.
const BOOK: &str = include_str!("../../../../docs/errors.md");

/// Explain a code: its meaning, causes and remedy.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl explain LGR-3005\n  ledgerctl explain 3005\n  ledgerctl explain HELD")]
pub(crate) struct Explain {
    /// LGR-3005, 3005 or HELD
    code: String,
}

#[derive(Serialize)]
struct Explanation {
    code: String,
    name: &'static str,
    exit_code: u8,
    text: &'static str,
}

impl Facts for Explanation {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "{} {} (exit code {})\n\n{}", self.code, self.name, self.exit_code, self.text)
    }
}

impl Explain {
    pub(crate) fn run(&self, output: &mut Output) -> Result<(), Failure> {
        let code = find(&self.code)?;
        let text = paragraph(code).unwrap_or_default();
        output.show(&Explanation {
            code: code.to_string(),
            name: code.name(),
            exit_code: code.class().exit_code(),
            text,
        })
    }
}

/// The code that somebody means by its number, its printed form, or its name.
fn find(text: &str) -> Result<Code, Rejection> {
    let wanted = text.trim().to_ascii_uppercase().replace([' ', '-'], "_");
    let number = wanted.strip_prefix("LGR_").unwrap_or(&wanted);
    if let Ok(number) = number.parse::<u16>() {
        return Code::from_number(number).ok_or_else(|| unknown(text, None));
    }
    let named = |name: &str| Code::ALL.iter().find(|code| code.name() == name).copied();
    named(&wanted).ok_or_else(|| {
        let near = ledger_base::nearest::nearest(&wanted, Code::ALL.iter().map(|code| code.name()));
        unknown(text, near.and_then(named))
    })
}

fn unknown(text: &str, near: Option<Code>) -> Rejection {
    Rejection::new(Code::NotFound, "there is no such code")
        .found(format!("{text:?}"))
        .wanted("a code such as LGR-3005, its number 3005, or its name HELD")
        .next(near.map_or_else(
            || "copy the code in brackets from the error message".to_owned(),
            |near| format!("did you mean {near} {}?", near.name()),
        ))
}

/// The paragraph of the book about a code, without its heading.
fn paragraph(code: Code) -> Option<&'static str> {
    let heading = format!("\n## {code} {}\n", code.name());
    let (_, rest) = BOOK.split_once(heading.as_str())?;
    Some(rest.split("\n## ").next().unwrap_or(rest).trim())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::panic, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn every_code_has_a_paragraph_with_meaning_cause_and_remedy() {
        for code in Code::ALL {
            let text = paragraph(*code).unwrap_or_else(|| panic!("docs/errors.md lacks {code} {}", code.name()));
            for part in ["- Meaning: ", "- Cause: ", "- Remedy: "] {
                assert_eq!(text.matches(part).count(), 1, "{part:?} of {code}");
            }
        }
    }

    #[test]
    fn no_paragraph_lacks_a_code_and_they_stand_in_order() {
        let headings: Vec<_> = BOOK.lines().filter_map(|line| line.strip_prefix("## ")).collect();
        let codes: Vec<_> = Code::ALL.iter().map(|code| format!("{code} {}", code.name())).collect();
        assert_eq!(headings, codes);
    }

    #[test]
    fn every_command_that_a_remedy_names_exists() {
        use clap::CommandFactory;
        let root = crate::cli::Cli::command();
        for command in BOOK.split('`').filter_map(|span| span.strip_prefix("ledgerctl ")) {
            let mut at = &root;
            for word in command.split_whitespace().take_while(|word| word.chars().all(|c| c.is_ascii_lowercase())) {
                if !at.has_subcommands() {
                    break;
                }
                at = at.find_subcommand(word).unwrap_or_else(|| panic!("`ledgerctl {command}`: no {word:?}"));
            }
        }
    }

    #[test]
    fn a_remedy_contains_the_advice_that_refusals_with_the_code_show() {
        let plain = |text: &str| text.replace('`', "").split_whitespace().collect::<Vec<_>>().join(" ").to_lowercase();
        let advised: Vec<_> = Code::ALL.iter().filter(|code| !code.advice().is_empty()).collect();
        for code in &advised {
            let remedy = plain(paragraph(**code).unwrap().split("- Remedy: ").last().unwrap());
            let advice = plain(code.advice());
            assert!(remedy.contains(&advice), "{code}: the advice is {advice:?}, the remedy {remedy:?}");
        }
        assert!(advised.len() > 20, "the table of codes has its advice");
    }

    #[test]
    fn the_advice_of_a_code_removes_nothing() {
        for code in Code::ALL {
            for word in ["remove", "delete", "--force", "revoke", "recover", "rejoin", "ledgerd init"] {
                assert!(!code.advice().contains(word), "{code}: {}", code.advice());
            }
        }
    }

    #[test]
    fn a_code_is_found_by_number_form_and_name() {
        for text in ["LGR-3005", "lgr-3005", "3005", "HELD", "held"] {
            assert_eq!(find(text).unwrap(), Code::Held, "{text}");
        }
        assert_eq!(find("missing-attribute").unwrap(), Code::MissingAttribute);
        assert_eq!(find("0").unwrap(), Code::Ok);
    }

    #[test]
    fn an_unknown_code_is_refused_with_a_near_match() {
        assert!(find("MISING_ATTRIBUTE").unwrap_err().advice().contains("LGR-3001 MISSING_ATTRIBUTE"));
        assert_eq!(find("9999").unwrap_err().code, Code::NotFound);
        assert_eq!(find("99999999").unwrap_err().code, Code::NotFound);
    }
}
