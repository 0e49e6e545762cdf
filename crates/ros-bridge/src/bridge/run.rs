//! Runs bridges one after another, until the program ends.

use std::time::Duration;

use futures::{FutureExt, Stream, StreamExt, future::BoxFuture};
use ledger_api::Client;
use ledger_base::rejection::{Code, Rejection};

use super::{
    renewal::keep_renewed,
    running::{Bridge, Summary},
};
use crate::{
    config::{Config, context_of},
    graph::choice::MiddlewareChoice,
    log::one_line,
    monitor::BridgeMonitor,
    routes::table::is_to_come,
};

/// Pause before a bridge that cannot start yet tries again.
const RETRY_PAUSE: Duration = Duration::from_secs(2);

/// Runs a bridge by itself until `stop` is ready, and then prints one line of JSON on standard output: the
/// [`Summary`]. It waits, and says so, as long as no node answers or its robot is not registered. If it loses the local graph, it
/// joins it again; the summary counts from there. `changes` brings configurations that are to count from now on, as
/// [`Bridge::reload`] takes them. `monitor` shows the bridge of each moment.
///
/// # Errors
/// As [`Client::connect`] and [`Bridge::start`] at the first start, where waiting cannot help.
pub async fn run(
    config: Config,
    changes: impl Stream<Item = Config>,
    stop: impl Future<Output = ()>,
    monitor: &BridgeMonitor,
) -> Result<(), Rejection> {
    match keep_running(config, changes, stop, start, monitor).await? {
        Some(summary) => print(&summary),
        None => Ok(()),
    }
}

/// A bridge, and what ends it as `stop` does: its certificate is a new one.
pub(super) type Started = (Bridge, BoxFuture<'static, ()>);

/// Runs bridges that `start` starts, one after another, until `stop` is ready. Answers with the summary of the last one, if one
/// ever ran.
pub(super) async fn keep_running(
    mut config: Config,
    changes: impl Stream<Item = Config>,
    stop: impl Future<Output = ()>,
    start: impl AsyncFn(&Config) -> Result<Started, Rejection>,
    monitor: &BridgeMonitor,
) -> Result<Option<Summary>, Rejection> {
    let (mut stop, mut changes) = (std::pin::pin!(stop), std::pin::pin!(changes));
    let (mut told, mut last) = (String::new(), None);
    loop {
        let refused = tokio::select! {
            () = &mut stop => return Ok(last),
            started = start(&config) => match started {
                Ok((mut bridge, mut renewed)) => {
                    told.clear();
                    bridge.show_on(monitor);
                    let lost = loop {
                        tokio::select! {
                            () = &mut stop => break None,
                            () = &mut renewed => break None,
                            lost = bridge.ended() => break Some(lost),
                            Some(changed) = changes.next() => {
                                config = changed;
                                bridge.reload(config.clone()).await;
                            }
                        }
                    };
                    let summary = bridge.stop().await;
                    let Some(lost) = lost else { return Ok(Some(summary)) };
                    let counters = serde_json::to_string(&summary).unwrap_or_default();
                    tracing::error!(summary = counters, "the local graph is lost, and is joined again");
                    last = Some(summary);
                    lost
                }
                Err(refused) if last.is_some() || is_to_come(&refused) || has_no_router(&config, &refused) => refused,
                Err(refused) => return Err(refused),
            },
        };
        monitor.waits(&refused);
        // The same reason once, not every two seconds.
        if told != refused.message {
            let (code, reason) = (refused.code.name(), one_line(&refused));
            tracing::warn!(code, reason, "the bridge waits: {}", refused.message);
            told = refused.message;
        }
        tokio::select! {
            () = &mut stop => return Ok(last),
            Some(changed) = changes.next() => config = changed,
            () = tokio::time::sleep(RETRY_PAUSE) => {}
        }
    }
}

/// Has the middleware refused, and may the router still come? Without one no session of zenoh opens.
fn has_no_router(config: &Config, refused: &Rejection) -> bool {
    matches!(config.middleware, MiddlewareChoice::Zenoh(_)) && refused.code == Code::MiddlewareFailed
}

async fn start(config: &Config) -> Result<Started, Rejection> {
    let client = Client::connect(&context_of(config)?).await?;
    let bridge = Bridge::start(config.clone(), client.clone()).await?;
    let config = config.clone();
    Ok((bridge, async move { keep_renewed(&config, &client).await }.boxed()))
}

#[expect(clippy::print_stdout, reason = "the summary is the output of the program")]
fn print(summary: &Summary) -> Result<(), Rejection> {
    let text = serde_json::to_string(summary)
        .map_err(|error| Rejection::new(Code::Internal, format!("the summary cannot be written: {error}")))?;
    println!("{text}");
    Ok(())
}
