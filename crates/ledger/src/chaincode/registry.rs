//! The chaincodes that a node has installed.

use super::Chaincode;
use crate::rules::Rules;
use ledger_base::rejection::{Code, Rejection};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The chaincodes that a node has installed, by name, and the rules that it executes them by. Every node of a network needs
/// the same chaincodes.
#[derive(Clone)]
pub struct Registry {
    chaincodes: BTreeMap<&'static str, Arc<dyn Chaincode>>,
    newest: Rules,
}

impl Default for Registry {
    fn default() -> Self {
        Self { chaincodes: BTreeMap::new(), newest: Rules::NEWEST }
    }
}

impl Registry {
    /// Nothing installed.
    pub fn new() -> Self {
        Self::default()
    }

    /// Speaks no newer rules than these: the node is as one of another release.
    pub fn speak_up_to(&mut self, newest: Rules) {
        self.newest = newest;
    }

    /// The newest rules that the node speaks.
    pub fn newest(&self) -> Rules {
        self.newest
    }

    /// The rules of a number, if the node speaks them.
    pub(crate) fn speaks(&self, number: u32) -> Option<Rules> {
        self.newest.find_up_to(number)
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
            return Err(Rejection::new(Code::BadName, "the chaincode cannot be installed")
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
                .next("call one of these; `ledgerctl query --help` has examples")
        })
    }

    /// The chaincodes that may emit an event of one of these names: of this chaincode or, if it is empty, of all. No
    /// names stand for any.
    ///
    /// # Errors
    /// [`Code::UnknownChaincode`]; [`Code::BadArgument`] with the names that exist.
    pub(crate) fn emitting(&self, chaincode: &str, names: &[String]) -> Result<Vec<&dyn Chaincode>, Rejection> {
        let asked: Vec<&dyn Chaincode> = match chaincode {
            "" => self.iter().collect(),
            name => vec![self.find(name)?],
        };
        let may_emit = |chaincode: &dyn Chaincode, name: &str| {
            let events = chaincode.events();
            events.is_empty() || events.contains(&name)
        };
        if let Some(name) = names.iter().find(|name| !asked.iter().any(|chaincode| may_emit(*chaincode, name))) {
            let known: Vec<_> = asked.iter().flat_map(|chaincode| chaincode.events().iter().copied()).collect();
            return Err(Rejection::new(Code::BadArgument, format!("there are no events {name:?}"))
                .found(format!("{name:?}"))
                .wanted(format!("some of {}", known.join(", ")))
                .next("subscribe to one of these, or to all by naming none"));
        }
        let of_concern =
            |chaincode: &&dyn Chaincode| names.is_empty() || names.iter().any(|name| may_emit(*chaincode, name));
        Ok(asked.into_iter().filter(of_concern).collect())
    }

    /// Is this key of the world state control state?
    pub(crate) fn is_control(&self, key: &[u8]) -> bool {
        let Some(end) = key.iter().position(|byte| *byte == 0) else { return false };
        let Some((name, key)) = key.split_at_checked(end) else { return false };
        let chaincode = std::str::from_utf8(name).ok().and_then(|name| self.chaincodes.get(name));
        let key = key.get(1..).unwrap_or_default();
        chaincode.is_some_and(|found| found.control_keys().iter().any(|prefix| key.starts_with(prefix.as_bytes())))
    }

    /// The beginnings of all keys of control state, as the world state knows them.
    pub(crate) fn control_keys(&self) -> impl Iterator<Item = Vec<u8>> {
        self.iter().flat_map(|chaincode| {
            let full = |prefix: &&str| [chaincode.name(), "\0", *prefix].concat().into_bytes();
            chaincode.control_keys().iter().map(full).collect::<Vec<_>>()
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
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::super::Context;
    use super::*;
    use bytes::Bytes;

    struct Emitter(&'static str, &'static [&'static str]);

    impl Chaincode for Emitter {
        fn name(&self) -> &'static str {
            self.0
        }

        fn invoke(&self, _: &mut Context<'_>, _: &str, _: &[Bytes]) -> Result<Bytes, Rejection> {
            Ok(Bytes::new())
        }

        fn events(&self) -> &'static [&'static str] {
            self.1
        }
    }

    #[test]
    fn a_name_that_no_event_has_is_refused_unless_somebody_does_not_say() {
        let mut registry = Registry::new();
        registry.install(Arc::new(Emitter("a", &["granted", "message"]))).unwrap();
        registry.install(Arc::new(Emitter("b", &["moved"]))).unwrap();
        let emitting = |registry: &Registry, chaincode: &str, names: &[&str]| {
            let names: Vec<_> = names.iter().map(|name| (*name).to_owned()).collect();
            let found = registry.emitting(chaincode, &names)?;
            Ok::<_, Rejection>(found.iter().map(|chaincode| chaincode.name()).collect::<Vec<_>>())
        };
        assert_eq!(emitting(&registry, "", &[]).unwrap(), ["a", "b"]);
        assert_eq!(emitting(&registry, "", &["message", "moved"]).unwrap(), ["a", "b"]);
        assert_eq!(emitting(&registry, "", &["moved"]).unwrap(), ["b"]);
        assert_eq!(emitting(&registry, "c", &[]).unwrap_err().code, Code::UnknownChaincode);
        for (chaincode, names) in [("a", &["mesage"][..]), ("a", &["message", "moved"]), ("", &["mesage"])] {
            let refused = emitting(&registry, chaincode, names).unwrap_err();
            assert!(refused.code == Code::BadArgument && refused.wanted.contains("message"), "{refused}");
        }
        registry.install(Arc::new(Emitter("c", &[]))).unwrap();
        assert_eq!(emitting(&registry, "", &["mesage"]).unwrap(), ["c"]);
        assert_eq!(emitting(&registry, "a", &["mesage"]).unwrap_err().code, Code::BadArgument);
    }
}
