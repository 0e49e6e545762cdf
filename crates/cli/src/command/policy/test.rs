//! `policy test`: cases that policies are to decide in a known way.

use crate::argument::policies;
use crate::argument::when::When;
use crate::command::can;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table, printable};
use crate::session::Session;
use crate::time;
use ledger_base::rejection::{Class, Code, Rejection};
use ledger_contract::Ask;
use serde::{Deserialize, Serialize};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Most cases of a file.
const CASES_MAX: usize = 1000;

/// Run cases against policies: those in force, or those of files.
///
/// A case says who, what and when, and what is expected: `allow`, `deny`, or the code of the refusal. A name that the network does not
/// know is no `deny`: such a case fails unless it expects the code, such as NOT_FOUND. If a case fails, the exit code is 1.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
A file of cases:
  [[case]]
  who = \"Org1/Farhad\"
  action = \"acquire\"
  service = \"Husky/cmd_vel\"
  at = \"2027-05-01T22:00:00+02:00\"  # now without
  expect = \"DENIED_BY_POLICY\"       # or allow, deny, LGR-3002

Example:
  ledgerctl policy test cases.toml
  ledgerctl policy test cases.toml --policy night.cedar guests.cedar")]
pub(crate) struct Test {
    /// File with the cases
    #[arg(value_name = "CASES")]
    cases: PathBuf,
    /// Decide by these policies instead of those in force
    #[arg(long = "policy", value_name = "FILE", num_args = 1..)]
    policies: Vec<PathBuf>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Cases {
    case: Vec<Case>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Case {
    who: String,
    action: String,
    service: String,
    #[serde(default, deserialize_with = "moment")]
    at: Option<When>,
    #[serde(deserialize_with = "expected")]
    expect: String,
}

fn moment<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Option<When>, D::Error> {
    String::deserialize(from)?.parse().map(Some).map_err(serde::de::Error::custom)
}

fn expected<'de, D: serde::Deserializer<'de>>(from: D) -> Result<String, D::Error> {
    let text = String::deserialize(from)?;
    let is_name = !text.is_empty() && text.bytes().all(|b| b.is_ascii_uppercase() || b == b'_');
    let is_code = text.strip_prefix("LGR-").is_some_and(|digits| digits.bytes().all(|b| b.is_ascii_digit()));
    if is_name || is_code || text == "allow" || text == "deny" {
        return Ok(text);
    }
    Err(serde::de::Error::custom(format!(
        "{text:?}: wanted allow, deny, or a code such as LGR-3002 or DENIED_BY_POLICY"
    )))
}

/// Reads the cases of a file.
fn cases(text: &str, path: &Path) -> Result<Vec<Case>, Rejection> {
    let refused = |found: String| {
        Rejection::new(Code::BadFile, format!("the cases in {} cannot be read", path.display()))
            .found(found)
            .wanted("[[case]] with who, action, service and expect, and perhaps at")
            .next("ledgerctl policy test --help")
    };
    let Cases { case } = toml::from_str(text).map_err(|fault| refused(fault.to_string().trim().to_owned()))?;
    if (1..=CASES_MAX).contains(&case.len()) { Ok(case) } else { Err(refused(format!("{} cases", case.len()))) }
}

impl Test {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let cases = cases(&policies::text(&self.cases)?, &self.cases)?;
        let policies = policies::read(&self.policies)?;
        let session = Session::open(global).await?;
        let now = time::now();
        let mut results = Vec::new();
        for Case { who, action, service, at, expect } in cases {
            let at = at.map(|when| when.micros(now));
            let ask = Ask {
                who: Some(who.clone()),
                action: action.clone(),
                service: service.clone(),
                at,
                policies: policies.clone(),
            };
            let (code, name, why, decided) = match can::asked(&session, &ask).await {
                Ok(answer) => (answer.code, answer.name, answer.reason, true),
                Err(refused) if refused.code.class() == Class::Unreachable => return Err(refused.into()),
                // Faults of the policies themselves are no result of a case.
                Err(refused) if refused.code == Code::PolicyInvalid => return Err(refused.into()),
                Err(refused) => {
                    let why = format!("no policy was asked: {}", refused.message);
                    (refused.code.to_string(), refused.code.name().to_owned(), why, false)
                }
            };
            let passed = passes(&expect, (&code, &name), decided);
            results.push(Outcome { who, action, service, expect, code, name, why, passed });
        }
        let failed = results.iter().filter(|result| !result.passed).count();
        output.show(&Results(results))?;
        if failed == 0 { Ok(()) } else { Err(Failure::Told(Class::Failure.exit_code())) }
    }
}

/// Is that what was expected? A question that the policies have not decided is no denial.
fn passes(expect: &str, (code, name): (&str, &str), decided: bool) -> bool {
    let allowed = code == Code::Ok.to_string();
    match expect {
        "allow" => allowed,
        "deny" => decided && !allowed,
        expect => expect == code || expect == name,
    }
}

#[derive(Serialize)]
struct Results(Vec<Outcome>);

#[derive(Serialize)]
struct Outcome {
    who: String,
    action: String,
    service: String,
    expect: String,
    code: String,
    name: String,
    why: String,
    passed: bool,
}

impl Facts for Results {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::new(["CASE", "WHO", "ACTION", "SERVICE", "EXPECTED", "FOUND", "RESULT"]);
        for (number, case) in (1..).zip(&self.0) {
            table.row([
                number.to_string(),
                case.who.clone(),
                case.action.clone(),
                case.service.clone(),
                case.expect.clone(),
                if passes("allow", (&case.code, ""), true) { "allow".to_owned() } else { case.name.clone() },
                if case.passed { "passed" } else { "FAILED" }.to_owned(),
            ]);
        }
        table.write(out, 0)?;
        for (number, case) in (1..).zip(&self.0).filter(|(_, case)| !case.passed && !case.why.is_empty()) {
            writeln!(out, "case {number}: {}", printable(&case.why))?;
        }
        let failed = self.0.iter().filter(|case| !case.passed).count();
        writeln!(out, "{} passed, {failed} failed", self.0.len() - failed)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    const CASE: &str =
        "[[case]]\nwho = \"Org1/Farhad\"\naction = \"acquire\"\nservice = \"Husky\"\nexpect = \"deny\"\n";

    #[test]
    fn cases_are_read_and_slips_are_told_with_their_line() {
        let path = Path::new("cases.toml");
        let with_time = format!("{CASE}at = \"2027-05-01T22:00:00+02:00\"\n{CASE}");
        let read = cases(&with_time, path).unwrap();
        assert_eq!(read.iter().map(|case| case.at.is_some()).collect::<Vec<_>>(), [true, false]);
        for (text, part) in [
            (CASE.replace("deny", "maybe"), "wanted allow, deny, or a code"),
            (CASE.replace("who", "whom"), "whom"),
            (CASE.replace("action = \"acquire\"\n", ""), "action"),
            (format!("{CASE}at = \"soon\"\n"), "line 6"),
            (String::new(), "case"),
            ("case = []".to_owned(), "0 cases"),
        ] {
            let refused = cases(&text, path).err().unwrap();
            assert!(refused.found.contains(part), "{text}: {refused}");
        }
    }

    #[test]
    fn a_case_expects_a_yes_any_no_or_one_code() {
        for (expect, code, name, wanted) in [
            ("allow", "LGR-0000", "OK", true),
            ("allow", "LGR-3002", "DENIED_BY_POLICY", false),
            ("deny", "LGR-3002", "DENIED_BY_POLICY", true),
            ("LGR-3002", "LGR-3002", "DENIED_BY_POLICY", true),
            ("DENIED_BY_POLICY", "LGR-3002", "DENIED_BY_POLICY", true),
            ("MISSING_ATTRIBUTE", "LGR-3002", "DENIED_BY_POLICY", false),
            ("deny", "LGR-0000", "OK", false),
        ] {
            assert_eq!(passes(expect, (code, name), true), wanted, "{expect} {code}");
        }
        for (expect, wanted) in [("deny", false), ("allow", false), ("NOT_FOUND", true), ("LGR-1013", true)] {
            assert_eq!(passes(expect, ("LGR-1013", "NOT_FOUND"), false), wanted, "an unknown name, and {expect}");
        }
    }
}
