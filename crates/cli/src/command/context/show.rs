//! `context show`: one identity on this machine, and what it knows of its network.

use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table};
use crate::{context, time};
use ledger_api::context::RenewalRule;
use ledger_api::{Context, renewal_due};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_identity::certificate::Certificate;
use serde::Serialize;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Show a context with its known nodes.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ledgerctl context show\n  ledgerctl context show Salma")]
pub(crate) struct Show {
    /// Name of the context; by default the selected one
    name: Option<String>,
}

impl Show {
    pub(super) fn run(self, global: &Global, home: &Path, output: &mut Output) -> Result<(), Failure> {
        let loaded = match self.name {
            Some(name) => Context::load(home, Some(&name))?,
            None => context::selected(global)?,
        };
        output.show(&Details::of(&loaded, home)?)
    }
}

#[derive(Serialize)]
pub(super) struct Details {
    name: String,
    id: String,
    not_after: u64,
    /// From when on it is renewed at use; none if it is not.
    renewed_from: Option<u64>,
    network: Hash,
    label: String,
    /// Addresses in the order in which they are tried.
    nodes: Vec<String>,
    /// The nodes as the network told them last.
    known_nodes: Vec<Node>,
    directory: PathBuf,
    authorities: Vec<Authority>,
}

/// A node that a context knows.
#[derive(Serialize)]
pub(super) struct Node {
    pub(super) address: String,
    pub(super) organisation: String,
    pub(super) served_last: bool,
}

#[derive(Serialize)]
struct Authority {
    organisation: String,
    ca_fingerprints: Vec<Hash>,
}

/// The nodes that a context knows.
pub(super) fn nodes(context: &Context) -> Vec<Node> {
    let known = context.known_nodes().iter().map(|node| Node {
        served_last: context.last_node() == Some(&node.address),
        address: node.address.clone(),
        organisation: node.organisation.clone(),
    });
    known.collect()
}

impl Details {
    fn of(loaded: &Context, home: &Path) -> Result<Self, Rejection> {
        let identity = context::identity(loaded)?;
        let Certificate { not_before, not_after, .. } = loaded.certificate()?;
        let authority = |msp: &ledger_identity::msp::Msp| Authority {
            organisation: msp.organisation().to_owned(),
            ca_fingerprints: msp.roots().map(|root| Hash::of(&[root])).collect(),
        };
        let msps = loaded.learnt_organisations().unwrap_or(&loaded.msps);
        Ok(Self {
            name: loaded.name.clone(),
            id: identity.id(),
            not_after,
            renewed_from: (loaded.renew == RenewalRule::Auto).then(|| renewal_due(not_before, not_after)),
            network: loaded.network,
            label: loaded.label.clone(),
            nodes: loaded.addresses(),
            known_nodes: nodes(loaded),
            directory: context::directory(home, &loaded.name),
            authorities: msps.iter().map(authority).collect(),
        })
    }
}

impl Facts for Details {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut table = Table::pairs();
        table.pair("context", &self.name);
        table.pair("identity", &self.id);
        table.pair("valid until", time::moment(self.not_after));
        let renewed = match self.renewed_from {
            Some(from) => format!("when used, from {}", time::moment(from)),
            None => "never; renew it with ledgerctl identity renew".to_owned(),
        };
        table.pair("renewed", renewed);
        table.pair("network", format!("{} {}", self.label, self.network).trim_start());
        table.pair("nodes", self.nodes.join(", "));
        for node in &self.known_nodes {
            let last = if node.served_last { ", last used" } else { "" };
            table.pair("  of the network", format!("{} of {}{last}", node.address, node.organisation));
        }
        table.pair("stored in", self.directory.display());
        for authority in &self.authorities {
            for fingerprint in &authority.ca_fingerprints {
                table.pair(&format!("CA of {}", authority.organisation), fingerprint);
            }
        }
        table.write(out, 0)
    }
}
