//! Messages whose definitions the bridge has: those that it writes, the stop messages, and the lengths that fit.

pub(crate) mod builtin;
pub(crate) mod length;
pub mod stop;
