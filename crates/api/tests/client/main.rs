//! The client against a scripted node over real TLS and HTTP/2.
#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

mod authority;
mod believing;
mod contexts;
mod enrolment;
mod fake;
mod nodes;
mod plugged;
mod reading;
mod renewing;
mod submitting;
mod subscribing;
#[path = "../tls.rs"]
mod tls;
#[path = "../wire.rs"]
mod wire;
