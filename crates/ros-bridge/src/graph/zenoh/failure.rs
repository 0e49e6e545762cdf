//! Errors of zenoh, with advice.

use ros_zenoh::error::Error as Failure;

use crate::error::{Error, Explained};

pub(super) fn zenoh_error(what: &str, error: &Failure) -> Error {
    let (wanted, hint) =
        ("a zenoh session with its router", "look at the router: `ros2 run rmw_zenoh_cpp rmw_zenohd` starts one");
    let explained = Explained::new(what, error.to_string(), wanted, hint);
    match error {
        Failure::Busy(_) => Error::Slow(explained),
        _ => Error::Zenoh(explained),
    }
}
