//! The console, as a program that is no browser meets it: HTTP, JSON and signatures written down here once more.

use crate::own_network::isolated;
use crate::support::{Ctl, Dev, Fleet, eventually, programs};
use ledger_api::v1;
use ledger_identity::key::{KeyKind, SigningKey};
use prost::Message;
use rcgen::{CertificateParams, KeyPair, PKCS_ECDSA_P256_SHA256};
use ring::rand::SystemRandom;
use rustls_pki_types::PrivatePkcs8KeyDer;
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::Command;

/// An address that is not one of loopback, though nothing leaves the namespace.
const ELSEWHERE: &str = "10.77.0.1";

/// An answer over HTTP.
struct Answer {
    status: u16,
    head: String,
    body: Vec<u8>,
}

impl Answer {
    fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|_| panic!("{}\n{:?}", self.head, self.body))
    }
}

/// The browser's side of a console.
struct Browser {
    /// `HOST:PORT`
    host: String,
    origin: String,
    session: String,
}

/// An identity that was enrolled through a console.
struct Tablet {
    key: SigningKey,
    certificate: Vec<u8>,
    network: Vec<u8>,
}

impl Browser {
    fn at(console: &str) -> Self {
        let host = console.strip_prefix("http://").unwrap().to_owned();
        Self { origin: console.to_owned(), host, session: String::new() }
    }

    /// Asks in HTTP/1.0, whose answers end with the connection. Status 0 where it ended without an answer.
    fn ask(&self, line: &str, headers: &[(&str, &str)], body: &[u8]) -> Answer {
        let mut stream = TcpStream::connect(&self.host).unwrap();
        let mut request = format!("{line} HTTP/1.0\r\ncontent-length: {}\r\n", body.len());
        for (name, value) in headers {
            request.push_str(&format!("{name}: {value}\r\n"));
        }
        request.push_str("\r\n");
        stream.write_all(request.as_bytes()).unwrap();
        // A server that has heard enough may close before all was sent.
        let _refused = stream.write_all(body);
        let mut answer = Vec::new();
        let _reset = stream.read_to_end(&mut answer);
        let Some(end) = answer.windows(4).position(|window| window == b"\r\n\r\n") else {
            return Answer { status: 0, head: String::new(), body: answer };
        };
        let head = String::from_utf8(answer[..end].to_vec()).unwrap();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        Answer { status, head, body: answer[end + 4..].to_vec() }
    }

    fn get(&self, path: &str) -> Answer {
        self.ask(&format!("GET {path}"), &[("host", &self.host)], b"")
    }

    fn post(&self, path: &str, body: &Value) -> Answer {
        let headers = [("host", self.host.as_str()), ("origin", &self.origin), ("content-type", "application/json")];
        self.ask(&format!("POST {path}"), &headers, body.to_string().as_bytes())
    }

    /// Asks the HTTP API under the session, if there is one. The answer, or the one that rejects.
    fn call(&self, line: &str, kind: &str, body: &[u8]) -> Result<Value, Answer> {
        let authorisation = format!("Session {}", self.session);
        let mut headers = vec![("host", self.host.as_str()), ("origin", &self.origin), ("content-type", kind)];
        if !self.session.is_empty() {
            headers.push(("authorization", &authorisation));
        }
        let answer = self.ask(line, &headers, body);
        if answer.status == 200 { Ok(answer.json()) } else { Err(answer) }
    }

    fn read(&self, path: &str) -> Result<Value, Answer> {
        self.call(&format!("GET {path}"), "", b"")
    }

    fn write(&self, path: &str, body: &Value) -> Result<Value, Answer> {
        self.call(&format!("POST {path}"), "application/json", body.to_string().as_bytes())
    }

    /// Enrols by a link of `ledgerctl console`.
    fn enrol(&self, link: &str) -> Tablet {
        let parts: Vec<&str> = link.split("/#/enrol/").nth(1).unwrap().split('/').collect();
        let [organisation, name, secret] = parts[..] else { panic!("{link}") };
        let key = SigningKey::generate(KeyKind::P256, &SystemRandom::new()).unwrap();
        let pair = PrivatePkcs8KeyDer::from(key.to_pkcs8_der());
        let pair = KeyPair::from_pkcs8_der_and_sign_algo(&pair, &PKCS_ECDSA_P256_SHA256).unwrap();
        let request = CertificateParams::default().serialize_request(&pair).unwrap().der().to_vec();
        let enrol =
            json!({"name": format!("{organisation}/{name}"), "secret": secret, "request": hex::encode(request)});
        let enrolled = self.write("/v1/enrol", &enrol).unwrap_or_else(|no| panic!("{}", no.head));
        let bytes = |digits: &Value| hex::decode(digits.as_str().unwrap()).unwrap();
        Tablet { key, certificate: bytes(&enrolled["certificate"]), network: bytes(&enrolled["network"]["network"]) }
    }

    fn challenge(&self) -> Value {
        let challenge = self.post("/session/challenge", &json!({}));
        assert_eq!(challenge.status, 200, "{}", challenge.head);
        challenge.json()
    }

    /// Answers a challenge as if the browser were at this origin.
    fn answer(&self, tablet: &Tablet, challenge: &Value, origin: &str) -> Answer {
        let text = |name: &str| challenge[name].as_str().unwrap().to_owned();
        assert_eq!(text("network"), hex::encode(&tablet.network));
        let bytes = hex::decode(text("challenge")).unwrap();
        let part = |part: &[u8]| [&(part.len() as u32).to_be_bytes()[..], part].concat();
        let signed = [
            &b"ledgerd console session v1\0"[..],
            &tablet.network,
            &part(text("node").as_bytes()),
            &part(origin.as_bytes()),
            &part(&bytes),
        ]
        .concat();
        let body = json!({
            "certificate": hex::encode(&tablet.certificate),
            "challenge": text("challenge"),
            "signature": hex::encode(tablet.key.sign(&signed)),
        });
        self.post("/session/open", &body)
    }

    /// Opens a session.
    fn open(&mut self, tablet: &Tablet) -> Value {
        let opened = self.answer(tablet, &self.challenge(), &self.origin);
        assert_eq!(opened.status, 200, "{:?}", String::from_utf8_lossy(&opened.body));
        let opened = opened.json();
        self.session = opened["session"].as_str().unwrap().to_owned();
        opened
    }

    fn height(&self) -> Result<u64, Answer> {
        self.read("/v1/status").map(|status| status["height"].as_u64().unwrap())
    }

    /// Submits a call that this key signs. The answer, or the rejection.
    fn submit(&self, tablet: &Tablet, function: &str, args: &[&str]) -> Value {
        let status = self.read("/v1/status").unwrap_or_else(|no| panic!("{}", no.head));
        let body = v1::TransactionBody {
            network: tablet.network.clone().into(),
            creator: ring::digest::digest(&ring::digest::SHA256, &tablet.certificate).as_ref().to_vec().into(),
            nonce: ring::rand::generate::<[u8; 16]>(&SystemRandom::new()).unwrap().expose().to_vec().into(),
            not_after: status["clock"].as_u64().unwrap() + 10_000_000,
            chaincode: "abac".into(),
            function: function.into(),
            args: args.iter().map(|arg| arg.as_bytes().to_vec().into()).collect(),
            known_block: None,
        }
        .encode_to_vec();
        let signature = tablet.key.sign(&[&b"ledgerd transaction v1\0"[..], &body].concat());
        let transaction = v1::Transaction {
            body: body.into(),
            signature: signature.into(),
            certificate: tablet.certificate.clone().into(),
        };
        let line = "POST /v1/transactions?first_attempt=true";
        let answer = self.call(line, "application/octet-stream", &transaction.encode_to_vec());
        answer.unwrap_or_else(|rejected| rejected.json())
    }
}

/// A link for a browser of this identity.
fn link(ctl: &Ctl, args: &[&str]) -> String {
    let told = ctl.json(&[&["console"], args].concat());
    told["link"].as_str().unwrap().to_owned()
}

#[test]
fn a_browser_enrols_by_a_link_proves_its_key_reads_and_signs_what_it_changes() {
    let dev = Dev::start();
    let mut browser = Browser::at(dev.fact("console"));
    let link = link(&dev.admin(), &["Tablet", "--attr", "Turtlebot4"]);
    assert!(link.starts_with(&format!("{}/#/enrol/Org1/Tablet/", browser.origin)), "{link}");
    let tablet = browser.enrol(&link);
    // The certificate is no secret, and opens nothing.
    assert_eq!(browser.height().err().map(|refused| refused.status), Some(401));
    let opened = browser.open(&tablet);
    assert_eq!((opened["id"].as_str(), opened["role"].as_str()), (Some("Org1/Tablet"), Some("member")));
    assert_eq!(opened["attributes"], json!({"Turtlebot4": "true"}));
    assert!(browser.height().is_ok_and(|height| height > 0));
    let acquired = browser.submit(&tablet, "acquire", &["Turtlebot4/cmd_vel"]);
    assert_eq!(acquired["response"]["holder"], "Org1/Tablet", "{acquired}");
    let rejected = browser.submit(&tablet, "acquire", &["Husky/cmd_vel"]);
    assert_eq!(rejected["code"], "LGR-3001", "{rejected}");
    assert_eq!(dev.owner().json(&["robot", "show", "Turtlebot4"])["owner"], "Org1/Tablet");

    // A session ends when the page says so.
    let headers = [("host", browser.host.clone()), ("origin", browser.origin.clone())];
    let authorisation = format!("Session {}", browser.session);
    let mut headers: Vec<_> = headers.iter().map(|(name, value)| (*name, value.as_str())).collect();
    headers.push(("authorization", &authorisation));
    assert_eq!(browser.ask("POST /session/end", &headers, b"").status, 204);
    assert_eq!(browser.height().err().map(|refused| refused.status), Some(401));

    // A name of its own: the caller's role and attributes; and another browser of the same name by another link.
    let admins = dev.owner().json(&["console"]);
    assert_eq!((admins["id"].as_str(), admins["role"].as_str()), (Some("Org2/Admin-browser"), Some("admin")));
    dev.owner().run(&["console"]).refused(3, &["--reissue"]);
    let again = dev.owner().json(&["console", "--reissue"]);
    assert_eq!(again["role"], "admin");
    assert_ne!(again["link"], admins["link"]);

    // Revoked, it reads nothing more, and opens nothing more.
    let opened = browser.open(&tablet);
    assert_eq!(opened["id"], "Org1/Tablet");
    dev.admin().run(&["identity", "revoke", "Tablet"]).ok();
    let rejected = browser.height().err().unwrap();
    assert_eq!((rejected.status, &rejected.json()["code"]), (403, &json!("LGR-2004")));
    assert_eq!(browser.answer(&tablet, &browser.challenge(), &browser.origin).status, 401);
}

#[test]
fn a_challenge_is_good_once_and_for_one_origin_and_nothing_is_answered_to_other_pages() {
    let dev = Dev::start();
    let mut browser = Browser::at(dev.fact("console"));
    let tablet = browser.enrol(&link(&dev.admin(), &["Tablet", "--attr", "Turtlebot4"]));

    let challenge = browser.challenge();
    assert_eq!(browser.answer(&tablet, &challenge, "http://evil.example").status, 401, "signed for another page");
    assert_eq!(browser.answer(&tablet, &challenge, &browser.origin).status, 200);
    assert_eq!(browser.answer(&tablet, &challenge, &browser.origin).status, 401, "used before");
    let mut forged = browser.challenge();
    forged["challenge"] = json!("00".repeat(56));
    assert_eq!(browser.answer(&tablet, &forged, &browser.origin).status, 401, "made up");
    let other = SigningKey::generate(KeyKind::P256, &SystemRandom::new()).unwrap();
    let thief = Tablet { key: other, certificate: tablet.certificate.clone(), network: tablet.network.clone() };
    assert_eq!(browser.answer(&thief, &browser.challenge(), &browser.origin).status, 401, "another key");
    browser.open(&tablet);

    // DNS rebinding: the name of somebody else. Another page: its origin.
    assert_eq!(browser.ask("GET /", &[("host", "evil.example")], b"").status, 403);
    assert_eq!(browser.ask("GET /", &[], b"").status, 403);
    let host = browser.host.clone();
    for origin in ["http://evil.example", "null", "https://127.0.0.1"] {
        let headers = [("host", host.as_str()), ("origin", origin)];
        assert_eq!(browser.ask("POST /session/challenge", &headers, b"{}").status, 403, "{origin}");
    }
    assert_eq!(browser.ask("POST /session/challenge", &[("host", &host)], b"{}").status, 403, "no origin");

    // A token is of use to its own page and to programs, and to nobody else's page.
    let authorisation = format!("Session {}", browser.session);
    let as_page = |site: &str| {
        let headers = [("host", host.as_str()), ("authorization", &authorisation), ("sec-fetch-site", site)];
        browser.ask("GET /v1/status", &headers, b"").status
    };
    assert_eq!(["same-origin", "cross-site", "same-site"].map(as_page), [200, 401, 401]);

    // Calls of gRPC, what changes something without a signature, and what nodes tell each other have no path.
    for path in ["/ledgerd.v1.Gateway/Status", "/ledgerd.v1.Gateway/Submit", "/v1/leadership", "/ledgerd.v1.Peer/Talk"]
    {
        let rejected = browser.write(path, &json!({})).err().unwrap();
        assert_eq!(rejected.status, 404, "{path}");
    }
    let line = "POST /v1/transactions";
    let unsigned = browser.call(line, "application/octet-stream", b"anything").err().unwrap();
    assert_eq!((unsigned.status, &unsigned.json()["code"]), (400, &json!("LGR-1001")));

    // Sizes: a request for a session, and a call.
    let large = json!({ "certificate": "00".repeat(64 * 1024) });
    assert!([413, 0].contains(&browser.post("/session/open", &large).status));
    let large = browser.call(line, "application/octet-stream", &vec![0; 2 << 20]).err().unwrap();
    assert!([413, 0].contains(&large.status), "{}", large.head);
    assert!(browser.height().is_ok(), "others do not feel it");

    // A flood of keys that are none is not even looked at; whoever has a session goes on.
    let nonsense = json!({"certificate": "00", "challenge": "00", "signature": "00"});
    let statuses: Vec<_> = (0..100).map(|_| browser.post("/session/open", &nonsense).status).collect();
    assert!(statuses.contains(&429), "{statuses:?}");
    assert!(browser.height().is_ok());
}

#[test]
fn the_page_has_nothing_from_outside_and_a_strict_policy() {
    let dev = Dev::start();
    let browser = Browser::at(dev.fact("console"));
    let page = browser.get("/");
    assert_eq!(page.status, 200);
    let head = page.head.to_lowercase();
    for part in [
        "content-security-policy: default-src 'none'; script-src 'self'; style-src 'self'",
        "frame-ancestors 'none'",
        "x-content-type-options: nosniff",
        "x-frame-options: deny",
        "referrer-policy: no-referrer",
        "cross-origin-opener-policy: same-origin",
        "content-type: text/html; charset=utf-8",
    ] {
        assert!(head.contains(part), "{part:?} in {head}");
    }
    assert!(!head.contains("unsafe") && !head.contains("set-cookie") && !head.contains("access-control"), "{head}");
    let text = String::from_utf8(page.body).unwrap();
    assert!(!text.contains("http://") && !text.contains("https://") && !text.contains("<style"), "{text}");
    for script in text.split("<script").skip(1) {
        assert!(
            script
                .split_once('>')
                .is_some_and(|(head, rest)| head.contains("src=\"/") && rest.starts_with("</script>"))
        );
    }
    let paths: Vec<&str> = text.split(['"', '\'']).filter(|part| part.starts_with('/')).collect();
    assert!(paths.len() >= 3, "{paths:?}");
    for path in paths {
        let file = browser.get(path);
        assert_eq!(file.status, 200, "{path}");
        assert!(file.head.to_lowercase().contains("nosniff"), "{path}");
        let mark = file.head.lines().find_map(|line| line.strip_prefix("etag: ")).unwrap().to_owned();
        let known = browser.ask(&format!("GET {path}"), &[("host", &browser.host), ("if-none-match", &mark)], b"");
        assert_eq!((known.status, known.body.len()), (304, 0), "{path}");
    }
    assert_eq!(browser.get("/session/open").status, 405);
    assert_eq!(browser.get("/../Cargo.toml").status, 404);
}

#[test]
fn a_node_without_a_console_says_so_and_away_from_loopback_it_is_https() {
    if !isolated(&|| ()) {
        return;
    }
    let added = Command::new("ip").args(["address", "add", &format!("{ELSEWHERE}/32"), "dev", "lo"]).status().unwrap();
    assert!(added.success());
    let fleet = Fleet::found(1);
    let owner = fleet.ctl().as_(&fleet.owner().name);
    let node = fleet.nodes[0].start();
    let refused = eventually("the node answers", || Some(owner.run(&["console"])).filter(|run| run.code != 4));
    refused.refused(3, &["this node has no console"]);
    drop(node);
    fleet.nodes[0].configure(&format!("[console]\nlisten = \"{ELSEWHERE}:7452\""));
    let _node = fleet.nodes[0].start();
    let told = eventually("the console is told", || {
        let run = owner.run(&["console", "Tablet", "-o", "json"]);
        run.stdout.contains("https://").then_some(run.stdout)
    });
    assert!(told.contains(&format!("https://{ELSEWHERE}:7452/#/enrol/")), "{told}");
    let mut python = Command::new(programs::python());
    python.args(["-c", ASK, ELSEWHERE, "7452"]);
    let page = programs::ran(&mut python).stdout;
    let page = String::from_utf8_lossy(&page).into_owned();
    assert!(page.starts_with("TLSv1.3 200") && page.contains("<title>ledgerd</title>"), "{page}");
}

/// Asks for the page over TLS, without a certificate of its own.
const ASK: &str = r#"
import http.client, ssl, sys
settings = ssl.create_default_context()
settings.check_hostname, settings.verify_mode = False, ssl.CERT_NONE
connection = http.client.HTTPSConnection(sys.argv[1], int(sys.argv[2]), context=settings, timeout=10)
connection.request("GET", "/")
version = connection.sock.version()
answer = connection.getresponse()
print(version, answer.status, answer.read().decode())
"#;
