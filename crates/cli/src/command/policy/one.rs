//! `policy put`, `policy remove`: the set in force with one policy changed, applied as a whole set.

use super::propose::arguments;
use super::unknown::Expected;
use super::{Changed, WORDS, text};
use crate::answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::Output;
use crate::session::{ABAC, Session};
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{PolicyChange, PolicyDraft, PolicySet, PolicySetTexts, PolicyText};

/// Put a policy of your organisation in force, or replace it; for admins.
///
/// The first policy of an organisation replaces the built-in policy. Grants that the policies no longer permit end in
/// the same block.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl policy put night @night.cedar
  ledgerctl policy put no-farhad 'forbid(principal == User::\"Org1/Farhad\", action, resource);'")]
pub(crate) struct Put {
    /// Name of the policy within your organisation
    id: String,
    /// The policy in Cedar: text, @FILE, or - for standard input
    policy: String,
    /// Also if no one could publish to some robot afterwards
    #[arg(long)]
    i_mean_it: bool,
    #[command(flatten)]
    expected: Expected,
}

/// Remove a policy of your organisation; for admins.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl policy remove night")]
pub(crate) struct Remove {
    /// Name of the policy within your organisation
    id: String,
    /// Also if no one could publish to some robot afterwards
    #[arg(long)]
    i_mean_it: bool,
}

impl Put {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let text = read(&text(&self.policy)?)?;
        let session = Session::open(global).await?;
        let mut set = InForce::of(&session).await?;
        set.policies.retain(|policy| policy.id != self.id);
        let policy = PolicyText { id: self.id.clone(), text };
        self.expected.check(&session, std::slice::from_ref(&policy)).await?;
        set.policies.push(policy);
        set.apply(&session, output, (self.id, "put"), self.i_mean_it).await
    }
}

impl Remove {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let mut set = InForce::of(&session).await?;
        let before = set.policies.len();
        set.policies.retain(|policy| policy.id != self.id);
        if set.policies.len() == before {
            let message = format!("{} has no policy {:?}", set.organisation, self.id);
            return Err(Rejection::new(Code::NotFound, message)
                .found(format!("{:?}", self.id))
                .wanted("the id of one of its own policies")
                .next("ledgerctl policy list")
                .into());
        }
        set.apply(&session, output, (self.id, "removed"), self.i_mean_it).await
    }
}

/// The text of a policy, which must be UTF-8.
fn read(bytes: &[u8]) -> Result<String, Rejection> {
    ledger_base::text::of_bytes(bytes).map_err(|fault| {
        Rejection::new(Code::BadArgument, "the policy is not text")
            .found(fault.to_string())
            .wanted("Cedar in UTF-8")
            .next("see the built-in policy: ledgerctl policy show default")
    })
}

/// The set of policies that is in force.
pub(in crate::command) struct InForce {
    pub(in crate::command) organisation: String,
    /// Its number; 0 before the first one.
    pub(in crate::command) version: u64,
    pub(in crate::command) policies: Vec<PolicyText>,
}

impl InForce {
    /// That of the caller's organisation.
    pub(in crate::command) async fn of(session: &Session) -> Result<Self, Rejection> {
        let organisation = session.identity()?.organisation;
        let name = Bytes::from(organisation.clone());
        let sets = session.ask(ABAC, "policy_history", vec![name.clone()]).await?;
        let sets: Vec<PolicySet> = answer::parse(&sets, "sets of policies")?;
        let Some(newest) = sets.first() else { return Ok(Self { organisation, version: 0, policies: Vec::new() }) };
        let args = vec![name, Bytes::from(newest.version.to_string())];
        let set: PolicySetTexts = answer::parse(&session.ask(ABAC, "policy_set", args).await?, "a set of policies")?;
        Ok(Self { organisation, version: newest.version, policies: set.policies })
    }

    /// Applies the changed set, if it is still in force. `change` is the changed policy, and what becomes of it.
    async fn apply(
        self,
        session: &Session,
        output: &mut Output,
        change: (String, &str),
        means_it: bool,
    ) -> Result<(), Failure> {
        let draft =
            PolicyDraft { policies: Some(self.policies), base: Some(self.version), means_it, ..PolicyDraft::default() };
        let done =
            session.call(ABAC, "policy", arguments("apply", &draft)?).await.map_err(|refused| match refused.code {
                Code::PoliciesChanged => {
                    WORDS.told(refused).next("run the command again: it starts from the set in force")
                }
                _ => WORDS.told(refused),
            })?;
        let mut changed: PolicyChange = answer::parse(&done.response, "a change of policies")?;
        if changed.change == "applied" {
            (changed.id, changed.change) = (change.0, change.1.to_owned());
        }
        output.show(&Changed(changed))
    }
}
