//! The chaincodes that a node has installed.

use super::context::{Context, Environment, run};
use super::overlay::Overlay;
use super::{Chaincode, Event, Foretold};
use crate::code::Code;
use crate::rejection::Rejection;
use bytes::Bytes;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

/// The chaincodes that a node has installed, by name. Every node of a network needs the same ones.
#[derive(Clone, Default)]
pub struct Registry {
    chaincodes: BTreeMap<&'static str, Arc<dyn Chaincode>>,
}

impl Registry {
    /// Nothing installed.
    pub fn new() -> Self {
        Self::default()
    }

    /// Installs a chaincode.
    ///
    /// # Errors
    /// [`Code::AlreadyExists`] if the name is taken, [`Code::BadName`] if it is not made of lower-case letters,
    /// digits and `-`.
    pub fn install(&mut self, chaincode: Arc<dyn Chaincode>) -> Result<(), Rejection> {
        let name = chaincode.name();
        if name.is_empty()
            || name.len() > 64
            || !name.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-')
        {
            return Err(Rejection::new(Code::BadName, "chaincode cannot be installed")
                .found(format!("name {name:?}"))
                .wanted("1 to 64 lower-case letters, digits and \"-\""));
        }
        if self.chaincodes.contains_key(name) {
            return Err(Rejection::new(Code::AlreadyExists, format!("a chaincode {name:?} is already installed")));
        }
        self.chaincodes.insert(name, chaincode);
        Ok(())
    }

    /// The chaincode of that name.
    ///
    /// # Errors
    /// [`Code::UnknownChaincode`] with the names that exist.
    pub fn find(&self, name: &str) -> Result<&dyn Chaincode, Rejection> {
        self.chaincodes.get(name).map(AsRef::as_ref).ok_or_else(|| {
            Rejection::new(Code::UnknownChaincode, format!("no chaincode {name:?} is installed"))
                .found(name.to_owned())
                .wanted(format!("one of {}", self.names().join(", ")))
        })
    }

    /// All installed chaincodes in order of their names.
    pub fn iter(&self) -> impl Iterator<Item = &dyn Chaincode> {
        self.chaincodes.values().map(AsRef::as_ref)
    }

    /// The names in order.
    pub fn names(&self) -> Vec<&'static str> {
        self.chaincodes.keys().copied().collect()
    }

    /// Executes one call: its writes are in the overlay and its events in `events` only if it succeeds.
    ///
    /// # Errors
    /// The rejection of the chaincode, or [`Code::UnknownChaincode`].
    pub fn invoke(
        environment: Environment<'_>,
        overlay: &mut Overlay,
        events: &mut Vec<Event>,
        chaincode: &str,
        function: &str,
        args: &[Bytes],
    ) -> Result<Bytes, Rejection> {
        let callee = environment.registry.find(chaincode)?;
        run(environment, callee.name(), 0, overlay, events, |ctx| callee.invoke(ctx, function, args))
    }

    /// What a successful call answers and emits, if the call alone tells ([`Chaincode::foretell`]).
    pub(crate) fn foretell(&self, chaincode: &str, function: &str, args: &[Bytes]) -> Option<Foretold> {
        let callee = self.chaincodes.get(chaincode)?;
        catch_unwind(AssertUnwindSafe(|| callee.foretell(function, args))).ok().flatten()
    }

    /// Runs a hook of one chaincode; a hook that panics leaves nothing behind.
    pub(crate) fn hook(
        environment: Environment<'_>,
        chaincode: &dyn Chaincode,
        overlay: &mut Overlay,
        events: &mut Vec<Event>,
        body: impl FnOnce(&mut Context<'_>),
    ) -> Result<(), Rejection> {
        run(environment, chaincode.name(), 0, overlay, events, |ctx| {
            body(ctx);
            Ok(Bytes::new())
        })
        .map(drop)
    }
}
