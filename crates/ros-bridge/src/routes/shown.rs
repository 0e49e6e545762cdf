//! What routes show on topics of the local graph, for those who come late too.

mod display;
mod holder;
mod latched;

pub(super) use self::{
    display::HolderDisplay,
    holder::{HolderNames, HolderTopic, KEY as HOLDER_KEY, read as read_holder},
    latched::LatchedTopic,
};
