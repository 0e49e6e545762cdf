//! `top`: robots, holders, rates, latencies and nodes on the whole screen, as they are now.

mod question;
mod rates;
mod screen;
mod view;

use crate::command::emergency;
use crate::command::network::status::{self, Overview};
use crate::failure::Failure;
use crate::global::Global;
use crate::session::{ABAC, Session};
use bytes::Bytes;
use ledger_api::{Committed, EventStream, Subscription};
use ledger_base::rejection::{Class, Rejection};
use ledger_contract::RobotAsset;
use question::Progress;
use rates::Rates;
use screen::{Key, Screen, Typed};
use std::time::Duration;
use tokio::signal::unix::{SignalKind, signal};
use tokio::time::{Instant, interval, sleep};
use view::View;

/// Between two looks at the robots and the nodes.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// Pause before messages are subscribed to again, where that was refused.
const AGAIN_AFTER: Duration = Duration::from_secs(5);
/// How often the node says that it is alive while there are no messages, in milliseconds.
const HEARTBEAT_MS: u32 = 1_000;

/// Show robots, holders, rates, latencies and nodes on the whole screen, continuously.
///
/// Rates and latencies are those of the services that you may subscribe to, over the last ten seconds. A latency is the
/// time from the signature of a message to its arrival here. The arrow keys select a service. `s` stops its robot at
/// once. `u` resumes it, after a reason and Enter. `r` releases your grant of it, and `q` quits.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl top")]
pub(crate) struct Top {}

impl Top {
    pub(crate) async fn run(self, global: &Global) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let mut screen = Screen::open()?;
        Ok(run(&session, &mut screen).await?)
    }
}

async fn run(session: &Session, screen: &mut Screen) -> Result<(), Rejection> {
    let mut terminate = signal(SignalKind::terminate()).map_err(screen::unusable)?;
    let (mut view, mut rates) = (View::of(session.context()), Rates::default());
    let mut messages = session.client.subscribe(Subscription {
        chaincode: ABAC.to_owned(),
        names: vec!["message".to_owned()],
        heartbeat: HEARTBEAT_MS,
        ..Subscription::default()
    });
    let mut ticks = interval(LOOK_EVERY);
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    // A look waits for nodes that may be silent, and keys wait for nothing.
    let mut looking = Box::pin(look(session));
    let mut is_looking = true;
    loop {
        tokio::select! {
            typed = screen.typed() => if let Next::End = after(&typed, session, &mut view).await {
                return Ok(());
            },
            seen = &mut looking, if is_looking => {
                is_looking = false;
                view.saw(seen, session.client.now());
            }
            _ = ticks.tick() => if !is_looking {
                looking = Box::pin(look(session));
                is_looking = true;
            },
            delivered = next(&mut messages) => {
                rates.count(&delivered, session.client.now());
                continue;
            }
            _ = terminate.recv() => return Ok(()),
        }
        screen.draw(&view.lines(&rates.now(Instant::now()), screen.size()))?;
    }
}

/// Whether the screen stays after a key.
enum Next {
    Stay,
    End,
}

/// Does what a key asks for. While a question is open, keys are its answer.
async fn after(typed: &Typed, session: &Session, view: &mut View) -> Next {
    if let Some(mut question) = view.question.take() {
        match question.typed(typed.bytes()) {
            Progress::Open => view.question = Some(question),
            Progress::Cancelled => "not resumed".clone_into(&mut view.told),
            Progress::Answered => {
                let (robot, reason) = question.answer();
                let done = emergency::resume(session, robot.clone(), Some(reason), |_| ()).await;
                view.told = outcome("resume", &robot, done);
            }
        }
        return Next::Stay;
    }
    match typed.key() {
        Key::End => return Next::End,
        Key::Up => view.choose(-1),
        Key::Down => view.choose(1),
        Key::Stop => view.told = act(session, "stop", view.robot()).await,
        Key::Resume => view.ask_to_resume(),
        Key::Release => view.told = act(session, "release", view.service()).await,
        Key::Other => {}
    }
    Next::Stay
}

/// The next delivery; after a refusal of the subscription another try.
async fn next(messages: &mut EventStream) -> ledger_api::v1::Delivery {
    loop {
        match messages.next().await {
            Ok(delivery) => return delivery,
            Err(_) => sleep(AGAIN_AFTER).await,
        }
    }
}

/// The robots and the nodes of this moment.
async fn look(session: &Session) -> Result<(Vec<RobotAsset>, Overview), Rejection> {
    let robots = session.list(ABAC, "robots").await?;
    Ok((robots, status::asked(session).await?))
}

/// Does something about what is chosen, and tells how that went.
async fn act(session: &Session, function: &str, about: Option<String>) -> String {
    let Some(about) = about else { return "no service is selected".to_owned() };
    let done = session.call(ABAC, function, vec![Bytes::from(about.clone())]).await;
    outcome(function, &about, done)
}

/// How a call went, in a line.
fn outcome(function: &str, about: &str, done: Result<Committed, Rejection>) -> String {
    match done {
        Ok(done) => format!("{function} {about}: done in block {}", done.height),
        Err(refused) if refused.code.class() == Class::Unreachable => {
            format!("{function} {about}: not in force, repeat it: {} [{}]", refused.message, refused.code)
        }
        Err(refused) => format!("{function} {about}: {} [{}]", refused.message, refused.code),
    }
}
