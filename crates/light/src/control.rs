//! The two chains over control state: hashes over every write since the genesis. The *governing* chain covers the control
//! state of the chaincode `msp`, the *control* chain that of all others.
//!
//! A reader that follows the writes from its pinned beginning computes the same chain. A certified value of the chain then
//! shows that no write was left out, and none made up. It needs the value of no write: the hash of a value is enough.

use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};

const DOMAIN: &[u8] = b"ledgerd control v1\0";

/// A write of control state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Write<'a> {
    /// The key, with its chaincode.
    pub key: &'a [u8],
    /// Hash of the value; none if the key was deleted.
    pub value: Option<Hash>,
}

/// The chain after a block of that height with these writes. A block without any leaves the chain as it is.
///
/// # Errors
/// [`Code::Malformed`] if the writes are not in ascending order of keys, each key once: they are of no block then.
pub fn extend(previous: Hash, height: u64, writes: &[Write<'_>]) -> Result<Hash, Rejection> {
    if writes.is_empty() {
        return Ok(previous);
    }
    if !writes.is_sorted_by(|one, next| one.key < next.key) {
        return Err(Rejection::new(Code::Malformed, "the control writes of a block are not in order")
            .found(format!("{} writes of block {height}", writes.len()))
            .wanted("ascending keys, each of them once")
            .next("ask another node for them"));
    }
    let mut bytes = Vec::with_capacity(DOMAIN.len() + 48 + writes.len() * 80);
    bytes.extend_from_slice(DOMAIN);
    bytes.extend_from_slice(&previous.0);
    bytes.extend_from_slice(&height.to_be_bytes());
    bytes.extend_from_slice(&(writes.len() as u32).to_be_bytes());
    for Write { key, value } in writes {
        crate::codec::put(&mut bytes, key);
        bytes.push(u8::from(value.is_some()));
        bytes.extend_from_slice(value.as_ref().map(Hash::as_ref).unwrap_or_default());
    }
    Ok(Hash::of(&[&bytes]))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn write(key: &str, value: Option<u8>) -> Write<'_> {
        Write { key: key.as_bytes(), value: value.map(|value| Hash([value; 32])) }
    }

    #[test]
    fn the_chain_tells_of_each_write_its_value_its_height_and_all_before() {
        let writes = [write("a", Some(1)), write("b", None)];
        let chain = extend(Hash::ZERO, 7, &writes).unwrap();
        let others = [
            extend(Hash([1; 32]), 7, &writes),
            extend(Hash::ZERO, 8, &writes),
            extend(Hash::ZERO, 7, &[writes[0]]),
            extend(Hash::ZERO, 7, &[write("a", Some(2)), write("b", None)]),
            extend(Hash::ZERO, 7, &[write("a", Some(1)), write("b", Some(0))]),
            extend(Hash::ZERO, 7, &[write("a", Some(1)), write("c", None)]),
            extend(Hash::ZERO, 7, &[]),
        ];
        for other in others {
            assert_ne!(other.unwrap(), chain);
        }
        assert_eq!(extend(chain, 8, &[]).unwrap(), chain);
    }

    #[test]
    fn writes_of_a_block_are_ordered_and_each_key_stands_once() {
        for wrong in [[write("b", None), write("a", None)], [write("a", None), write("a", Some(1))]] {
            assert_eq!(extend(Hash::ZERO, 1, &wrong).unwrap_err().code, Code::Malformed);
        }
    }
}
