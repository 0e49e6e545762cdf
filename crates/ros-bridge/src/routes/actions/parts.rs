//! The three services of an action, and one client or server for each.

use super::frame::Part;
use crate::{
    error::Result,
    graph::{
        dds::{Exchange, Matched},
        local::{Client, Reply, Request, Server},
        names::{TopicName, TypeName},
    },
};

/// A client or a server for each of the three services.
pub(super) struct Parts<T> {
    goals: T,
    cancels: T,
    results: T,
}

/// An end of a service that receives messages.
pub(super) trait Receive: Send {
    /// A request or a reply.
    type Message: Send;

    /// The next message. None if the middleware ended. Cancelling it loses nothing.
    fn receive(&mut self) -> impl Future<Output = Option<Self::Message>> + Send;

    /// The ends of others.
    fn matched(&self) -> &Matched;
}

impl Receive for Box<dyn Client + '_> {
    type Message = Reply;

    async fn receive(&mut self) -> Option<Reply> {
        self.as_mut().next().await
    }

    fn matched(&self) -> &Matched {
        self.as_ref().matched()
    }
}

impl Receive for Box<dyn Server + '_> {
    type Message = Request;

    async fn receive(&mut self) -> Option<Request> {
        self.as_mut().next().await
    }

    fn matched(&self) -> &Matched {
        self.as_ref().matched()
    }
}

impl<T: Receive> Parts<T> {
    /// Opens all three for an action of that type.
    ///
    /// # Errors
    /// Those of `open`; the name of the action is too long.
    pub(super) fn open(action: &TopicName, of: &TypeName, open: impl Fn(Exchange) -> Result<T>) -> Result<Self> {
        Ok(Self {
            goals: open(Exchange::of_goals(action, of)?)?,
            cancels: open(Exchange::of_cancels(action)?)?,
            results: open(Exchange::of_results(action, of)?)?,
        })
    }

    /// The next message, and for which part it is. None if the middleware ended. Cancelling it loses nothing.
    pub(super) async fn next(&mut self) -> Option<(Part, T::Message)> {
        let Self { goals, cancels, results } = self;
        let (part, message) = tokio::select! {
            message = goals.receive() => (Part::Goal, message),
            message = cancels.receive() => (Part::Cancel, message),
            message = results.receive() => (Part::Result, message),
        };
        message.map(|message| (part, message))
    }

    /// The one of a part.
    pub(super) fn of(&mut self, part: Part) -> &mut T {
        match part {
            Part::Goal => &mut self.goals,
            Part::Cancel | Part::Alive => &mut self.cancels,
            Part::Result => &mut self.results,
        }
    }

    /// The one for goals.
    pub(super) fn goals(&self) -> &T {
        &self.goals
    }

    /// The ends of others for goals.
    pub(super) fn matched(&self) -> &Matched {
        self.goals.matched()
    }
}
