//! The command line of `ledgerd`.

use crate::clients::monitoring::{Admin, PageCredentials};
use crate::node::NodeBuilder;
use crate::node::supervise::until_stopped;
use crate::process::config::{Config, Fault, OfBridge};
use crate::process::terminal::{eprint_line, print_line, stop_signal, written};
use crate::process::{memory, telemetry};
use crate::tools::ca_commands;
use crate::tools::{backup, demo, dev, join, lab, prove, recover, setup, verify};
use clap::{CommandFactory, Parser, Subcommand};
use futures::{Stream, stream};
use ledger_api::report;
use ledger_base::rejection::{Class, Code, Rejection};
use ledger_base::shell;
use ledger_traces::Tracer;
use ros_bridge::BridgeMonitor;
use std::ffi::OsString;
use std::future::Future;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

/// The exit code of a program that was interrupted, as shells have it: 128 and the number of SIGINT.
const INTERRUPTED: u8 = 130;
/// The exit code of a node that does not belong to its network any more.
const NO_MEMBER: u8 = 6;
/// The exit code of a node whose network has another history.
const FORKED: u8 = 7;

/// A permissioned ledger for ROS 2 fleets in one binary.
#[derive(Parser)]
#[command(
    version,
    about,
    after_help = "Start with: ledgerd demo    (the experiment in a minute)\n       or: ledgerd dev     (a network for \
                  trials)"
)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Runs the experiment of the paper: two organisations, two users, three robots, real ROS 2 messages.
    Demo(demo::Options),
    /// Starts a network of one node for trials, with both organisations and the robots of the paper.
    Dev(dev::Options),
    /// Starts a network of several nodes and organisations on this machine for trials, and removes it at the end.
    ///
    /// Each node is a separate process. Contexts for admins, users and robots are in a separate home, which it prints:
    /// nothing is written to yours. Ctrl-C ends all processes and removes all files.
    Lab(lab::Options),
    /// Runs a configured node.
    Run(RunOptions),
    /// Checks a configuration and reports all errors at once.
    Check(WithConfig),
    /// Creates a network of one organisation with one node, in the directory that the configuration names.
    Init(setup::InitOptions),
    /// Joins a node to a network, with a token from one of its admins.
    Join(join::JoinOptions),
    /// Brings a node with damaged, lost or contradicted blocks back under a new number; needs its certificate, but no
    /// token.
    Rejoin(join::RejoinOptions),
    /// Renews the key and certificate of a node before the renewal is due; the node may be running.
    Renew(join::RenewOptions),
    /// Backs up a node, which may be running, to a directory, and verifies the backup.
    Backup(backup::BackupOptions),
    /// Creates a data directory from a backup. A node starts from it only after `rejoin` or `recover`.
    Restore(backup::RestoreOptions),
    /// Forced recovery: continues with one node when most voters are permanently lost. Blocks that only they stored are
    /// lost.
    Recover(recover::RecoverOptions),
    /// Writes a checkpoint from which gates and light clients start after a forced recovery. They then trust this node
    /// for the voters.
    Checkpoint(recover::CheckpointOptions),
    /// Creates a one-time secret for an admin, at a node that holds the CA key: for an admin who is locked out.
    AdminSecret(ca_commands::AdminSecret),
    /// Backs up, restores or gives up a CA key that a node holds.
    #[command(subcommand)]
    Ca(ca_commands::Ca),
    /// Connects a ROS 2 graph to the ledger through a remote gateway.
    Bridge(WithConfig),
    /// Verifies the chain of a stopped node or of an archive: every hash, every signature, and every verdict by
    /// executing it again.
    ///
    /// Trusts no result that the node computed, and compares the signed results of all nodes. Exits with 1 and reports
    /// the first wrong byte. If the oldest blocks were dropped, execution starts with the snapshot before the others.
    /// Blocks that call a custom chaincode are verified by the program that contains it.
    Verify(verify::Options),
    /// Proves what policies can never permit.
    #[command(subcommand)]
    Policy(prove::Policy),
    /// Prints a script for shell completion of these commands.
    Completions {
        /// The shell.
        #[arg(value_enum)]
        shell: clap_complete::Shell,
    },
    /// Writes the manual pages of all commands into a directory, for packages.
    #[command(hide = true)]
    Man {
        /// An existing directory.
        directory: PathBuf,
    },
}

#[derive(clap::Args)]
struct WithConfig {
    /// The configuration file.
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
}

#[derive(clap::Args)]
struct RunOptions {
    /// The configuration file.
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Trust the machine's clock although it is behind block time: the only voter of a network then continues.
    #[arg(long)]
    trust_clock: bool,
}

/// Runs the command line with a node that has these chaincodes; the whole of `main`.
pub fn run(builder: NodeBuilder) -> ExitCode {
    run_with(builder, std::env::args_os())
}

/// As [`run`], with another command line than that of the process; the name of the program comes first.
pub fn run_with(builder: NodeBuilder, arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let _known = memory::give_back();
    ledger_base::invariant::end_process();
    let arguments = match Arguments::try_parse_from(arguments) {
        Ok(arguments) => arguments,
        Err(error) if error.use_stderr() => {
            let _closed = with_config_tip(error).print();
            return ExitCode::from(64);
        }
        Err(help) => return exit_code(written(help.print()).map(|()| ExitCode::SUCCESS)),
    };
    exit_code(execute(arguments.command, &builder))
}

/// `ledgerd bridge salma.toml`: the file needs an option. clap's own tips are `'-- …'`, which helps nobody here.
fn with_config_tip(mut error: clap::Error) -> clap::Error {
    use clap::error::{ContextKind, ContextValue, ErrorKind};
    if error.kind() != ErrorKind::UnknownArgument {
        return error;
    }
    let _misleading = error.remove(ContextKind::Suggested);
    let wants_file = error.get(ContextKind::Usage).is_some_and(|usage| usage.to_string().contains("--config <FILE>"));
    if let Some(ContextValue::String(word)) = error.get(ContextKind::InvalidArg)
        && wants_file
        && !word.starts_with('-')
    {
        let tip = format!("did you mean '--config {}'?", shell::word(word));
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
    }
    error
}

/// Runs a program of its own beside the command line, such as an experiment on [`crate::demo`]: a rejection goes to
/// standard error, and decides the exit code.
pub fn run_program(body: impl Future<Output = Result<(), Rejection>>) -> ExitCode {
    exit_code(block_on(body).map(|()| ExitCode::SUCCESS))
}

fn exit_code(outcome: Result<ExitCode, Rejection>) -> ExitCode {
    match outcome {
        Ok(code) => code,
        Err(rejection) => {
            eprint_line(&report(&rejection));
            ExitCode::from(match rejection.code {
                Code::ShuttingDown => INTERRUPTED,
                Code::NotAMember => NO_MEMBER,
                Code::Forked | Code::Contradicted => FORKED,
                code => code.class().exit_code().max(Class::Failure.exit_code()),
            })
        }
    }
}

fn execute(command: Command, builder: &NodeBuilder) -> Result<ExitCode, Rejection> {
    let done = match command {
        Command::Demo(options) => block_on(demo::run(options)),
        Command::Dev(options) => block_on(dev::run(builder, options)),
        Command::Lab(options) => block_on(lab::run(options)),
        Command::Run(RunOptions { config: path, trust_clock }) => {
            let config = load(&path)?;
            let builder = if trust_clock { builder.clone().trust_clock() } else { builder.clone() };
            telemetry::start(&config.log);
            block_on(async move {
                let (stop, changes) = (stop_signal(), read_again(|| Config::load(&path)));
                let node = builder.start(&config).await?;
                until_stopped(node, stop, changes).await
            })
        }
        Command::Check(WithConfig { config: path }) => {
            let config = load(&path)?;
            print_line(&format!(
                "{} is valid: data in {}, listens on {}",
                path.display(),
                config.data.display(),
                config.listen
            ))
        }
        Command::Init(options) => setup::init(&options).and_then(|text| print_line(&text)),
        Command::Join(options) => {
            block_on(async { join::join(&options).await.and_then(|text| print_line(&text)) })?;
            if options.run {
                let options = RunOptions { config: options.config, trust_clock: false };
                return execute(Command::Run(options), builder);
            }
            Ok(())
        }
        Command::Rejoin(options) => {
            let config = load(&options.config)?;
            block_on(async { join::rejoin(builder, &options, &config).await.and_then(|text| print_line(&text)) })
        }
        Command::Renew(options) => {
            let config = load(&options.config)?;
            block_on(async { join::renew(&options, &config).await.and_then(|text| print_line(&text)) })
        }
        Command::Backup(options) => {
            let config = load(&options.config)?;
            backup::backup(builder, &options, &config).and_then(|text| print_line(&text))
        }
        Command::Restore(options) => {
            let taken = options.config_of_backup()?;
            let config = match &taken {
                Some(text) => parsed(Config::parse(text, &options.config))?,
                None => load(&options.config)?,
            };
            backup::restore(builder, &options, &config, taken.as_deref()).and_then(|text| print_line(&text))
        }
        Command::Recover(options) => {
            let config = load(&options.config)?;
            block_on(async { recover::recover(builder, &options, &config).await.and_then(|text| print_line(&text)) })
        }
        Command::Checkpoint(options) => {
            let config = load(&options.config)?;
            recover::checkpoint(builder, &options, &config).and_then(|text| print_line(&text))
        }
        Command::AdminSecret(command) => {
            let config = load(&command.config)?;
            command.run(&config, crate::process::clock::wall()).and_then(|text| print_line(&text))
        }
        Command::Ca(command) => {
            let config = load(command.config())?;
            command.run(&config).and_then(|text| print_line(&text))
        }
        Command::Bridge(WithConfig { config: path }) => run_bridge(&path),
        Command::Verify(options) => verify::run(builder, &options),
        Command::Policy(command) => {
            let is_proved = prove::run(command)?;
            return Ok(if is_proved { ExitCode::SUCCESS } else { ExitCode::FAILURE });
        }
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Arguments::command(), "ledgerd", &mut script);
            print_line(&String::from_utf8_lossy(&script))
        }
        Command::Man { directory } => clap_mangen::generate_to(Arguments::command(), &directory).map_err(|error| {
            Rejection::new(Code::BadFile, format!("cannot write manual pages into {}", directory.display()))
                .found(error.to_string())
                .next("name an existing directory with write permission")
        }),
    };
    done.map(|()| ExitCode::SUCCESS)
}

/// Runs a bridge that is a process of its own, with its page.
fn run_bridge(path: &Path) -> Result<(), Rejection> {
    let (program, config) = parsed(OfBridge::load(path))?;
    telemetry::start(&program.log);
    let _known = memory::keep();
    block_on_with(1, async move {
        let sight = BridgeMonitor::default();
        let _page = match program.admin.listen.as_str() {
            "" => None,
            address => {
                let papers = PageCredentials::OfFiles(program.admin.clone());
                Some(Admin::serve(address, Arc::new(sight.clone()), papers).await?)
            }
        };
        let who =
            ros_bridge::context_of(&config).map(|who| format!("{}/{}", who.organisation, who.name)).unwrap_or_default();
        let tracer = Tracer::start(&program.traces, "ledgerd-bridge", &who);
        let changes = read_again(|| {
            let (changed, config) = OfBridge::load(path)?;
            if (&changed.admin, &changed.traces) != (&program.admin, &program.traces) {
                tracing::warn!("changed [admin] and [traces] settings take effect at the next start of the bridge");
            }
            telemetry::set_level(&changed.log);
            Ok(config.traced(tracer.clone()))
        });
        ros_bridge::run(config.traced(tracer.clone()), changes, stop_signal(), &sight).await
    })
}

/// A configuration, read again after each SIGHUP. Must be called inside a tokio runtime.
fn read_again<T>(read: impl Fn() -> Result<T, Vec<Fault>>) -> impl Stream<Item = T> {
    use tokio::signal::unix::{SignalKind, signal};
    let hang_ups = signal(SignalKind::hangup());
    let hang_ups =
        hang_ups.inspect_err(|error| tracing::warn!(%error, "cannot watch SIGHUP; routes cannot be reloaded")).ok();
    stream::unfold((hang_ups, read), async |(mut hang_ups, read)| {
        loop {
            hang_ups.as_mut()?.recv().await?;
            match read() {
                Ok(config) => return Some((config, (hang_ups, read))),
                Err(faults) => {
                    for fault in faults {
                        tracing::error!(code = fault.rejection.code.name(), reason = %fault, "configuration rejected \
                                                                                              on reload; the previous \
                                                                                              one stays in force");
                    }
                }
            }
        }
    })
}

/// Every fault of a configuration, one below the other.
fn load(path: &Path) -> Result<Config, Rejection> {
    parsed(Config::load(path))
}

fn parsed<T>(config: Result<T, Vec<Fault>>) -> Result<T, Rejection> {
    config.map_err(|mut faults| {
        let last = faults
            .pop()
            .map_or_else(|| Rejection::new(Code::BadConfiguration, "the configuration is not usable"), Rejection::from);
        for fault in faults {
            eprint_line(&report(&Rejection::from(fault)));
        }
        last
    })
}

fn block_on(body: impl Future<Output = Result<(), Rejection>>) -> Result<(), Rejection> {
    block_on_with(2, body)
}

/// With so many workers. A bridge has one: it does little between two waits, and each sample would wake a second one
/// that finds nothing to do.
fn block_on_with(workers: usize, body: impl Future<Output = Result<(), Rejection>>) -> Result<(), Rejection> {
    tokio::runtime::Builder::new_multi_thread()
        .worker_threads(workers)
        .enable_all()
        .build()
        .map_err(|error| Rejection::new(Code::Internal, format!("cannot start the runtime: {error}")))?
        .block_on(body)
}
