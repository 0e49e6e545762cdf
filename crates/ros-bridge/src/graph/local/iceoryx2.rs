//! Shared memory as a transport of the local graph. It has no quality of service: every process gets every sample.

use std::sync::Arc;

use futures::{FutureExt, future::BoxFuture};
use ledger_gate::sample::Sample;

use super::transport::{Input, InputSettings, Output, OutputSettings, Transport};
use crate::{
    error::Result,
    graph::{
        qos::Qos,
        queue::Queue,
        shm::{Node, Peers, Publisher, Subscriber},
    },
};

impl Transport for Node {
    fn name(&self) -> &'static str {
        "shared memory"
    }

    fn input<'a>(&'a self, settings: &'a InputSettings, _qos: &'a Qos) -> BoxFuture<'a, Result<Box<dyn Input>>> {
        async move {
            let InputSettings { topic, limits, filter, .. } = settings;
            let subscriber = match filter {
                Some(filter) => self.subscriber_behind(topic, *limits, Arc::clone(filter)).await?,
                None => self.subscriber(topic, *limits).await?,
            };
            let input: Box<dyn Input> = Box::new(subscriber);
            Ok(input)
        }
        .boxed()
    }

    fn output<'a>(&'a self, settings: &'a OutputSettings, _qos: &'a Qos) -> BoxFuture<'a, Result<Box<dyn Output>>> {
        async move {
            let OutputSettings { topic, mark, .. } = settings;
            let publisher = match mark {
                Some(mark) => self.marked_publisher(topic, *mark).await?,
                None => self.publisher(topic).await?,
            };
            let output: Box<dyn Output> = Box::new(publisher);
            Ok(output)
        }
        .boxed()
    }
}

impl Input for Subscriber {
    fn queue(&self) -> &Queue {
        Self::queue(self)
    }

    fn in_memory(&self) -> Option<Peers> {
        Some(self.peers())
    }
}

impl Output for Publisher {
    fn write(&self, sample: &Sample) -> Result<()> {
        Self::write(self, sample).map(drop)
    }

    fn in_memory(&self) -> Option<Peers> {
        Some(self.peers())
    }
}
