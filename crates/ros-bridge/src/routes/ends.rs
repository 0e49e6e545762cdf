//! The local ends of routes: a topic of the local graph, or for calls the part that serves or calls there.

mod handover;
mod inlet;
mod outlet;
mod reply_frame;

use tokio::sync::watch;

pub(super) use self::{
    handover::{CALLS_MAX, Hand, Handed, SubmitUpdate, TOO_MANY},
    inlet::Inlet,
    outlet::Outlet,
    reply_frame::{REPLY_BYTES, message_of, reply_to, split},
};
use crate::graph::qos::Qos;

/// Waits for another quality of service; for ever where there is none to follow.
pub(super) fn changed(qos: Option<&watch::Receiver<Qos>>) -> impl Future<Output = ()> + use<> {
    let qos = qos.cloned();
    async move {
        let Some(mut qos) = qos else { return std::future::pending().await };
        if qos.changed().await.is_err() {
            std::future::pending().await
        }
    }
}
