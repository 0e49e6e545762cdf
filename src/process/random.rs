//! Randomness of the operating system.

use ledger_base::rejection::{Code, Rejection};
use ring::rand::{SecureRandom, SystemRandom};

/// A random number.
///
/// # Errors
/// [`Code::Internal`] if the operating system gives none.
pub(crate) fn number() -> Result<u64, Rejection> {
    let mut bytes = [0; 8];
    SystemRandom::new()
        .fill(&mut bytes)
        .map_err(|_| Rejection::new(Code::Internal, "the operating system provides no randomness"))?;
    Ok(u64::from_be_bytes(bytes))
}
