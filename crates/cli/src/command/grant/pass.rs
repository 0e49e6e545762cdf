//! `delegate`, `handover`, `recall`: a holder passes a grant on, and takes it back.

use super::Granted;
use crate::answer;
use crate::argument::span::Milliseconds;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::Output;
use crate::session::{self, ABAC, Session};
use crate::words::Words;
use bytes::Bytes;
use ledger_contract::PassOptions;

/// Delegate a grant that you hold for a limited time; you can recall it.
///
/// The robot does not stop. The receiver must be permitted by the owner's policies. Its grant ends when you could no
/// longer hold one.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl delegate Turtlebot4/cmd_vel --to Org1/Farhad --for 10m")]
pub(crate) struct Delegate {
    #[command(flatten)]
    pass: Pass,
    /// Latest end of the delegated grant, from now, such as 10m
    #[arg(long = "for", value_name = "SPAN")]
    span: Option<Milliseconds>,
    /// The receiver may delegate it further
    #[arg(long)]
    may_delegate: bool,
}

/// Hand a grant that you hold over permanently.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl handover Turtlebot4/cmd_vel --to Org1/Farhad")]
pub(crate) struct Handover {
    #[command(flatten)]
    pass: Pass,
}

/// Recall a grant that you delegated.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl recall Turtlebot4/cmd_vel")]
pub(crate) struct Recall {
    /// The service; the robot alone if it offers exactly one
    #[arg(value_name = "ROBOT[/TOPIC]")]
    service: String,
    /// Stop the robot in between
    #[arg(long)]
    stop: bool,
}

#[derive(Debug, clap::Args)]
struct Pass {
    /// The service; the robot alone if it offers exactly one
    #[arg(value_name = "ROBOT[/TOPIC]")]
    service: String,
    /// The receiver
    #[arg(long, value_name = "ORG/NAME")]
    to: String,
    /// Stop the robot in between
    #[arg(long)]
    stop: bool,
}

/// The words of the command line where the chaincode has other names.
const DELEGATE: Words =
    Words { arguments: &[("RECEIVER", "--to"), ("OPTIONS_JSON", "the options")], help: "ledgerctl delegate" };
const HANDOVER: Words = Words { help: "ledgerctl handover", ..DELEGATE };
const RECALL: Words = Words { help: "ledgerctl recall", ..DELEGATE };

async fn run(
    (function, words): (&str, Words),
    mut args: Vec<Bytes>,
    options: &PassOptions,
    global: &Global,
    output: &mut Output,
) -> Result<(), Failure> {
    let session = Session::open(global).await?;
    if *options != PassOptions::default() {
        args.push(session::argument(options)?);
    }
    let done = session.call(ABAC, function, args).await.map_err(|refused| words.told(refused))?;
    let grant = answer::parse(&done.response, "a grant")?;
    output.show(&Granted::of(&done, grant, false).for_somebody(function != "recall"))
}

impl Delegate {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let Self { pass: Pass { service, to, stop }, span, may_delegate } = self;
        let options = PassOptions { for_ms: span.map(|span| span.0), may_delegate, stop };
        run(("delegate", DELEGATE), vec![service.into(), to.into()], &options, global, output).await
    }
}

impl Handover {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let Pass { service, to, stop } = self.pass;
        let options = PassOptions { stop, ..PassOptions::default() };
        run(("handover", HANDOVER), vec![service.into(), to.into()], &options, global, output).await
    }
}

impl Recall {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let options = PassOptions { stop: self.stop, ..PassOptions::default() };
        run(("recall", RECALL), vec![self.service.into()], &options, global, output).await
    }
}
