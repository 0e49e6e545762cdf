//! Authorities and lists as OpenSSL makes them: what it verifies and what is verified here, algorithm by algorithm and name by name.

use ledger_identity::certificate::Certificate;
use ledger_identity::msp::{Msp, Msps};
use ledger_identity::{Identity, IdentityError};
use std::fs;
use std::path::PathBuf;
use std::process::Command;
use std::time::SystemTime;
use tempfile::TempDir;

const NONE: &[Vec<u8>] = &[];

/// Every section that a test names.
const CONFIG: &str = "\
[req]
distinguished_name = dn
prompt = no
string_mask = MASK
[dn]
[ca]
default_ca = lists
[lists]
database = index.txt
crlnumber = number
default_crl_days = 7
default_md = sha256
[plain]
basicConstraints = critical, CA:TRUE
keyUsage = critical, keyCertSign, cRLSign
[person]
keyUsage = critical, digitalSignature
[policies]
basicConstraints = critical, CA:TRUE
keyUsage = critical, keyCertSign, cRLSign
certificatePolicies = critical, 1.3.6.1.4.1.99999.1
[require]
basicConstraints = critical, CA:TRUE
policyConstraints = critical, requireExplicitPolicy:0
[unknown]
basicConstraints = critical, CA:TRUE
1.2.3.4 = critical, DER:0500
[servers]
basicConstraints = critical, CA:TRUE
extendedKeyUsage = serverAuth
[directory]
basicConstraints = critical, CA:TRUE
nameConstraints = critical, permitted;dirName:branch, excluded;dirName:night
[branch]
O = Sales
[night]
1.O = Sales
2.OU = Night
[hosts]
basicConstraints = critical, CA:TRUE
nameConstraints = critical, permitted;DNS:example.com, excluded;email:.example.org, permitted;IP:10.0.0.0/255.0.0.0, permitted;URI:.example.com
[whole]
authorityKeyIdentifier = keyid
[place]
issuingDistributionPoint = critical, @at_place
[at_place]
fullname = URI:http://ca.example.com/list.crl
[people]
issuingDistributionPoint = critical, @of_people
[of_people]
onlyuser = TRUE
[authorities]
issuingDistributionPoint = critical, @of_authorities
[of_authorities]
onlyCA = TRUE
[reasons]
issuingDistributionPoint = critical, @of_reasons
[of_reasons]
onlysomereasons = keyCompromise
[indirect]
issuingDistributionPoint = critical, @of_others
[of_others]
indirectCRL = TRUE
[attributes]
issuingDistributionPoint = critical, @of_attributes
[of_attributes]
onlyAA = TRUE
";

/// A directory in which OpenSSL works.
struct OpenSsl(TempDir);

impl OpenSsl {
    fn new() -> Self {
        let ssl = Self(tempfile::tempdir().unwrap());
        ssl.mask("utf8only");
        fs::write(ssl.path("index.txt"), "").unwrap();
        fs::write(ssl.path("number"), "01\n").unwrap();
        ssl
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// The string types of the names that follow.
    fn mask(&self, mask: &str) {
        fs::write(self.path("config"), CONFIG.replace("MASK", mask)).unwrap();
    }

    fn run(&self, line: &str, more: &[&str]) {
        let mut words: Vec<&str> = line.split_whitespace().collect();
        words.extend(more);
        let ran = Command::new("openssl").args(&words).current_dir(self.0.path()).output().unwrap();
        assert!(ran.status.success(), "{words:?}: {}", String::from_utf8_lossy(&ran.stderr));
    }

    fn der(&self, name: &str) -> Vec<u8> {
        pem::parse(fs::read(self.path(name)).unwrap()).unwrap().into_contents()
    }

    fn key(&self, name: &str, algorithm: &str) {
        self.run(&format!("genpkey -out {name}.key -algorithm {algorithm}"), &[]);
    }

    /// An authority that signs itself, `NAME.pem`.
    fn root(&self, name: &str, [subject, section, digest]: [&str; 3]) -> Vec<u8> {
        let line = format!(
            "req -x509 -utf8 -new -config config -days 30 -extensions {section} -key {name}.key -out {name}.pem {digest}"
        );
        self.run(&line, &["-subj", subject]);
        self.der(&format!("{name}.pem"))
    }

    /// Somebody with a key of P-256, certified by `CA.pem` with `KEY.key`.
    fn person(&self, [ca, key, digest]: [&str; 3], subject: &str, extensions: &str) -> Vec<u8> {
        if !self.path("person.key").exists() {
            self.key("person", "EC -pkeyopt ec_paramgen_curve:P-256");
        }
        self.run("req -new -utf8 -config config -key person.key -out person.csr", &["-subj", subject]);
        fs::write(self.path("extensions"), format!("keyUsage = digitalSignature\n{extensions}")).unwrap();
        let line = format!(
            "x509 -req -in person.csr -days 20 -CA {ca}.pem -CAkey {key}.key -CAcreateserial -extfile extensions -out person.pem {digest}"
        );
        self.run(&line, &[]);
        self.der("person.pem")
    }

    /// A revocation list with these extensions.
    fn list(&self, [ca, section, digest]: [&str; 3]) -> Vec<u8> {
        let line = format!(
            "ca -gencrl -config config -crlexts {section} -cert {ca}.pem -keyfile {ca}.key -out list.pem {digest}"
        );
        self.run(&line, &[]);
        self.der("list.pem")
    }
}

fn now() -> u64 {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap();
    u64::try_from(since.as_micros()).unwrap() + 1_000_000
}

fn verified(root: &[u8], person: &[u8]) -> Result<Identity, IdentityError> {
    let mut msps = Msps::new();
    msps.insert(Msp::new("Org3", &[root], NONE)?)?;
    msps.verify(person, &[], now())
}

fn entry(root: &[u8]) -> Result<(), IdentityError> {
    Msp::new("Org3", &[root], NONE)?.check_entry(None, now())
}

#[test]
fn what_openssl_signs_is_verified_in_each_supported_pair_of_key_and_hash() {
    let ssl = OpenSsl::new();
    let pss = "-sha256 -sigopt rsa_padding_mode:pss -sigopt rsa_pss_saltlen:digest -sigopt rsa_mgf1_md:sha256";
    let (rsa, p256, p384) = (
        "RSA -pkeyopt rsa_keygen_bits:2048",
        "EC -pkeyopt ec_paramgen_curve:P-256",
        "EC -pkeyopt ec_paramgen_curve:P-384",
    );
    for (name, algorithm, digests) in [
        ("rsa", rsa, &["-sha256", "-sha384", "-sha512", pss][..]),
        ("p256", p256, &["-sha256", "-sha384"]),
        ("p384", p384, &["-sha256", "-sha384"]),
        ("ed25519", "ED25519", &[""]),
    ] {
        ssl.key(name, algorithm);
        for digest in digests {
            let root = ssl.root(name, ["/O=Org3/CN=ca", "plain", digest]);
            entry(&root).unwrap();
            let person = ssl.person([name, name, digest], "/CN=Salma", "");
            assert_eq!(verified(&root, &person).unwrap().id(), "Org3/Salma", "{name} {digest}");
            let mut forged = person.clone();
            *forged.last_mut().unwrap() ^= 1;
            assert!(verified(&root, &forged).is_err(), "{name} {digest}");
            if digest.contains("sigopt") {
                continue;
            }
            let algorithm =
                if digest.is_empty() { String::new() } else { format!("-md {}", digest.trim_start_matches('-')) };
            let list = ssl.list([name, "whole", &algorithm]);
            let (list, _) = Msp::new("Org3", &[&root], NONE).unwrap().verify_list(&list).unwrap();
            assert!(list.serials.is_empty() && list.number.is_some(), "{name} {digest}");
        }
    }
}

#[test]
fn an_authority_by_which_nobody_could_sign_in_is_refused_at_the_door_with_what_it_has() {
    let ssl = OpenSsl::new();
    for (algorithm, found) in [
        ("RSA -pkeyopt rsa_keygen_bits:1024", "an RSA key of 1024 bits"),
        ("RSA-PSS -pkeyopt rsa_keygen_bits:2048", "RSA for PSS alone"),
        ("EC -pkeyopt ec_paramgen_curve:P-521", "ECDSA on P-521"),
        ("EC -pkeyopt ec_paramgen_curve:secp256k1", "ECDSA on secp256k1"),
        ("ED448", "Ed448"),
    ] {
        ssl.key("odd", algorithm);
        let refused = entry(&ssl.root("odd", ["/CN=ca", "plain", ""])).unwrap_err().to_string();
        assert!(refused.contains(found) && refused.contains("wanted a key of Ed25519"), "{refused}");
    }
    ssl.key("good", "ED25519");
    for (section, found) in [
        ("unknown", "the critical extension 1.2.3.4"),
        ("require", "the critical extension 2.5.29.36"),
        ("servers", "an extended key usage without clientAuth"),
    ] {
        let refused = entry(&ssl.root("good", ["/CN=ca", section, ""])).unwrap_err().to_string();
        assert!(refused.contains(found), "{refused}");
    }
    let root = ssl.root("good", ["/CN=ca", "plain", ""]);
    let msp = Msp::new("Org3", &[&root], NONE).unwrap();
    let later = now() + 40 * 86_400_000_000;
    assert!(matches!(msp.check_entry(None, later), Err(IdentityError::Expired { .. })));
    msp.check_entry(Some(&msp), later).unwrap();
}

#[test]
fn a_signature_that_is_not_verified_is_refused_with_its_algorithm_and_key() {
    let ssl = OpenSsl::new();
    ssl.key("p256", "EC -pkeyopt ec_paramgen_curve:P-256");
    ssl.key("rsa", "RSA -pkeyopt rsa_keygen_bits:2048");
    for (name, digest, found) in [
        ("p256", "-sha512", "ECDSA with SHA-512 by a key of ECDSA on P-256"),
        ("p256", "-sha1", "ECDSA with SHA-1 by a key of ECDSA on P-256"),
        ("rsa", "-sha1", "RSA with SHA-1 by an RSA key of 2048 bits"),
    ] {
        // How a root signs itself does not matter.
        let root = ssl.root(name, ["/CN=ca", "plain", digest]);
        entry(&root).unwrap();
        let person = ssl.person([name, name, digest], "/CN=Salma", "");
        let refused = verified(&root, &person).unwrap_err();
        assert!(matches!(refused, IdentityError::UnsupportedSignature { .. }), "{refused}");
        assert!(refused.to_string().contains(found), "{refused}");
    }
    let person = {
        ssl.key("person", "RSA -pkeyopt rsa_keygen_bits:2048");
        ssl.person(["rsa", "rsa", "-sha256"], "/CN=Salma", "")
    };
    let refused = verified(&ssl.der("rsa.pem"), &person).unwrap_err().to_string();
    assert!(refused.contains("found an RSA key of 2048 bits, wanted Ed25519 or"), "{refused}");
}

#[test]
fn policies_that_nobody_asks_for_keep_nobody_out() {
    let ssl = OpenSsl::new();
    ssl.key("ca", "ED25519");
    let root = ssl.root("ca", ["/CN=ca", "policies", ""]);
    entry(&root).unwrap();
    let person = ssl.person(["ca", "ca", ""], "/CN=Salma", "certificatePolicies = critical, 1.3.6.1.4.1.99999.1");
    verified(&root, &person).unwrap();
}

#[test]
fn an_unknown_critical_extension_is_refused_wherever_it_stands() {
    let ssl = OpenSsl::new();
    ssl.key("ca", "ED25519");
    let odd_root = ssl.root("ca", ["/CN=ca", "unknown", ""]);
    let person = ssl.person(["ca", "ca", ""], "/CN=Salma", "");
    let refused = verified(&odd_root, &person).unwrap_err();
    assert!(matches!(&refused, IdentityError::BadPath { found, .. } if found.contains("1.2.3.4")), "{refused}");
    let root = ssl.root("ca", ["/CN=ca", "plain", ""]);
    verified(&root, &person).unwrap();
    let odd = ssl.person(["ca", "ca", ""], "/CN=Salma", "1.2.3.5 = critical, DER:0500");
    let refused = verified(&root, &odd).unwrap_err();
    assert!(matches!(&refused, IdentityError::BadPath { found, .. } if found.contains("1.2.3.5")), "{refused}");
}

#[test]
fn one_name_in_another_string_type_is_the_same_issuer() {
    let ssl = OpenSsl::new();
    ssl.key("ca", "ED25519");
    let (utf8, subject) = (ssl.root("ca", ["/O=Org Drei/CN=Straße", "plain", ""]), "/CN=Jürgen");
    let issuer = Certificate::parse(&utf8).unwrap().subject_name.hash();
    // BMPString, T61String, UTF8String in another case
    for (mask, name) in [
        ("MASK:0x800", "/O=Org Drei/CN=Straße"),
        ("MASK:0x4", "/O=Org Drei/CN=Straße"),
        ("utf8only", "/O=ORG  DREI/CN=STRASSE"),
    ] {
        ssl.mask(mask);
        let other = ssl.root("ca", [name, "plain", ""]);
        assert_ne!(
            Certificate::parse(&other).unwrap().subject_name.der(),
            Certificate::parse(&utf8).unwrap().subject_name.der()
        );
        let person = verified(&utf8, &ssl.person(["ca", "ca", ""], subject, "")).unwrap();
        assert_eq!((person.id().as_str(), person.issuer), ("Org3/Jürgen", issuer.0), "{mask}");
        let msp = Msp::new("Org3", &[&utf8], NONE).unwrap();
        assert_eq!(msp.verify_list(&ssl.list(["ca", "whole", ""])).unwrap().1.name, issuer, "{mask}");
        let both = Msp::new("Org3", &[&utf8, &other], NONE).unwrap();
        let refused = both.check_entry(None, now()).unwrap_err().to_string();
        assert!(refused.contains("another spelling"), "{refused}");
        let renewed = Msp::new("Org3", &[&other], NONE).unwrap();
        assert!(renewed.check_entry(Some(&msp), now()).is_err(), "{mask}");
        let mut network = Msps::new();
        network.insert(msp).unwrap();
        let shared = network.insert(Msp::new("Org4", &[&other], NONE).unwrap()).unwrap_err();
        assert!(matches!(shared, IdentityError::SharedAuthority { .. }), "{shared}");
    }
}

#[test]
fn names_are_certified_only_by_an_authority_that_may() {
    let ssl = OpenSsl::new();
    ssl.key("ca", "ED25519");
    let root = ssl.root("ca", ["/CN=ca", "directory", ""]);
    entry(&root).unwrap();
    for (subject, is_fine) in [
        ("/O=Sales/CN=Salma", true),
        ("/O=SALES/OU=Day/CN=Salma", true),
        ("/O=Sales/OU=night/CN=Salma", false),
        ("/O=Buying/CN=Salma", false),
        ("/CN=Salma/O=Sales", false),
    ] {
        let person = ssl.person(["ca", "ca", ""], subject, "");
        let found = verified(&root, &person);
        assert_eq!(found.is_ok(), is_fine, "{subject}: {found:?}");
        if let Err(refused) = found {
            assert!(
                matches!(&refused, IdentityError::BadPath { found, .. } if found.contains("CN=Salma")),
                "{refused}"
            );
        }
    }
    let root = ssl.root("ca", ["/CN=ca", "hosts", ""]);
    for (names, is_fine) in [
        ("DNS:robot.example.com", true),
        ("DNS:example.com", true),
        ("DNS:badexample.com", false),
        ("IP:10.1.2.3", true),
        ("IP:11.1.2.3", false),
        ("IP:fd00::1", false),
        ("email:salma@example.org", true),
        ("email:salma@mail.example.org", false),
        ("URI:https://a.example.com:99/x", true),
        ("URI:https://example.com/x", false),
        ("URI:urn:nothing", false),
    ] {
        let person = ssl.person(["ca", "ca", ""], "/CN=Salma", &format!("subjectAltName = {names}"));
        let found = verified(&root, &person);
        assert_eq!(found.is_ok(), is_fine, "{names}: {found:?}");
        // OpenSSL is of the same opinion, but for a name without a host, which it does not look at.
        if names != "URI:urn:nothing" {
            let judge = Command::new("openssl")
                .args(["verify", "-CAfile", "ca.pem", "person.pem"])
                .current_dir(ssl.0.path())
                .output();
            assert_eq!(judge.unwrap().status.success(), is_fine, "OpenSSL about {names}");
        }
    }
}

#[test]
fn the_distribution_point_of_a_list_says_what_it_covers() {
    let ssl = OpenSsl::new();
    ssl.key("ca", "ED25519");
    let root = ssl.root("ca", ["/CN=ca", "plain", ""]);
    let msp = Msp::new("Org3", &[&root], NONE).unwrap();
    let scope = |section: &str| msp.verify_list(&ssl.list(["ca", section, ""])).map(|(list, _)| list.scope);
    assert_eq!(scope("whole").unwrap().point, None);
    let points = ["place", "people", "authorities", "reasons"].map(|section| scope(section).unwrap());
    assert_eq!(points.map(|point| point.leaves_out_people), [false, false, true, true]);
    let different: std::collections::BTreeSet<_> = points.iter().map(|scope| scope.point).collect();
    assert_eq!(different.len(), 4, "each is a scope of its own");
    for (section, found) in [("indirect", "an indirect list"), ("attributes", "attribute certificates")] {
        let refused = scope(section).unwrap_err().to_string();
        assert!(refused.contains(found), "{refused}");
    }
}
