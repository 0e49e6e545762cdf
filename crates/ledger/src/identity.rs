//! Identities (stub until merge).
use crate::key::PublicKey;
use std::collections::BTreeMap;
/// Role.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// m
    Member,
    /// a
    Admin,
    /// n
    Node,
    /// r
    Robot,
}
/// An identity.
#[derive(Clone, Debug)]
pub struct Identity {
    /// o
    pub organisation: String,
    /// n
    pub name: String,
    /// r
    pub role: Role,
    /// a
    pub attributes: BTreeMap<String, String>,
    /// i
    pub issuer: [u8; 32],
    /// s
    pub serial: Vec<u8>,
    /// f
    pub fingerprint: [u8; 32],
    /// k
    pub public_key: PublicKey,
    /// nb
    pub not_before: u64,
    /// na
    pub not_after: u64,
}
impl Identity {
    /// Org1/Salma
    pub fn id(&self) -> String {
        format!("{}/{}", self.organisation, self.name)
    }
}
