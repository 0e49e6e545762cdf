//! `ledgerd dev`, as a player starts it.

use super::{Ctl, Process, programs};
use serde_json::Value;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A running network for playing, in a home of its own.
pub struct Dev {
    /// The program.
    pub process: Process,
    /// The output of `--json`.
    pub facts: Value,
    /// The home directory of its contexts.
    pub home: TempDir,
}

impl Dev {
    /// Starts one that is temporary.
    pub fn start() -> Self {
        Self::start_in(tempfile::tempdir().unwrap(), None)
    }

    /// Starts one in this home; it goes on in `data` if given.
    pub fn start_in(home: TempDir, data: Option<&Path>) -> Self {
        let mut command = programs::node();
        command.args(["dev", "--json", "--listen", "127.0.0.1:0"]);
        command.env("LEDGERD_HOME", home.path()).env("TMPDIR", home.path());
        if let Some(data) = data {
            command.arg("--data").arg(data);
        }
        let mut process = Process::start("dev", home.path(), command);
        let facts = serde_json::from_str(&process.first_line()).unwrap();
        Self { process, facts, home }
    }

    /// One fact that is a text.
    pub fn fact(&self, name: &str) -> &str {
        self.facts[name].as_str().unwrap_or_else(|| panic!("{name} in {}", self.facts))
    }

    /// Its data directory.
    pub fn data(&self) -> PathBuf {
        self.fact("data").into()
    }

    /// `ledgerctl` without a context.
    pub fn ctl(&self) -> Ctl {
        Ctl::at(self.home.path())
    }

    /// `ledgerctl` as the admin of Org1, who registers people.
    pub fn admin(&self) -> Ctl {
        self.ctl().as_("dev-org1-admin")
    }

    /// `ledgerctl` as the admin of Org2, who owns the robots.
    pub fn owner(&self) -> Ctl {
        self.ctl().as_("dev-org2-admin")
    }

    /// Registers and enrols a user of Org1 with these attributes; `ledgerctl` as that user.
    pub fn user(&self, name: &str, attributes: &[&str], key: &str) -> Ctl {
        let mut register = vec!["identity", "register", name];
        for attribute in attributes {
            register.extend(["--attr", attribute]);
        }
        let invitation = self.admin().json(&register);
        let (node, fingerprint) = (self.fact("address"), self.fact("ca_fingerprint"));
        assert_eq!(invitation["ca_fingerprint"], fingerprint);
        let secret = invitation["secret"].as_str().unwrap();
        let enroll =
            ["enroll", name, "--node", node, "--ca-fingerprint", fingerprint, "--secret", secret, "--key", key];
        self.ctl().run(&enroll).ok();
        self.ctl().as_(name)
    }
}
