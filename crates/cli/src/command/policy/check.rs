//! `policy check`: the faults of policies, with a caret under each place, or their meaning in words.

use super::meaning::{check, meaning};
use super::unknown::shown;
use crate::argument::policies;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, printable};
use crate::session::Session;
use ledger_base::rejection::Code;
use ledger_contract::{PolicyCheck, PolicyFault, PolicyMeaning, UnknownName};
use serde::Serialize;
use std::io::{self, Write};
use std::path::PathBuf;

/// Check policies in files without putting them in force.
///
/// The node checks each file as `policy put` would, and reports every error with line and column. If there are errors,
/// the exit code is 3. Otherwise it prints what each policy permits to whom, under which conditions and limits.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl policy check night.cedar guests.cedar")]
pub(crate) struct Check {
    /// Files with policies in Cedar
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
}

impl Check {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let texts = self.files.iter().map(|path| policies::text(path)).collect::<Result<Vec<_>, _>>()?;
        let session = Session::open(global).await?;
        let mut checked = Vec::new();
        for (path, text) in self.files.iter().zip(texts) {
            let PolicyCheck { faults, policies, unknown } = check(&session, &text).await?;
            checked.push(File { file: path.display().to_string(), faults, policies, unknown });
        }
        let are_fine = checked.iter().all(|file| file.faults.is_empty());
        output.show(&Checked(checked))?;
        if are_fine { Ok(()) } else { Err(Failure::Told(Code::PolicyInvalid.class().exit_code())) }
    }
}

#[derive(Serialize)]
struct Checked(Vec<File>);

#[derive(Serialize)]
struct File {
    file: String,
    faults: Vec<PolicyFault>,
    policies: Vec<PolicyMeaning>,
    unknown: Vec<UnknownName>,
}

impl Facts for Checked {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        for File { file, faults, policies, unknown } in &self.0 {
            if faults.is_empty() {
                writeln!(out, "{file}: no errors")?;
            }
            for policy in policies {
                meaning(out, policy)?;
            }
            for name in unknown {
                writeln!(out, "  warning: line {} names {}, which does not exist", name.line, shown(name))?;
            }
            for PolicyFault { message, help, line, column, length, text } in faults {
                if *line == 0 {
                    writeln!(out, "{file}: {}", printable(message))?;
                } else {
                    writeln!(out, "{file}:{line}:{column}: {}", printable(message))?;
                    let before: String = text.chars().take(column.saturating_sub(1) as usize).collect();
                    // As wide as what stands above it.
                    let indent: String = before.chars().map(|c| if c == '\t' { '\t' } else { ' ' }).collect();
                    writeln!(out, "  {line} | {text}")?;
                    let margin = " ".repeat(line.to_string().len());
                    writeln!(out, "  {margin} | {indent}{}", "^".repeat(*length as usize))?;
                }
                if !help.is_empty() {
                    writeln!(out, "  help: {}", printable(help))?;
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_caret_stands_under_the_place() {
        let fault = PolicyFault {
            message: "attribute `nam` not found".into(),
            help: "did you mean `name`?".into(),
            line: 12,
            column: 8,
            length: 13,
            text: "\twhen { principal.nam == 1 };".into(),
        };
        let whole = PolicyFault { message: "too long".into(), line: 0, ..fault.clone() };
        let whole = PolicyFault { help: String::new(), ..whole };
        let checked = Checked(vec![
            File { file: "a.cedar".into(), faults: vec![fault, whole], policies: vec![], unknown: vec![] },
            File {
                file: "b.cedar".into(),
                faults: vec![],
                policies: vec![PolicyMeaning {
                    line: 3,
                    effect: "permit".into(),
                    meaning: "any user may acquire any service".into(),
                    when: vec!["their role is admin".into()],
                    limits: vec!["at most 0.2 m/s".into()],
                    except: vec!["stop".into(), "resume".into()],
                    unmatched: true,
                }],
                unknown: vec![UnknownName {
                    line: 3,
                    kind: "User".into(),
                    name: "Org1/Late".into(),
                    near: String::new(),
                }],
            },
        ]);
        let mut out = Vec::new();
        checked.text(&mut out).unwrap();
        let wanted = "a.cedar:12:8: attribute `nam` not found\n  12 | \twhen { principal.nam == 1 };\n     | \t      \
                      ^^^^^^^^^^^^^\n  help: did you mean `name`?\na.cedar: too long\nb.cedar: no errors\n  line 3: any user may acquire any service\n    when \
                      their role is admin\n    with at most 0.2 m/s\n    warning: it applies to no current identity that the ledger lists\n    without stop, resume: a permit must name \
                      these actions\n  warning: line 3 names User::\"Org1/Late\", which does not exist\n";
        assert_eq!(String::from_utf8(out).unwrap(), wanted);
    }
}
