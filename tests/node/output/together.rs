//! Organisations that decide together, nodes that come and go, CAs that are carried elsewhere, and people of Fabric.

use super::Printed;
use crate::fabric::Fabric;
use crate::join::Newcomer;
use crate::support::{Ctl, Fleet, eventually};
use ledger_identity::Role;
use serde_json::Value;
use std::fs;
use std::path::Path;
use testkit::rcgen::PKCS_ECDSA_P256_SHA256;

impl Printed {
    /// As [`Printed::run`], until it succeeds: other nodes may have to hear of what was done before.
    fn succeed(&mut self, ctl: &Ctl, name: &str, rest: &[&str]) -> Value {
        let words: Vec<&str> = name.split(' ').chain(rest.iter().copied()).chain(["-o", "json"]).collect();
        let told = eventually(&format!("{words:?} succeeds"), || {
            let ran = ctl.run(&words);
            (ran.code == 0).then(|| ran.json())
        });
        self.note(name, &told);
        told
    }

    /// One organisation proposes, another one agrees.
    fn agree(&mut self, (one, other): (&Ctl, &Ctl), name: &str, rest: &[&str]) {
        let proposed = self.run(one, name, rest);
        assert_eq!(proposed["executed"], false, "{proposed}");
        let id = proposed["proposal"]["id"].as_str().unwrap();
        assert_eq!(self.run(other, "network approve", &[id])["executed"], true);
    }

    /// The CA of an organisation goes to its other node, and comes back from a copy.
    fn carry(&mut self, boss: &Ctl, [first, second]: [&str; 2], files: &Path) {
        let (copy, words) = (files.join("ca.pem").display().to_string(), files.join("words"));
        fs::write(&words, "correct horse battery\n").unwrap();
        let words = words.display().to_string();
        boss.run(&["ca", "backup", &copy, "--passphrase-file", &words]).ok();
        self.succeed(boss, "ca move", &[second, "--i-mean-it"]);
        self.succeed(boss, "ca restore", &[&copy, "--node", first, "--passphrase-file", &words]);
        self.succeed(boss, "ca forget", &[second, "--i-mean-it"]);
        self.succeed(boss, "ca carry", &[second]);
    }

    /// People of Fabric come with their certificates, are revoked by a list, and their organisation is removed.
    fn move_people(&mut self, (boss, owner): (&Ctl, &Ctl), (fleet, node): (&Fleet, &str)) {
        let fabric = Fabric::new(&fleet.path().join("fabric"));
        let serial = fabric.user("salma", "client", &[], &PKCS_ECDSA_P256_SHA256);
        fabric.user("chief", "admin", &[], &PKCS_ECDSA_P256_SHA256);
        fabric.list("list.pem", 60, &[serial]);
        let path = |name: &str| fleet.path().join("fabric").join(name).display().to_string();
        let person = [&path("salma"), "Org3", "--msp", &path("MSP")];
        self.run(&fleet.ctl(), "network add-org --check", &person);
        self.agree((boss, owner), "network add-org", &["Org3", "--msp", &path("MSP")]);
        let known = boss.json(&["network", "organisations"]);
        let fingerprint = known[0]["roots"][0]["fingerprint"].as_str().unwrap();
        for name in ["salma", "chief"] {
            let (certificate, key) =
                (path(&format!("{name}/signcerts/cert.pem")), path(&format!("{name}/keystore/priv_sk")));
            let paths = ["--cert", &certificate, "--key", &key];
            let rest = [&paths[..], &["--node", node, "--ca-fingerprint", fingerprint, "--context", name]].concat();
            self.run(&fleet.ctl(), "identity import", &rest);
        }
        let chief = fleet.ctl().as_("chief");
        self.run(&chief, "identity crl FILE", &[&path("list.pem")]);
        self.run(&chief, "identity crl --when-ended", &["refuse"]);
        self.run(&chief, "identity crl", &[]);
        self.run(&chief, "identity revoke PERSON", &["salma"]);
        self.agree((boss, owner), "network remove-organisation", &["Org3"]);
    }
}

/// Plays the story.
pub(super) fn play(it: &mut Printed) {
    let fleet = Fleet::found(1);
    fleet.issue("Org1", "Boss", Role::Admin, &[]);
    fleet.owner();
    let (boss, owner) = (fleet.ctl().as_("Boss"), fleet.ctl().as_("Admin"));
    let place = &fleet.nodes[0];
    let mut first = place.start();
    let invited = it.succeed(&boss, "network invite --node", &["second"]);
    let newcomer = Newcomer::new(&fleet, "second");
    newcomer.join(invited["token"].as_str().unwrap()).ok();
    let mut second = newcomer.run("second", &fleet);
    it.carry(&boss, [&place.name, "second"], fleet.path());
    it.agree((&boss, &owner), "network promote", &["second"]);
    // The new voter catches up, and a leader hands over once it has led for a while.
    it.succeed(&boss, "network transfer", &["second"]);
    it.succeed(&boss, "network demote", &["second"]);
    it.succeed(&boss, "network remove", &["second"]);
    it.run(&boss, "network invite --organisation", &["Org4"]);
    it.move_people((&boss, &owner), (&fleet, &place.address));
    for node in [&mut first, &mut second] {
        node.no_panic();
    }
    first.interrupt();
}
