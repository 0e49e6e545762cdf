//! The page for whoever watches a node.

use crate::own_network::isolated;
use crate::support::network::{free_address, register_robots};
use crate::support::page::{documented, exposed, get, get_by, get_with, named, values};
use crate::support::wait::{eventually, until};
use crate::support::{Fleet, connect, programs, wire};
use ledger_api::Context;
use ledger_identity::Role;
use std::process::Command;
use tonic::client::Grpc;
use tonic::codegen::http::uri::PathAndQuery;
use tonic_prost::ProstCodec;

/// An address that is not one of loopback, though nothing leaves the namespace.
const ELSEWHERE: &str = "10.77.0.1";

/// The questions of a dashboard to Prometheus.
fn expressions(part: &serde_json::Value) -> Vec<String> {
    let own = part.get("expr").and_then(|text| text.as_str()).map(str::to_owned);
    let below: Vec<&serde_json::Value> = match part {
        serde_json::Value::Array(parts) => parts.iter().collect(),
        serde_json::Value::Object(parts) => parts.values().collect(),
        _ => Vec::new(),
    };
    own.into_iter().chain(below.into_iter().flat_map(expressions)).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_page_says_whether_a_node_is_ready_and_why_not_and_has_the_figures_of_the_documentation() {
    let fleet = Fleet::found(2);
    let page = free_address();
    fleet.nodes[0].configure(&format!("[admin]\nlisten = \"{page}\""));
    let mut nodes: Vec<_> = fleet.nodes.iter().map(|place| place.start()).collect();
    let owner = connect(&Context { nodes: vec![fleet.nodes[0].address.clone()], ..fleet.owner() }).await;
    register_robots(&owner, "open").await;
    assert_eq!(get(&page, "/livez"), ("HTTP/1.1 200 OK".to_owned(), "ok\n".to_owned()));
    let ready = eventually("the node is ready", || {
        let (status, body) = get(&page, "/readyz?verbose");
        (status == "HTTP/1.1 200 OK").then_some(body)
    });
    assert_eq!(ready.matches("[+]").count(), 11, "{ready}");
    assert!(ready.ends_with("ready\n") && !ready.contains("[-]"), "{ready}");
    assert_eq!(get(&page, "/readyz").1, "ready\n");
    assert!(get(&page, "/metric").0.contains("404"));
    // A name that a foreign page lets point here is rejected; so nothing is read through a browser.
    let port = page.rsplit_once(':').unwrap().1;
    for path in ["/livez", "/readyz", "/metrics"] {
        let (status, body) = get_by(&format!("rebound.example:{port}"), &page, path);
        assert!(status.contains("403") && body.contains("the request is not for this page"), "{path}: {status} {body}");
        assert!(!get_by(&format!("localhost:{port}"), &page, path).0.contains("403"), "{path}");
    }

    assert!(owner.invoke("abac", "acquire", vec!["Nothing/at_all".into()]).await.is_err());
    // A client that does not name OpenMetrics reads the text form.
    let (status, metrics) = get(&page, "/metrics");
    assert_eq!(status, "HTTP/1.1 200 OK");
    assert!(metrics.contains("# TYPE ledgerd_executed_total counter\n") && !metrics.contains("# EOF"), "{metrics}");
    let (status, metrics) = get_with(&["accept: application/openmetrics-text; version=1.0.0"], &page, "/metrics");
    assert_eq!(status, "HTTP/1.1 200 OK");
    let height = owner.status().await.unwrap().height;
    let [(_, told)] = values(&metrics, "ledgerd_height")[..] else { panic!("{metrics}") };
    assert!((1.0..=height as f64).contains(&told), "{told} of {height}");
    assert_eq!(values(&metrics, "ledgerd_is_leader"), [("", 1.0)]);
    let [(_, committed)] = values(&metrics, "ledgerd_commit_seconds_count")[..] else { panic!("{metrics}") };
    let [(_, flushed)] = values(&metrics, "ledgerd_flush_seconds_count")[..] else { panic!("{metrics}") };
    let [(_, handed_over)] = values(&metrics, "ledgerd_gateway_seconds_count")[..] else { panic!("{metrics}") };
    assert!(committed >= 1.0 && flushed >= 1.0 && handed_over >= 1.0, "{committed} {flushed} {handed_over}");
    let [(_, awake)] = values(&metrics, "ledgerd_awake_seconds_total")[..] else { panic!("{metrics}") };
    assert!(awake >= 0.0, "{awake}");
    let executed = values(&metrics, "ledgerd_executed_total");
    assert!(executed.iter().any(|(labels, count)| labels.contains("code=\"OK\"") && *count >= 1.0), "{executed:?}");
    let refused = values(&metrics, "ledgerd_refused_total");
    assert!(refused.iter().any(|(labels, count)| labels.contains("UNKNOWN_ROBOT") && *count >= 1.0), "{refused:?}");
    let lives = values(&metrics, "ledgerd_certificate_remaining_seconds");
    assert!(lives.iter().any(|(labels, left)| labels.contains("kind=\"node\"") && *left > 86_400.0), "{lives:?}");
    assert!(metrics.ends_with("# EOF\n"));
    let series = metrics.lines().filter(|line| !line.starts_with('#')).count();
    assert!(series <= 95, "{series} series:\n{metrics}");

    // Nothing is exposed that is not documented, and the other way round; alerts and the dashboard speak of nothing else.
    let (of_nodes, of_bridges) = documented();
    assert_eq!(exposed(&metrics), of_nodes);
    let types = &of_nodes | &of_bridges;
    let alerts = include_str!("../../packaging/prometheus/alerts.yml");
    let dashboard: serde_json::Value =
        serde_json::from_str(include_str!("../../packaging/grafana/ledgerd.json")).unwrap();
    let asked = expressions(&dashboard);
    assert!(asked.len() > 20, "{asked:?}");
    for name in asked.iter().map(String::as_str).chain([alerts]).flat_map(named) {
        assert!(types.contains(name.trim_end_matches("_bucket")), "{name}");
    }
    for expression in &asked {
        let labels = expression.split('{').skip(1).filter_map(|rest| rest.split_once('}'));
        let unknown = |labels: &str| !labels.starts_with("job=\"$job\"");
        assert!(labels.clone().count() > 0 && !labels.into_iter().any(|(labels, _)| unknown(labels)), "{expression}");
    }

    // The second node only follows: with it nothing is lost. Without the first, it knows no leader.
    nodes[1].kill();
    assert_eq!(get(&page, "/readyz").0, "HTTP/1.1 200 OK");
    nodes[0].interrupt();
    let other = free_address();
    fleet.nodes[1].configure(&format!("[admin]\nlisten = \"{other}\""));
    nodes[1] = fleet.nodes[1].start();
    let body = eventually("the node that only follows is not ready", || {
        let (status, body) = get(&other, "/readyz");
        (status == "HTTP/1.1 503 Service Unavailable").then_some(body)
    });
    assert!(body.contains("[-] leader failed: there is no leader") && body.ends_with("not ready\n"), "{body}");
    assert_eq!(get(&other, "/livez").1, "ok\n");
}

/// The answer to a health check (`grpc.health.v1.HealthCheckResponse`): 1 is SERVING, 2 NOT_SERVING.
async fn health(context: &Context, named: bool, service: &str) -> Result<u64, tonic::Code> {
    #[derive(Clone, PartialEq, prost::Message)]
    struct Request {
        #[prost(string, tag = "1")]
        service: String,
    }
    #[derive(Clone, PartialEq, prost::Message)]
    struct Answer {
        #[prost(uint64, tag = "1")]
        status: u64,
    }
    let mut client = Grpc::new(wire::channel(context, named).await);
    client.ready().await.unwrap();
    let path = PathAndQuery::from_static("/grpc.health.v1.Health/Check");
    let codec = ProstCodec::<Request, Answer>::default();
    let answer = client.unary(tonic::Request::new(Request { service: service.into() }), path, codec).await;
    answer.map(|answer| answer.into_inner().status).map_err(|status| status.code())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn health_checks_of_grpc_tell_what_readyz_tells_also_to_who_has_no_certificate() {
    let fleet = Fleet::found(2);
    let mut nodes: Vec<_> = fleet.nodes.iter().map(|place| place.start()).collect();
    let owner = Context { nodes: vec![fleet.nodes[1].address.clone()], ..fleet.owner() };
    connect(&owner).await;
    for named in [true, false] {
        for service in ["", "ledgerd.v1.Gateway"] {
            until("the node is ready", || async { (health(&owner, named, service).await == Ok(1)).then_some(()) })
                .await;
        }
        assert_eq!(health(&owner, named, "ledgerd.v1.Other").await, Err(tonic::Code::NotFound));
    }
    // The other one orders. Without it there is no leader.
    nodes[0].kill();
    until("the node is not ready", || async { (health(&owner, false, "").await == Ok(2)).then_some(()) }).await;
    nodes[1].interrupt();
}

/// `grpcurl list`, as far as it goes: the names of the services (`grpc.reflection.v1`).
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn server_reflection_names_the_services_to_members_and_to_nobody_else() {
    #[derive(Clone, PartialEq, prost::Message)]
    struct Request {
        #[prost(string, tag = "7")]
        list_services: String,
    }
    #[derive(Clone, PartialEq, prost::Message)]
    struct Answer {
        #[prost(bytes = "vec", tag = "6")]
        services: Vec<u8>,
    }
    let fleet = Fleet::found(1);
    let mut node = fleet.nodes[0].start();
    let owner = fleet.owner();
    connect(&owner).await;
    for version in ["v1", "v1alpha"] {
        let path: PathAndQuery =
            format!("/grpc.reflection.{version}.ServerReflection/ServerReflectionInfo").parse().unwrap();
        let ask = async |named| {
            let mut client = Grpc::new(wire::channel(&owner, named).await);
            client.ready().await.unwrap();
            let request = tokio_stream::once(Request { list_services: "*".into() });
            let codec = ProstCodec::<Request, Answer>::default();
            let answers = client.streaming(tonic::Request::new(request), path.clone(), codec).await;
            answers.map_err(|status| status.code())?.into_inner().message().await.map_err(|status| status.code())
        };
        let services = ask(true).await.unwrap().unwrap().services;
        let services = String::from_utf8_lossy(&services).into_owned();
        for name in ["ledgerd.v1.Gateway", "ledgerd.v1.Enrolment", "ledgerd.v1.Peer", "grpc.health.v1.Health"] {
            assert!(services.contains(name), "{services}");
        }
        assert_eq!(ask(false).await, Err(tonic::Code::Unimplemented));
    }
    node.interrupt();
}

#[test]
fn away_from_loopback_the_page_is_for_whoever_has_a_certificate_of_the_network() {
    if !isolated(&|| ()) {
        return;
    }
    let added = Command::new("ip").args(["address", "add", &format!("{ELSEWHERE}/32"), "dev", "lo"]).status().unwrap();
    assert!(added.success());
    let fleet = Fleet::found(1);
    let page = format!("{ELSEWHERE}:7451");
    fleet.nodes[0].configure(&format!("[admin]\nlisten = \"{page}\""));
    fleet.issue("Org1", "Salma", Role::Member, &[]);
    let _node = fleet.nodes[0].start();
    let salma = fleet.home().join("contexts/Salma");
    let ask = |with: bool| {
        let mut python = Command::new(programs::python());
        python.args(["-c", ASK, ELSEWHERE, "7451"]);
        if with {
            python.arg(salma.join("certificate.pem")).arg(salma.join("key.pem"));
        }
        let told = python.output().unwrap();
        String::from_utf8_lossy(&told.stdout).into_owned()
    };
    let told = eventually("the page answers", || Some(ask(true)).filter(|told| !told.is_empty()));
    assert!(told.starts_with("HTTP/1.1 200 OK") && told.ends_with("ok\n"), "{told}");
    assert_eq!(ask(false), "", "without a certificate");
}

/// Asks for /livez over TLS, and prints the answer; nothing if there is none.
const ASK: &str = r#"
import socket, ssl, sys
settings = ssl.create_default_context()
settings.check_hostname, settings.verify_mode = False, ssl.CERT_NONE
if len(sys.argv) > 3:
    settings.load_cert_chain(sys.argv[3], sys.argv[4])
try:
    with settings.wrap_socket(socket.create_connection((sys.argv[1], int(sys.argv[2])), 5)) as page:
        page.sendall(b"GET /livez HTTP/1.1\r\nhost: node\r\nconnection: close\r\n\r\n")
        answer = b""
        while chunk := page.recv(4096):
            answer += chunk
        sys.stdout.write(answer.decode().replace("\r\n", "\n"))
except OSError:
    pass
"#;
