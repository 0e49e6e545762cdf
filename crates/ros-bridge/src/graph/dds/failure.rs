//! Errors of DDS, with advice.

use crate::error::{Error, Explained};

pub(super) fn dds_error(what: &str, error: &dyn std::error::Error) -> Error {
    let wanted = "a working DDS participant";
    let hint = "look at the interfaces of this machine (`ip address`) and at its free UDP ports from 7400";
    Error::Dds(Explained::new(what, error.to_string(), wanted, hint))
}
