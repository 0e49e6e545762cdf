//! The token, the identifier and the time of each endpoint.

use std::time::{SystemTime, UNIX_EPOCH};

use zenoh::{Wait, liveliness::LivelinessToken};

use crate::{
    error::{Error, failed},
    gid::{Gid, gid_of},
    key::Subject,
    node::Node,
    qos::TokenQos,
    token::{Kind, Token},
};

/// An endpoint that is announced. It leaves the graph when dropped.
pub(crate) struct Announced {
    pub(crate) gid: Gid,
    _token: LivelinessToken,
}

impl Node {
    /// Announces an endpoint.
    pub(crate) fn announce(&self, kind: Kind, subject: &Subject, qos: TokenQos) -> Result<Announced, Error> {
        let node = self.inner.identity.clone();
        let token = Token { node, number: self.next_number(), kind, subject: subject.clone(), qos }.to_string();
        let gid = gid_of(&token);
        let token = self.inner.session.liveliness().declare_token(token).wait().map_err(failed)?;
        Ok(Announced { gid, _token: token })
    }
}

/// Nanoseconds since 1970 by the clock of this host.
pub(crate) fn now() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
}
