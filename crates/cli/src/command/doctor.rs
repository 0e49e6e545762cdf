//! `doctor`: everything on this machine and in the network that keeps commands from robots, each with its repair.

mod finding;
mod fleet;
mod here;
mod peers;
mod ros;

use crate::argument::domain;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Format, Output, Table};
use crate::session::Session;
use crate::{context, time};
use finding::{Finding, State};
use ledger_api::Context;
use serde::Serialize;
use std::io::{self, Write};
use std::path::PathBuf;

/// Exit code where something is wrong.
const EXIT_WRONG: u8 = 1;

/// Check for problems that keep commands from robots, and print how to fix them.
///
/// It checks the context, clocks, certificates, the ports of nodes, the nodes and their disks. On this machine it
/// checks the ROS domain, interfaces, multicast and receive buffers. On the ledger it checks side doors, stops and
/// policies. The result of a check is `ok`, `advice` (works, but not in all cases), `wrong`, or `unknown` (could not be
/// checked). Exits with 1 if something is wrong. Changes nothing.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl doctor
  ledgerctl doctor --config bridge.toml
  ledgerctl doctor -o json")]
pub(crate) struct Doctor {
    /// Check with the settings of this bridge
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// The ROS domain; by default that of the bridge, ROS_DOMAIN_ID or 0
    #[arg(long, value_name = "NUMBER", value_parser = domain::parse)]
    domain: Option<u16>,
    /// The same as -o json
    #[arg(long)]
    json: bool,
}

/// Everything that was looked at.
#[derive(Serialize)]
struct Report {
    /// Is nothing wrong?
    ok: bool,
    wrong: usize,
    advice: usize,
    unknown: usize,
    findings: Vec<Finding>,
}

impl Doctor {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let mut findings = Vec::new();
        let context = here::context(global, &mut findings);
        if let Some(context) = &context {
            here::certificate(context, time::now(), &mut findings);
            network(context, &mut findings).await;
        }
        ros::look(self.config.as_deref(), self.domain, &mut findings);
        let report = Report::of(findings);
        if self.json {
            output.set_format(Format::Json);
        }
        output.show(&report)?;
        if report.ok { Ok(()) } else { Err(Failure::Told(EXIT_WRONG)) }
    }
}

/// The word of others: the ports of the nodes, the nodes, the robots.
async fn network(context: &Context, findings: &mut Vec<Finding>) {
    peers::ports(&context.addresses(), findings).await;
    match Session::connect(context.clone()).await {
        Ok(session) => {
            if peers::look(&session, findings).await {
                fleet::look(&session, findings).await;
            } else {
                unknown(&["side doors", "policy"], "not checked, because there is no quorum", findings);
            }
        }
        Err(refused) => {
            findings.push(Finding::refused("node", &refused));
            unknown(
                &["clock", "peers", "disk", "side doors", "policy"],
                "not checked, because no node answers",
                findings,
            );
        }
    }
}

fn unknown(checks: &[&'static str], why: &str, findings: &mut Vec<Finding>) {
    let repair = "fix the findings above that are `wrong`, then run the command again";
    findings.extend(checks.iter().map(|check| Finding::unknown(*check, why, repair)));
}

impl Report {
    fn of(findings: Vec<Finding>) -> Self {
        let count = |state| findings.iter().filter(|finding| finding.state == state).count();
        let [wrong, advice, unknown] = [State::Wrong, State::Advice, State::Unknown].map(count);
        Self { ok: wrong == 0, wrong, advice, unknown, findings }
    }
}

impl Facts for Report {
    fn rows(&self) -> serde_json::Result<String> {
        serde_json::to_string(&self.findings)
    }

    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::pairs();
        for finding in &self.findings {
            table.row([finding.state.word().to_owned(), finding.check.to_string(), finding.message.clone()]);
            if !finding.r#try.is_empty() {
                table.row([String::new(), String::new(), format!("try: {}", finding.r#try)]);
            }
        }
        table.write(out, 0)?;
        writeln!(out)?;
        match (self.wrong, self.advice) {
            (0, 0) => writeln!(out, "no problems"),
            (0, advice) => writeln!(out, "no problems, {advice} to review"),
            (wrong, 0) => writeln!(out, "{wrong} wrong"),
            (wrong, advice) => writeln!(out, "{wrong} wrong, {advice} to review"),
        }
    }
}

/// The name that a command needs for this context, where it is not the one in use.
fn acting(context: &Context) -> String {
    let in_use = context::home().ok().and_then(|home| Context::current(&home).ok()).flatten();
    if in_use.as_ref() == Some(&context.name) { String::new() } else { format!(" --context {}", context.name) }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_report_counts_what_is_wrong_and_names_each_repair() {
        let findings = vec![
            Finding::ok("context", "Salma"),
            Finding::advice("receive buffers", "small", "sysctl -w x=1"),
            Finding::wrong("clock", "9 s ahead", "timedatectl set-ntp true"),
        ];
        let report = Report::of(findings);
        assert_eq!((report.ok, report.wrong, report.advice, report.unknown), (false, 1, 1, 0));
        let mut out = Vec::new();
        report.text(&mut out).unwrap();
        let wanted = "\
ok      context          Salma
advice  receive buffers  small
                         try: sysctl -w x=1
wrong   clock            9 s ahead
                         try: timedatectl set-ntp true

1 wrong, 1 to review
";
        assert_eq!(String::from_utf8(out).unwrap(), wanted);
        assert!(Report::of(vec![Finding::unknown("peers", "no answer", "run the command again")]).ok);
    }
}
