//! Robots with their services, and the places of those who read them.

use super::Model;
use ledger_base::rejection::Code;
use serde::Deserialize;
use serde_json::{Map, Value};

/// The end of the id of the places of a service's readers.
const READERS: &str = ":subscribe";

/// A robot as it was registered.
#[derive(Clone, PartialEq, Deserialize)]
pub(in crate::oracle) struct Robot {
    #[serde(skip)]
    pub(super) owner: String,
    pub(super) name: String,
    pub(super) attribute_required: String,
    pub(super) trusted: Vec<String>,
    pub(super) services: Vec<Service>,
}

/// A service as it was registered, or the places of its readers.
#[derive(Clone, PartialEq, Deserialize)]
pub(in crate::oracle) struct Service {
    pub(super) topic: String,
    pub(super) mode: String,
    pub(super) lease_ms: u64,
    pub(super) lease_ms_max: u64,
    #[serde(default)]
    pub(super) sharing: Map<String, Value>,
    /// One reads from these places, and does nothing else.
    #[serde(skip)]
    pub(super) reads: bool,
}

impl Robot {
    pub(super) fn read(json: &[u8], owner: &str) -> Result<Self, Code> {
        let robot: Self = serde_json::from_slice(json).map_err(|_| Code::BadArgument)?;
        Ok(Self { owner: owner.to_owned(), ..robot })
    }

    /// The ids of all that can be had of it, also of places that it does not have now.
    pub(super) fn ids(&self) -> Vec<String> {
        let id = |service: &Service| format!("{}{}", self.name, service.topic);
        self.services.iter().flat_map(|service| [id(service), id(service) + READERS]).collect()
    }
}

impl Service {
    pub(super) fn setting(&self, key: &str) -> Option<u64> {
        self.sharing.get(key).and_then(Value::as_u64)
    }

    /// The places of its readers, if they are limited: as many as the owner says, and all else like the service.
    pub(super) fn places_to_read(&self) -> Option<Self> {
        let places = self.sharing.get("subscribers")?.clone();
        let mut service = Self { reads: true, ..self.clone() };
        service.sharing.remove("subscribers");
        service.sharing.insert("publishers".to_owned(), places);
        Some(service)
    }

    /// May everybody hold it, and publish without holding it?
    pub(super) fn is_open(&self) -> bool {
        self.mode == "open" || self.mode == "limited" && self.setting("publishers").is_none()
    }

    /// How many hold it at once.
    pub(super) fn places(&self) -> usize {
        match &*self.mode {
            "limited" => self.setting("publishers").map_or(usize::MAX, |places| places as usize),
            "open" => usize::MAX,
            _ => 1,
        }
    }
}

impl Model {
    /// Is there such a service, or such places?
    pub(in crate::oracle) fn find(&self, id: &str) -> Result<(Robot, Service), Code> {
        let (name, topic) = id.split_at(id.find('/').unwrap_or(id.len()));
        let robot = self.robots.get(name).ok_or(Code::UnknownRobot)?;
        let of_readers = topic.strip_suffix(READERS);
        let topic = of_readers.unwrap_or(topic);
        let service = robot.services.iter().find(|service| service.topic == topic).ok_or(Code::UnknownService)?;
        let service = if of_readers.is_some() { service.places_to_read() } else { Some(service.clone()) };
        Ok((robot.clone(), service.ok_or(Code::UnknownService)?))
    }
}
