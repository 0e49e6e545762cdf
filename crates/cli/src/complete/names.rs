//! The names of this machine and of the network.

use crate::session::{ABAC, MSP, Session};
use crate::{answer, context};
use clap_complete::engine::CompletionCandidate;
use ledger::msp::{NodeRole, Nodes};
use ledger_api::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::RobotAsset;
use std::ffi::OsString;
use std::future::Future;
use std::time::Duration;
use tokio::time::timeout;

/// How long a person in front of a shell waits for the network.
const PATIENCE: Duration = Duration::from_millis(1200);
/// The roles of identities.
const ROLES: [&str; 4] = ["member", "admin", "node", "robot"];

/// A kind of names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Names {
    Contexts,
    Robots,
    Services,
    Users,
    Nodes,
    Roles,
    Codes,
}

/// All names of a kind, each with a word about it; none if they cannot be had now.
pub(super) fn candidates(names: Names) -> Vec<CompletionCandidate> {
    let told = |name: String, about: String| {
        let about = crate::output::printable(&about).into_owned();
        CompletionCandidate::new(name).help((!about.is_empty()).then(|| about.into()))
    };
    // Names come from other organisations: one that a terminal would obey is not offered.
    let harmless = |(name, _): &(String, String)| crate::output::printable(name) == *name;
    found(names).into_iter().filter(harmless).map(|(name, about)| told(name, about)).collect()
}

fn found(names: Names) -> Vec<(String, String)> {
    match names {
        Names::Roles => ROLES.map(|role| (role.to_owned(), String::new())).into(),
        Names::Codes => {
            let refusals = Code::ALL.iter().filter(|code| **code != Code::Ok);
            refusals.map(|code| (code.to_string(), code.name().to_owned())).collect()
        }
        Names::Contexts => {
            let all = context::home().and_then(|home| Context::list(&home)).unwrap_or_default();
            all.into_iter().map(|name| (name, String::new())).collect()
        }
        Names::Robots => asked(async |session| {
            let robots: Vec<RobotAsset> = session.list(ABAC, "robots").await?;
            Ok(robots.into_iter().map(|robot| (robot.name, format!("of {}", robot.organisation))).collect())
        }),
        Names::Services => asked(async |session| {
            let robots: Vec<RobotAsset> = session.list(ABAC, "robots").await?;
            let services = robots.into_iter().flat_map(|robot| robot.services);
            Ok(services.map(|service| (service.service, service.type_name)).collect())
        }),
        Names::Users => asked(async |session| {
            let all = session.client.identities("").await?;
            Ok(all.into_iter().map(|user| (user.name, user.role.to_string())).collect())
        }),
        Names::Nodes => asked(async |session| {
            let response = session.client.query_at(0, MSP, "nodes", vec![]).await?.response;
            let nodes: Nodes = answer::parse(&response, "the nodes")?;
            let live = nodes.nodes.iter().filter(|node| node.role != NodeRole::Removed);
            Ok(live.map(|node| (node.full_name(), node.role.to_string())).collect())
        }),
    }
}

/// Asks the network, as the context of the line that is typed.
fn asked<F>(ask: F) -> Vec<(String, String)>
where
    F: AsyncFnOnce(&Session) -> Result<Vec<(String, String)>, Rejection>,
{
    let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_all().build() else { return Vec::new() };
    let names = async {
        let home = context::home()?;
        let session = Session::connect(Context::load(&home, typed(std::env::args_os()).as_deref())?).await?;
        ask(&session).await
    };
    let names = runtime.block_on(within(names));
    runtime.shutdown_background();
    names
}

async fn within(names: impl Future<Output = Result<Vec<(String, String)>, Rejection>>) -> Vec<(String, String)> {
    timeout(PATIENCE, names).await.ok().and_then(Result::ok).unwrap_or_default()
}

/// The context that stands in the line, else in the environment.
fn typed(words: impl Iterator<Item = OsString>) -> Option<String> {
    let words: Vec<String> = words.map(|word| word.to_string_lossy().into_owned()).collect();
    let behind =
        words.iter().zip(words.iter().skip(1)).find(|(word, _)| *word == "--context").map(|(_, name)| name.clone());
    let within = words.iter().find_map(|word| word.strip_prefix("--context=").map(str::to_owned));
    let variable = || std::env::var(context::VARIABLE).ok();
    behind.or(within).or_else(variable).filter(|name| !name.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_context_of_the_line_is_the_one_that_asks() {
        let typed = |line: &str| typed(line.split(' ').map(OsString::from));
        assert_eq!(typed("ledgerctl --context Salma acquire").as_deref(), Some("Salma"));
        assert_eq!(typed("ledgerctl acquire T --context=Farhad").as_deref(), Some("Farhad"));
    }

    #[test]
    fn codes_and_roles_need_nobody() {
        assert_eq!(found(Names::Roles).len(), 4);
        assert!(found(Names::Codes).contains(&("LGR-3005".to_owned(), "HELD".to_owned())));
    }
}
