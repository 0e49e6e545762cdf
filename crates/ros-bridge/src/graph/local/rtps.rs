//! DDS as a transport of the local graph.

use std::{collections::BTreeSet, net::Ipv4Addr, sync::Arc, time::Duration};

use futures::{FutureExt, future::BoxFuture};
use ledger_gate::sample::Sample;
use tokio::sync::watch;

use super::transport::{
    Caller, Client, Input, InputSettings, Middleware, Number, Output, OutputSettings, Reply, Request, Server, Transport,
};
use crate::{
    error::Result,
    graph::{
        dds::{self, Change, Exchange, Matched, Participant, Reader, Writer},
        mark::Mark,
        qos::Qos,
        queue::Queue,
    },
};

impl Transport for Participant {
    fn name(&self) -> &'static str {
        "DDS"
    }

    fn input<'a>(&'a self, settings: &'a InputSettings, qos: &'a Qos) -> BoxFuture<'a, Result<Box<dyn Input>>> {
        async move {
            let InputSettings { topic, message, limits, filter } = settings;
            let reader = match filter {
                Some(filter) => self.reader_behind(topic, message, qos, *limits, Arc::clone(filter))?,
                None => self.reader(topic, message, qos, *limits)?,
            };
            let input: Box<dyn Input> = Box::new(reader);
            Ok(input)
        }
        .boxed()
    }

    fn output<'a>(&'a self, settings: &'a OutputSettings, qos: &'a Qos) -> BoxFuture<'a, Result<Box<dyn Output>>> {
        async move {
            let OutputSettings { topic, message, mark } = settings;
            let writer = match mark {
                Some(mark) => self.marked_writer(topic, message, qos, *mark)?,
                None => self.writer(topic, message, qos)?,
            };
            let output: Box<dyn Output> = Box::new(writer);
            Ok(output)
        }
        .boxed()
    }
}

impl Middleware for Participant {
    fn identity(&self) -> [u8; 16] {
        self.guid()
    }

    fn unreachable(&self) -> Vec<Ipv4Addr> {
        Self::unreachable(self)
    }

    fn has_publisher(&self, publisher: &[u8; 16]) -> bool {
        Self::has_publisher(self, publisher)
    }

    fn follow(
        &self,
        topics: watch::Receiver<BTreeSet<String>>,
        report: Box<dyn FnMut(Change) + Send>,
    ) -> BoxFuture<'static, ()> {
        let participant = self.clone();
        async move { Self::follow(&participant, topics, report).await }.boxed()
    }

    fn client(&self, exchange: &Exchange, mark: Mark, bytes_max: usize) -> Result<Box<dyn Client>> {
        Ok(Box::new(Self::client(self, exchange, mark, bytes_max)?))
    }

    fn server(&self, exchange: &Exchange, mark: Mark, bytes_max: usize) -> Result<Box<dyn Server>> {
        Ok(Box::new(Self::server(self, exchange, mark, bytes_max)?))
    }

    #[cfg(test)]
    fn break_down(&self) {
        Self::break_down(self);
    }
}

impl Input for Reader {
    fn queue(&self) -> &Queue {
        Self::queue(self)
    }

    fn matched(&self) -> Option<&Matched> {
        Some(Self::matched(self))
    }
}

impl Output for Writer {
    fn write(&self, sample: &Sample) -> Result<()> {
        Self::write(self, sample)
    }

    fn flush(&self, at_most: Duration) -> BoxFuture<'_, bool> {
        Self::flush(self, at_most).boxed()
    }

    fn matched(&self) -> Option<&Matched> {
        Some(Self::matched(self))
    }
}

impl Client for dds::Client {
    fn call(&mut self, message: &[u8]) -> Result<Number> {
        Self::call(self, message).map(Number::Dds)
    }

    fn next(&mut self) -> BoxFuture<'_, Option<Reply>> {
        async {
            let dds::Reply { number, message } = Self::next(self).await?;
            Some(Reply { number: Number::Dds(number), message })
        }
        .boxed()
    }

    fn matched(&self) -> &Matched {
        Self::matched(self)
    }
}

impl Server for dds::Server {
    fn next(&mut self) -> BoxFuture<'_, Option<Request>> {
        async {
            let dds::Request { message, caller } = Self::next(self).await?;
            Some(Request { message, caller: Caller::Dds(caller) })
        }
        .boxed()
    }

    fn reply(&mut self, caller: &Caller, message: &[u8]) -> Result<()> {
        match caller {
            Caller::Dds(caller) => Self::reply(self, caller, message),
            #[cfg(feature = "zenoh")]
            Caller::Zenoh(_) => Ok(()),
        }
    }

    fn is_there(&self, caller: &Caller) -> bool {
        match caller {
            Caller::Dds(caller) => Self::is_there(self, caller),
            #[cfg(feature = "zenoh")]
            Caller::Zenoh(_) => false,
        }
    }

    fn matched(&self) -> &Matched {
        Self::matched(self)
    }
}
