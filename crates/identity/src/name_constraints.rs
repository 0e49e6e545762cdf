//! Name constraints (RFC 5280 section 4.2.1.10): the names that an authority may certify.
//!
//! A name of a form that cannot be judged here is refused if the authority constrains that form.

use crate::der::{Element, SEQUENCE};
use crate::distinguished_name::DistinguishedName;
use crate::identity::{IdentityError, malformed, printable};
use std::fmt;

/// Most names of a certificate, and most subtrees of a constraint.
const NAMES_MAX: usize = 64;

/// A name of one of the forms of X.509.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum GeneralName {
    /// A distinguished name.
    Directory(DistinguishedName),
    /// A host.
    Dns(String),
    /// A mailbox.
    Email(String),
    /// A uniform resource identifier.
    Uri(String),
    /// An address: 4 or 16 bytes; in a constraint followed by a mask of as many.
    Address(Vec<u8>),
    /// Another form, by the number of its tag.
    Other(u8),
}

impl GeneralName {
    fn read(element: &Element<'_>) -> Result<Self, IdentityError> {
        let unreadable = || malformed("a name that cannot be read".into(), "names in the forms of RFC 5280");
        let text = || {
            let text = std::str::from_utf8(element.content).ok().filter(|text| text.is_ascii());
            text.map(str::to_owned).ok_or_else(unreadable)
        };
        Ok(match element.tag {
            0x81 => Self::Email(text()?),
            0x82 => Self::Dns(text()?),
            0xa4 => Self::Directory(DistinguishedName::parse(element.content)?),
            0x86 => Self::Uri(text()?),
            0x87 => Self::Address(element.content.to_vec()),
            0x80 | 0x83 | 0x85 | 0x88 | 0xa0 | 0xa3 | 0xa5 => Self::Other(element.tag & 0x1f),
            _ => return Err(unreadable()),
        })
    }

    /// Reads GeneralNames, such as those of a subject alternative name.
    pub(crate) fn all(der: &[u8]) -> Result<Vec<Self>, IdentityError> {
        let elements = Element::inside(der, SEQUENCE).filter(|found| !found.is_empty() && found.len() <= NAMES_MAX);
        let wanted = "1 to 64 names in the forms of RFC 5280";
        elements
            .ok_or_else(|| malformed("alternative names that cannot be read".into(), wanted))?
            .iter()
            .map(Self::read)
            .collect()
    }

    fn same_form(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Other(form), Self::Other(other)) => form == other,
            _ => std::mem::discriminant(self) == std::mem::discriminant(other),
        }
    }

    /// Is it in this subtree? None: that cannot be judged.
    fn is_in(&self, subtree: &Self) -> Option<bool> {
        match (self, subtree) {
            (Self::Directory(name), Self::Directory(subtree)) => Some(name.is_within(subtree)),
            (Self::Dns(host), Self::Dns(subtree)) => Some(is_below(host, subtree, true)),
            (Self::Email(mailbox), Self::Email(subtree)) => {
                match (mailbox.rsplit_once('@'), subtree.rsplit_once('@')) {
                    (Some((local, host)), Some((subtree_local, subtree_host))) => {
                        Some(local == subtree_local && host.eq_ignore_ascii_case(subtree_host))
                    }
                    (Some((_, host)), None) => Some(is_below(host, subtree, false)),
                    (None, _) => None,
                }
            }
            (Self::Uri(identifier), Self::Uri(subtree)) => Some(is_below(host_of(identifier)?, subtree, false)),
            (Self::Address(address), Self::Address(subtree)) => {
                // An IPv4 address is in no subtree of IPv6, and the other way round.
                let (network, mask) = subtree.split_at_checked(subtree.len() / 2)?;
                let mut parts = address.iter().zip(network).zip(mask);
                Some(
                    address.len() == network.len()
                        && parts.all(|((part, network), mask)| part & mask == network & mask),
                )
            }
            _ => None,
        }
    }
}

impl fmt::Display for GeneralName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Directory(name) => write!(f, "{}", printable(&name.to_string())),
            Self::Dns(text) | Self::Email(text) | Self::Uri(text) => write!(f, "{}", printable(text)),
            Self::Address(bytes) => write!(f, "the address {}", hex::encode(bytes)),
            Self::Other(form) => write!(f, "a name of form {form}"),
        }
    }
}

/// Is a host in a subtree? A dot in front means the hosts below alone; otherwise `deep` includes them.
fn is_below(host: &str, subtree: &str, deep: bool) -> bool {
    let (host, subtree) = (host.to_ascii_lowercase(), subtree.to_ascii_lowercase());
    let host = host.strip_suffix('.').unwrap_or(&host);
    match (subtree.strip_prefix('.'), host.strip_suffix(&subtree)) {
        (_, _) if subtree.is_empty() => true,
        (Some(_), Some(front)) => !front.is_empty(),
        (None, Some(front)) => front.is_empty() || (deep && front.ends_with('.')),
        (_, None) => false,
    }
}

/// The host that a uniform resource identifier names; none if it names none, or an address.
fn host_of(identifier: &str) -> Option<&str> {
    let (_, behind) = identifier.split_once("://")?;
    let authority = behind.split(['/', '?', '#']).next()?;
    let host = authority.rsplit('@').next()?.split(':').next()?;
    let is_name = host.chars().any(|c| c.is_ascii_alphabetic()) && !host.starts_with('[');
    is_name.then_some(host)
}

/// The constraints of an authority.
#[derive(Clone, Debug, Default)]
pub(crate) struct NameConstraints {
    permitted: Vec<GeneralName>,
    excluded: Vec<GeneralName>,
}

impl NameConstraints {
    /// Reads the content of the extension.
    pub(crate) fn read(der: &[u8]) -> Result<Self, IdentityError> {
        let unreadable = || {
            malformed(
                "name constraints that cannot be read".into(),
                "permitted and excluded subtrees, at most 64 of each",
            )
        };
        let mut constraints = Self::default();
        for part in Element::inside(der, SEQUENCE).ok_or_else(unreadable)? {
            let subtrees = match part.tag {
                0xa0 => &mut constraints.permitted,
                0xa1 => &mut constraints.excluded,
                _ => return Err(unreadable()),
            };
            for subtree in Element::all(part.content).filter(|all| all.len() <= NAMES_MAX).ok_or_else(unreadable)? {
                // RFC 5280: minimum is 0 and maximum is absent, so that nothing stands behind the base.
                let parts = Element::inside(subtree.whole, SEQUENCE).ok_or_else(unreadable)?;
                let [base] = parts.as_slice() else { return Err(unreadable()) };
                subtrees.push(GeneralName::read(base)?);
            }
        }
        Ok(constraints)
    }

    /// Checks the names of a certificate further down; answers with what is wrong.
    pub(crate) fn check<'a>(&self, names: impl Iterator<Item = &'a GeneralName>) -> Result<(), String> {
        for name in names {
            let judge = |subtree: &GeneralName| {
                name.is_in(subtree).ok_or_else(|| format!("{name}, and a name constraint that cannot be judged"))
            };
            let of_form = |subtrees: &'_ [GeneralName]| -> Result<Vec<bool>, String> {
                subtrees.iter().filter(|subtree| subtree.same_form(name)).map(judge).collect()
            };
            if of_form(&self.excluded)?.contains(&true) {
                return Err(format!("{name}, which a name constraint excludes"));
            }
            let is_constrained = self.permitted.iter().any(|subtree| subtree.same_form(name));
            if is_constrained && !of_form(&self.permitted)?.contains(&true) {
                return Err(format!("{name}, which is outside of the permitted names"));
            }
        }
        Ok(())
    }
}
