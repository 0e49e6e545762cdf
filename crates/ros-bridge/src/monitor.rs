//! The bridge as operators see it: its log, `/diagnostics`, the reports of rogue publishers, and the view of the program that
//! runs it.

mod bridge_monitor;
mod diagnostics;
mod neighbourhood;
mod reporter;
mod rogue_publishers;
mod silence;
mod silence_log;

pub(crate) use self::{
    bridge_monitor::Running,
    reporter::{Reporter, Statuses},
};
pub use self::{
    bridge_monitor::{BridgeMonitor, BridgeStatus, BridgeView, RouteView},
    diagnostics::{Level, Status},
};
