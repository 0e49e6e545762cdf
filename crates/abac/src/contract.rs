//! The function table of the chaincode, and its hooks.

use crate::calls::{self, NAME};
use crate::lifecycle::{ends, publishing, turns};
use crate::policy::decider::Decider;
use crate::records::target::{self, Target};
use crate::rules::{Rule, Table};
use bytes::Bytes;
use ledger::{Chaincode, Context, Foretold, Quorum, Revocation, ServiceBudget};
use ledger_base::nearest::did_you_mean;
use ledger_base::rejection::Rejection;
use ledger_contract::Sharing;
use ledger_storage::result::Event;
use std::sync::Arc;

/// The access-control chaincode `abac`. Arguments are text, payloads raw bytes; responses and stored values are
/// JSON.
///
/// | function | who | answer |
/// |---|---|---|
/// | `setup ROBOT_JSON...` | an admin of the owner | the assets |
/// | `configure ROBOT[/TOPIC] SETTINGS_JSON` | an admin of the owner | [`crate::RobotChange`] |
/// | `replace ROBOT_JSON...` | an admin of the owner | a [`crate::RobotChange`] each |
/// | `reconcile PLAN_JSON` of [`crate::FleetPlan`] | an admin of the owner | [`crate::FleetChange`]; all of it or nothing |
/// | `remove ROBOT` | an admin of the owner | the grants it ended |
/// | `acquire SERVICE [LEASE_MS\|OPTIONS_JSON]` | whom policies permit | [`crate::Acquired`] |
/// | `acquire_all OPTIONS_JSON SERVICE...` | whom policies permit all of them | [`crate::Grant`]s |
/// | `take SERVICE REASON [LEASE_MS]` | an admin of the owner, whom policies permit `override` | [`crate::Grant`] |
/// | `stop ROBOT\|* [REASON]` | an admin of the owner, whom policies permit it | [`crate::EmergencyAnswer`] |
/// | `resume ROBOT\|* [REASON]` | an admin of the owner, whom policies permit it | [`crate::EmergencyAnswer`] |
/// | `confirm SERVICE CONTENDER` | an admin of the owner, whom policies permit it; never the contender | [`crate::Confirmation`] |
/// | `delegate SERVICE RECEIVER [OPTIONS_JSON]`, `handover SERVICE RECEIVER [OPTIONS_JSON]` | the holder | the receiver's [`crate::Grant`] |
/// | `recall SERVICE [OPTIONS_JSON]` | one who delegated it | [`crate::Grant`] |
/// | `renew SERVICE [LEASE_MS]` | the holder | [`crate::Grant`] |
/// | `release SERVICE [HOLDER]` | the holder, who waits in line, an admin of the owner | the grants it ended |
/// | `set SERVICE EPOCH FIRST_SEQ PAYLOAD...` | the holder; in open mode whom policies permit | [`crate::Published`] |
/// | `reader SERVICE KEY` | whom policies permit to subscribe, who stands for the owner | [`crate::ReaderTold`] |
/// | `reader SERVICE none [READER]` | the reader itself, an admin of the owner | [`crate::ReaderTold`] |
/// | `share SERVICE EPOCH SHARE_JSON` of [`crate::Share`] | as `set`, on a confidential service | [`crate::Keyed`] |
/// | `readers SERVICE` | anybody | [`crate::Readers`] |
/// | `authorize SERVICE [ACTION]` | anybody | [`crate::Authorization`] |
/// | `can ASK_JSON` of [`crate::Ask`] | anybody | [`crate::Can`] |
/// | `could ASK_JSON PAGE_JSON` | an admin, about their organisation | page of [`crate::Could`] |
/// | `access ACCESS_JSON [PAGE_JSON]` of [`crate::AskAccess`] | anybody about themselves, an admin about their organisation, an admin of the owner about all | page of [`crate::Access`] |
/// | `check TEXT` | anybody | [`crate::PolicyCheck`]: the faults of a policy, or its meaning |
/// | `shares [PAGE_JSON]` | anybody | [`crate::ShareEntry`]s |
/// | `share_preview TERMS_JSON` of [`crate::ShareTerms`] | an admin of the owner | [`crate::SharePreview`], whose set is for `policy apply` |
/// | `unshare_preview ID` | an admin of the owner | [`crate::UnsharePreview`], whose set is for `policy apply` |
/// | `diff POLICIES_JSON` of [`crate::PolicyText`] | anybody, about the robots of their organisation | [`crate::PolicyDiff`] |
/// | `GetSubmittingClientIdentity` | anybody | [`crate::Caller`] |
/// | `robots [PAGE_JSON]`, `robot NAME` | anybody | [`crate::RobotAsset`]s |
/// | `declare ROBOT` | anybody | [`crate::Declaration`], certified |
/// | `service SERVICE` | anybody | [`crate::ServiceState`] |
/// | `line SERVICE` | anybody | [`crate::LineState`] |
/// | `latest SERVICE` | anybody | [`crate::Latest`]s, the newest first |
/// | `grants [SERVICE]`, `grants PAGE_JSON` | anybody | [`crate::Grant`]s |
/// | `submit SERVICE TASK_JSON` | whom policies permit | [`crate::Submitted`] |
/// | `progress ID REACHED`, `fail ID REASON` | the submitter of the task, the robot itself | [`crate::Task`] |
/// | `cancel ID` | the submitter of the task, an admin of the owner | [`crate::Task`] |
/// | `tasks [PAGE_JSON]`, `task ID` | anybody | [`crate::Task`]s |
/// | `report_side_door SERVICE TOPIC PUBLISHERS` | the robot itself, a node of its owner; once in a minute | [`crate::SideDoor`] |
/// | `policy apply SET_JSON` of [`crate::PolicyDraft`] | an admin, for their robots, where nobody else must agree | [`crate::PolicyChange`] |
/// | `policy propose SET_JSON` of [`crate::PolicyDraft`] | an admin, for their robots | [`crate::PolicyProposal`] |
/// | `policy approve ID`, `policy withdraw ID` | an admin | [`crate::PolicyProposal`] |
/// | `policy enact ID [break-glass]` | an admin of the proposal's organisation | [`crate::PolicyChange`] |
/// | `policy_history ORGANISATION` | anybody | [`crate::PolicySet`]s, the newest first |
/// | `policy_set ORGANISATION VERSION` | anybody | [`crate::PolicySetTexts`] |
/// | `policy_proposals [PAGE_JSON]`, `policy_proposal ID` | anybody | [`crate::PolicyProposal`]s, [`crate::PolicyProposalTexts`] |
/// | `policy_approvals ORGANISATION` | anybody | [`crate::PolicyApprovals`] |
/// | `set_policy_approvals QUORUM\|none` | an admin, with approval of the network | the quorum |
/// | `policies [PAGE_JSON]` | anybody | [`crate::PolicyEntry`]s |
///
/// `PAGE_JSON` is [`ledger::Paging`]: the answer is then a [`ledger::Page`].
///
/// A service is named `Turtlebot4/cmd_vel`, or `Turtlebot4` while that robot has only one.
///
/// Its events, with their subjects and payloads, are in docs/events.md.
pub struct AccessControl {
    decider: Decider,
}

/// Every function, for whoever mistypes one.
const FUNCTIONS: [&str; 52] = [
    "GetSubmittingClientIdentity",
    "access",
    "acquire",
    "acquire_all",
    "authorize",
    "can",
    "cancel",
    "check",
    "configure",
    "confirm",
    "could",
    "declare",
    "delegate",
    "diff",
    "fail",
    "grants",
    "handover",
    "latest",
    "line",
    "policies",
    "policy",
    "policy_approvals",
    "policy_history",
    "policy_proposal",
    "policy_proposals",
    "policy_set",
    "progress",
    "reader",
    "readers",
    "recall",
    "reconcile",
    "release",
    "remove",
    "renew",
    "replace",
    "report_side_door",
    "resume",
    "robot",
    "robots",
    "service",
    "set",
    calls::set_policy_approvals::SET,
    "setup",
    "share",
    "share_preview",
    "shares",
    "stop",
    "submit",
    "take",
    "task",
    "tasks",
    "unshare_preview",
];

/// Those of them that only read.
const READS: [&str; 25] = [
    "GetSubmittingClientIdentity",
    "access",
    "authorize",
    "can",
    "check",
    "could",
    "diff",
    "grants",
    "latest",
    "line",
    "policies",
    "policy_approvals",
    "policy_history",
    "policy_proposal",
    "policy_proposals",
    "policy_set",
    "readers",
    "robot",
    "robots",
    "service",
    "share_preview",
    "shares",
    "task",
    "tasks",
    "unshare_preview",
];

/// Those of them that end or hand over control, or keep it: a renewal that waits would end it.
const URGENT: [&str; 19] = [
    "acquire",
    "acquire_all",
    "cancel",
    "configure",
    "confirm",
    "delegate",
    "fail",
    "handover",
    "policy",
    "progress",
    "recall",
    "reconcile",
    "release",
    "remove",
    "renew",
    "resume",
    "stop",
    "submit",
    "take",
];

/// Those that the network decides together.
static NEEDS_APPROVAL: [(&str, Quorum); 1] = [(calls::set_policy_approvals::SET, Quorum::Majority)];

/// The names of its events.
const EVENTS: [&str; 23] = [
    "confirmed",
    "pending",
    "permitted",
    "delegated",
    "granted",
    "keyed",
    "left",
    "line",
    "message",
    "policy",
    "policy_approvals",
    "policy_approved",
    "policy_proposed",
    "policy_withdrawn",
    "queued",
    "reader",
    "released",
    "renewed",
    "resumed",
    "robot",
    "side_door",
    "stopped",
    "task",
];

impl AccessControl {
    /// The chaincode, with the thread on which it evaluates policies.
    ///
    /// # Errors
    /// [`ledger_base::rejection::Code::Internal`] if the operating system gives no thread.
    pub fn new() -> Result<Self, Rejection> {
        Ok(Self { decider: Decider::new(Table::built_in())? })
    }

    /// The chaincode with one more rule, which owners choose by its mode. Every node of a network needs the same rules.
    ///
    /// # Errors
    /// [`ledger_base::rejection::Code::AlreadyExists`] if the mode has a rule.
    pub fn with_rule(mut self, rule: Arc<dyn Rule>) -> Result<Self, Rejection> {
        self.decider.rules.add(rule)?;
        Ok(self)
    }

    /// May the submitter publish on a service now, under a grant with that epoch? The decision that `set` makes, by
    /// itself: how long it takes, and what it reads, can so be measured.
    ///
    /// # Errors
    /// As `set`: unknown names, [`ledger_base::rejection::Code::StaleEpoch`], [`ledger_base::rejection::Code::NotHolder`], what policies say.
    pub fn may_publish(&self, ctx: &Context<'_>, service: &str, epoch: u64) -> Result<(), Rejection> {
        let target = self.decider.records.target(ctx, service)?;
        publishing::may_publish(ctx, &self.decider, ctx.submitter()?, &target, Some(epoch)).map(drop)
    }
}

impl Chaincode for AccessControl {
    fn name(&self) -> &'static str {
        NAME
    }

    /// Services stand in the records of their robots. A message writes neither of them.
    fn control_keys(&self) -> &'static [&'static str] {
        &["grant/", "robot/", "stopped/"]
    }

    fn invoke(&self, ctx: &mut Context<'_>, function: &str, args: &[Bytes]) -> Result<Bytes, Rejection> {
        let decider = &self.decider;
        match function {
            "set" => calls::set::set(ctx, decider, args),
            "acquire" => calls::acquire::acquire(ctx, decider, args),
            "acquire_all" => calls::acquire_all::acquire_all(ctx, decider, args),
            "renew" => calls::renew::renew(ctx, decider, args),
            "take" => calls::take::take(ctx, decider, args),
            "delegate" => calls::delegate::delegate(ctx, decider, args),
            "handover" => calls::handover::handover(ctx, decider, args),
            "recall" => calls::recall::recall(ctx, decider, args),
            "confirm" => calls::confirm::confirm(ctx, decider, args),
            "stop" => calls::stop::stop(ctx, decider, args),
            "resume" => calls::resume::resume(ctx, decider, args),
            "line" => calls::line::line(ctx, decider, args),
            "latest" => calls::latest::latest(ctx, args),
            "submit" => calls::submit::submit(ctx, decider, args),
            "progress" => calls::progress::progress(ctx, decider, args),
            "fail" => calls::fail::fail(ctx, args),
            "cancel" => calls::cancel::cancel(ctx, decider, args),
            "report_side_door" => calls::report_side_door::report(ctx, args),
            "reader" => calls::reader::reader(ctx, decider, args),
            "readers" => calls::readers::readers(ctx, decider, args),
            "share" => calls::share::share(ctx, decider, args),
            "tasks" => calls::tasks::tasks(ctx, args),
            "task" => calls::task::task(ctx, args),
            "can" => calls::can::can(ctx, decider, args),
            "could" => calls::could::could(ctx, decider, args),
            "access" => calls::access::access(ctx, decider, args),
            "shares" => calls::shares::list(ctx, args),
            "share_preview" => calls::share_preview::preview(ctx, decider, args),
            "unshare_preview" => calls::unshare_preview::preview(ctx, decider, args),
            "check" => calls::check::check(ctx, decider, args),
            "diff" => calls::diff::diff(ctx, decider, args),
            "release" => calls::release::release(ctx, decider, args),
            "authorize" => calls::authorize::authorize(ctx, decider, args),
            "GetSubmittingClientIdentity" => calls::caller::caller(ctx, args),
            "setup" => calls::setup::setup(ctx, decider, args),
            "configure" => calls::configure::configure(ctx, decider, args),
            "replace" => calls::replace::replace(ctx, decider, args),
            "reconcile" => calls::reconcile::reconcile(ctx, decider, args),
            "remove" => calls::remove::remove(ctx, args),
            "robots" => calls::robots::robots(ctx, decider, args),
            "robot" => calls::robot::robot(ctx, decider, args),
            "declare" => calls::declare::declare(ctx, decider, args),
            "service" => calls::service::service(ctx, decider, args),
            "grants" => calls::grants::list(ctx, decider, args),
            "policy" => calls::policy::policy(ctx, decider, args),
            "policies" => calls::policies::list(ctx, args),
            "policy_approvals" => calls::policy_approvals::show(ctx, args),
            "policy_history" => calls::policy_history::history(ctx, args),
            "policy_proposal" => calls::policy_proposal::show(ctx, args),
            "policy_proposals" => calls::policy_proposals::list(ctx, args),
            "policy_set" => calls::policy_set::show(ctx, args),
            calls::set_policy_approvals::SET => calls::set_policy_approvals::set(ctx, args),
            _ => Err(Rejection::unknown_function(self.name(), function, &FUNCTIONS)
                .next(did_you_mean(function, FUNCTIONS, ""))),
        }
    }

    fn reads(&self) -> &'static [&'static str] {
        &READS
    }

    fn needs_approval(&self) -> &'static [(&'static str, Quorum)] {
        &NEEDS_APPROVAL
    }

    fn foretell(&self, function: &str, args: &[Bytes]) -> Option<Foretold> {
        if function == "set" { calls::set::foretell(args) } else { None }
    }

    fn publishes<'a>(&self, function: &str, args: &'a [Bytes]) -> Option<(&'a str, u64)> {
        if function == "set" { calls::set::publishes(args) } else { None }
    }

    fn published(&self, event: &Event) -> Option<u64> {
        if event.name == calls::set::MESSAGE { calls::set::published(event) } else { None }
    }

    fn service_budget(&self, ctx: &Context<'_>, service: &str) -> Option<ServiceBudget> {
        let Target { robot, service, id } = target::resolve(ctx, service).ok()?;
        let Sharing { bytes_per_s, messages_per_s, .. } = service.sharing;
        Some(ServiceBudget { service: id, organisation: robot.organisation.clone(), bytes_per_s, messages_per_s })
    }

    fn urgent(&self, function: &str) -> bool {
        URGENT.contains(&function)
    }

    /// A caller of release must hold something, and acquiring is refused meanwhile.
    fn ends(&self, function: &str) -> bool {
        matches!(function, "release" | "remove" | "stop")
    }

    fn told_early(&self, function: &str) -> bool {
        function == "stop"
    }

    // A hook cannot refuse. What it cannot read, the store reports as a fault of its own, and the node stops.
    fn begin_block(&self, ctx: &mut Context<'_>) {
        let _ = ends::sweep(ctx, &self.decider).and_then(|()| turns::resume(ctx, &self.decider));
    }

    fn next_deadline(&self, ctx: &Context<'_>) -> Option<u64> {
        ends::next_deadline(ctx)
    }

    fn identity_revoked(&self, ctx: &mut Context<'_>, revoked: &Revocation) {
        let _ = ends::identity_revoked(ctx, &self.decider, revoked);
    }

    fn organisation_removed(&self, ctx: &mut Context<'_>, organisation: &str) {
        let _ = ends::organisation_removed(ctx, &self.decider, organisation);
    }

    fn authority_lost(&self, ctx: &mut Context<'_>, issuer: &[u8; 32]) {
        let _ = ends::authority_lost(ctx, &self.decider, issuer);
    }

    fn events(&self) -> &'static [&'static str] {
        &EVENTS
    }

    fn may_follow(&self, ctx: &Context<'_>, subjects: &[String], names: &[String]) -> Result<(), Rejection> {
        calls::follow::may_follow(ctx, &self.decider, subjects, names)
    }

    fn may_read(&self, ctx: &Context<'_>, event: &Event) -> Result<(), Rejection> {
        calls::follow::may_read(ctx, &self.decider, event)
    }
}
