//! A node with the programs that operators put around it: Prometheus, nginx and grpcurl.

use crate::support::network::free_address;
use crate::support::page::{get, values};
use crate::support::process::Process;
use crate::support::programs::{ran, repository};
use crate::support::{Fleet, connect, eventually};
use ledger_identity::Role;
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::Command;
use tempfile::TempDir;

/// The block of code with this language below a heading of a page.
fn block<'a>(page: &'a str, heading: &str, language: &str) -> &'a str {
    let section = page.split_once(&format!("\n{heading}\n")).expect("the heading").1;
    section.split_once(&format!("```{language}\n")).expect("the block").1.split_once("```").expect("its end").0
}

/// The answer of curl, and the status of HTTP.
fn curl(arguments: &[&str]) -> (String, String) {
    let output = Command::new("curl").args(["-s", "-w", "\n%{http_code}"]).args(arguments).output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let (body, status) = text.rsplit_once('\n').unwrap_or_default();
    (status.to_owned(), body.to_owned())
}

/// The answer of Prometheus to a question, once it has one.
fn prometheus(address: &str, path: &str, query: &str) -> Option<Value> {
    let url = format!("http://{address}/api/v1/{path}");
    let (status, body) = curl(&["-G", "--data-urlencode", &format!("query={query}"), &url]);
    let answer: Value = serde_json::from_str(&body).ok().filter(|_| status == "200")?;
    Some(answer["data"].clone())
}

#[test]
fn prometheus_reads_the_figures_and_its_alerts_are_the_list_of_the_node() {
    let fleet = Fleet::found(1);
    let (page, address) = (free_address(), free_address());
    // Certificates of two days are nothing to warn of.
    fleet.nodes[0].configure(&format!("[admin]\nlisten = \"{page}\"\n[ca]\ncertificate_days = 2"));
    let _node = fleet.nodes[0].start();
    eventually("the node is ready", || get(&page, "/readyz").0.contains("200").then_some(()));
    let place = TempDir::new().unwrap();
    let alerts = repository().join("packaging/prometheus/alerts.yml");
    let config = format!(
        "global: {{scrape_interval: 1s, evaluation_interval: 1s}}\nrule_files: [{}]\n\
         scrape_configs:\n- job_name: ledgerd\n  static_configs: [{{targets: ['{page}']}}]\n",
        alerts.display()
    );
    fs::write(place.path().join("prometheus.yml"), config).unwrap();
    let mut command = Command::new("prometheus");
    command.arg(format!("--config.file={}", place.path().join("prometheus.yml").display()));
    command.arg(format!("--storage.tsdb.path={}", place.path().join("data").display()));
    command.arg(format!("--web.listen-address={address}"));
    let _prometheus = Process::start("prometheus", place.path(), command);
    eventually("Prometheus reads the page", || {
        let targets = prometheus(&address, "targets", "")?;
        let target = targets["activeTargets"].get(0)?;
        assert!(target["lastError"].as_str().is_none_or(|error| error.is_empty()), "{target}");
        (target["health"] == "up").then_some(())
    });
    let warned = eventually("the list is an alert", || {
        let alerts = prometheus(&address, "query", "ALERTS{alertname=~\"Ledgerd(Critical|Error|Warning)\"}")?;
        let alerts = alerts["result"].as_array().filter(|alerts| !alerts.is_empty())?;
        Some(alerts.iter().map(|alert| alert["metric"]["check"].as_str().unwrap().to_owned()).collect::<Vec<_>>())
    });
    // The disk of this machine may be almost full.
    let mut warned: Vec<_> = warned.into_iter().filter(|check| check != "disk").collect();
    warned.sort();
    assert_eq!(warned, ["ca", "redundancy"]);
    let rules = prometheus(&address, "rules", "").unwrap();
    let rules = rules["groups"][0]["rules"].as_array().unwrap();
    assert!(rules.len() > 7 && rules.iter().all(|rule| rule["health"] == "ok"), "{rules:?}");
    let types = prometheus(&address, "metadata", "").unwrap();
    assert_eq!(types["ledgerd_executed"][0]["type"], "counter", "it reads OpenMetrics");
}

#[test]
fn an_organisation_whose_ca_key_no_node_holds_is_an_error_on_every_light() {
    let fleet = Fleet::found(1);
    let (page, place) = (free_address(), &fleet.nodes[0]);
    place.configure(&format!("[admin]\nlisten = \"{page}\""));
    fleet.issue("Org1", "Boss", Role::Admin, &[]);
    let _node = place.start();
    let boss = fleet.ctl().as_("Boss");
    let listed = |command: &[&str]| {
        let ran = boss.run(&[command, &["--check", "-o", "json"]].concat());
        let status: Value = serde_json::from_str(&ran.stdout).ok()?;
        let items = status["attention"].as_array()?.iter().filter(|item| item["check"] == "ca");
        let of = items.filter(|item| item["message"].as_str().unwrap().contains("of Org1"));
        Some((ran.code, of.map(|item| item["severity"].as_str().unwrap().to_owned()).collect::<Vec<_>>()))
    };
    eventually("a single holder without a copy is a warning", || {
        (listed(&["status"])? == (1, vec!["warning".to_owned()])).then_some(())
    });
    boss.run(&["ca", "forget", &place.name, "--i-mean-it"]).ok();
    for command in [&["status"][..], &["network", "status"]] {
        eventually("no holder is an error", || (listed(command)? == (1, vec!["error".to_owned()])).then_some(()));
    }
    let doctor = boss.run(&["doctor", "-o", "json"]);
    let findings: Value = serde_json::from_str(&doctor.stdout).unwrap();
    let wrong = findings["findings"].as_array().unwrap().iter().find(|found| found["check"] == "ca").unwrap();
    assert!(
        doctor.code == 1
            && wrong["state"] == "wrong"
            && wrong["try"].as_str().unwrap().contains("ledgerctl ca restore"),
        "{wrong}"
    );
    // The node serves, so balancers keep it.
    let (status, body) = get(&page, "/readyz?verbose");
    let line = body.lines().find(|line| line.contains("] ca ")).unwrap();
    assert!(status.contains("200") && line.starts_with("[+] ca ok, but no node holds the CA key of Org1"), "{body}");
    assert!(values(&get(&page, "/metrics").1, "ledgerd_attention").contains(&("{check=\"ca\"}", 2.0)));
}

/// nginx with this block `server`, in the foreground and as one process.
fn nginx(place: &Path, server: &str) -> Process {
    let at = place.display();
    let temporary = ["client_body", "proxy", "fastcgi", "uwsgi", "scgi"];
    let temporary: String = temporary.map(|kind| format!("{kind}_temp_path {at}/{kind};\n")).concat();
    let config = format!(
        "daemon off;\nmaster_process off;\npid {at}/nginx.pid;\nerror_log stderr;\nevents {{}}\n\
         http {{\naccess_log off;\n{temporary}{server}}}\n"
    );
    fs::write(place.join("nginx.conf"), config).unwrap();
    let mut command = Command::new("nginx");
    command.arg("-e").arg("stderr").arg("-p").arg(place).arg("-c").arg(place.join("nginx.conf"));
    Process::start("nginx", place, command)
}

#[test]
fn the_console_is_reached_through_a_proxy_that_ends_tls_as_its_page_says() {
    let fleet = Fleet::found(1);
    let (console, proxy) = (free_address(), free_address());
    let page = include_str!("../../docs/console.md");
    let settings = block(page, "### Behind a proxy", "toml").replace("127.0.0.1:7452", &console);
    fleet.nodes[0].configure(&settings);
    let _node = fleet.nodes[0].start();
    let place = TempDir::new().unwrap();
    let made = rcgen::generate_simple_self_signed(vec!["robots.example".to_owned()]).unwrap();
    let (certificate, key) = (place.path().join("page.pem"), place.path().join("page.key"));
    fs::write(&certificate, made.cert.pem()).unwrap();
    fs::write(&key, made.signing_key.serialize_pem()).unwrap();
    let server = block(page, "### Behind a proxy", "nginx")
        .replace("listen 443 ssl", &format!("listen {proxy} ssl"))
        .replace("/etc/ssl/robots.example.pem", &certificate.display().to_string())
        .replace("/etc/ssl/robots.example.key", &key.display().to_string())
        .replace("127.0.0.1:7452", &console);
    let _proxy = nginx(place.path(), &server);
    let port = proxy.rsplit_once(':').unwrap().1;
    let (site, resolved) = (format!("https://robots.example:{port}"), format!("robots.example:{port}:127.0.0.1"));
    let ask = |arguments: &[&str]| {
        let common = ["--cacert", certificate.to_str().unwrap(), "--resolve", &resolved];
        curl(&[&common, arguments].concat())
    };
    let start = eventually("the proxy passes the page on", || {
        Some(ask(&[&format!("{site}/")])).filter(|(status, _)| status == "200")
    });
    assert!(start.1.contains("<html"), "{start:?}");
    let challenge = |origin: &str| {
        let origin = format!("origin: {origin}");
        ask(&[
            "-X",
            "POST",
            "-H",
            &origin,
            "-H",
            "content-type: application/json",
            &format!("{site}/session/challenge"),
        ])
    };
    let (status, body) = challenge(&site);
    assert!(status == "200" && body.contains("\"challenge\""), "{status} {body}");
    let (status, body) = challenge("https://evil.example");
    assert!(status == "403" && body.contains("LGR-"), "{status} {body}");

    // Without the proxy: an unknown path is answered in JSON, and two hosts or two origins are rejected.
    let plain = |arguments: &[&str]| curl(arguments);
    let (status, body) = plain(&[&format!("http://{console}/nothing")]);
    assert!(
        status == "404" && serde_json::from_str::<Value>(&body).is_ok_and(|answer| answer["code"] == "LGR-1013"),
        "{body}"
    );
    let origin = format!("origin: http://{console}");
    let (status, body) = plain(&["-X", "DELETE", "-H", &origin, &format!("http://{console}/main.js")]);
    assert!(
        status == "405" && serde_json::from_str::<Value>(&body).is_ok_and(|answer| answer["code"].is_string()),
        "{body}"
    );
    let twice = ["-X", "POST", "-H", &origin, "-H", "origin: http://evil.example"];
    let (status, body) = plain(&[&twice[..], &[&format!("http://{console}/session/challenge")]].concat());
    assert_eq!(status, "403", "{body}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn grpcurl_lists_the_services_by_the_line_of_the_documentation() {
    let fleet = Fleet::found(1);
    let _node = fleet.nodes[0].start();
    let owner = fleet.owner();
    connect(&owner).await;
    let place = TempDir::new().unwrap();
    ran(Command::new("go")
        .args(["install", "github.com/fullstorydev/grpcurl/cmd/grpcurl@v1.9.1"])
        .env("GOBIN", place.path()));
    let page = include_str!("../../docs/metrics.md");
    let lines = block(page, "## gRPC health checks and reflection", "sh");
    let context = fleet.home().join("contexts").join(&owner.name);
    // As `jq -r '.[].roots[]' msps.json` prints them.
    let msps: Vec<Value> = serde_json::from_slice(&fs::read(context.join("msps.json")).unwrap()).unwrap();
    let roots = msps.iter().flat_map(|msp| msp["roots"].as_array().unwrap()).map(|root| root.as_str().unwrap());
    fs::write(context.join("roots.pem"), roots.collect::<Vec<_>>().join("\n")).unwrap();
    assert!(lines.contains("jq -r '.[].roots[]' msps.json > roots.pem"), "{lines}");
    let line = lines.lines().find_map(|line| line.strip_prefix("grpcurl ")).expect("the line of grpcurl");
    let line = line.replace("fleet.example:7450", &fleet.nodes[0].address).replace("node1", &fleet.nodes[0].name);
    let listed = ran(Command::new(place.path().join("grpcurl")).args(line.split(' ')).current_dir(&context));
    assert!(String::from_utf8_lossy(&listed.stdout).contains("ledgerd.v1.Gateway"), "{listed:?}");
}
