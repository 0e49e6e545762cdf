//! `identity list`: the registered names of an organisation, and those whose certificates end soon.

use super::{Person, identities};
use crate::argument::span::Milliseconds;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table, attributes};
use crate::session::Session;
use crate::time;
use serde::Serialize;
use std::io::{self, Write};

/// List the identities of your organisation, including those that have not enrolled; for admins.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl identity list\n  ledgerctl identity list --expiring 30d")]
pub(crate) struct List {
    /// Only identities whose last valid certificate expires within this time, earliest first
    #[arg(long, value_name = "SPAN")]
    expiring: Option<Milliseconds>,
}

impl List {
    pub(super) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let people = identities(&session).await?;
        match self.expiring {
            None => output.show(&Registered(people)),
            Some(within) => output.show(&Expiring::of(people, within)),
        }
    }
}

#[derive(Serialize)]
struct Registered(Vec<Person>);

impl Facts for Registered {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::new(["NAME", "ORGANISATION", "ROLE", "STATE", "ATTRIBUTES"]);
        for person in &self.0 {
            table.row([
                person.name.clone(),
                person.organisation.clone(),
                person.role.to_string(),
                person.state(),
                attributes(&person.attributes),
            ]);
        }
        table.write(out, 0)
    }
}

/// Those whose certificates end soon.
#[derive(Serialize)]
struct Expiring(Vec<Ending>);

#[derive(Serialize)]
struct Ending {
    /// The end of the last valid certificate, microseconds since the UNIX epoch.
    ends: u64,
    #[serde(flatten)]
    person: Person,
}

impl Expiring {
    fn of(people: Vec<Person>, Milliseconds(within): Milliseconds) -> Self {
        let ending = people.into_iter().filter_map(|person| {
            let now = person.now;
            let live = person.certificates.iter().filter(|issued| !issued.revoked && issued.not_after >= now);
            let ends = live.map(|issued| issued.not_after).max()?;
            (ends - now <= within.saturating_mul(1_000)).then_some(Ending { ends, person })
        });
        let mut ending: Vec<_> = ending.collect();
        ending.sort_by(|one, other| (one.ends, &one.person.name).cmp(&(other.ends, &other.person.name)));
        Self(ending)
    }
}

impl Facts for Expiring {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::new(["NAME", "ORGANISATION", "ROLE", "ENDS", ""]);
        for Ending { ends, person } in &self.0 {
            table.row([
                person.name.clone(),
                person.organisation.clone(),
                person.role.to_string(),
                time::moment(*ends),
                time::relative(*ends, person.now),
            ]);
        }
        table.write(out, 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ledger::msp::IssuedCertificate;
    use ledger_base::hash::Hash;
    use ledger_identity::Role;
    use std::collections::BTreeMap;

    const DAY: u64 = 86_400_000_000;

    fn person(name: &str, certificates: &[(u64, bool)]) -> Person {
        let issued = |(not_after, revoked): &(u64, bool)| IssuedCertificate {
            serial: "01".into(),
            issuer: Hash::ZERO,
            fingerprint: Hash::ZERO,
            not_before: 0,
            not_after: *not_after,
            via: String::new(),
            recorded: 0,
            revoked: *revoked,
        };
        Person {
            name: name.into(),
            organisation: "Org1".into(),
            role: Role::Member,
            attributes: BTreeMap::new(),
            enrolled: true,
            secret_expires: None,
            secret_at: None,
            registered_by: String::new(),
            certificates: certificates.iter().map(issued).collect(),
            now: 100 * DAY,
        }
    }

    #[test]
    fn those_are_listed_whose_last_valid_certificate_ends_in_time_and_the_first_to_end_comes_first() {
        let people = vec![
            person("later", &[(131 * DAY, false)]),
            person("renewed", &[(101 * DAY, false), (200 * DAY, false)]),
            person("second", &[(130 * DAY, false)]),
            person("first", &[(105 * DAY, false), (200 * DAY, true)]),
            person("gone", &[(99 * DAY, false)]),
            person("revoked", &[(105 * DAY, true)]),
            person("never", &[]),
        ];
        let listed = Expiring::of(people, Milliseconds(30 * 86_400_000));
        let names: Vec<_> = listed.0.iter().map(|ending| ending.person.name.as_str()).collect();
        assert_eq!(names, ["first", "second"]);
    }
}
