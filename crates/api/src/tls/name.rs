//! The name that a client sends in a handshake: it says which network the client wants.
//!
//! A process may serve several networks behind one address, each with its own certificate. The server reads the name of
//! a network in the first message of TLS, before it shows a certificate. A server of one network needs no name.
//!
//! | client | name (server name indication) |
//! |---|---|
//! | knows its network | the hash of the genesis, in hexadecimal, as two labels of 32 digits, then `.ledgerd.internal` |
//! | first contact | `node.ledgerd.internal` |

use ledger_base::hash::Hash;
use rustls::pki_types::{InvalidDnsNameError, ServerName};

/// The end of every name.
const SUFFIX: &str = ".ledgerd.internal";
/// The name of a client that knows no network yet.
const FIRST_CONTACT: &str = "node.ledgerd.internal";
/// Digits of one label; a label of a host name has at most 63 characters.
const LABEL_DIGITS: usize = 32;

/// The name that a client of this network sends, or one that knows none yet.
///
/// # Errors
/// Never: both names are host names.
pub fn server_name(network: Option<&Hash>) -> Result<ServerName<'static>, InvalidDnsNameError> {
    let Some(network) = network else { return ServerName::try_from(FIRST_CONTACT) };
    let digits = network.to_string();
    let (first, second) = digits.split_at(LABEL_DIGITS);
    ServerName::try_from(format!("{first}.{second}{SUFFIX}"))
}

/// The network that a client names, if it names one.
pub fn named_network(name: &str) -> Option<Hash> {
    let digits = name.strip_suffix(SUFFIX)?;
    let (first, second) = digits.split_once('.')?;
    let whole = first.len() == LABEL_DIGITS && second.len() == LABEL_DIGITS;
    Hash::from_hex(&format!("{first}{second}")).filter(|_| whole)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn the_name_of_a_client_says_its_network() {
        let network = Hash::of(&[b"network"]);
        let name = server_name(Some(&network)).unwrap();
        assert_eq!(named_network(&name.to_str()), Some(network));
    }

    #[test]
    fn a_first_contact_and_other_names_say_no_network() {
        let first = server_name(None).unwrap();
        let digits = Hash::of(&[b"network"]).to_string();
        for name in [&*first.to_str(), "any.host", ".ledgerd.internal", &format!("{digits}.ledgerd.internal")] {
            assert_eq!(named_network(name), None, "{name}");
        }
    }
}
