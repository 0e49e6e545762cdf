//! The confidential service: the robot that offers it, the pairs with which people read, and the messages that must stay secret.

use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_confidential::ReadingKey;
use ledger_confidential::rand_core::{Infallible, TryCryptoRng, TryRng};
use std::collections::BTreeMap;
use testkit::Random;

/// The robot. Org2 owns it, as the others.
pub const ROBOT: &str = "Courier";
/// Its one service.
pub const SERVICE: &str = "Courier/cmd_vel";
/// So many pairs each reader has: the first one, and others that it makes after it has lost one.
pub const PAIRS: usize = 3;
/// Begins every message that must stay secret, behind the header of CDR. No identity, policy or other message says this.
pub const SECRET: &[u8] = b"between us";
/// The header of CDR.
const CDR: &[u8] = &[0, 1, 0, 0];

/// A description of the robot that its owner wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Terms {
    /// Are the messages of its service encrypted?
    pub confidential: bool,
    /// The longest lease, milliseconds: tells one description from another.
    pub lease_ms_max: u64,
    /// Do the attributes of Org1 count?
    pub trusts_all: bool,
}

impl Terms {
    /// The description with which everything works.
    pub const PLAIN: Self = Self { confidential: true, lease_ms_max: 20_000, trusts_all: true };

    /// The argument of `replace`.
    pub fn json(self) -> String {
        let Self { confidential, lease_ms_max, trusts_all } = self;
        let trusted = if trusts_all { r#"["Org1","Org2"]"# } else { r#"["Org2"]"# };
        let sharing = if confidential { r#","sharing":{"confidential":true}"# } else { "" };
        format!(
            r#"{{"name":"{ROBOT}","attribute_required":"Turtlebot4","trusted":{trusted},"services":[{{"topic":"/cmd_vel","type":"geometry_msgs/msg/Twist","mode":"exclusive","lease_ms":3000,"lease_ms_max":{lease_ms_max}{sharing}}}]}}"#
        )
    }
}

/// One of the pairs of a reader; the same in every run.
pub fn pair(reader: &str, nth: usize) -> ReadingKey {
    let secret = Hash::of(&[b"simulated reading key", reader.as_bytes(), &nth.to_be_bytes()]);
    ReadingKey::from_secret(&secret.0).unwrap()
}

/// A message that must stay secret. No two are alike.
pub fn secret(number: u64) -> Bytes {
    [CDR, SECRET, &number.to_be_bytes()].concat().into()
}

/// Does somebody see a secret who sees these bytes?
pub fn shows_a_secret(bytes: &[u8]) -> bool {
    bytes.windows(SECRET.len()).any(|window| window == SECRET)
}

/// The messages that honest publishers have sealed, by their envelopes.
pub type Sealed = BTreeMap<Bytes, Bytes>;

/// Random bytes for keys and nonces that are the same again from the same seed.
pub struct Chance<'a>(pub &'a mut Random);

impl TryRng for Chance<'_> {
    type Error = Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Infallible> {
        Ok(self.0.below(1 << 32) as u32)
    }

    fn try_next_u64(&mut self) -> Result<u64, Infallible> {
        Ok(self.0.number())
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Infallible> {
        for part in bytes.chunks_mut(8) {
            part.copy_from_slice(&self.0.number().to_be_bytes()[..part.len()]);
        }
        Ok(())
    }
}

impl TryCryptoRng for Chance<'_> {}
