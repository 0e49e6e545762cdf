//! Arguments as people type them, read into our types. Every refusal says what was found and what is wanted.

pub(crate) mod attribute;
pub(crate) mod bytes;
pub(crate) mod capability;
pub(crate) mod destination;
pub(crate) mod domain;
pub(crate) mod message;
pub(crate) mod moment;
pub(crate) mod number;
pub(crate) mod points;
pub(crate) mod policies;
pub(crate) mod remap;
pub(crate) mod service;
pub(crate) mod setting;
pub(crate) mod span;
pub(crate) mod when;
