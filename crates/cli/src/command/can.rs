//! `can`: may somebody do something, why, and who could instead.

use super::grant::limits_text;
use crate::answer;
use crate::argument::policies;
use crate::argument::when::When;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table, printable};
use crate::session::{self, ABAC, Session};
use crate::time;
use crate::words::Words;
use bytes::Bytes;
use ledger::Page;
use ledger_api::pages::PageBound;
use ledger_base::rejection::{Class, Rejection};
use ledger_contract::{Access, Ask, AskAccess, Can as Answer, Could, PolicyText, Right, RobotAsset};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::{self, Write};
use std::path::PathBuf;

/// Most names of a page: each is decided about.
const PAGE: usize = 32;
/// The answer about an organisation of which nobody is registered.
const UNLISTED: &str = "the ledger lists no identity of your organisation: with an external CA, its members are not \
                        registered and can only ask about themselves";

/// Check whether an identity may do something, and why.
///
/// A positive answer names the policies that decided. A negative answer names the conditions that failed, with the
/// values found and wanted, and exits with 2. The answer is about permission only: `robot list` shows whether the
/// service is free. Members of an organisation with an external CA can only ask about themselves, because the ledger
/// does not list them.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Actions: acquire, publish, subscribe, override, confirm; of a robot stop and resume.

Example:
  ledgerctl can Org1/Farhad acquire Husky/cmd_vel --who-could
  ledgerctl can Org1/Salma publish Turtlebot4/cmd_vel --at 2027-05-01T22:00:00+02:00 --policy night.cedar
  ledgerctl can --matrix
  ledgerctl can --as Org1/Salma")]
pub(crate) struct Can {
    /// The identity, such as Org1/Farhad; a name without an organisation is one of your own
    #[arg(required_unless_present_any = ["matrix", "as"])]
    who: Option<String>,
    /// The action, such as acquire
    #[arg(required_unless_present_any = ["matrix", "as"])]
    action: Option<String>,
    /// The service, or the robot
    #[arg(value_name = "ROBOT[/TOPIC]", required_unless_present_any = ["matrix", "as"])]
    service: Option<String>,
    /// Decide for another time than now: 10m for ten minutes from now, or a time such as 2027-05-01T22:00:00+02:00
    #[arg(long, value_name = "TIME")]
    at: Option<When>,
    /// Decide by these policies instead of those in force
    #[arg(long = "policy", value_name = "FILE", num_args = 1..)]
    policies: Vec<PathBuf>,
    /// Also list the members of your organisation that could do it; for its admins
    #[arg(long)]
    who_could: bool,
    /// List all permissions on every robot: of each organisation for admins of its owner, of their own for other admins
    #[arg(long, conflicts_with_all = ["who", "action", "service", "who_could"])]
    matrix: bool,
    /// List all permissions of this identity, such as Org1/Salma
    #[arg(long = "as", id = "as", value_name = "ORG/PERSON", conflicts_with_all = ["who", "action", "service", "who_could"])]
    person: Option<String>,
}

/// The words of the command line where the chaincode has other names.
const WORDS: Words = Words { arguments: &[("ASK_JSON", "the question")], help: "ledgerctl can" };

impl Can {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let policies = policies::read(&self.policies)?;
        let at = self.at.map(|when| when.micros(time::now()));
        let session = Session::open(global).await?;
        let ask = |action: &str, service: &str| Ask {
            who: None,
            action: action.to_owned(),
            service: service.to_owned(),
            at,
            policies: policies.clone(),
        };
        let (Some(who), Some(action), Some(service)) = (self.who, self.action, self.service) else {
            return output.show(&matrix(&session, self.person, at, policies).await?);
        };
        let who = if who.contains('/') { who } else { format!("{}/{who}", session.identity()?.organisation) };
        let ask = ask(&action, &service);
        let answer = asked(&session, &Ask { who: Some(who), ..ask.clone() }).await?;
        let listed =
            if self.who_could { Some(in_pages::<Could>(&session, "could", &ask, "who may").await?) } else { None };
        let is_listed = listed.as_ref().is_some_and(|listed| !listed.is_empty());
        let names = |all: Vec<Could>| all.into_iter().filter(|one| one.allowed).map(|one| one.who).collect::<Vec<_>>();
        let (allowed, who_could) = (answer.allowed, listed.map(names));
        output.show(&Told { answer, who_could, is_listed })?;
        if allowed { Ok(()) } else { Err(Failure::Told(Class::Denied.exit_code())) }
    }
}

/// The answer to one question.
pub(super) async fn asked(session: &Session, ask: &Ask) -> Result<Answer, Rejection> {
    let response = session.ask(ABAC, "can", vec![session::argument(ask)?]).await;
    answer::parse(&response.map_err(|refused| WORDS.told(refused))?, "the permission of an identity")
}

/// All answers of a function that gives them in pages: `could` for the caller's organisation, `access` for a robot.
async fn in_pages<T: DeserializeOwned>(
    session: &Session,
    function: &str,
    ask: &impl Serialize,
    what: &str,
) -> Result<Vec<T>, Rejection> {
    let ask = session::argument(ask)?;
    let (mut all, mut after, mut bound) = (Vec::new(), None, PageBound::default());
    loop {
        let page = serde_json::json!({"after": after, "most": PAGE});
        let args: Vec<Bytes> = vec![ask.clone(), session::argument(&page)?];
        let response = session.ask(ABAC, function, args).await.map_err(|refused| WORDS.told(refused))?;
        let page: Page<T> = answer::parse(&response, what)?;
        let count = page.items.len();
        all.extend(page.items);
        after = page.next;
        if after.is_none() {
            return Ok(all);
        }
        bound.count("those with the permission", count)?;
    }
}

/// The rights of all people, or of one person, on every robot.
async fn matrix(
    session: &Session,
    who: Option<String>,
    at: Option<u64>,
    policies: Option<Vec<PolicyText>>,
) -> Result<Matrix, Rejection> {
    let who = match who {
        Some(name) if !name.contains('/') => Some(format!("{}/{name}", session.identity()?.organisation)),
        who => who,
    };
    let robots: Vec<RobotAsset> = session.list(ABAC, "robots").await?;
    let mut rows = Vec::new();
    for robot in robots {
        let ask = AskAccess { robot: robot.name.clone(), who: who.clone(), at, policies: policies.clone() };
        for Access { who, rights, .. } in in_pages(session, "access", &ask, "the permissions of identities").await? {
            rows.extend(rows_of(&who, &robot.name, rights));
        }
    }
    rows.sort_by(|one: &Row, other| (&one.who, &one.service).cmp(&(&other.who, &other.service)));
    Ok(Matrix(rows))
}

/// A row for the services and one for the robot, with each limit; one for the robot of who has no right.
fn rows_of(who: &str, robot: &str, rights: Vec<Right>) -> Vec<Row> {
    let row = |service: &str, limits: &str| Row {
        who: who.to_owned(),
        service: service.to_owned(),
        actions: Vec::new(),
        limits: limits.to_owned(),
    };
    let mut rows: Vec<Row> = Vec::new();
    for Right { of, action, limits, closed, .. } in rights {
        let limits = match closed.is_empty() {
            true => limits_text(&limits),
            false => format!("only within {}", closed.join(" or ")),
        };
        match rows.iter_mut().find(|row| row.service == of && row.limits == limits) {
            Some(row) => row.actions.push(action),
            None => rows.push(Row { actions: vec![action], ..row(&of, &limits) }),
        }
    }
    if rows.is_empty() { vec![row(robot, "")] } else { rows }
}

#[derive(Serialize)]
struct Told {
    #[serde(flatten)]
    answer: Answer,
    #[serde(skip_serializing_if = "Option::is_none")]
    who_could: Option<Vec<String>>,
    /// The registry has somebody of the organisation.
    #[serde(skip)]
    is_listed: bool,
}

impl Facts for Told {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let Answer { who, action, service, allowed, policies, rule, conditions, .. } = &self.answer;
        let by = if policies.is_empty() { String::new() } else { format!(", by policy {}", policies.join(", ")) };
        let version = self.answer.policy_version;
        let by = if version == 0 || by.is_empty() { by } else { format!("{by} (version {version})") };
        if *allowed {
            let by = if rule.is_empty() { by } else { format!(", as {rule}: by rule, without a policy") };
            writeln!(out, "yes: {} may {action} {service}{}", printable(who), printable(&by))?;
        } else {
            let by = if version == 0 { String::new() } else { format!(" (version {version})") };
            writeln!(out, "no: {}{by} [{}]", printable(&self.answer.reason), self.answer.code)?;
            let mut table = Table::pairs();
            table.pair("found", &self.answer.found).pair("wanted", &self.answer.wanted).pair("try", &self.answer.next);
            table.write(out, 2)?;
            for failed in conditions {
                writeln!(
                    out,
                    "  policy {}: {}",
                    printable(&failed.policy),
                    printable(&failed.condition.replace('\n', " "))
                )?;
                writeln!(out, "    found {}; wanted {}", printable(&failed.found), printable(&failed.wanted))?;
            }
        }
        match self.who_could.as_deref() {
            None => Ok(()),
            Some([]) if !self.is_listed => writeln!(out, "{UNLISTED}"),
            Some([]) => writeln!(out, "no listed identity of your organisation could"),
            Some(names) => writeln!(out, "of your organisation, {} could", printable(&names.join(", "))),
        }
    }
}

#[derive(Serialize)]
struct Matrix(Vec<Row>);

#[derive(Clone, Serialize)]
struct Row {
    who: String,
    service: String,
    actions: Vec<String>,
    #[serde(skip_serializing_if = "String::is_empty")]
    limits: String,
}

impl Facts for Matrix {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.0.is_empty() {
            return writeln!(out, "there is no robot, or {UNLISTED}");
        }
        let mut table = Table::new(["WHO", "OF", "MAY", "LIMITS"]);
        for Row { who, service, actions, limits } in &self.0 {
            let may = if actions.is_empty() { "-".to_owned() } else { actions.join(", ") };
            table.row([who.clone(), service.clone(), may, limits.clone()]);
        }
        table.write(out, 0)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_contract::{Condition, Limits};

    fn text(facts: &impl Facts) -> String {
        let mut out = Vec::new();
        facts.text(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    fn told(allowed: bool, policies: &[&str], conditions: Vec<Condition>) -> Told {
        let (code, name) = if allowed { ("LGR-0000", "OK") } else { ("LGR-3002", "DENIED_BY_POLICY") };
        let answer = Answer {
            who: "Org1/Farhad".into(),
            action: "acquire".into(),
            service: "Husky/cmd_vel".into(),
            allowed,
            code: code.into(),
            name: name.into(),
            reason: if allowed { "" } else { "Org1/Farhad may not" }.into(),
            found: String::new(),
            wanted: String::new(),
            next: String::new(),
            policies: policies.iter().map(|&id| id.to_owned()).collect(),
            rule: if allowed && policies.is_empty() { "an admin of the owner".into() } else { String::new() },
            conditions,
            policy_version: 0,
        };
        Told { answer, who_could: None, is_listed: false }
    }

    #[test]
    fn a_yes_names_the_policy_and_a_no_the_conditions() {
        assert_eq!(
            text(&told(true, &["night"], vec![])),
            "yes: Org1/Farhad may acquire Husky/cmd_vel, by policy night\n"
        );
        let failed = Condition {
            policy: "night".into(),
            condition: "principal.role == \"admin\"".into(),
            found: "principal.role is \"member\"".into(),
            wanted: "principal.role == \"admin\"".into(),
        };
        let mut no = told(false, &[], vec![failed]);
        no.who_could = Some(vec!["Org1/Salma".into()]);
        assert_eq!(
            text(&no),
            "no: Org1/Farhad may not [LGR-3002]\n  policy night: principal.role == \"admin\"\n    \
             found principal.role is \"member\"; wanted principal.role == \"admin\"\n\
             of your organisation, Org1/Salma could\n"
        );
    }

    #[test]
    fn nobody_is_said_to_be_allowed_only_where_the_ledger_lists_people() {
        let mut no = told(false, &[], vec![]);
        no.who_could = Some(vec![]);
        assert!(text(&no).ends_with(&format!("\n{UNLISTED}\n")), "{}", text(&no));
        assert!(text(&Matrix(vec![])).contains(UNLISTED));
        no.is_listed = true;
        assert!(text(&no).ends_with("\nno listed identity of your organisation could\n"));
    }

    #[test]
    fn the_matrix_has_a_line_for_each_user_object_and_limit() {
        let right = |of: &str, action: &str, limits: Limits| Right {
            of: of.into(),
            action: action.into(),
            policies: vec![],
            rule: String::new(),
            limits,
            closed: vec![],
        };
        let slow = Limits { max_linear_mm_s: Some(300), ..Limits::default() };
        let rights = vec![
            right("Husky/cmd_vel", "acquire", slow),
            right("Husky/cmd_vel", "subscribe", Limits::default()),
            right("Husky/cmd_vel", "override", Limits::default()),
            right("Husky", "stop", Limits::default()),
        ];
        let matrix = Matrix([rows_of("Org1/Farhad", "Husky", vec![]), rows_of("Org1/Salma", "Husky", rights)].concat());
        let wanted = "WHO          OF             MAY                  LIMITS\n\
                      Org1/Farhad  Husky          -\n\
                      Org1/Salma   Husky/cmd_vel  acquire              0.3 m/s\n\
                      Org1/Salma   Husky/cmd_vel  subscribe, override\n\
                      Org1/Salma   Husky          stop\n";
        assert_eq!(text(&matrix), wanted);
    }
}
