//! `ledgerd init`: founds a network of one organisation with one node, and invites its first admin.

use super::settings::{Settings, public_address};
use super::{NetworkPlan, PlannedNode, PlannedOrganisation, found_for};
use crate::process::clock::wall;
use crate::process::config::{Config, MemberOf};
use crate::trust::ca::CertificateAuthority;
use crate::trust::membership::way_back;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shell;
use ledger_identity::Role;
use ledger_identity::key::KeyKind;
use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

/// The arguments of `ledgerd init`.
#[derive(Clone, Debug, clap::Args)]
pub struct InitOptions {
    /// The node's configuration; created with all defaults if it does not exist.
    #[arg(long, value_name = "FILE", default_value = "ledgerd.toml")]
    pub config: PathBuf,
    /// Name of the founding organisation, e.g. Org1.
    #[arg(long, value_name = "NAME")]
    pub organisation: String,
    /// Name of the network for people; by default that of the organisation.
    #[arg(long, value_name = "TEXT")]
    pub label: Option<String>,
    /// Name of the node.
    #[arg(long, value_name = "NAME", default_value = "node1")]
    pub node: String,
    /// Address under which clients and other nodes reach the node; by default the setting `listen`.
    #[arg(long, value_name = "HOST:PORT")]
    pub address: Option<String>,
    /// Kind of key of the organisation's CA: ed25519, p256 or p384.
    #[arg(long, value_name = "KIND", default_value_t = KeyKind::Ed25519)]
    pub key: KeyKind,
    /// Name of the first admin, who gets a one-time secret.
    #[arg(long, value_name = "NAME", default_value = "admin")]
    pub admin: String,
}

/// Founds the network; answers with what to tell the user.
///
/// # Errors
/// A fault of the configuration, an address that others cannot reach, and what [`super::found`] says. Nothing is left behind.
pub fn init(options: &InitOptions) -> Result<String, Rejection> {
    let mut settings = Settings::of(&options.config, options.address.as_deref(), None, None)?;
    check_free(&settings.config)?;
    let written = settings.write(&options.config)?;
    let founded = init_at(options, &settings.config, wall()).inspect_err(|_| {
        if written {
            let _ = fs::remove_file(&options.config);
        }
    })?;
    let InitOptions { organisation, node, .. } = options;
    let hint = settings.name(founded.network, &format!("{organisation}/{node}"), &founded.address);
    settings.write_again(&options.config)?;
    Ok(founded.told + &hint)
}

/// A configuration of a node that has lost its data must not found another network by mistake.
fn check_free(config: &Config) -> Result<(), Rejection> {
    let MemberOf { network, node, .. } = &config.member;
    // Where there are data, that is what is told.
    if (network.is_empty() && node.is_empty()) || config.data.exists() {
        return Ok(());
    }
    let file = config.file.display();
    Err(Rejection::new(Code::BadConfiguration, format!("{file} belongs to a network that was founded before"))
        .found(format!("node {node} of network {network}, in the section [member]"))
        .wanted("a configuration without a network, because this command creates a new one")
        .next(format!(
            "to bring that node back: {}; to create another network, choose another file with --config",
            way_back(config, node)
        )))
}

/// A network that was founded.
struct Begun {
    network: Hash,
    /// Where others reach its node.
    address: String,
    /// The text that the user reads.
    told: String,
}

fn init_at(options: &InitOptions, config: &Config, now: u64) -> Result<Begun, Rejection> {
    let path = shell::path(&options.config);
    let address = public_address(options.address.as_deref(), &config.listen, "ledgerd init")?;
    let organisation = &options.organisation;
    let plan = NetworkPlan {
        snapshot_every: ledger::network::SNAPSHOT_EVERY_DEFAULT,
        label: options.label.clone().unwrap_or_else(|| organisation.clone()),
        organisations: vec![PlannedOrganisation { name: organisation.clone(), key: options.key }],
        nodes: vec![PlannedNode {
            name: options.node.clone(),
            organisation: organisation.clone(),
            data: config.data.clone(),
            address: address.clone(),
            voter: true,
        }],
    };
    let founded = found_for(&plan, config.ca.certificate_days, now)?;
    let secret = invite(options, config, &founded.authorities, now).inspect_err(|_| {
        let _ = fs::remove_dir_all(&config.data);
    })?;
    let fingerprint = founded.authorities.first().map(|ca| ca.fingerprint).unwrap_or_default();
    let InitOptions { node, admin, .. } = options;
    let told = format!(
        "network {:?} is created: {}\nnode     {organisation}/{node} at {address}, data in {}\nCA       \
         {organisation}, sha256 {fingerprint}\nadmin    {organisation}/{admin}, to enrol within {} days\n\nnext:\n  \
         ledgerd run --config {path}\n  ledgerctl enroll {admin} --node {address} --ca-fingerprint {fingerprint} \
         --secret {secret}\n  ledgerctl identity register NAME --attr KEY=VALUE",
        plan.label,
        founded.network,
        config.data.display(),
        config.ca.secret_days,
    );
    Ok(Begun { network: founded.network, address, told })
}

/// Registers the first admin; answers with the one-time secret.
fn invite(
    options: &InitOptions,
    config: &Config,
    authorities: &[super::FoundedAuthority],
    now: u64,
) -> Result<String, Rejection> {
    let authority = authorities.first().ok_or_else(|| Rejection::new(Code::Internal, "no CA was created"))?;
    let mut authority = CertificateAuthority::open(&authority.directory)?;
    authority.set_days(config.ca.certificate_days, config.ca.secret_days);
    authority.register(&options.admin, Role::Admin, BTreeMap::new(), now)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::trust::ca;
    use rustls_pki_types::CertificateDer;
    use rustls_pki_types::pem::PemObject;
    use std::path::Path;
    use tempfile::TempDir;

    const NOW: u64 = 1_800_000_000_000_000;

    fn options(place: &Path) -> InitOptions {
        InitOptions {
            config: place.join("ledgerd.toml"),
            organisation: "Org1".into(),
            label: None,
            node: "node1".into(),
            address: None,
            key: KeyKind::Ed25519,
            admin: "admin".into(),
        }
    }

    fn entries(place: &Path) -> usize {
        fs::read_dir(place).unwrap().count()
    }

    #[test]
    fn without_a_configuration_one_is_written_and_the_network_stands_beside_it() {
        let place = TempDir::new().unwrap();
        let text = init(&options(place.path())).unwrap();
        let config = Config::load(&place.path().join("ledgerd.toml")).unwrap();
        assert_eq!(config.data, place.path().join("data"));
        let authorities = CertificateAuthority::open_all(&config.data).unwrap();
        let ca = authorities.first().unwrap();
        assert!(text.contains(&format!("--ca-fingerprint {}", ca.fingerprint())), "{text}");
        assert_eq!(ca.identity("admin").unwrap().role, Role::Admin);
    }

    #[test]
    fn a_configuration_that_was_there_stays_as_it_is_and_the_user_is_told_what_it_lacks() {
        let place = TempDir::new().unwrap();
        let options = options(place.path());
        let own = "# mine\ndata = 'data'\nlisten = '127.0.0.1:7450'\n";
        fs::write(&options.config, own).unwrap();
        let told = init(&options).unwrap();
        assert_eq!(fs::read_to_string(&options.config).unwrap(), own);
        let (_, lacking) = told.split_once("  [member]\n").unwrap();
        for line in ["  network = \"", "  node = \"Org1/node1\"\n", "  address = \"127.0.0.1:7450\"\n"] {
            assert!(lacking.contains(line), "{told}");
        }
    }

    #[test]
    fn a_configuration_that_is_written_listens_where_the_address_leads() {
        for (address, listen) in [
            ("127.0.0.1:17450", "127.0.0.1:17450"),
            ("robot-1.fleet.example:17450", "0.0.0.0:17450"),
            ("10.0.0.4:7450", "0.0.0.0:7450"),
            ("[fd00::5]:7450", "[::]:7450"),
            ("[::1]:7450", "[::1]:7450"),
            ("localhost:17450", "127.0.0.1:17450"),
            ("Localhost:17450", "127.0.0.1:17450"),
        ] {
            let place = TempDir::new().unwrap();
            let options = InitOptions { address: Some(address.into()), ..options(place.path()) };
            init(&options).unwrap();
            assert_eq!(Config::load(&options.config).unwrap().listen, listen);
        }
    }

    #[test]
    fn the_secret_that_is_told_enrols_the_admin_within_the_configured_days() {
        let place = TempDir::new().unwrap();
        let options = options(place.path());
        fs::write(&options.config, "data = 'd'\n[ca]\nsecret_days = 2\n").unwrap();
        let config = Config::load(&options.config).unwrap();
        let text = init_at(&options, &config, NOW).unwrap().told;
        let secret = text.split_once("--secret ").unwrap().1.lines().next().unwrap();
        let mut ca = CertificateAuthority::open(&place.path().join("d").join(ca::DIRECTORY).join("Org1")).unwrap();
        let key = ledger_identity::key::SigningKey::generate(KeyKind::P256, &ring::rand::SystemRandom::new()).unwrap();
        let request = ca::request(&key, "admin").unwrap();
        assert!(ca.enrol("admin", secret, &request, NOW + 2 * ca::DAY + 1).is_err());
        assert!(ca.enrol("admin", secret, &request, NOW + 2 * ca::DAY).is_ok());
    }

    #[test]
    fn the_certificate_of_the_founding_node_is_valid_for_the_configured_days() {
        let place = TempDir::new().unwrap();
        let options = options(place.path());
        fs::write(&options.config, "data = 'd'\n[ca]\ncertificate_days = 2\n").unwrap();
        init_at(&options, &Config::load(&options.config).unwrap(), NOW).unwrap();
        let chain = CertificateDer::pem_file_iter(place.path().join("d").join(super::super::CERTIFICATE_FILE)).unwrap();
        let own = chain.map(Result::unwrap).next().unwrap();
        let own = ledger_identity::certificate::Certificate::parse(&own).unwrap();
        assert_eq!(own.not_after / 1_000_000, (NOW + 2 * ca::DAY) / 1_000_000);
    }

    #[test]
    fn a_failure_leaves_nothing_behind() {
        let place = TempDir::new().unwrap();
        for spoil in [
            |options: &mut InitOptions| options.admin = "a/b".into(),
            |options: &mut InitOptions| options.organisation = "..".into(),
            |options: &mut InitOptions| options.admin = "node1".into(),
            |options: &mut InitOptions| options.address = Some("0.0.0.0:7450".into()),
            |options: &mut InitOptions| options.address = Some("[::]:7450".into()),
            |options: &mut InitOptions| options.address = Some("localhost:0".into()),
            |options: &mut InitOptions| options.address = Some("localhost".into()),
        ] {
            let mut options = options(place.path());
            spoil(&mut options);
            assert!(init(&options).is_err(), "{options:?}");
            assert_eq!(entries(place.path()), 0, "{options:?}");
        }
    }

    #[test]
    fn a_second_time_is_refused_and_changes_nothing() {
        let place = TempDir::new().unwrap();
        let options = options(place.path());
        init(&options).unwrap();
        let genesis = fs::read(place.path().join("data").join(super::super::GENESIS_FILE)).unwrap();
        assert_eq!(init(&options).unwrap_err().code, Code::BadFile);
        assert_eq!(fs::read(place.path().join("data").join(super::super::GENESIS_FILE)).unwrap(), genesis);
        assert!(options.config.exists());
    }

    #[test]
    fn the_configuration_of_a_node_whose_data_are_lost_founds_no_other_network() {
        let place = TempDir::new().unwrap();
        let options = options(place.path());
        init(&options).unwrap();
        let config = Config::load(&options.config).unwrap();
        assert_eq!((config.member.node.as_str(), config.member.network.len()), ("Org1/node1", 64));
        fs::remove_dir_all(&config.data).unwrap();
        let refused = init(&options).unwrap_err();
        assert_eq!(refused.code, Code::BadConfiguration);
        assert!(refused.advice().contains("ledgerctl network invite --node node1"), "{refused}");
        assert!(
            refused.advice().contains(&format!("ledgerd join TOKEN --config {}", options.config.display())),
            "{refused}"
        );
        assert!(!config.data.exists());
    }

    #[test]
    fn a_faulty_configuration_is_refused_with_the_way_to_see_all_faults() {
        let place = TempDir::new().unwrap();
        let options = options(place.path());
        fs::write(&options.config, "a = 1\nb = 2\n").unwrap();
        let refused = init(&options).unwrap_err();
        assert!(refused.advice().contains("names all 2 faults"), "{refused}");
        assert!(options.config.exists());
    }
}
