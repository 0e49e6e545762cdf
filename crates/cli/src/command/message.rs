//! `publish`, `echo`: the messages of a service.

mod echo;
mod publish;

pub(crate) use echo::Echo;
pub(crate) use publish::Publish;
