//! zenoh as a transport of the local graph.

use std::collections::BTreeSet;

use futures::{FutureExt, future::BoxFuture};
use ledger_gate::sample::Sample;
use tokio::sync::watch;

use super::transport::{
    Caller, Client, Input, InputSettings, Middleware, Number, Output, OutputSettings, Reply, Request, Server, Transport,
};
use crate::{
    error::Result,
    graph::{
        dds::{Change, Exchange, Matched},
        mark::Mark,
        qos::Qos,
        queue::Queue,
        zenoh::{self, Reader, Session, Writer},
    },
};

impl Transport for Session {
    fn name(&self) -> &'static str {
        "zenoh"
    }

    fn input<'a>(&'a self, settings: &'a InputSettings, qos: &'a Qos) -> BoxFuture<'a, Result<Box<dyn Input>>> {
        async move {
            let InputSettings { topic, message, limits, filter } = settings;
            let input: Box<dyn Input> = Box::new(self.reader((topic, message), qos, *limits, filter.clone())?);
            Ok(input)
        }
        .boxed()
    }

    fn output<'a>(&'a self, settings: &'a OutputSettings, qos: &'a Qos) -> BoxFuture<'a, Result<Box<dyn Output>>> {
        async move {
            let OutputSettings { topic, message, mark } = settings;
            let output: Box<dyn Output> = Box::new(self.writer((topic, message), qos, *mark)?);
            Ok(output)
        }
        .boxed()
    }
}

impl Middleware for Session {
    fn identity(&self) -> [u8; 16] {
        Self::identity(self)
    }

    fn has_publisher(&self, publisher: &[u8; 16]) -> bool {
        Self::has_publisher(self, publisher)
    }

    fn follow(
        &self,
        topics: watch::Receiver<BTreeSet<String>>,
        report: Box<dyn FnMut(Change) + Send>,
    ) -> BoxFuture<'static, ()> {
        Self::follow(self, topics, report).boxed()
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

    fn matched(&self) -> Option<&Matched> {
        Some(Self::matched(self))
    }
}

impl Client for zenoh::Client {
    fn call(&mut self, message: &[u8]) -> Result<Number> {
        Self::call(self, message).map(Number::Zenoh)
    }

    fn next(&mut self) -> BoxFuture<'_, Option<Reply>> {
        async {
            let (number, message) = Self::next(self).await?;
            Some(Reply { number: Number::Zenoh(number), message })
        }
        .boxed()
    }

    fn matched(&self) -> &Matched {
        Self::matched(self)
    }
}

impl Server for zenoh::Server {
    fn next(&mut self) -> BoxFuture<'_, Option<Request>> {
        async {
            let (id, message) = Self::next(self).await?;
            Some(Request { message, caller: Caller::Zenoh(id) })
        }
        .boxed()
    }

    fn reply(&mut self, caller: &Caller, message: &[u8]) -> Result<()> {
        match caller {
            Caller::Zenoh(id) => Self::reply(self, id, message),
            Caller::Dds(_) => Ok(()),
        }
    }

    fn is_there(&self, caller: &Caller) -> bool {
        match caller {
            Caller::Zenoh(id) => Self::is_there(self, id),
            Caller::Dds(_) => false,
        }
    }

    fn matched(&self) -> &Matched {
        Self::matched(self)
    }
}
