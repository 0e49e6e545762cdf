//! Functions that need approval: how many must agree before a call is executed, and the approvals that it has.

use super::Chaincode;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::str::FromStr;

/// The chaincode that keeps proposals: it executes calls that were approved.
pub(crate) const MSP: &str = "msp";
/// Most admins of one organisation that a proposal counts, so that none can fill its record.
pub const ADMINS_PER_ORGANISATION_MAX: usize = 16;

/// How many must approve a call. Written as text: `organisations = majority`, `organisations = all`,
/// `organisations = 2`, `admins of Org1 = 2`, `admins = 2`.
///
/// ```
/// use ledger::Quorum;
///
/// let quorum: Quorum = "admins of Org1 = 2".parse().unwrap();
/// assert_eq!(quorum, Quorum::Admins { of: Some("Org1".into()), least: 2 });
/// assert_eq!(quorum.to_string(), "admins of Org1 = 2");
/// assert!("admins = 0".parse::<Quorum>().is_err());
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
#[non_exhaustive]
pub enum Quorum {
    /// More than half of the organisations.
    Majority,
    /// Every organisation.
    All,
    /// That many organisations; all of them where there are fewer, so that nothing waits for ever.
    Organisations(usize),
    /// That many admins of one organisation.
    Admins {
        /// The organisation; that of the proposal if none is named.
        of: Option<String>,
        /// How many.
        least: usize,
    },
}

impl Quorum {
    /// How many approvals are missing, if these are the organisations of the network.
    pub fn missing(&self, approved: &ApprovedBy, organisations: &[String]) -> usize {
        let agreed = organisations.iter().filter(|name| approved.admins.contains_key(*name)).count();
        let (wanted, found) = match self {
            Self::Majority => (organisations.len() / 2 + 1, agreed),
            Self::All => (organisations.len(), agreed),
            Self::Organisations(least) => ((*least).min(organisations.len()), agreed),
            Self::Admins { of, least } => {
                let admins = approved.admins.get(of.as_ref().unwrap_or(&approved.proposer));
                (*least, admins.map_or(0, BTreeSet::len))
            }
        };
        wanted.saturating_sub(found)
    }

    /// The organisations that could give what is missing.
    pub(crate) fn pending(&self, approved: &ApprovedBy, organisations: &[String]) -> Vec<String> {
        match self {
            Self::Admins { of, .. } => vec![of.as_ref().unwrap_or(&approved.proposer).clone()],
            _ => organisations.iter().filter(|name| !approved.admins.contains_key(*name)).cloned().collect(),
        }
    }
}

impl fmt::Display for Quorum {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Majority => f.write_str("organisations = majority"),
            Self::All => f.write_str("organisations = all"),
            Self::Organisations(least) => write!(f, "organisations = {least}"),
            Self::Admins { of: None, least } => write!(f, "admins = {least}"),
            Self::Admins { of: Some(organisation), least } => write!(f, "admins of {organisation} = {least}"),
        }
    }
}

/// The text is no [`Quorum`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NotAQuorum;

impl fmt::Display for NotAQuorum {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "\"organisations = majority\", \"organisations = all\", \"organisations = N\", \"admins = N\" or \"admins of \
             ORGANISATION = N\", N from 1 to {ADMINS_PER_ORGANISATION_MAX}"
        )
    }
}

impl FromStr for Quorum {
    type Err = NotAQuorum;

    fn from_str(text: &str) -> Result<Self, NotAQuorum> {
        let (what, least) = text.rsplit_once('=').ok_or(NotAQuorum)?;
        let (what, least) = (what.trim(), least.trim());
        let number = || {
            let plain = !least.is_empty() && least.bytes().all(|digit| digit.is_ascii_digit());
            let number: usize = if plain { least.parse().map_err(|_| NotAQuorum)? } else { return Err(NotAQuorum) };
            if (1..=ADMINS_PER_ORGANISATION_MAX).contains(&number) { Ok(number) } else { Err(NotAQuorum) }
        };
        match (what, least) {
            ("organisations", "majority") => Ok(Self::Majority),
            ("organisations", "all") => Ok(Self::All),
            ("organisations", _) => number().map(Self::Organisations),
            ("admins", _) => Ok(Self::Admins { of: None, least: number()? }),
            _ => {
                let organisation = what.strip_prefix("admins of ").map(str::trim).ok_or(NotAQuorum)?;
                ledger_identity::check_name(organisation).map_err(|_| NotAQuorum)?;
                Ok(Self::Admins { of: Some(organisation.to_owned()), least: number()? })
            }
        }
    }
}

impl From<Quorum> for String {
    fn from(quorum: Quorum) -> Self {
        quorum.to_string()
    }
}

impl TryFrom<String> for Quorum {
    type Error = NotAQuorum;

    fn try_from(text: String) -> Result<Self, NotAQuorum> {
        text.parse()
    }
}

/// A call of a function of a chaincode.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Call {
    /// Name of the chaincode.
    pub chaincode: String,
    /// Name of the function.
    pub function: String,
    /// The arguments; in JSON each is text of hexadecimal digits.
    #[serde(default, with = "crate::network::hex_list")]
    pub args: Vec<Bytes>,
}

/// The quorum that a function needs unless the network decides otherwise.
pub(crate) fn quorum_of<'a>(chaincode: &'a dyn Chaincode, function: &str) -> Result<&'a Quorum, Rejection> {
    let table = chaincode.needs_approval();
    if let Some((_, quorum)) = table.iter().find(|(name, _)| *name == function) {
        return Ok(quorum);
    }
    let function: String = function.chars().take(128).collect();
    let names: Vec<_> = table.iter().map(|(name, _)| *name).collect();
    let wanted =
        if names.is_empty() { "another chaincode: this one has no such function".to_owned() } else { names.join(", ") };
    let message = format!("{} {function:?} is not a function that needs approval", chaincode.name());
    Err(Rejection::new(Code::BadArgument, message)
        .found(function)
        .wanted(format!("a function that needs approval: {wanted}"))
        .next("ledgerctl network quorums lists them; call others directly: ledgerctl invoke"))
}

/// Refuses an ordinary call of a function that needs approval. The chaincode `msp` keeps the proposals: an ordinary call of
/// its own functions proposes them.
pub(super) fn check_ordinary(chaincode: &dyn Chaincode, function: &str) -> Result<(), Rejection> {
    let name = chaincode.name();
    let table = chaincode.needs_approval();
    if name == MSP || table.iter().all(|(needs, _)| *needs != function) {
        return Ok(());
    }
    Err(Rejection::new(Code::NeedsApproval, format!("{name} {function} cannot be called directly: it needs approval"))
        .found("a call without further approvals")
        .wanted("a proposal, executed when its quorum is reached")
        .next(format!("ledgerctl network propose {name} {function} ARG..., as an admin")))
}

/// The approvals of the call that is executed; the answer of [`crate::Context::approved_by`].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ApprovedBy {
    /// The proposal.
    pub proposal: Hash,
    /// The organisation that proposed it.
    pub proposer: String,
    /// Names of the admins that agreed, by their organisations.
    pub admins: BTreeMap<String, BTreeSet<String>>,
}

impl ApprovedBy {
    /// The organisations that agreed.
    pub fn organisations(&self) -> impl Iterator<Item = &str> {
        self.admins.keys().map(String::as_str)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn approved(admins: &[(&str, &[&str])]) -> ApprovedBy {
        let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        let admins = admins.iter().map(|(organisation, admins)| ((*organisation).to_owned(), names(admins)));
        ApprovedBy { proposal: Hash::ZERO, proposer: "Org1".into(), admins: admins.collect() }
    }

    #[test]
    fn an_organisation_counts_once_and_only_while_it_belongs_to_the_network() {
        let organisations = ["Org1", "Org2", "Org3", "Org4"].map(str::to_owned);
        let approved = approved(&[("Org1", &["a", "b", "c"]), ("Org2", &["a"]), ("Gone", &["a"])]);
        for (quorum, missing) in [
            (Quorum::Majority, 1),
            (Quorum::All, 2),
            (Quorum::Organisations(2), 0),
            (Quorum::Organisations(9), 2),
            (Quorum::Admins { of: None, least: 4 }, 1),
            (Quorum::Admins { of: Some("Org2".into()), least: 3 }, 2),
            (Quorum::Admins { of: Some("Org3".into()), least: 1 }, 1),
        ] {
            assert_eq!(quorum.missing(&approved, &organisations), missing, "{quorum}");
        }
        assert_eq!(Quorum::Majority.pending(&approved, &organisations), ["Org3", "Org4"]);
        assert_eq!(Quorum::Admins { of: None, least: 4 }.pending(&approved, &organisations), ["Org1"]);
    }

    #[test]
    fn a_quorum_is_read_from_the_text_that_it_is_written_as_and_from_no_other() {
        for text in ["organisations = majority", "organisations = all", "organisations = 2", "admins = 16"] {
            assert_eq!(text.parse::<Quorum>().unwrap().to_string(), text);
        }
        let odd: Quorum = "admins of A = B=3".parse().unwrap();
        assert_eq!(odd, Quorum::Admins { of: Some("A = B".into()), least: 3 });
        assert_eq!(odd.to_string().parse(), Ok(odd));
        for text in
            ["", "=", "organisations", "organisations = 0", "organisations = 17", "organisations = +2", "admins = all"]
        {
            assert_eq!(text.parse::<Quorum>(), Err(NotAQuorum), "{text}");
        }
        for text in ["admins of  = 2", "admins of a/b = 2", "admins = 99999999999999999999", "members = 2"] {
            assert_eq!(text.parse::<Quorum>(), Err(NotAQuorum), "{text}");
        }
    }
}
