//! The organisational units that name roles in the certificates of an organisation with words of its own.
//!
//! Our CAs write the role itself as a unit ([`Role::from_unit`]). The CA of another software, such as Fabric's, may use
//! other words, and another meaning of ours. So an organisation can say which unit stands for which role; then no other
//! word counts. As in Fabric (NodeOUs), a certificate has to have exactly one of the roles.

use crate::identity::{IdentityError, Role, at_most, malformed};
use ledger_base::hash::Hash;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Most units that an organisation can declare.
pub const UNITS_MAX: usize = 8;

/// Longest name of a unit, in bytes: the limit of X.520.
pub const UNIT_BYTES_MAX: usize = 64;

/// A unit that stands for a role.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Unit {
    /// The value of OU, exactly.
    pub unit: String,
    /// The role that it names.
    pub role: Role,
    /// SHA-256 of the authority's certificate: only what that authority itself has issued has this unit. None: any
    /// authority of the organisation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub issuer: Option<Hash>,
}

/// The units of an organisation. Without any, everybody is a member.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Units(Vec<Unit>);

impl Units {
    /// These units, and no other word.
    ///
    /// # Errors
    /// [`IdentityError::TooLarge`], [`IdentityError::Malformed`] for an empty or long one.
    pub fn new(units: Vec<Unit>) -> Result<Self, IdentityError> {
        let units = Self(units);
        units.check()?;
        Ok(units)
    }

    /// Checks units that were read.
    pub(crate) fn check(&self) -> Result<(), IdentityError> {
        at_most("organisational units", self.0.len(), UNITS_MAX)?;
        match self.0.iter().find(|unit| unit.unit.is_empty() || unit.unit.len() > UNIT_BYTES_MAX) {
            None => Ok(()),
            Some(odd) => {
                let found = format!("an organisational unit of {} bytes", odd.unit.len());
                Err(malformed(found, "units of 1 to 64 bytes"))
            }
        }
    }

    /// The units.
    pub fn iter(&self) -> impl Iterator<Item = &Unit> {
        self.0.iter()
    }

    /// Can somebody have this role?
    pub fn have(&self, role: Role) -> bool {
        self.0.iter().any(|unit| unit.role == role)
    }

    /// The role that these values of OU name in a certificate that this authority has issued.
    pub(crate) fn role(&self, values: &[String], issuer: &Hash) -> Result<Role, IdentityError> {
        if self.0.is_empty() {
            return Ok(Role::Member);
        }
        let counts =
            |unit: &&Unit| values.contains(&unit.unit) && unit.issuer.as_ref().is_none_or(|wanted| wanted == issuer);
        let roles: BTreeSet<Role> = self.0.iter().filter(counts).map(|unit| unit.role).collect();
        let mut roles = roles.into_iter();
        match (roles.next(), roles.next()) {
            (Some(role), None) => Ok(role),
            (Some(one), Some(other)) => {
                Err(malformed(format!("the roles {one} and {other}"), "one role in the subject's OU"))
            }
            (None, _) => {
                let shown: Vec<String> = values.iter().map(|value| format!("{value:?}")).collect();
                Err(malformed(
                    format!("no role in the units {}", shown.join(", ")),
                    "an OU that the organisation has declared for a role, issued by the authority it names",
                ))
            }
        }
    }
}

const _: () = assert!(UNIT_BYTES_MAX == 64, "the message of check states the limit");
