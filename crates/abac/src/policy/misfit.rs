//! A fault of a policy that Cedar accepts, with its place.

/// The fault, and what it quotes of the text.
pub(super) struct Misfit {
    pub(super) message: String,
    /// The text of the policy.
    pub(super) policy: String,
    /// The part of it that is at fault, as it is written.
    pub(super) quoted: String,
}

impl Misfit {
    /// Offset and length of the part in the whole text, in bytes.
    pub(super) fn place(&self, text: &str) -> Option<(usize, usize)> {
        let start = text.find(&self.policy)?;
        Some((start + self.policy.rfind(&self.quoted)?, self.quoted.len()))
    }
}
