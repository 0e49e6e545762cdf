//! `console`: a link with which a browser enrols.

use crate::argument::attribute::Attribute;
use crate::argument::span::Milliseconds;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table, attributes};
use crate::session::Session;
use crate::time;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::net::Ipv4Addr;
use std::time::Duration;

/// Added to the name of the caller for the name of its browser.
const BROWSER: &str = "-browser";

/// Print a link that opens the console of the node in a browser and creates an identity for that browser.
///
/// For admins. The link contains a one-time secret: the first browser that opens it becomes the new identity. The key
/// never leaves that browser. By default, the identity is named after you and has your role and attributes.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl console
  ledgerctl console Salma-tablet --role member --attr Turtlebot4
  ledgerctl console --reissue
  ledgerctl console --at https://robots.example:7452")]
pub(crate) struct Console {
    /// Name of the new identity
    name: Option<String>,
    /// Its role, member or admin; by default yours if no name is given, otherwise member
    #[arg(long, value_name = "ROLE", value_parser = role)]
    role: Option<Role>,
    /// Attribute to sign into its certificate; KEY alone means KEY=true
    #[arg(long = "attr", value_name = "KEY[=VALUE]")]
    attributes: Vec<Attribute>,
    /// Print a new link for a registered name, such as for another browser
    #[arg(long, conflicts_with_all = ["role", "attributes"])]
    reissue: bool,
    /// How long the link is valid
    #[arg(long = "for", value_name = "SPAN", default_value = "1h")]
    span: Milliseconds,
    /// Address of the console; by default the one that the node reports
    #[arg(long, value_name = "URL", value_parser = page)]
    at: Option<String>,
}

/// The address of a console. Browsers make keys on safe pages only: over TLS, or of their own machine.
fn page(text: &str) -> Result<String, String> {
    let host = text.strip_prefix("http://").map(|rest| rest.split(['/', '?', '#']).next().unwrap_or_default());
    let port = |port: &str| port.parse::<u16>().is_ok();
    let name = host.map(|host| host.rsplit_once(':').filter(|(_, rest)| port(rest)).map_or(host, |(name, _)| name));
    let is_of_this_machine =
        |name: &str| matches!(name, "localhost" | "[::1]") || name.parse::<Ipv4Addr>().is_ok_and(|ip| ip.is_loopback());
    match name {
        Some(name) if is_of_this_machine(name) => Ok(text.to_owned()),
        None if text.starts_with("https://") => Ok(text.to_owned()),
        _ => {
            Err("wanted https://…, or http:// with this machine: browsers create keys only on secure pages".to_owned())
        }
    }
}

fn role(text: &str) -> Result<Role, String> {
    match text {
        "member" => Ok(Role::Member),
        "admin" => Ok(Role::Admin),
        _ => Err("wanted member or admin".to_owned()),
    }
}

/// The link, and the identity behind it.
#[derive(Serialize)]
struct Link {
    link: String,
    id: String,
    role: Role,
    attributes: BTreeMap<String, String>,
    /// Until when, microseconds since the UNIX epoch.
    expires: u64,
}

impl Facts for Link {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "{}", self.link)?;
        let mut table = Table::pairs();
        table.pair("identity", &self.id);
        table.pair("role", self.role);
        table.pair("attributes", attributes(&self.attributes));
        table.pair("valid once, until", time::moment(self.expires));
        table.write(out, 2)
    }
}

impl Console {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let session = Session::open(global).await?;
        let is_of_this_node = self.at.is_none();
        let at = match self.at {
            Some(at) => at,
            None => session.client.status().await?.console,
        };
        if at.is_empty() {
            return Err(no_console(session.client.node()).into());
        }
        let own = session.identity()?;
        // A browser enrols at the node that serves the page, and cannot go on to another one.
        if is_of_this_node && !session.client.network().await?.carries.contains(&own.organisation) {
            return Err(no_ca(session.client.node(), &own.organisation).into());
        }
        let asked = self.attributes.into_iter().map(|Attribute { key, value }| (key, value)).collect();
        let (role, attributes) = match (&self.name, self.role, self.reissue) {
            (None, None, false) if BTreeMap::is_empty(&asked) => (own.role, own.attributes),
            (_, role, _) => (role.unwrap_or(Role::Member), asked),
        };
        let name = self.name.unwrap_or_else(|| format!("{}{BROWSER}", own.name));
        let life = Duration::from_millis(self.span.0);
        let wanted = Some(role).filter(|_| !self.reissue);
        let registered = session.client.register_for(&name, wanted, &attributes, life).await.map_err(again)?;
        let known = session.client.identities(&name).await?.into_iter().find(|record| record.name == name);
        let (role, attributes) = known.map_or((role, attributes), |record| (record.role, record.attributes));
        output.show(&Link {
            // Behind the #, so that no server and no log ever sees it.
            link: format!(
                "{}/#/enrol/{}/{}/{}",
                at.trim_end_matches('/'),
                encoded(&registered.organisation),
                encoded(&name),
                encoded(&registered.secret)
            ),
            id: format!("{}/{name}", registered.organisation),
            role,
            attributes,
            expires: registered.expires,
        })
    }
}

fn no_console(node: impl std::fmt::Display) -> Rejection {
    Rejection::new(Code::NotFound, "this node has no console")
        .found(format!("node {node} without the setting console.listen"))
        .wanted("a node with a console")
        .next(
            "set listen = \"127.0.0.1:7452\" in the section [console] of its ledgerd.toml, or name another console \
               with --at URL",
        )
}

fn no_ca(node: impl std::fmt::Display, organisation: &str) -> Rejection {
    Rejection::new(Code::CaElsewhere, format!("the node of this console does not hold the CA key of {organisation}"))
        .found(format!("node {node}"))
        .wanted("the console of a node that holds it: ledgerctl ca status")
        .next(
            "copy the CA key to this node (ledgerctl ca carry NODE), or name the console of a node that holds it with \
             --at URL",
        )
}

/// A name that is registered wants the word for it.
fn again(refused: Rejection) -> Rejection {
    match refused.code {
        Code::AlreadyRegistered => {
            refused.next("ledgerctl console --reissue creates a new link for the same identity; or choose another NAME")
        }
        _ => refused,
    }
}

/// The text as a part of an address.
fn encoded(text: &str) -> String {
    let is_plain = |byte: &u8| byte.is_ascii_alphanumeric() || b"-._~".contains(byte);
    text.bytes()
        .map(|byte| if is_plain(&byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_one_part_of_the_link_whatever_is_in_it() {
        assert_eq!(encoded("Salma-1_x.y~z"), "Salma-1_x.y~z");
        assert_eq!(encoded("a/b c#d%é"), "a%2Fb%20c%23d%25%C3%A9");
    }

    #[test]
    fn a_page_without_tls_is_refused_unless_it_is_of_this_machine() {
        for good in [
            "https://robots.example:7452",
            "http://localhost:7452",
            "http://127.0.0.1/x",
            "http://[::1]:7452/",
            "http://[::1]/",
        ] {
            assert_eq!(page(good).as_deref(), Ok(good));
        }
        for bad in ["http://robots.example:7452", "http://10.0.0.1", "robots.example", "http://localhost.example:1", ""]
        {
            assert!(page(bad).is_err(), "{bad}");
        }
    }
}
