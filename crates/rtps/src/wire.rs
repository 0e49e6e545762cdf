//! Datagrams and their submessages as bytes (§8.3, §9.4).

pub(crate) mod cursor;
pub(crate) mod encoder;
mod format;
mod number_set;
pub(crate) mod parameters;
pub(crate) mod pid;
pub mod read;
pub mod submessage;
pub mod write;

pub(crate) use format::VERSION;

#[cfg(test)]
mod tests;
