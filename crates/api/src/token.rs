//! The join token: all that a new node needs to know, as one word to copy.

use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Largest token that is read, in characters.
pub const TOKEN_CHARS_MAX: usize = 4096;
/// Most addresses in a token.
pub const ADDRESSES_MAX: usize = 16;
/// Every token begins with this, so that people see what it is, and other formats can follow.
const PREFIX: &str = "ledgerd1-";

/// An invitation into a network, for `ledgerd join`. Prints as one word, and is read from it again.
///
/// Its bearer can join in the place of the intended newcomer: it holds a secret, is good once, and expires.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JoinToken {
    /// Name of the network: SHA-256 of its genesis.
    pub network: Hash,
    /// `HOST:PORT` of nodes that let the new one in, in the order to try them.
    pub addresses: Vec<String>,
    /// SHA-256 of the CA certificate of the organisation that runs these nodes.
    pub ca: Hash,
    /// The organisation of the new node.
    pub organisation: String,
    /// Name of the new node.
    pub node: String,
    /// The newcomer.
    pub kind: JoinKind,
    /// Of a node: its one-time secret for enrolment. Of an organisation: the seed of the invitation's Ed25519 key, 64
    /// hex digits.
    pub secret: String,
}

/// The newcomer that a token admits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JoinKind {
    /// Another node of an organisation of the network.
    Node,
    /// A new organisation with its first node.
    Organisation,
}

impl fmt::Display for JoinToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let content = serde_json::to_vec(self).map_err(|_| fmt::Error)?;
        write!(f, "{PREFIX}{}", URL_SAFE_NO_PAD.encode(content))
    }
}

impl fmt::Debug for JoinToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { network, addresses, ca, organisation, node, kind, secret: _ } = self;
        write!(f, "JoinToken({kind:?} {organisation}/{node}, network {network}, at {addresses:?} with CA {ca})")
    }
}

impl FromStr for JoinToken {
    type Err = Rejection;

    /// Reads a token as it was copied, spaces and line breaks around or inside it forgiven.
    fn from_str(text: &str) -> Result<Self, Rejection> {
        let unusable = |found: String| {
            Rejection::new(Code::BadArgument, "this is not a join token")
                .found(found)
                .wanted("the complete token that ledgerctl network invite printed")
                .next("copy it again, or ask an admin of the network for a new one")
        };
        if text.len() > TOKEN_CHARS_MAX {
            return Err(unusable(format!("{} characters, more than {TOKEN_CHARS_MAX}", text.len())));
        }
        let text: String = text.split_whitespace().collect();
        let content =
            text.strip_prefix(PREFIX).ok_or_else(|| unusable(format!("a word that does not start with {PREFIX}")))?;
        let content = URL_SAFE_NO_PAD.decode(content).map_err(|error| unusable(format!("a damaged token: {error}")))?;
        let token: Self =
            serde_json::from_slice(&content).map_err(|error| unusable(format!("a damaged token: {error}")))?;
        if token.addresses.is_empty() || token.addresses.len() > ADDRESSES_MAX {
            return Err(unusable(format!("{} addresses, wanted 1 to {ADDRESSES_MAX}", token.addresses.len())));
        }
        Ok(token)
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;

    fn token() -> JoinToken {
        JoinToken {
            network: Hash([1; 32]),
            addresses: vec!["10.0.0.4:7450".into(), "[::1]:7450".into()],
            ca: Hash([2; 32]),
            organisation: "Org2".into(),
            node: "node2".into(),
            kind: JoinKind::Organisation,
            secret: "00".repeat(32),
        }
    }

    #[test]
    fn a_token_is_one_word_of_a_shell_that_reads_back() {
        let text = token().to_string();
        assert!(text.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_'), "{text}");
        assert_eq!(text.parse::<JoinToken>().unwrap(), token());
        let (first, rest) = text.split_at(40);
        assert_eq!(format!(" {first}\n  {rest}\n").parse::<JoinToken>().unwrap(), token());
    }

    #[test]
    fn a_damaged_token_says_what_to_do() {
        let text = token().to_string();
        let mut nowhere = token();
        nowhere.addresses.clear();
        let wrong = [
            String::new(),
            "Org2".into(),
            text[..text.len() - 5].into(),
            text.replace("ledgerd1", "ledgerd2"),
            nowhere.to_string(),
            "x".repeat(1 << 20),
        ];
        for wrong in wrong {
            let refused = wrong.parse::<JoinToken>().unwrap_err();
            assert_eq!(refused.code, Code::BadArgument);
            assert!(refused.advice().contains("ask an admin"), "{refused}");
        }
    }

    #[test]
    fn the_secret_is_not_shown() {
        assert!(!format!("{:?}", token()).contains(&token().secret));
    }
}
