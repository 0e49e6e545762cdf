//! `bridge export-sros2`: files by which SROS2 lets nobody but a relay of the bridge use what the bridge guards.

use super::keystore::enclaves;
use super::policy::{Enclave, governance, path, policy};
use crate::argument::domain;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::{Facts, Output, Table, warn};
use crate::session::{ABAC, Session};
use crate::time;
use ledger_base::moment::rfc3339_seconds;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::RobotAsset;
use ros_bridge::config::PROGRAM_SECTIONS;
use ros_bridge::names::Interface;
use ros_bridge::{Config, Guarded, context_of};
use serde::Serialize;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// How long permissions count; certificates of SROS2 count as long.
const VALID: u64 = 3650 * DAY;
/// Permissions begin so long ago: the clocks of robots may be behind.
const BEFORE: u64 = DAY;
/// In microseconds.
const DAY: u64 = 24 * 3600 * 1_000_000;
/// Stands for the keystore where none was named.
const KEYSTORE: &str = "KEYSTORE";

/// Write SROS2 permissions that close a robot's side door.
///
/// In the robot's secured domain, only the enclave of a relay may publish on the topics that the bridge delivers, call
/// the robot's services, and send its goals. All other enclaves keep their other permissions. The bridge itself joins
/// no secured domain: it delivers in a separate domain, and the relay forwards from there.
///
/// The files contain no secrets. Sign them with `ros2 security` or openssl; the command prints how.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ledgerctl bridge export-sros2 --config bridge.toml --keystore ~/sros2_keystore
  ledgerctl bridge export-sros2 --config bridge.toml --enclave /base --enclave /lidar --domain 7 --to sros2")]
pub(crate) struct ExportSros2 {
    /// Configuration of the robot's bridge
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Another enclave in the robot's domain
    #[arg(long = "enclave", value_name = "PATH", value_parser = path)]
    enclaves: Vec<String>,
    /// Use all enclaves of this keystore; only their names are read
    #[arg(long, value_name = "DIR")]
    keystore: Option<PathBuf>,
    /// Enclave of the relay
    #[arg(long, value_name = "PATH", value_parser = path, default_value = "/ledgerd_relay")]
    relay: String,
    /// Secured domain of the robot
    #[arg(long, value_name = "N", value_parser = domain::parse, default_value = "0")]
    domain: u16,
    /// Directory for the files
    #[arg(long, value_name = "DIR", default_value = "sros2")]
    to: PathBuf,
    /// Replace existing files
    #[arg(long)]
    force: bool,
}

/// The files that were written, and the next steps with them.
#[derive(Serialize)]
struct Exported {
    relay: String,
    domain: u16,
    guarded: Vec<Door>,
    /// The enclaves that may not use it.
    denied: Vec<String>,
    files: Vec<PathBuf>,
    /// With the tools of ROS 2.
    ros2: Vec<String>,
    /// Without them.
    openssl: Vec<String>,
}

#[derive(Serialize)]
struct Door {
    name: String,
    kind: &'static str,
    service: String,
}

impl ExportSros2 {
    pub(crate) async fn run(self, global: &Global, output: &mut Output) -> Result<(), Failure> {
        let config = Config::load(&self.config, |root| root.ignore(&PROGRAM_SECTIONS));
        // The first fault names its line.
        let config = config.map_err(|faults| faults.into_iter().next().map_or_else(not_usable, Rejection::from))?;
        self.apart_from(&config)?;
        let others = self.others()?;
        let session = match &global.context {
            Some(_) => Session::open(global).await?,
            None => Session::connect(context_of(&config)?).await?,
        };
        let robots: Vec<RobotAsset> = session.list(ABAC, "robots").await?;
        let guarded = config.guarded(&robots)?;
        if guarded.is_empty() {
            return Err(nothing(&self.config).into());
        }
        let written = self.write(&guarded, &others)?;
        output.show(&self.exported(&guarded, &others, written))?;
        if others.is_empty() {
            let what = "no other enclave is named: those of `ros2 security create_enclave` may publish on every topic";
            warn(global.format(), what, "--keystore DIR, or --enclave PATH for each of them");
        }
        Ok(())
    }

    /// A bridge that is not secured hears nobody in a secured domain.
    fn apart_from(&self, config: &Config) -> Result<(), Rejection> {
        if config.domain_id.unwrap_or_default() != self.domain {
            return Ok(());
        }
        Err(Rejection::new(Code::BadConfiguration, "the bridge is in the domain to be secured")
            .found(format!("domain {} for both", self.domain))
            .wanted("a separate domain for the bridge and the relay: a bridge joins no secured domain")
            .next("domain_id in the configuration of the bridge, or --domain for the robot's"))
    }

    fn others(&self) -> Result<Vec<String>, Rejection> {
        let mut others = self.keystore.as_deref().map(enclaves).transpose()?.unwrap_or_default();
        others.extend(self.enclaves.iter().cloned());
        others.sort();
        others.dedup();
        others.retain(|other| *other != self.relay);
        Ok(others)
    }

    /// Writes the files, and answers with their paths.
    fn write(&self, guarded: &[Guarded], others: &[String]) -> Result<Vec<PathBuf>, Rejection> {
        let robot = others.iter().map(|path| Enclave::of_the_robot(path, guarded));
        let all: Vec<Enclave> = std::iter::once(Enclave::of_the_relay(&self.relay, guarded)).chain(robot).collect();
        let (from, until) = validity();
        let permissions = all.iter().map(|enclave| {
            let file = format!("enclaves{}/permissions.xml", enclave.path.trim_end_matches('/'));
            (file, enclave.permissions(self.domain, (&from, &until)))
        });
        let files = [("policy.xml", policy(&all)), ("enclaves/governance.xml", governance(self.domain))];
        let files = files.map(|(name, text)| (name.to_owned(), text)).into_iter().chain(permissions);
        let files: Vec<_> = files.map(|(name, text)| (self.to.join(name), text)).collect();
        if let Some((path, _)) = files.iter().find(|(path, _)| !self.force && path.exists()) {
            return Err(Rejection::new(Code::AlreadyExists, format!("{} exists already", path.display()))
                .found("a file that this command would replace")
                .wanted("an empty directory, or --force")
                .next("choose another directory with --to DIR, or replace the files with --force"));
        }
        files.into_iter().map(|(path, text)| put(&path, &text).map(|()| path)).collect()
    }

    fn exported(&self, guarded: &[Guarded], others: &[String], files: Vec<PathBuf>) -> Exported {
        let door = |door: &Guarded| Door {
            name: door.name.as_str().to_owned(),
            kind: door.interface.name(),
            service: door.service.clone(),
        };
        let keystore = self.keystore.as_deref().map_or_else(|| KEYSTORE.to_owned(), quoted);
        let enclaves: Vec<&String> = std::iter::once(&self.relay).chain(others).collect();
        Exported {
            relay: self.relay.clone(),
            domain: self.domain,
            guarded: guarded.iter().map(door).collect(),
            denied: others.to_vec(),
            files,
            ros2: ros2(self.domain, &keystore, &self.relay, &enclaves, &quoted(&self.to.join("policy.xml"))),
            openssl: openssl(&keystore, &enclaves, &quoted(&self.to.join("enclaves"))),
        }
    }
}

fn not_usable() -> Rejection {
    Rejection::new(Code::BadConfiguration, "the configuration is not usable")
}

fn nothing(config: &Path) -> Rejection {
    Rejection::new(Code::BadConfiguration, format!("the bridge of {} guards no topic", config.display()))
        .found("no route that delivers commands, requests or goals to a robot")
        .wanted("the configuration of a robot's bridge: from_ledger, service_client or action_client")
        .next("use the configuration of the robot's bridge; a user's bridge has no side door to close")
}

fn validity() -> (String, String) {
    let now = time::now();
    // Without the zone, as the schema of DDS Security has it.
    let text = |moment: u64| rfc3339_seconds(moment).trim_end_matches('Z').to_owned();
    (text(now.saturating_sub(BEFORE)), text(now.saturating_add(VALID)))
}

fn put(path: &Path, text: &str) -> Result<(), Rejection> {
    let failed = |error: io::Error| {
        Rejection::new(Code::BadFile, format!("cannot write {}", path.display()))
            .found(error.to_string())
            .next("choose another directory with --to DIR")
    };
    path.parent().map_or(Ok(()), std::fs::create_dir_all).map_err(failed)?;
    ledger_base::durable::replace(path, text.as_bytes(), ledger_base::durable::PUBLIC_MODE)
}

/// The commands with the tools of ROS 2.
fn ros2(domain: u16, keystore: &str, relay: &str, enclaves: &[&String], policy: &str) -> Vec<String> {
    let before = [
        format!("export ROS_DOMAIN_ID={domain}"),
        format!("ros2 security create_keystore {keystore}"),
        format!("ros2 security create_enclave {keystore} {relay}"),
    ];
    let each = enclaves.iter().map(|enclave| format!("ros2 security create_permission {keystore} {enclave} {policy}"));
    before.into_iter().chain(each).collect()
}

/// The commands without them, in a keystore that has keys and certificates already.
fn openssl(keystore: &str, enclaves: &[&String], written: &str) -> Vec<String> {
    let sign = |file: &str| {
        let (public, private) = (format!("{keystore}/public"), format!("{keystore}/private"));
        format!(
            "openssl smime -sign -text -in {keystore}/enclaves{file}.xml -out {keystore}/enclaves{file}.p7s \
             -signer {public}/permissions_ca.cert.pem -inkey {private}/permissions_ca.key.pem"
        )
    };
    let each = enclaves.iter().map(|enclave| sign(&format!("{}/permissions", enclave.trim_end_matches('/'))));
    let before = [format!("cp -r {written}/. {keystore}/enclaves"), sign("/governance")];
    before.into_iter().chain(each).collect()
}

/// A path as a word of a shell.
fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let is_plain = text.chars().all(|c| c.is_ascii_alphanumeric() || "/._-~".contains(c));
    if is_plain { text } else { format!("'{}'", text.replace('\'', r"'\''")) }
}

impl Facts for Exported {
    fn text(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "In domain {}, only {} may", self.domain, self.relay)?;
        let mut table = Table::pairs();
        for Door { name, kind, service } in &self.guarded {
            let verb = match *kind {
                kind if kind == Interface::Service.name() => "call",
                kind if kind == Interface::Action.name() => "set goals of",
                _ => "publish on",
            };
            table.pair(verb, format!("{name}, for {service}"));
        }
        table.write(out, 2)?;
        if !self.denied.is_empty() {
            writeln!(out, "These may do everything else: {}", self.denied.join(", "))?;
        }
        writeln!(out, "Written:")?;
        self.files.iter().try_for_each(|file| writeln!(out, "  {}", file.display()))?;
        writeln!(out, "Sign with the ROS 2 tools:")?;
        self.ros2.iter().try_for_each(|line| writeln!(out, "  {line}"))?;
        writeln!(out, "Or, in a keystore whose enclaves have keys:")?;
        self.openssl.iter().try_for_each(|line| writeln!(out, "  {line}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_with_spaces_is_one_word_of_a_shell() {
        assert_eq!(quoted(Path::new("/home/me/sros2_keystore")), "/home/me/sros2_keystore");
        assert_eq!(quoted(Path::new("a b")), "'a b'");
        assert_eq!(quoted(Path::new("it's")), r"'it'\''s'");
    }

    #[test]
    fn permissions_count_from_yesterday_as_xml_writes_it() {
        let (from, until) = validity();
        assert!(from < until && from.len() == "2026-11-25T10:00:00".len() && from.contains('T'), "{from} {until}");
    }
}
