//! The node of a bridge in shared memory.

use std::sync::Arc;

use iceoryx2::{
    node::{Node as IoxNode, NodeBuilder, NodeCreationFailure},
    prelude::{LogLevel, NodeName, ServiceName, SignalHandlingMode, set_log_level_from_env_or},
    service::{
        builder::{
            event::{EventOpenError, EventOpenOrCreateError},
            publish_subscribe::{PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError},
        },
        ipc_threadsafe::Service,
    },
};

use super::{
    attempt::{blocking, failed, retry},
    directory,
    header::Header,
    service::{BUFFER_SAMPLES, DataService, EventService, NODES_MAX, PUBLISHERS_MAX, SUBSCRIBERS_MAX},
};
use crate::{error::Result, graph::names::TopicName};

/// Our presence in the shared memory of this machine. Cloning shares it.
#[derive(Clone)]
pub struct Node {
    pub(super) node: Arc<IoxNode<Service>>,
    domain: u16,
    pub(super) origin: [u8; 16],
}

impl Node {
    /// Opens the shared memory of a ROS domain under a name that tools show. `origin` marks what we publish: unique in
    /// the world, such as the GUID of a DDS participant.
    ///
    /// # Errors
    /// [`Error::Shm`](crate::error::Error::Shm) if the directory of shared memory is not safe ([`directory::config`]), or iceoryx2 fails.
    pub async fn open(domain: u16, name: &str, origin: [u8; 16]) -> Result<Self> {
        let node_name = NodeName::new(name).map_err(|error| failed(&format!("node name {name:?}"), &error))?;
        blocking(move || {
            set_log_level_from_env_or(LogLevel::Error);
            let config = directory::config()?;
            let create = || -> std::result::Result<_, NodeCreationFailure> {
                let builder = NodeBuilder::new().name(&node_name).config(&config);
                builder.signal_handling_mode(SignalHandlingMode::Disabled).create::<Service>()
            };
            Ok(Self { node: Arc::new(retry("cannot open shared memory", create)?), domain, origin })
        })
        .await
    }

    pub(super) fn services(&self, topic: &TopicName) -> Result<(DataService, EventService)> {
        let what = format!("cannot open {topic} in shared memory");
        let name = match self.domain {
            0 => topic.dds(),
            domain => format!("domain{domain}/{}", topic.dds()),
        };
        let name = ServiceName::new(&name).map_err(|error| failed(&what, &error))?;
        let data = retry(&what, || self.data_service(&name))?;
        let events = retry(&what, || self.event_service(&name))?;
        Ok((data, events))
    }

    /// The samples: as another process has opened the service, else with our limits.
    fn data_service(&self, name: &ServiceName) -> std::result::Result<DataService, PublishSubscribeOpenOrCreateError> {
        let builder = || self.node.service_builder(name).publish_subscribe::<[u8]>().user_header::<Header>();
        match builder().open() {
            Err(PublishSubscribeOpenError::DoesNotExist) => Ok(builder()
                .max_publishers(PUBLISHERS_MAX)
                .max_subscribers(SUBSCRIBERS_MAX)
                .max_nodes(NODES_MAX)
                .subscriber_max_buffer_size(BUFFER_SAMPLES)
                .enable_safe_overflow(true)
                .create()?),
            opened => Ok(opened?),
        }
    }

    /// The wake-ups, in the same way.
    fn event_service(&self, name: &ServiceName) -> std::result::Result<EventService, EventOpenOrCreateError> {
        match self.node.service_builder(name).event().open() {
            Err(EventOpenError::DoesNotExist) => Ok(self
                .node
                .service_builder(name)
                .event()
                .max_notifiers(PUBLISHERS_MAX + SUBSCRIBERS_MAX)
                .max_listeners(SUBSCRIBERS_MAX)
                .max_nodes(NODES_MAX)
                .create()?),
            opened => Ok(opened?),
        }
    }
}
