//! Why a node and this machine do not accept each other, where the certificates alone tell it badly.
//!
//! A network that was made anew has another CA under the same name. A clock that is wrong makes good certificates look
//! expired. A certificate that has expired is refused by an alert that says "unknown". In these cases the node is
//! asked, without showing or believing anything, what it says of its network and its clock. That only chooses the
//! words: refused it stays.

use super::Connection;
use crate::clock::now;
use crate::tls::unverified_config;
use crate::v1::enrolment_client::EnrolmentClient;
use crate::v1::{NetworkRequest, NetworkResponse};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::moment::rfc3339_seconds;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use ledger_identity::certificate::Certificate;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::timeout;

/// Clocks that differ by less, in microseconds, are not what certificates fail by.
const CLOCK_OFF: u64 = 5 * 60 * 1_000_000;
const SECOND: u64 = 1_000_000;
/// Before the name of the network that answered.
const FOUND: &str = "network ";
const DAY: u64 = 24 * 3600 * SECOND;

/// The nodes that this machine looks for, and its own identity.
#[derive(Clone, Debug)]
pub(crate) struct Expected {
    /// Name of the network.
    pub network: Hash,
    /// The organisation of the own identity, if it is known.
    pub organisation: Option<String>,
    /// The own certificate in DER.
    pub certificate: Bytes,
}

/// The refusal in better words, if the node at `address` can be asked for them within `patience`.
pub(crate) async fn explain(refused: Rejection, address: &str, expected: &Expected, patience: Duration) -> Rejection {
    let doubtful = [Code::Untrusted, Code::CertificateExpired, Code::CertificateNotYetValid];
    if !doubtful.contains(&refused.code) {
        return refused;
    }
    let Ok(Ok(told)) = timeout(patience, ask((address, Some(&expected.network)), patience)).await else {
        return refused;
    };
    let here = now();
    other_network(address, expected, &told)
        .unwrap_or_else(|| by_the_clock(refused, address, expected, (here, told.clock)))
}

/// As [`explain`], at first contact, when nothing but its name is known of the network: only the clock can be it.
pub(crate) async fn explain_clock(
    refused: Rejection,
    (address, network): (&str, Option<&Hash>),
    patience: Duration,
) -> Rejection {
    if !matches!(refused.code, Code::CertificateExpired | Code::CertificateNotYetValid) {
        return refused;
    }
    let Ok(Ok(told)) = timeout(patience, ask((address, network), patience)).await else { return refused };
    let here = now();
    if here.abs_diff(told.clock) > CLOCK_OFF { clocks_differ(address, here, told.clock) } else { refused }
}

async fn ask(there: (&str, Option<&Hash>), patience: Duration) -> Result<NetworkResponse, Rejection> {
    let config = unverified_config().map_err(|error| super::unusable(&error))?;
    let connection = Connection::open(there, Arc::new(config), &Bytes::new(), patience).await?;
    let answer = EnrolmentClient::new(connection.channel.clone()).network(NetworkRequest {}).await;
    Ok(answer.map_err(|status| connection.refusal(&status))?.into_inner())
}

/// Why not, if the node is of another network than the one that is looked for.
pub(crate) fn other_network(address: &str, expected: &Expected, told: &NetworkResponse) -> Option<Rejection> {
    if told.network == expected.network.as_ref() {
        return None;
    }
    let own = expected.organisation.as_deref();
    let twin = told.organisations.iter().find(|found| Some(found.name.as_str()) == own);
    let authority = twin.and_then(|found| found.roots.first()).map(|root| Hash::of(&[root]));
    let found = match (own, authority) {
        (Some(own), Some(authority)) => format!(" with the CA {authority} of {own}"),
        _ => String::new(),
    };
    let found = format!("{FOUND}{} {:?}{found}", hex::encode(&told.network), told.label);
    let wanted = format!("network {}, as in the context", expected.network);
    Some(match own.filter(|_| authority.is_some()) {
        Some(own) => Rejection::new(Code::WrongNetwork, format!("a different network answers at {address}"))
            .found(found)
            .wanted(wanted)
            .next(format!(
                "ask an admin of {own} in that network to register you, then enrol again with --force; \
                 ledgerd dev replaces its own contexts when it starts"
            )),
        None => Rejection::new(Code::WrongNetwork, format!("a different network answers at {address}"))
            .found(found)
            .wanted(wanted)
            .next("check the address, or select the context of that network"),
    })
}

/// The network that answered, in the rejection of [`other_network`].
pub fn found_network(refused: &Rejection) -> Option<Hash> {
    let found = Some(&refused.found).filter(|_| refused.code == Code::WrongNetwork)?;
    found.split(FOUND).nth(1).and_then(|rest| Hash::from_hex(rest.split(' ').next()?))
}

/// The network is the right one: is it a clock, or the end of our certificate?
fn by_the_clock(refused: Rejection, address: &str, expected: &Expected, (here, there): (u64, u64)) -> Rejection {
    let Ok(own) = Certificate::parse(&expected.certificate) else { return refused };
    let valid = |at: u64| (own.not_before..=own.not_after).contains(&at);
    // Which of the two is wrong nobody can tell from here; that they differ explains it.
    if here.abs_diff(there) > CLOCK_OFF && (valid(here) != valid(there) || refused.code != Code::Untrusted) {
        return clocks_differ(address, here, there);
    }
    if there > own.not_after { ended(&own, expected.organisation.as_deref(), there) } else { refused }
}

fn clocks_differ(address: &str, here: u64, there: u64) -> Rejection {
    let way = if here > there { "ahead of" } else { "behind" };
    let off = span(here.abs_diff(there));
    Rejection::new(Code::ClockOff, format!("the clock of this machine is {off} {way} that of the node at {address}"))
        .found(format!("{} here, {} there", rfc3339_seconds(here), rfc3339_seconds(there)))
        .wanted("clocks that agree: certificates are valid from one moment to another")
}

/// Our certificate is past its end by the clock of the node, which is the one that counts.
fn ended(own: &Certificate, organisation: Option<&str>, now: u64) -> Rejection {
    let name = own.name().unwrap_or("NAME");
    let id = organisation.map_or_else(|| name.to_owned(), |organisation| format!("{organisation}/{name}"));
    Rejection::new(Code::CertificateExpired, format!("the certificate of {id} has expired"))
        .found(format!(
            "a certificate that expired on {}, {} ago",
            rfc3339_seconds(own.not_after),
            span(now.saturating_sub(own.not_after))
        ))
        .wanted("a valid certificate; it is renewed when used in the last third of its validity")
        .next(way_back(own, organisation))
}

/// Advice to the owner of an expired certificate.
pub(crate) fn way_back(own: &Certificate, organisation: Option<&str>) -> String {
    let name = own.name().unwrap_or("NAME");
    let organisation = organisation.unwrap_or("the organisation");
    let again = format!("ledgerctl identity register {name} --reissue; then run the command that it prints");
    match own.role() {
        Ok(Role::Admin) => format!(
            "ask another admin of {organisation} for: {again}; if there is none: ledgerd admin-secret, at a node of \
             {organisation} that holds its CA key"
        ),
        _ => format!("ask an admin of {organisation} for: {again}"),
    }
}

/// A time in words: the two largest that matter to people.
fn span(micros: u64) -> String {
    let count = |unit: u64, name: &str| {
        let count = micros / unit;
        format!("{count} {name}{}", if count == 1 { "" } else { "s" })
    };
    match micros {
        day if day >= 2 * DAY => count(DAY, "day"),
        hour if hour >= 2 * 3600 * SECOND => count(3600 * SECOND, "hour"),
        minute if minute >= 60 * SECOND => count(60 * SECOND, "minute"),
        _ => count(SECOND, "second"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_network_that_answered_is_named_in_the_rejection() {
        let there = Hash::of(&[b"there"]);
        let told = NetworkResponse { network: there.0.to_vec().into(), label: "fleet".into(), ..Default::default() };
        let expected = Expected { network: Hash::of(&[b"here"]), organisation: None, certificate: Bytes::new() };
        let refused = other_network("h:1", &expected, &told);
        assert_eq!(refused.as_ref().and_then(found_network), Some(there));
        assert_eq!(found_network(&Rejection::new(Code::WrongNetwork, "").found("nothing")), None);
    }

    #[test]
    fn spans_are_in_the_unit_that_people_would_choose() {
        for (micros, text) in
            [(730 * DAY, "730 days"), (DAY, "24 hours"), (90 * 60 * SECOND, "90 minutes"), (SECOND, "1 second")]
        {
            assert_eq!(span(micros), text);
        }
    }
}
