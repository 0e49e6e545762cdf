//! `ledgerctl bridge export-sros2` with real key material, in a keystore as `ros2 security` makes it. Every process is Fast DDS, the DDS
//! of `rmw_fastrtps`, with DDS Security.

use crate::network;
use crate::peer::fast_dds;
use crate::python::Python;
use crate::support::programs;
use crate::world::{self, World, route};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

const TYPE: &str = "geometry_msgs/msg/Twist";
const TOPIC: &str = "rt/cmd_vel";
/// The domain of the robot that SROS2 secures; the bridge is in another one.
const DOMAIN: u16 = 9;
/// More than a test has time for.
const MANY: (u32, u32) = (100_000, 50);

/// The rights of an enclave that `ros2 security create_enclave` has just made.
const EVERYTHING: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<dds><permissions><grant name="PATH"><subject_name>CN=PATH</subject_name>
<validity><not_before>2020-01-01T00:00:00</not_before><not_after>2100-01-01T00:00:00</not_after></validity>
<allow_rule><domains><id>9</id></domains>
<publish><topics><topic>rt/*</topic></topics></publish><subscribe><topics><topic>rt/*</topic></topics></subscribe>
</allow_rule><default>DENY</default></grant></permissions></dds>
"#;

/// Fast DDS with DDS Security, and the files of an enclave; or without both.
fn secured(enclave: Option<&Path>, role: &str, domain: u16, topic: &str, (count, about): (u32, u32)) -> Python {
    let mut command = Command::new(fast_dds());
    command.args([role, &domain.to_string(), topic, &count.to_string(), &about.to_string(), "0"]);
    enclave.map(|enclave| command.env("STREAM_ENCLAVE", enclave));
    Python::run(command)
}

/// A keystore of SROS2.
struct Keystore(PathBuf);

impl Keystore {
    fn new(place: &Path) -> Self {
        let keystore = Self(place.join("sros2 keystore"));
        for directory in ["public", "private", "enclaves"] {
            fs::create_dir_all(keystore.0.join(directory)).unwrap();
        }
        keystore.run("openssl ecparam -name prime256v1 -genkey -noout -out private/ca.key.pem");
        keystore.run("openssl req -new -x509 -sha256 -key private/ca.key.pem -subj /CN=sros2CA -days 3650 -out public/ca.cert.pem");
        for name in ["identity_ca", "permissions_ca"] {
            keystore
                .run(&format!("ln -s ca.cert.pem public/{name}.cert.pem && ln -s ca.key.pem private/{name}.key.pem"));
        }
        keystore
    }

    /// Runs a command in the keystore.
    fn run(&self, command: &str) {
        let done = Command::new("sh").args(["-c", command]).current_dir(&self.0).output().unwrap();
        assert!(done.status.success(), "{command}: {}", String::from_utf8_lossy(&done.stderr));
    }

    /// The directory of a new enclave, with a key, a certificate, and every right.
    fn enclave(&self, name: &str) -> PathBuf {
        let at = format!("enclaves/{name}");
        let (place, subject) = (self.0.join(&at), format!("-subj '/CN=\\/{name}'"));
        fs::create_dir(&place).unwrap();
        self.run(&format!("openssl ecparam -name prime256v1 -genkey -noout -out {at}/key.pem"));
        self.run(&format!("openssl req -new -sha256 -key {at}/key.pem {subject} -out {at}/request.pem"));
        let by = "-CA public/ca.cert.pem -CAkey private/ca.key.pem -CAcreateserial -days 365";
        self.run(&format!("openssl x509 -req -sha256 -in {at}/request.pem {by} -out {at}/cert.pem"));
        fs::write(place.join("permissions.xml"), EVERYTHING.replace("PATH", &format!("/{name}"))).unwrap();
        let links = ["public/identity_ca.cert.pem", "public/permissions_ca.cert.pem", "enclaves/governance.p7s"];
        links.iter().for_each(|link| self.run(&format!("ln -s ../../{link} {at}/")));
        place
    }
}

/// Exports for the robot's bridge, and answers with what the command says.
fn export(world: &World, keystore: &Keystore, to: &Path, more: &[&str]) -> Result<serde_json::Value, String> {
    export_in(world, keystore, to, DOMAIN, more)
}

/// The same for a robot in another domain.
fn export_in(
    world: &World,
    keystore: &Keystore,
    to: &Path,
    domain: u16,
    more: &[&str],
) -> Result<serde_json::Value, String> {
    let config = world.config_of("Rover", &format!("domain_id = 3\n{}", route("from_ledger", "/cmd_vel", TYPE)));
    let mut command = Command::new(programs::ledgerctl());
    command.args(["bridge", "export-sros2", "-o", "json", "--domain", &domain.to_string(), "--config"]).arg(config);
    command.arg("--keystore").arg(&keystore.0).arg("--to").arg(to).args(more);
    let done = command.env("LEDGERD_HOME", world.path("home")).output().unwrap();
    let said = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    if done.status.success() { Ok(serde_json::from_str(&said(done.stdout)).unwrap()) } else { Err(said(done.stderr)) }
}

/// The number of the next sample; the robot says in between that it has found a publisher.
fn heard(robot: &mut Python) -> Option<u32> {
    loop {
        let line = line(robot)?;
        if line != "matched" {
            return line.split_once(' ')?.0.parse().ok();
        }
    }
}

/// DDS refuses a process. One that ended without a word proves nothing, and is started again.
fn check_refused(start: impl Fn() -> Python, what: &str) {
    let said = (0..3).find_map(|_| line(&mut start()));
    assert!(said.as_ref().is_some_and(|line| line.starts_with("refused")), "{what}: {said:?}");
}

/// The next line that the program itself prints. Fast DDS prints in colours what it finds of processes that were killed.
fn line(process: &mut Python) -> Option<String> {
    loop {
        let line = process.line()?;
        if !line.starts_with('\u{1b}') {
            return Some(line);
        }
    }
}

/// A publisher that has found its reader. Two participants of Fast DDS now and then lose a message of their handshake for good,
/// so it is started again.
fn matched(start: impl Fn() -> Python) -> Python {
    let found = |publisher: &mut Python| line(publisher).as_deref() == Some("matched");
    let mut tries = (0..4).map(|_| start());
    tries.find_map(|mut publisher| found(&mut publisher).then_some(publisher)).expect("a reader is found")
}

#[test]
fn with_the_exported_policies_nobody_but_the_relay_publishes_to_the_robot() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        let keystore = Keystore::new(&world.path("home"));
        let [base, lidar, relay] = ["base", "lidar", "ledgerd_relay"].map(|name| keystore.enclave(name));
        let to = world.path("home").join("exported");
        let exported = export(&world, &keystore, &to, &[]).unwrap();
        assert_eq!(exported["denied"], serde_json::json!(["/base", "/lidar"]));
        assert_eq!(exported["guarded"][0]["name"], "/cmd_vel");
        let commands: Vec<&str> =
            exported["openssl"].as_array().unwrap().iter().map(|command| command.as_str().unwrap()).collect();

        // So far the lidar may do everything, as `create_enclave` leaves it: with the files signed that are there.
        let before: Vec<PathBuf> = [&base, &lidar, &relay].map(|enclave| enclave.join("permissions.xml")).into();
        let kept: Vec<String> = before.iter().map(|path| fs::read_to_string(path).unwrap()).collect();
        keystore.run(commands[0]);
        before.iter().zip(&kept).for_each(|(path, text)| fs::write(path, text).unwrap());
        commands[1..].iter().for_each(|command| keystore.run(command));
        let mut robot = secured(Some(&base), "sub", DOMAIN, TOPIC, (0, 90));
        assert_eq!(line(&mut robot).as_deref(), Some("ready"));
        let rogue = matched(|| secured(Some(&lidar), "pub", DOMAIN, TOPIC, MANY));
        assert!(heard(&mut robot).is_some(), "the robot obeys the lidar");
        drop((robot, rogue));

        // Now the exported ones.
        commands.iter().for_each(|command| keystore.run(command));
        let mut robot = secured(Some(&base), "sub", DOMAIN, TOPIC, (0, 90));
        assert_eq!(line(&mut robot).as_deref(), Some("ready"));
        let _stranger = secured(None, "pub", DOMAIN, TOPIC, MANY);
        check_refused(|| secured(Some(&lidar), "pub", DOMAIN, TOPIC, MANY), "the lidar may not publish any more");
        check_refused(|| secured(Some(&base), "pub", DOMAIN, TOPIC, MANY), "nor may the base itself");
        let bridge = matched(|| secured(Some(&relay), "pub", DOMAIN, TOPIC, MANY));
        // Numbers of somebody else would stand between these. A slow robot misses some.
        let mut last = None;
        while last < Some(150) {
            let number = heard(&mut robot);
            assert!(number > last, "nobody else is heard: {number:?} after {last:?}");
            last = number;
        }
        drop(bridge);

        // The relay does nothing but that.
        check_refused(|| secured(Some(&relay), "pub", DOMAIN, "rt/scan", MANY), "another topic");
        check_refused(|| secured(Some(&relay), "sub", DOMAIN, "rt/scan", (0, 90)), "hearing another topic");
    });
}

#[test]
fn an_export_that_would_close_nothing_or_replace_a_file_is_refused() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TYPE).await;
        let keystore = Keystore::new(&world.path("home"));
        let to = world.path("home").join("exported");
        let refused = export_in(&world, &keystore, &to, 3, &[]).unwrap_err();
        assert!(refused.contains("in the domain to be secured"), "{refused}");
        export(&world, &keystore, &to, &[]).unwrap();
        let again = export(&world, &keystore, &to, &[]).unwrap_err();
        assert!(again.contains("ALREADY_EXISTS") && again.contains("--force"), "{again}");
        export(&world, &keystore, &to, &["--force"]).unwrap();
        let none = export(&world, &Keystore(world.path("net")), &to, &["--force"]).unwrap_err();
        assert!(none.contains("is not an SROS2 keystore"), "{none}");
    });
}
