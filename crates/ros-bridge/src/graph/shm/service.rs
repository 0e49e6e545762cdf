//! The services of a topic, and their limits.

use iceoryx2::service::{ipc_threadsafe::Service, port_factory};

use super::header::Header;

/// Most publishers of a service.
pub const PUBLISHERS_MAX: usize = 16;
/// Most subscribers of a service.
pub const SUBSCRIBERS_MAX: usize = 16;
/// Most processes that use a service.
pub(super) const NODES_MAX: usize = 32;
/// Samples that wait for each subscriber; a slow one loses the oldest.
pub const BUFFER_SAMPLES: usize = 32;

/// Carries the samples.
pub(super) type DataService = port_factory::publish_subscribe::PortFactory<Service, [u8], Header>;
/// Wakes those up who wait for them.
pub(super) type EventService = port_factory::event::PortFactory<Service>;
