//! Identifiers of endpoints.

use xxhash_rust::xxh3::xxh3_128;

use crate::attachment::GID_BYTES;

/// The identifier of an endpoint: the XXH3 hash of its token.
pub type Gid = [u8; GID_BYTES];

/// The identifier of the endpoint with this token.
pub fn gid_of(token: &str) -> Gid {
    xxh3_128(token.as_bytes()).to_le_bytes()
}
