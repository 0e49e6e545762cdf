//! Keys (stub until merge).
/// Public key.
#[derive(Clone, Debug)]
pub struct PublicKey;
