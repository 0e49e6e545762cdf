//! Reports of routes on latched topics of the local graph.

mod display;
mod holder;
mod latched;

pub(super) use self::{
    display::HolderDisplay,
    holder::{HolderNames, HolderTopic, KEY as HOLDER_KEY, read as read_holder},
    latched::LatchedTopic,
};
