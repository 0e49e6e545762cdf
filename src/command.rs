//! The command line of `ledgerd`.

use crate::admin::{Admin, PagePapers};
use crate::ca::operator;
use crate::config::{Config, Fault, OfBridge};
use crate::host::NodeBuilder;
use crate::instance::Ended;
use crate::{backup, demo, dev, join, memory, recover, setup, telemetry, verify};
use clap::{CommandFactory, Parser, Subcommand};
use futures::{FutureExt, Stream, StreamExt, future, stream};
use ledger_api::report;
use ledger_base::rejection::{Class, Code, Rejection};
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
    after_help = "Start with: ledgerd demo    (the whole story in a minute)\n       or: ledgerd dev     (a network for playing)"
)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Plays the paper's experiment for real: two organisations, two users, three robots, real ROS 2 messages.
    Demo(demo::Options),
    /// Starts a network of one node for playing, with both organisations and the robots of the paper.
    Dev(dev::Options),
    /// Starts a configured node.
    Run(RunOptions),
    /// Checks a configuration and names every fault at once.
    Check(WithConfig),
    /// Founds a network of one organisation with one node, in the directory that the configuration names.
    Init(setup::InitOptions),
    /// Brings a node into a network, with a token from one of its admins.
    Join(join::JoinOptions),
    /// Brings a node back whose blocks are damaged or lost, under a new number; needs its certificate, and no token.
    Rejoin(join::RejoinOptions),
    /// Copies a node, which may run, into a directory, and verifies the copy.
    Backup(backup::BackupOptions),
    /// Makes a data directory from a backup. A node starts from it only after `rejoin` or `recover`.
    Restore(backup::RestoreOptions),
    /// Goes on with one node when most voters are lost for good. Blocks that only they had are gone.
    Recover(recover::RecoverOptions),
    /// Writes a file with which gates and light clients begin anew after a recovery: they believe this node then.
    Checkpoint(recover::CheckpointOptions),
    /// Makes a one-time secret for an admin, at a node that carries the CA: a way back for an admin who is locked out.
    AdminSecret(operator::AdminSecret),
    /// Copies, restores or gives up the CA that a node carries.
    #[command(subcommand)]
    Ca(operator::Ca),
    /// Joins a ROS 2 graph to the ledger through a remote gateway.
    Bridge(WithConfig),
    /// Checks the chain of a stopped node or of an archive: every hash, every signature, every verdict executed again.
    ///
    /// Nothing that the node has computed is trusted. The attestations of nodes are compared. Exits with 1 and names
    /// the first byte that is wrong. If the oldest blocks are gone, execution begins with the snapshot before the
    /// others. Blocks that call a chaincode of your own are verified by the program that has that chaincode.
    Verify(verify::Options),
    /// Prints what a shell needs to complete these commands.
    Completions {
        /// The shell.
        #[arg(value_enum)]
        shell: clap_complete::Shell,
    },
    /// Writes the manual pages of all commands into a directory, for packages.
    #[command(hide = true)]
    Man {
        /// The directory, which exists.
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
    /// The machine's clock is right although it was behind block time: the only voter of a network goes on.
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
        Err(error) => {
            let _closed = error.print();
            return if error.use_stderr() { ExitCode::from(64) } else { ExitCode::SUCCESS };
        }
    };
    match execute(arguments.command, &builder) {
        Ok(()) => ExitCode::SUCCESS,
        Err(rejection) => {
            eprint_line(&report(&rejection));
            ExitCode::from(match rejection.code {
                Code::ShuttingDown => INTERRUPTED,
                Code::NotAMember => NO_MEMBER,
                Code::Forked => FORKED,
                code => code.class().exit_code().max(Class::Failure.exit_code()),
            })
        }
    }
}

fn execute(command: Command, builder: &NodeBuilder) -> Result<(), Rejection> {
    match command {
        Command::Demo(options) => block_on(demo::run(options)),
        Command::Dev(options) => block_on(dev::run(builder, options)),
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
                "{} is fine: data in {}, listens on {}",
                path.display(),
                config.data.display(),
                config.listen
            ));
            Ok(())
        }
        Command::Init(options) => setup::init(&options).map(|text| print_line(&text)),
        Command::Join(options) => {
            block_on(async { join::join(&options).await.map(|text| print_line(&text)) })?;
            if !options.run {
                return Ok(());
            }
            let options = RunOptions { config: options.config, trust_clock: false };
            execute(Command::Run(options), builder)
        }
        Command::Rejoin(options) => {
            let config = load(&options.config)?;
            block_on(async { join::rejoin(builder, &options, &config).await.map(|text| print_line(&text)) })
        }
        Command::Backup(options) => {
            let config = load(&options.config)?;
            backup::backup(builder, &options, &config).map(|text| print_line(&text))
        }
        Command::Restore(options) => {
            options.provide_config()?;
            let config = load(&options.config)?;
            backup::restore(builder, &options, &config).map(|text| print_line(&text))
        }
        Command::Recover(options) => {
            let config = load(&options.config)?;
            block_on(async { recover::recover(builder, &options, &config).await.map(|text| print_line(&text)) })
        }
        Command::Checkpoint(options) => {
            let config = load(&options.config)?;
            recover::checkpoint(builder, &options, &config).map(|text| print_line(&text))
        }
        Command::AdminSecret(command) => {
            let config = load(&command.config)?;
            command.run(&config, crate::clock::wall()).map(|text| print_line(&text))
        }
        Command::Ca(command) => {
            let config = load(command.config())?;
            command.run(&config).map(|text| print_line(&text))
        }
        Command::Bridge(WithConfig { config: path }) => run_bridge(&path),
        Command::Verify(options) => verify::run(builder, &options),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Arguments::command(), "ledgerd", &mut script);
            print_line(&String::from_utf8_lossy(&script));
            Ok(())
        }
        Command::Man { directory } => clap_mangen::generate_to(Arguments::command(), &directory).map_err(|error| {
            Rejection::new(Code::BadFile, format!("cannot write manual pages into {}", directory.display()))
                .found(error.to_string())
                .next("name a directory that exists and that you may write to")
        }),
    }
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
                let papers = PagePapers::OfFiles(program.admin.clone());
                Some(Admin::serve(address, Arc::new(sight.clone()), papers).await?)
            }
        };
        let who =
            ros_bridge::context_of(&config).map(|who| format!("{}/{}", who.organisation, who.name)).unwrap_or_default();
        let tracer = Tracer::start(&program.traces, "ledgerd-bridge", &who);
        let changes = read_again(|| {
            let (changed, config) = OfBridge::load(path)?;
            if (&changed.admin, &changed.traces) != (&program.admin, &program.traces) {
                tracing::warn!("admin and traces change when the bridge starts again: they go on as they are");
            }
            telemetry::set_level(&changed.log);
            Ok(config.traced(tracer.clone()))
        });
        ros_bridge::run(config.traced(tracer.clone()), changes, stop_signal(), &sight).await
    })
}

/// Waits for a signal to stop, or for the node to end; ends the node in order either way. Meanwhile it takes over changed
/// configurations, as [`crate::Node::reload`] does.
pub(crate) async fn until_stopped(
    node: crate::Node,
    stop: impl Future<Output = ()>,
    changes: impl Stream<Item = Config>,
) -> Result<(), Rejection> {
    let reload = changes.for_each(async |config| node.reload(&config));
    let outcome = tokio::select! {
        () = stop => Ok(()),
        ended = node.ended() => Err(ended),
        () = reload.then(|()| future::pending()) => Ok(()),
    };
    node.stop().await;
    match outcome {
        Ok(()) => Ok(()),
        Err(Ended::Failed(reason)) => Err(reason),
        Err(Ended::StartAgain) => Err(start_again()),
    }
}

/// Puts this program anew in the place of this process: nothing of the old state is left in memory or in use.
fn start_again() -> Rejection {
    use std::os::unix::process::CommandExt;
    let failed = |error: std::io::Error| {
        Rejection::new(Code::Internal, format!("the node has to start again and cannot by itself: {error}"))
            .next("start it again")
    };
    match std::env::current_exe() {
        Ok(program) => failed(std::process::Command::new(program).args(std::env::args_os().skip(1)).exec()),
        Err(error) => failed(error),
    }
}

/// Catches SIGINT and SIGTERM from now on; the future ends when one of them comes. Called before a node starts, so that
/// it ends in order whenever it is asked to. Must be called inside a tokio runtime.
pub(crate) fn stop_signal() -> impl Future<Output = ()> {
    use tokio::signal::unix::{Signal, SignalKind, signal};
    let listen = |kind| {
        let listening = signal(kind);
        listening
            .inspect_err(|error| tracing::warn!(%error, signal = kind.as_raw_value(), "cannot wait for this signal"))
            .ok()
    };
    async fn received(signal: Option<Signal>) {
        match signal {
            Some(mut signal) => drop(signal.recv().await),
            None => std::future::pending().await,
        }
    }
    let (terminate, interrupt) = (listen(SignalKind::terminate()), listen(SignalKind::interrupt()));
    async move {
        tokio::select! {
            () = received(terminate) => {}
            () = received(interrupt) => {}
        }
    }
}

/// A configuration, read again after each SIGHUP. Must be called inside a tokio runtime.
fn read_again<T>(read: impl Fn() -> Result<T, Vec<Fault>>) -> impl Stream<Item = T> {
    use tokio::signal::unix::{SignalKind, signal};
    let hang_ups = signal(SignalKind::hangup());
    let hang_ups = hang_ups.inspect_err(|error| tracing::warn!(%error, "SIGHUP does not change the routes")).ok();
    stream::unfold((hang_ups, read), async |(mut hang_ups, read)| {
        loop {
            hang_ups.as_mut()?.recv().await?;
            match read() {
                Ok(config) => return Some((config, (hang_ups, read))),
                Err(faults) => {
                    for fault in faults {
                        tracing::error!(code = fault.rejection.code.name(), reason = %fault, "the configuration was not taken over, and everything goes on as before");
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
            .map_or_else(|| Rejection::new(Code::BadConfiguration, "configuration is not usable"), Rejection::from);
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

/// Prints a line; that the reader has gone away is not our failure.
pub(crate) fn print_line(text: &str) {
    use std::io::Write;
    let _closed = writeln!(std::io::stdout(), "{text}");
}

/// Prints a line on standard error.
pub(crate) fn eprint_line(text: &str) {
    use std::io::Write;
    let _closed = writeln!(std::io::stderr(), "{text}");
}
