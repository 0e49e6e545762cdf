//! The bridge inside a node: the same as `ledgerd bridge`, through the node's own gateway.

use ledger_api::Client;
use ledger_base::rejection::Rejection;
use ledger_traces::Tracer;
use ros_bridge::Bridge;
use ros_bridge::BridgeMonitor;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinHandle;

/// Pause before a bridge that cannot start tries again: its robot may not be registered yet.
const RETRY_PAUSE: Duration = Duration::from_secs(2);

/// A bridge that starts as soon as it can, and ends with its node.
pub(crate) struct NodeBridge {
    stop: watch::Sender<bool>,
    settings: watch::Sender<ros_bridge::Config>,
    task: JoinHandle<()>,
    tracer: Tracer,
}

impl NodeBridge {
    /// Starts the bridge. `address` is the node's gateway; `sight` shows the bridge of each moment, `tracer` hears
    /// of messages.
    pub(crate) fn start(
        settings: ros_bridge::Config,
        address: String,
        (sight, tracer): (BridgeMonitor, Tracer),
    ) -> Self {
        let settings = settings.traced(tracer.clone());
        let (stop, mut stopping) = watch::channel(false);
        let (sender, mut changes) = watch::channel(settings);
        let task = tokio::spawn(async move {
            let (mut told, mut down) = (String::new(), false);
            loop {
                let settings = changes.borrow_and_update().clone();
                let started = tokio::select! {
                    started = start(settings.clone(), address.clone()) => started,
                    () = stopped(&mut stopping) => return,
                };
                match started {
                    Ok((mut bridge, client)) => {
                        // An outage and its end have the same level.
                        match std::mem::take(&mut down) {
                            true => tracing::warn!("bridge running again"),
                            false => tracing::info!("bridge running"),
                        }
                        told.clear();
                        bridge.show_on(&sight);
                        let mut renewed = std::pin::pin!(ros_bridge::keep_renewed(&settings, &client));
                        let lost = loop {
                            tokio::select! {
                                () = stopped(&mut stopping) => break None,
                                () = &mut renewed => break None,
                                lost = bridge.ended() => break Some(lost),
                                Ok(()) = changes.changed() => {}
                            }
                            let changed = changes.borrow_and_update().clone();
                            bridge.reload(changed).await;
                        };
                        let summary = serde_json::to_string(&bridge.stop().await).unwrap_or_default();
                        tracing::info!(summary, "bridge stopped");
                        match lost {
                            Some(reason) => {
                                sight.waits(&reason);
                                tracing::warn!(code = reason.code.name(), %reason, "bridge failed; restarting");
                            }
                            None => return,
                        }
                        down = true;
                    }
                    // The same reason once, not every two seconds.
                    Err(reason) if told == reason.message => {}
                    Err(reason) => {
                        sight.waits(&reason);
                        tracing::warn!(code = reason.code.name(), %reason, "bridge cannot start yet; retrying");
                        (told, down) = (reason.message, true);
                    }
                }
                tokio::select! {
                    () = tokio::time::sleep(RETRY_PAUSE) => {}
                    () = stopped(&mut stopping) => return,
                }
            }
        });
        Self { stop, settings: sender, task, tracer }
    }

    /// Takes over the routes of these settings, as [`Bridge::reload`] does.
    pub(crate) fn reload(&self, settings: ros_bridge::Config) {
        self.settings.send_replace(settings.traced(self.tracer.clone()));
    }

    /// Ends the bridge: what it has set in motion is stopped.
    pub(crate) async fn stop(self) {
        self.stop.send_replace(true);
        if let Err(error) = self.task.await {
            tracing::error!(%error, "bridge ended unexpectedly");
        }
    }
}

/// Ends when the node stops. The value that told so is not kept, because it locks the channel.
async fn stopped(stopping: &mut watch::Receiver<bool>) {
    drop(stopping.wait_for(|stop| *stop).await);
}

async fn start(settings: ros_bridge::Config, address: String) -> Result<(Bridge, Client), Rejection> {
    let credentials = ros_bridge::context_of(&settings)?.credentials()?;
    let client = Client::connect_to(vec![address], credentials).await?;
    Ok((Bridge::start(settings, client.clone()).await?, client))
}
