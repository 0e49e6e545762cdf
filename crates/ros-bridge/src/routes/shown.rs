//! Latched topics of the local graph on which routes show their state: the holders of a service, and points of a task.

mod display;
mod holder;
mod latched;

pub(super) use self::{
    display::HolderDisplay,
    holder::{HolderNames, HolderTopic, KEY as HOLDER_KEY, read as read_holder},
    latched::LatchedTopic,
};
