//! docs/http.md with curl: every example as it stands, with a certificate against a real node; and each path without one.

use crate::support::{Ctl, Dev, eventually};
use ledger::transaction::{Body, Transaction};
use ledger_identity::key::{KeyKind, SigningKey};
use rcgen::{CertificateParams, KeyPair, PKCS_ECDSA_P256_SHA256};
use ring::rand::SystemRandom;
use rustls_pki_types::PrivatePkcs8KeyDer;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const PAGE: &str = include_str!("../../docs/http.md");
/// The exit code of curl for a stream that it has read long enough.
const TIMED_OUT: i32 = 28;

/// An endpoint as the page has it: its heading, its example for a shell, and its answer.
struct Endpoint {
    method: String,
    path: String,
    command: String,
    answer: Value,
}

impl Endpoint {
    fn needs_identity(&self) -> bool {
        !["/v1/network", "/v1/enrol"].contains(&self.path.as_str())
    }
}

/// The endpoints with an example for curl.
fn endpoints() -> Vec<Endpoint> {
    let block = |section: &str, kind: &str| {
        let (_, rest) = section.split_once(&format!("```{kind}\n"))?;
        rest.split_once("\n```").map(|(block, _)| block.to_owned())
    };
    let sections = PAGE.split("\n### `").skip(1).map(|section| {
        let (heading, section) = section.split_once('`').unwrap();
        let (method, path) = heading.split_once(' ').unwrap();
        let answer = block(section, "json").map(|text| serde_json::from_str(&text).unwrap()).unwrap_or_default();
        let command = block(section, "sh").unwrap_or_default();
        assert!(!command.is_empty() || path.starts_with("/session/"), "{heading} has no example");
        Endpoint { method: method.to_owned(), path: path.to_owned(), command, answer }
    });
    let found: Vec<_> = sections.filter(|endpoint| !endpoint.command.is_empty()).collect();
    assert_eq!(found.len(), 14);
    found
}

/// A network with the files that the page names, for the admin of Org1.
struct Place {
    dev: Dev,
    /// The id and the height of a transaction that acquired a robot.
    acquired: (String, u64),
    secret: String,
    request: String,
}

impl Place {
    fn start() -> Self {
        let dev = Dev::start();
        let user = dev.user("Salma", &["Turtlebot4"], "p256");
        let acquired = user.json(&["acquire", "Turtlebot4/cmd_vel"]);
        let acquired = (acquired["transaction"].as_str().unwrap().to_owned(), acquired["height"].as_u64().unwrap());
        let secret = dev.admin().json(&["identity", "register", "Tablet"])["secret"].as_str().unwrap().to_owned();
        let place = Self { acquired, secret, request: request(), dev };
        place.configure();
        place
    }

    /// The directory of the admin's context.
    fn directory(&self) -> PathBuf {
        self.dev.home.path().join("contexts/dev-org1-admin")
    }

    fn file(&self, name: &str) -> PathBuf {
        self.directory().join(name)
    }

    fn configure(&self) {
        let msps: Value = serde_json::from_slice(&fs::read(self.file("msps.json")).unwrap()).unwrap();
        let roots = msps.as_array().unwrap().iter().flat_map(|msp| msp["roots"].as_array().unwrap());
        fs::write(self.file("roots.pem"), roots.map(|root| root.as_str().unwrap()).collect::<String>()).unwrap();
        let common = format!(
            "silent\nshow-error\nmax-time = 4\ncacert = roots.pem\nconnect-to = node1:7450:{}\n",
            self.dev.fact("address")
        );
        fs::write(self.file("newcomer.curl"), &common).unwrap();
        fs::write(self.file("me.curl"), format!("{common}cert = certificate.pem\nkey = key.pem\n")).unwrap();
    }

    /// From now on `me.curl` shows the certificate of this context.
    fn identify_as(&self, context: &Path) {
        let common = fs::read_to_string(self.file("newcomer.curl")).unwrap();
        let context = context.display();
        let text = format!("{common}cert = {context}/certificate.pem\nkey = {context}/key.pem\n");
        fs::write(self.file("me.curl"), text).unwrap();
    }

    /// Writes a new transaction that calls this function.
    fn sign(&self, function: &str, args: &[&str]) {
        let key = SigningKey::from_pem(&fs::read_to_string(self.file("key.pem")).unwrap()).unwrap();
        let certificate = pem::parse(fs::read(self.file("certificate.pem")).unwrap()).unwrap().into_contents();
        let body = Body {
            network: hex::decode(self.dev.fact("network")).unwrap().into(),
            creator: ring::digest::digest(&ring::digest::SHA256, &certificate).as_ref().to_vec().into(),
            nonce: ring::rand::generate::<[u8; 16]>(&SystemRandom::new()).unwrap().expose().to_vec().into(),
            not_after: self.status()["clock"].as_u64().unwrap() + 60_000_000,
            chaincode: "abac".into(),
            function: function.into(),
            args: args.iter().map(|arg| arg.as_bytes().to_vec().into()).collect(),
            known_block: None,
        };
        let signed = Transaction::sign(&body, &key).unwrap().with_certificate(certificate.into()).unwrap();
        fs::write(self.file("transaction.bin"), signed.encoded()).unwrap();
    }

    /// Runs a command line of the page.
    fn run(&self, line: &str) -> Output {
        let mut shell = Command::new("bash");
        shell.current_dir(self.directory()).args(["-c", line]).env("ID", &self.acquired.0);
        shell.env("HEIGHT", self.acquired.1.to_string()).env("SECRET", &self.secret).env("REQUEST", &self.request);
        shell.output().unwrap()
    }

    /// The JSON of the first line that a command answers.
    fn first(&self, line: &str) -> Value {
        let output = self.run(line);
        let (said, told) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        let ended = output.status.code().unwrap();
        assert!(ended == 0 || ended == TIMED_OUT, "{line}\n{said}\n{told}");
        serde_json::from_str(said.lines().next().unwrap_or_default())
            .unwrap_or_else(|error| panic!("{line}\n{error}: {said}\n{told}"))
    }

    /// Its status of HTTP, and its JSON.
    fn asked(&self, arguments: &str) -> (u16, Value) {
        let output = self.run(&format!("curl {arguments} -w '\\n%{{http_code}}'"));
        let said = String::from_utf8(output.stdout).unwrap();
        let (body, status) = said
            .trim()
            .rsplit_once('\n')
            .unwrap_or_else(|| panic!("{arguments}: {said:?}: {}", String::from_utf8_lossy(&output.stderr)));
        let body = serde_json::from_str(body).unwrap_or_else(|error| panic!("{arguments}: {error}: {body}"));
        (status.parse().unwrap(), body)
    }

    fn status(&self) -> Value {
        self.first("curl -K me.curl https://node1:7450/v1/status")
    }
}

/// A signing request for a new key, in hexadecimal digits.
fn request() -> String {
    let key = SigningKey::generate(KeyKind::P256, &SystemRandom::new()).unwrap();
    let pair = PrivatePkcs8KeyDer::from(key.to_pkcs8_der());
    let pair = KeyPair::from_pkcs8_der_and_sign_algo(&pair, &PKCS_ECDSA_P256_SHA256).unwrap();
    hex::encode(CertificateParams::default().serialize_request(&pair).unwrap().der())
}

fn keys(value: &Value) -> BTreeSet<&str> {
    value.as_object().map(|fields| fields.keys().map(String::as_str).collect()).unwrap_or_default()
}

/// The answer has the fields of the example; `…` stands for more.
#[track_caller]
fn alike(what: &str, wanted: &Value, found: &Value) {
    match (wanted, found) {
        (Value::Array(wanted), Value::Array(found)) => {
            if let (Some(wanted), Some(found)) = (wanted.first(), found.first()) {
                alike(what, wanted, found);
            }
        }
        (Value::Object(fields), Value::Object(_)) => {
            let (mut named, answered) = (keys(wanted), keys(found));
            let has_more = named.remove("…");
            assert!(
                named.is_subset(&answered) && (has_more || named == answered),
                "{what}: {named:?}, answered {answered:?}"
            );
            for name in named.into_iter().filter(|name| !["response", "payload"].contains(name)) {
                alike(&format!("{what} {name}"), &fields[name], &found[name]);
            }
        }
        _ => {
            let kind = |value: &Value| std::mem::discriminant(value);
            assert_eq!(kind(wanted), kind(found), "{what}: {wanted} is not like {found}");
        }
    }
}

#[test]
fn every_example_of_the_page_works_with_a_certificate_and_answers_in_its_form() {
    let place = Place::start();
    place.dev.user("Farhad", &[], "p256").run(&["acquire", "Turtlebot4/cmd_vel"]);
    place.sign("stop", &["Turtlebot4"]);
    for endpoint in endpoints() {
        if endpoint.method == "POST" && endpoint.path == "/v1/transactions" {
            place.sign("can_be_anything", &[]);
            let (status, rejected) = place.asked(endpoint.command.trim_start_matches("curl "));
            assert_eq!((status, &rejected["code"]), (400, &json!("LGR-1010")), "{rejected}");
            place.sign("acquire", &["Turtlebot4/cmd_vel"]);
            let (status, held) = place.asked(endpoint.command.trim_start_matches("curl "));
            assert!([403, 409].contains(&status) && keys(&held).contains("id"), "{status} {held}");
            continue;
        }
        let found = place.first(&endpoint.command);
        alike(&format!("{} {}", endpoint.method, endpoint.path), &endpoint.answer, &found);
    }
}

#[test]
fn no_path_answers_without_a_certificate_but_those_that_make_an_identity() {
    let place = Place::start();
    place.sign("stop", &["Turtlebot4"]);
    for endpoint in endpoints().iter().filter(|endpoint| endpoint.needs_identity()) {
        let without = endpoint.command.replace("me.curl", "newcomer.curl");
        let (status, rejected) = place.asked(without.trim_start_matches("curl "));
        assert_eq!((status, &rejected["code"]), (401, &json!("LGR-2008")), "{without}: {rejected}");
        assert_eq!(keys(&rejected), BTreeSet::from(["code", "found", "message", "next", "wanted"]), "{without}");
    }
    // A certificate of another network is no certificate.
    let other = Dev::start();
    place.identify_as(&other.home.path().join("contexts/dev-org1-admin"));
    let refused = place.run("curl -K me.curl https://node1:7450/v1/status");
    assert!(!refused.status.success() && refused.stdout.is_empty(), "{refused:?}");
}

#[test]
fn rights_and_codes_are_those_of_grpc() {
    let place = Place::start();
    let ctl = |name: &str| -> Ctl { place.dev.ctl().as_(name) };
    let use_as = |name: &str| place.identify_as(&place.dev.home.path().join("contexts").join(name));
    let url = "https://node1:7450/v1";
    // The same rejection with the same four lines, whichever way it takes.
    let by_http = |arguments: &str| place.asked(&format!("-K me.curl {arguments}"));
    let farhad = place.dev.user("Farhad", &[], "p256");
    use_as("Farhad");
    let told: Value =
        serde_json::from_str(&farhad.run(&["denials", "-o", "json"]).refused(2, &["LGR-3010"]).stderr).unwrap();
    let (status, rejected) = by_http(&format!("{url}/denials"));
    assert_eq!(status, 403);
    for (http, grpc) in
        [("code", "code"), ("message", "message"), ("found", "found"), ("wanted", "wanted"), ("next", "try")]
    {
        assert_eq!(rejected[http], told[grpc], "{http}");
    }
    // Messages of a robot that he may not read.
    let (status, rejected) = by_http(&format!("'{url}/events?chaincode=abac&name=message&subject=Husky%2Fcmd_vel'"));
    assert_eq!(status, 403, "{rejected}");
    // Nothing is lost of what a block says.
    use_as("dev-org1-admin");
    let height = place.acquired.1.to_string();
    let granted = place.first(&format!("curl -K me.curl -N '{url}/events?from_height={height}&name=granted'"));
    let call = &granted["events"][0]["transaction"];
    assert_eq!((&call["function"], &call["creator"]), (&"acquire".into(), &"Org1/Salma".into()), "{granted}");
    let (status, mut block) = by_http(&format!("{url}/blocks/{height}"));
    assert_eq!(status, 200);
    for transaction in block["transactions"].as_array_mut().unwrap() {
        for more in ["not_after", "not_after_utc"] {
            transaction.as_object_mut().unwrap().remove(more);
        }
    }
    assert_eq!(block, ctl("dev-org1-admin").json(&["block", &height]));
    let (_, audit) = by_http(&format!("'{url}/audit?robot=Turtlebot4&limit=1'"));
    let printed = ctl("dev-org1-admin").json(&["audit", "--robot", "Turtlebot4", "--limit", "1"]);
    assert_eq!(keys(&audit["rows"][0]), keys(&printed), "{audit}");
    let (_, status) = by_http(&format!("{url}/status"));
    let printed = ctl("dev-org1-admin").json(&["status"]);
    let judged = BTreeSet::from(["failures_tolerated", "quorum"]);
    let more = BTreeSet::from(["console", "first_height", "snapshot_height"]);
    assert_eq!(keys(&printed).difference(&keys(&status)).copied().collect::<BTreeSet<_>>(), judged);
    assert_eq!(keys(&status).difference(&keys(&printed)).copied().collect::<BTreeSet<_>>(), more);
    for part in ["disk", "certificates"] {
        let first = |facts: &Value| if facts[part].is_array() { facts[part][0].clone() } else { facts[part].clone() };
        assert_eq!(keys(&first(&status)), keys(&first(&printed)), "{part}");
    }
    // A revoked certificate reads nothing more, and its streams end.
    use_as("Farhad");
    place.dev.admin().run(&["identity", "revoke", "Farhad"]).ok();
    eventually("the revoked certificate is rejected", || {
        let answer = place.run(&format!("curl -K me.curl {url}/status"));
        (!String::from_utf8_lossy(&answer.stdout).contains("\"height\"")).then_some(())
    });
}

#[test]
fn hostile_requests_are_rejected_with_their_four_lines() {
    let place = Place::start();
    let url = "https://node1:7450/v1";
    let rejected = |arguments: &str, status: u16, code: &str| {
        let (found, rejected) = place.asked(&format!("-K me.curl {arguments}"));
        assert_eq!((found, rejected["code"].as_str()), (status, Some(code)), "{arguments}: {rejected}");
        assert!(rejected["message"].as_str().is_some_and(|text| !text.is_empty()), "{rejected}");
    };
    // Pages of others in the browser of somebody who has a certificate, and names of others.
    for header in ["origin: https://evil.example", "origin: null", "sec-fetch-site: cross-site", "host: evil.example"] {
        rejected(&format!("{url}/status -H '{header}'"), 403, "LGR-2001");
    }
    // Paths, parameters and bodies that mean nothing.
    rejected(&format!("{url}/nothing"), 404, "LGR-1013");
    for path in ["", "/", "/readyz", "/v1", "/V1/status", "//v1/status", "/v1%2Fstatus"] {
        rejected(&format!("https://node1:7450{path}"), 404, "LGR-1013");
    }
    rejected(&format!("-X DELETE {url}/status"), 405, "LGR-1011");
    rejected(&format!("'{url}/blocks/0?x=1'"), 400, "LGR-1011");
    rejected(&format!("'{url}/audit?after=00'"), 400, "LGR-1011");
    rejected(&format!("{url}/blocks/x"), 400, "LGR-1011");
    rejected(&format!("{url}/blocks/99999999"), 404, "LGR-1013");
    rejected(&format!("{url}/blocks/%ff"), 400, "LGR-1011");
    rejected(&format!("{url}/transactions/12"), 400, "LGR-1011");
    rejected(&format!("'{url}/audit?robto=Husky'"), 400, "LGR-1011");
    rejected(&format!("'{url}/audit?limit=-1'"), 400, "LGR-1011");
    rejected(&format!("'{url}/events?name=nonsense'"), 400, "LGR-1011");
    rejected(&format!("{url}/query -d '{{}}'"), 400, "LGR-1011");
    rejected(&format!("{url}/query --json '{{}}'"), 400, "LGR-1011");
    rejected(&format!("{url}/query --json '[[[[[['"), 400, "LGR-1011");
    let none = r#"{"chaincode":"abac","function":"nothing"}"#;
    rejected(&format!("{url}/query --json '{none}'"), 400, "LGR-1010");
    fs::write(place.file("nonsense"), vec![0xff; 100]).unwrap();
    let bytes = "-H 'content-type: application/octet-stream' --data-binary";
    rejected(&format!("{url}/transactions {bytes} @nonsense"), 400, "LGR-1001");
    // Clients send the whole body of a rejected request before they read the answer.
    fs::write(place.file("body"), vec![b' '; 900_000]).unwrap();
    rejected(&format!("'{url}/transactions?first_attempt=yes' {bytes} @body"), 400, "LGR-1011");
    rejected(&format!("{url}/nothing {bytes} @body"), 404, "LGR-1013");
    rejected(&format!("{url}/status {bytes} @body"), 405, "LGR-1011");
    // More bytes than are read, announced or not.
    fs::write(place.file("large"), vec![b' '; (1 << 20) + 1]).unwrap();
    rejected(&format!("{url}/query -H 'content-type: application/json' --data-binary @large"), 413, "LGR-1002");
    rejected(
        &format!("{url}/transactions -X POST -H 'content-type: application/octet-stream' -T - < large"),
        413,
        "LGR-1002",
    );
    let (status, _) =
        place.asked(&format!("-K newcomer.curl {url}/enrol -H 'content-type: application/json' --data-binary @large"));
    assert_eq!(status, 413);
    assert!(place.status()["height"].as_u64().is_some_and(|height| height > 0), "others do not notice");
}
