//! The connection to a node that a client uses, with the services that it calls over it.

use crate::connect::Connection;
use crate::v1::enrolment_client::EnrolmentClient;
use crate::v1::gateway_client::GatewayClient;
use tonic::transport::Channel;

/// Largest message that a node may send, in bytes: a full block with its events.
const MESSAGE_BYTES_MAX: usize = 32 * 1024 * 1024;

/// A connection in use, and which one it is.
#[derive(Clone)]
pub(super) struct Uplink {
    pub(super) number: u64,
    pub(super) connection: Connection,
}

impl Uplink {
    pub(super) fn gateway(&self) -> GatewayClient<Channel> {
        GatewayClient::new(self.connection.channel.clone()).max_decoding_message_size(MESSAGE_BYTES_MAX)
    }

    pub(super) fn enrolment(&self) -> EnrolmentClient<Channel> {
        EnrolmentClient::new(self.connection.channel.clone()).max_decoding_message_size(MESSAGE_BYTES_MAX)
    }
}
