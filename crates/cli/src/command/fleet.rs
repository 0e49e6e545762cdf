//! `apply`, `diff`, `export`: the robots, policies and shares of an organisation as one file.

mod export;
mod file;
mod plan;

use super::policy::one::InForce;
use super::policy::rights::changes;
use super::policy::unknown::Expected;
use super::robot::change::{ends, settings};
use crate::answer;
use crate::argument::bytes;
use crate::confirm;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Format, Output, printable};
use crate::session::{self, ABAC, Session};
use crate::words::shell_word;
use bytes::from_file;
use file::FleetFile;
use ledger_base::rejection::{Code, Rejection};
use ledger_base::text;
use ledger_contract::{
    FleetChange, FleetPlan, PolicyDiff, PolicyEntry, PolicyText, Released, RobotAsset, RobotChange, SettingChange,
};
use plan::{FleetState, plan};
use serde::Serialize;
use std::io::{self, Write};
use std::path::PathBuf;

/// Change the fleet of your organisation to match a file; for admins.
///
/// The file lists robots with their services and trust, policies, and shares; `ledgerctl export` writes such a file.
/// The command shows the difference, with the grants that end and the permissions that people gain or lose, and asks
/// for confirmation. All changes take effect together, or none, even if another admin has changed the network in the
/// meantime. Without --prune, everything that the file does not name stays. Applying the file again changes nothing.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl apply fleet.toml
  ledgerctl apply fleet.toml --prune --yes")]
pub(crate) struct Apply {
    #[command(flatten)]
    which: FleetSource,
    /// Do not ask for confirmation
    #[arg(long)]
    yes: bool,
    /// Reason; recorded in the history of policies
    #[arg(long, short, default_value = "", hide_default_value = true)]
    message: String,
}

/// Show how the fleet of your organisation differs from a file; changes nothing.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl diff fleet.toml --prune")]
pub(crate) struct Diff {
    #[command(flatten)]
    which: FleetSource,
}

/// Print the fleet of your organisation as a file for `apply`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl export > fleet.toml")]
pub(crate) struct Export {}

#[derive(Debug, clap::Args)]
struct FleetSource {
    /// File, in TOML
    file: PathBuf,
    /// Remove what the file does not name: robots, services, attributes, policies and shares
    #[arg(long)]
    prune: bool,
    #[command(flatten)]
    expected: Expected,
}

/// A plan, and what it would change.
struct PreparedPlan {
    plan: FleetPlan,
    difference: Difference,
}

impl Apply {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let PreparedPlan { mut plan, difference } = self.which.prepare(&session).await?;
        let format = output.format();
        if format == Format::Table {
            output.show(&difference)?;
        }
        if difference.is_empty() {
            return if format == Format::Table { Ok(()) } else { output.show(&difference) };
        }
        confirm::agree("the file", self.yes)?;
        if let Some(set) = &mut plan.policies {
            // Robots without anyone who may publish were shown.
            (set.message, set.means_it) = (self.message, true);
        }
        let done = session.call(ABAC, "reconcile", vec![session::argument(&plan)?]).await.map_err(in_words)?;
        let change: FleetChange = answer::parse(&done.response, "a change of a fleet")?;
        output.show(&AppliedFile { difference: Difference::of(&plan, change), height: done.height })
    }
}

impl Diff {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        output.show(&self.which.prepare(&session).await?.difference)
    }
}

impl Export {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let file = export::written(&state(&session).await?)?;
        // To a file as it is: what is written to a terminal would change texts that hide something.
        if output.format() == Format::Table { output.raw(file.as_bytes()) } else { output.show(&ExportedFile { file }) }
    }
}

impl FleetSource {
    /// Reads the file, makes the plan, and asks the ledger what it would change.
    async fn prepare(&self, session: &Session) -> Result<PreparedPlan, Rejection> {
        let path = self.file.display().to_string();
        let unreadable = |found: String| {
            Rejection::new(Code::BadFile, format!("{path} is not a fleet file"))
                .found(found)
                .wanted("TOML with robots, policies and shares")
                .next(match self.file.extension().is_some_and(|extension| extension == "cedar") {
                    true => format!("ledgerctl policy apply {}", shell_word(&path)),
                    false => "ledgerctl export prints a file in this form".to_owned(),
                })
        };
        let text = text::of_bytes(&from_file(&self.file)?).map_err(|fault| unreadable(fault.to_string()))?;
        let file = FleetFile::read(&text).map_err(unreadable)?;
        let state = state(session).await?;
        let plan = plan(&state, &file, self.prune)?;
        if plan == FleetPlan::default() {
            return Ok(PreparedPlan { plan, difference: Difference::default() });
        }
        let set = plan.policies.iter().filter_map(|set| set.policies.as_ref()).flatten();
        let new: Vec<PolicyText> = set.filter(|policy| !state.policies.contains(policy)).cloned().collect();
        self.expected.check(session, &new).await?;
        let mut asked = plan.clone();
        if let Some(set) = &mut asked.policies {
            set.means_it = true;
        }
        let response = session.ask(ABAC, "reconcile", vec![session::argument(&asked)?]).await.map_err(in_words)?;
        let difference = Difference::of(&plan, answer::parse(&response, "a change of a fleet")?);
        Ok(PreparedPlan { plan, difference })
    }
}

/// The fleet of the own organisation now.
async fn state(session: &Session) -> Result<FleetState, Rejection> {
    let InForce { organisation, version, policies } = InForce::of(session).await?;
    let robots: Vec<RobotAsset> = session.list(ABAC, "robots").await?;
    let all: Vec<PolicyEntry> = session.list(ABAC, "policies").await?;
    let built_in = all.into_iter().find(|policy| policy.organisation.is_empty()).map(|policy| policy.text);
    let robots = robots.into_iter().filter(|robot| robot.organisation == organisation).collect();
    Ok(FleetState { organisation, robots, version, policies, built_in: built_in.unwrap_or_default() })
}

fn in_words(refused: Rejection) -> Rejection {
    match refused.code {
        Code::PoliciesChanged | Code::RobotChanged => {
            refused.next("nothing was changed; run the command again: it starts from the current state")
        }
        Code::NeedsApproval => refused.next(
            "propose the policies: ledgerctl policy propose FILE…, and ledgerctl share … --propose; then apply the \
             file for the robots",
        ),
        _ => refused,
    }
}

/// The differences between a file and a network.
#[derive(Default, Serialize)]
struct Difference {
    /// Robots that are new.
    added: Vec<String>,
    /// Robots that have other settings.
    changed: Vec<RobotDifference>,
    /// Robots that are taken out of service.
    removed: Vec<String>,
    /// Policies and shares of the next set, if it is another one.
    #[serde(skip_serializing_if = "Option::is_none")]
    policies: Option<Vec<String>>,
    /// Grants that end.
    ended: Vec<Released>,
    #[serde(skip_serializing_if = "Option::is_none")]
    diff: Option<PolicyDiff>,
}

#[derive(Serialize)]
struct RobotDifference {
    robot: String,
    changed: Vec<SettingChange>,
}

impl Difference {
    fn of(plan: &FleetPlan, change: FleetChange) -> Self {
        let FleetChange { robots, removed, policies, diff } = change;
        let mut difference = Self { diff, ended: removed, ..Self::default() };
        for (spec, RobotChange { robot, changed, ended }) in plan.robots.iter().zip(robots) {
            difference.ended.extend(ended);
            match spec.base.as_deref() {
                Some("") => difference.added.push(robot.name),
                _ => difference.changed.push(RobotDifference { robot: robot.name, changed }),
            }
        }
        difference.removed = plan.removed.iter().map(|gone| gone.name.clone()).collect();
        difference.ended.extend(policies.map(|change| change.ended).unwrap_or_default());
        let set = plan.policies.as_ref().and_then(|set| set.policies.as_ref());
        difference.policies = set.map(|set| set.iter().map(|policy| policy.id.clone()).collect());
        difference
    }

    fn is_empty(&self) -> bool {
        self.added.is_empty() && self.changed.is_empty() && self.removed.is_empty() && self.policies.is_none()
    }
}

impl Facts for Difference {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.is_empty() {
            return writeln!(out, "nothing to change: the network matches the file");
        }
        for robot in &self.added {
            writeln!(out, "robot {} is new", printable(robot))?;
        }
        for robot in &self.removed {
            writeln!(out, "robot {} is removed", printable(robot))?;
        }
        for RobotDifference { robot, changed } in &self.changed {
            writeln!(out, "robot {}:", printable(robot))?;
            settings(out, changed)?;
        }
        match self.policies.as_deref() {
            None => {}
            Some([]) => writeln!(out, "policies: none of your own, the built-in policy decides")?,
            Some(ids) => writeln!(out, "policies: {}", printable(&ids.join(", ")))?,
        }
        ends(out, &self.ended, "ends")?;
        self.diff.as_ref().map_or(Ok(()), |diff| changes(out, diff))
    }
}

/// A file that is applied.
#[derive(Serialize)]
struct AppliedFile {
    #[serde(flatten)]
    difference: Difference,
    height: u64,
}

impl Facts for AppliedFile {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "applied in block {}", self.height)?;
        ends(out, &self.difference.ended, "ended")
    }
}

/// The file of a fleet.
#[derive(Serialize)]
struct ExportedFile {
    file: String,
}

impl Facts for ExportedFile {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        out.write_all(self.file.as_bytes())
    }
}
