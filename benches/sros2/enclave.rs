//! Key material as `ros2 security` makes it: one CA for identities and permissions, and a directory for each enclave. OpenSSL
//! signs, as SROS2 lets it.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;
use tempfile::TempDir;

/// The rights that SROS2 gives by default: everything is authenticated, encrypted and has permissions (OMG DDS Security 1.1 §9.4.1.2).
const GOVERNANCE: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<dds><domain_access_rules><domain_rule>
<domains><id_range><min>0</min><max>230</max></id_range></domains>
<allow_unauthenticated_participants>false</allow_unauthenticated_participants>
<enable_join_access_control>true</enable_join_access_control>
<discovery_protection_kind>ENCRYPT</discovery_protection_kind>
<liveliness_protection_kind>ENCRYPT</liveliness_protection_kind>
<rtps_protection_kind>SIGN</rtps_protection_kind>
<topic_access_rules><topic_rule>
<topic_expression>*</topic_expression>
<enable_discovery_protection>true</enable_discovery_protection>
<enable_liveliness_protection>true</enable_liveliness_protection>
<enable_read_access_control>true</enable_read_access_control>
<enable_write_access_control>true</enable_write_access_control>
<metadata_protection_kind>ENCRYPT</metadata_protection_kind>
<data_protection_kind>ENCRYPT</data_protection_kind>
</topic_rule></topic_access_rules>
</domain_rule></domain_access_rules></dds>
"#;

/// The right of an enclave on `/cmd_vel`.
#[derive(Clone, Copy)]
pub(crate) enum Right {
    /// It drives.
    Publish,
    /// It is driven.
    Subscribe,
}

/// A keystore with its CA.
pub(crate) struct Keystore(TempDir);

impl Keystore {
    /// Makes the CA, and signs the governance.
    pub(crate) fn new() -> Self {
        let store = Self(tempfile::tempdir().unwrap());
        store.openssl("ecparam -name prime256v1 -genkey -noout -out ca.key.pem");
        store.openssl("req -new -x509 -sha256 -key ca.key.pem -subj /CN=sros2CA -days 3650 -out ca.cert.pem");
        std::fs::write(store.path().join("governance.xml"), GOVERNANCE).unwrap();
        store.sign("governance");
        store
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    fn openssl(&self, arguments: &str) {
        let mut command = Command::new("openssl");
        let done = command.args(arguments.split(' ')).current_dir(self.path()).output().expect("openssl starts");
        assert!(done.status.success(), "openssl {arguments}: {}", String::from_utf8_lossy(&done.stderr));
    }

    fn sign(&self, name: &str) {
        self.openssl(&format!(
            "smime -sign -text -in {name}.xml -out {name}.p7s -signer ca.cert.pem -inkey ca.key.pem"
        ));
    }

    /// The files of a new enclave with one right, for ever or for so long.
    pub(crate) fn enclave(&self, name: &str, right: Right, lasts: Option<Duration>) -> PathBuf {
        let place = self.path().join(name);
        std::fs::create_dir(&place).unwrap();
        self.openssl(&format!("ecparam -name prime256v1 -genkey -noout -out {name}/key.pem"));
        self.openssl(&format!("req -new -sha256 -key {name}/key.pem -subj /CN={name} -out {name}/request.pem"));
        self.openssl(&format!(
            "x509 -req -sha256 -in {name}/request.pem -CA ca.cert.pem -CAkey ca.key.pem -CAcreateserial -days 365 -out {name}/cert.pem"
        ));
        std::fs::write(place.join("permissions.xml"), permissions(name, right, lasts)).unwrap();
        self.sign(&format!("{name}/permissions"));
        for (from, to) in [
            ("ca.cert.pem", "identity_ca.cert.pem"),
            ("ca.cert.pem", "permissions_ca.cert.pem"),
            ("governance.p7s", "governance.p7s"),
        ] {
            std::fs::copy(self.path().join(from), place.join(to)).unwrap();
        }
        place
    }
}

fn permissions(name: &str, right: Right, lasts: Option<Duration>) -> String {
    let right = match right {
        Right::Publish => "publish",
        Right::Subscribe => "subscribe",
    };
    let until = lasts.unwrap_or(Duration::from_secs(365 * 86400)).as_secs();
    let mut date = Command::new("date");
    let told = date.args(["-u", &format!("-d+{until} seconds"), "+%Y-%m-%dT%H:%M:%S"]).output().expect("date starts");
    let until = String::from_utf8(told.stdout).unwrap().trim().to_owned();
    format!(
        r#"<?xml version="1.0" encoding="UTF-8"?>
<dds><permissions><grant name="/{name}">
<subject_name>CN={name}</subject_name>
<validity><not_before>2020-01-01T00:00:00</not_before><not_after>{until}</not_after></validity>
<allow_rule><domains><id_range><min>0</min><max>230</max></id_range></domains>
<{right}><topics><topic>rt/cmd_vel</topic></topics></{right}></allow_rule>
<default>DENY</default>
</grant></permissions></dds>
"#
    )
}
