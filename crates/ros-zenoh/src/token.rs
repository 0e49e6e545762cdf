//! Liveliness tokens: one for each node, publisher, subscriber, server and client.
//!
//! ```text
//! @ros2_lv/domain/session/node id/entity id/kind/enclave/namespace/node
//! @ros2_lv/domain/session/node id/entity id/kind/enclave/namespace/node/name/type/hash/qos
//! ```
//! Slashes within a name are written `%`, and so is an empty name.

use std::fmt;

use crate::{
    key::{NO_HASH, Subject},
    limits::TOKEN_BYTES_MAX,
    qos::TokenQos,
};

/// The key space of tokens.
const SPACE: &str = "@ros2_lv";

/// The key expression of all tokens of a domain.
pub fn all_of(domain: u16) -> String {
    format!("{SPACE}/{domain}/**")
}

/// The kinds of endpoints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Kind {
    /// It publishes messages.
    Publisher,
    /// It subscribes to messages.
    Subscriber,
    /// It serves requests.
    Server,
    /// It calls a server.
    Client,
}

impl Kind {
    const ALL: [Self; 4] = [Self::Publisher, Self::Subscriber, Self::Server, Self::Client];

    const fn code(self) -> &'static str {
        match self {
            Self::Publisher => "MP",
            Self::Subscriber => "MS",
            Self::Server => "SS",
            Self::Client => "SC",
        }
    }
}

/// The node of a token.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct NodeIdentity {
    /// The ROS domain.
    pub domain: u16,
    /// The zenoh session, in hexadecimal digits.
    pub session: String,
    /// The number of the node in its session.
    pub number: u64,
    /// Its namespace, `/` or `/robot1`.
    pub namespace: String,
    /// Its name.
    pub name: String,
}

impl NodeIdentity {
    /// The token of the node itself.
    pub fn token(&self) -> String {
        let Self { number, .. } = self;
        self.of(*number, "NN")
    }

    /// The name with the namespace, `/robot1/camera`.
    pub fn full_name(&self) -> String {
        format!("{}/{}", self.namespace.trim_end_matches('/'), self.name)
    }

    fn of(&self, entity: u64, kind: &str) -> String {
        let Self { domain, session, number, namespace, name } = self;
        format!("{SPACE}/{domain}/{session}/{number}/{entity}/{kind}/%/{}/{}", mangle(namespace), mangle(name))
    }
}

/// An endpoint as its token names it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Token {
    /// Its node.
    pub node: NodeIdentity,
    /// Its number in the session.
    pub number: u64,
    /// Its kind.
    pub kind: Kind,
    /// Its topic or service.
    pub subject: Subject,
    /// The quality of service that it offers or requests.
    pub qos: TokenQos,
}

impl fmt::Display for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { node, number, kind, subject: Subject { name, type_name, hash }, qos } = self;
        let hash = hash.as_deref().unwrap_or(NO_HASH);
        write!(f, "{}/{}/{type_name}/{hash}/{qos}", node.of(*number, kind.code()), mangle(name))
    }
}

impl Token {
    /// Reads a token. None if it is malformed, too long, or that of a node.
    pub fn parse(key: &str) -> Option<Self> {
        if key.len() > TOKEN_BYTES_MAX {
            return None;
        }
        let mut parts = key.strip_prefix(SPACE)?.strip_prefix('/')?.split('/');
        let mut part = || parts.next().filter(|part| !part.is_empty());
        let (domain, session) = (part()?.parse().ok()?, part()?.to_owned());
        let (node_number, number) = (part()?.parse().ok()?, part()?.parse().ok()?);
        let code = part()?;
        let kind = Kind::ALL.into_iter().find(|kind| kind.code() == code)?;
        let _enclave = part()?;
        let (namespace, node_name) = (demangle(part()?), demangle(part()?));
        let (name, type_name, hash, qos) = (demangle(part()?), part()?.to_owned(), part()?, part()?);
        let node = NodeIdentity { domain, session, number: node_number, namespace, name: node_name };
        let hash = (hash != NO_HASH).then(|| hash.to_owned());
        Some(Self { node, number, kind, subject: Subject { name, type_name, hash }, qos: TokenQos::parse(qos)? })
    }
}

fn mangle(name: &str) -> String {
    if name.is_empty() { "%".to_owned() } else { name.replace('/', "%") }
}

fn demangle(name: &str) -> String {
    name.replace('%', "/")
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HASH: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

    fn listener() -> Token {
        let node = NodeIdentity {
            domain: 0,
            session: "aac3178e146ba6f1fc6e6a4085e77f21".to_owned(),
            number: 0,
            namespace: "/".to_owned(),
            name: "listener".to_owned(),
        };
        let (name, type_name) = ("/chatter".to_owned(), "std_msgs::msg::dds_::String_".to_owned());
        let subject = Subject { name, type_name, hash: Some(HASH.to_owned()) };
        Token { node, number: 10, kind: Kind::Subscriber, subject, qos: TokenQos::default() }
    }

    #[test]
    fn the_tokens_are_those_of_rmw_zenoh() {
        let token = listener();
        assert_eq!(token.node.token(), "@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener");
        let key = format!(
            "@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MS/%/%/listener/%chatter/std_msgs::msg::dds_::String_/{HASH}/::,10:,:,:,,"
        );
        assert_eq!(token.to_string(), key);
        assert_eq!(Token::parse(&key).unwrap(), token);
        // Versions for later ROS 2 put more behind it.
        assert_eq!(Token::parse(&format!("{key}/more")).unwrap(), token);
    }

    #[test]
    fn a_type_without_a_hash_has_none() {
        let token = Token { subject: Subject { hash: None, ..listener().subject }, ..listener() };
        assert!(token.to_string().contains(NO_HASH));
        assert_eq!(Token::parse(&token.to_string()).unwrap(), token);
    }

    #[test]
    fn what_is_no_token_of_an_endpoint_is_none() {
        let key = listener().to_string();
        let long = key.replace("listener", &"a".repeat(TOKEN_BYTES_MAX));
        for bad in ["", "@ros2_lv", "@ros2_lv/0", "0/chatter/T/hash", &listener().node.token(), &long] {
            assert_eq!(Token::parse(bad), None, "{bad}");
        }
        for (part, other) in [("/MS/", "/XX/"), ("/0/aac", "/x/aac"), ("/0/10/", "/0/-1/"), ("::,10:,:,:,,", "qos")] {
            assert_eq!(Token::parse(&key.replacen(part, other, 1)), None, "{other}");
        }
    }

    #[test]
    fn a_node_has_a_full_name() {
        let node = NodeIdentity { namespace: "/robot1".to_owned(), ..listener().node };
        assert_eq!(
            (node.full_name().as_str(), listener().node.full_name().as_str()),
            ("/robot1/listener", "/listener")
        );
    }

    proptest! {
        #[test]
        fn any_text_is_read_without_a_panic(text in ".{0,200}") {
            let _read = Token::parse(&text);
            let _read = Token::parse(&format!("@ros2_lv/0/a/0/1/MP/%/%/n/{text}"));
        }
    }
}
