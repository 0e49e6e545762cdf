//! A graph of `rmw_zenoh` as others see it: two sessions, `hiroz`, plain zenoh in Python, and a router with access control.
#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

mod access;
mod hiroz;
mod python;
mod sessions;
mod support;
