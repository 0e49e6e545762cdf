//! The page for whoever watches a bridge.

use crate::support::page::{documented, exposed, get, named, values};
use crate::support::wait::{eventually, until};
use crate::world::{self, World};
use crate::{call, network};
use ledger_gate::sample::Sample;
use rcgen::{BasicConstraints, CertificateParams, DnType, IsCa, Issuer, KeyPair};
use ros_bridge::dds::Participant;
use ros_bridge::names::{TopicName, TypeName};
use ros_bridge::qos::Qos;
use ros_bridge::queue::Limits;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

const TWIST: &str = "geometry_msgs/msg/Twist";
const USERS_PAGE: &str = "127.0.0.1:7461";
const ROBOTS_PAGE: &str = "127.0.0.1:7462";

fn settings(domain: u16, direction: &str, page: &str) -> String {
    format!(
        "domain_id = {domain}\nshared_memory = false\n[admin]\nlisten = {page:?}\n[[route]]\n\
         service = \"Rover/cmd_vel\"\ndirection = {direction:?}\ntype = {TWIST:?}\n"
    )
}

/// The only value of a figure; 0 if there is none.
fn value(page: &str, name: &str) -> f64 {
    values(&get(page, "/metrics").1, name).first().map_or(0.0, |(_, value)| *value)
}

/// Waits until the page of a bridge answers so.
fn ready(page: &str, is_expected: impl Fn(&str, &str) -> bool) -> String {
    eventually("the bridge is as expected", || {
        let (status, body) = get(page, "/readyz?verbose");
        is_expected(&status, &body).then_some(body)
    })
}

fn is_well(status: &str, body: &str) -> bool {
    status == "HTTP/1.1 200 OK" && body.contains("cmd_vel ")
}

#[test]
fn the_page_of_a_bridge_says_whether_it_is_ready_and_why_not_and_has_the_figures_of_the_documentation() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TWIST).await;
        let user = world.start_bridge_as("Salma", &settings(1, "to_ledger", USERS_PAGE), &[]);
        let robot = world.start_bridge_as("Rover", &settings(3, "from_ledger", ROBOTS_PAGE), &[]);
        assert_eq!(get(USERS_PAGE, "/livez"), ("HTTP/1.1 200 OK".to_owned(), "ok\n".to_owned()));
        // Nobody has to hold anything: a user's bridge without a grant is ready, and says so.
        let said = ready(USERS_PAGE, is_well);
        for line in [
            "[+] ledger ok",
            "[+] graph ok",
            "[+] Rover/cmd_vel to_ledger ok",
            "[+] grant ok, but Org1/Salma does not hold Rover/cmd_vel",
        ] {
            assert!(said.lines().any(|told| told == line), "{line}\n{said}");
        }
        // The voters have answered.
        let is_opened = |body: &str| body.contains("[+] Rover/cmd_vel from_ledger ok\n");
        let said = ready(ROBOTS_PAGE, |status, body| is_well(status, body) && is_opened(body));
        assert!(!said.contains("grant"), "{said}");
        assert!(get(USERS_PAGE, "/metric").0.contains("404"));

        let (topic, kind) = (TopicName::parse("/cmd_vel").unwrap(), TypeName::parse(TWIST).unwrap());
        let graphs = [Participant::open(1, "teleop").await.unwrap(), Participant::open(3, "driver").await.unwrap()];
        let writer = graphs[0].writer(&topic, &kind, &Qos::default()).unwrap();
        let mut reader = graphs[1].reader(&topic, &kind, &Qos::default(), Limits::default()).unwrap();
        let drive = async || loop {
            writer.write(&Sample::new([0, 1], &[0; 48]).unwrap()).unwrap();
            tokio::time::sleep(Duration::from_millis(50)).await;
        };
        let test = async {
            // Without a grant the ledger refuses.
            until("a command is refused", || async {
                (value(USERS_PAGE, "ledgerd_bridge_refused_total") > 0.0).then_some(())
            })
            .await;
            call(&world.salma, "acquire", &["Rover/cmd_vel", "60000"]).await;
            reader.next().await.unwrap();
            until("a command is delivered", || async {
                (value(ROBOTS_PAGE, "ledgerd_bridge_delivered_total") > 0.0).then_some(())
            })
            .await;
            until("a command is committed", || async {
                (value(USERS_PAGE, "ledgerd_bridge_committed_total") > 0.0).then_some(())
            })
            .await;
            let said = ready(USERS_PAGE, |status, body| is_well(status, body) && body.contains("[+] grant ok\n"));
            assert!(said.ends_with("ready\n") && !said.contains("[-]"), "{said}");
            call(&world.salma, "release", &["Rover/cmd_vel"]).await;
            until("the robot is stopped", || async {
                (value(ROBOTS_PAGE, "ledgerd_bridge_stops_total") > 0.0).then_some(())
            })
            .await;
        };
        tokio::select! {
            () = drive() => {}
            () = test => {}
        }

        // Nothing is exposed that is not documented, and the other way round.
        let [users, robots] = [USERS_PAGE, ROBOTS_PAGE].map(|page| get(page, "/metrics").1);
        assert_eq!(&exposed(&users) | &exposed(&robots), documented().1);
        let labels = values(&robots, "ledgerd_bridge_delivered_total")[0].0;
        assert_eq!(labels, "{service=\"Rover/cmd_vel\",direction=\"from_ledger\"}");
        let of = |metrics: &str, name: &str| values(metrics, name)[0].1;
        assert!(of(&users, "ledgerd_bridge_commit_seconds_count") >= 1.0);
        assert!(of(&users, "ledgerd_bridge_commit_seconds_count") <= of(&users, "ledgerd_bridge_submitted_total"));
        assert!(of(&robots, "ledgerd_bridge_age_seconds_count") >= of(&robots, "ledgerd_bridge_delivered_total"));
        assert!(of(&robots, "ledgerd_bridge_age_seconds_sum") > 0.0);
        let refused = values(&users, "ledgerd_bridge_refused_total");
        assert!(refused.iter().any(|(labels, _)| labels.contains("code=\"NOT_HOLDER\"")), "{refused:?}");
        assert!(named(&users).len() > 10 && users.ends_with('\n'), "{users}");
        for metrics in [&users, &robots] {
            let series = metrics.lines().filter(|line| !line.starts_with('#')).count();
            assert!(series <= 60, "{series} series for one route:\n{metrics}");
        }

        // The ledger is silent: that is no reason to restart the bridge, and one not to be ready.
        world.node().send(rustix::process::Signal::STOP);
        let silent = |status: &str, body: &str| status.contains("503") && body.contains("[-] ledger failed: node ");
        let said = ready(ROBOTS_PAGE, silent);
        assert!(said.contains("gives no sign of life") && said.ends_with("not ready\n"), "{said}");
        assert_eq!(get(ROBOTS_PAGE, "/livez").1, "ok\n");
        assert!(value(ROBOTS_PAGE, "ledgerd_bridge_ledger_silence_seconds") > 1.0);
        world.node().send(rustix::process::Signal::CONT);
        ready(ROBOTS_PAGE, is_well);
        user.report();
        robot.report();
    });
}

#[test]
fn the_page_is_there_while_a_bridge_waits_and_says_for_what() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TWIST).await;
        let later = settings(1, "to_ledger", USERS_PAGE).replace("Rover/cmd_vel", "Latecomer/cmd_vel");
        let salma = world.start_bridge_as("Salma", &later, &[]);
        let said = ready(USERS_PAGE, |status, body| status.contains("503") && body.contains("Latecomer"));
        assert!(said.starts_with("[+] ledger ok\n[-] graph failed: not joined: LGR-"), "{said}");
        assert_eq!(value(USERS_PAGE, "ledgerd_bridge_is_running"), 0.0);
        assert_eq!(get(USERS_PAGE, "/livez").1, "ok\n");
        world.register("Latecomer", "/cmd_vel", TWIST).await;
        ready(USERS_PAGE, is_well);
        assert_eq!(value(USERS_PAGE, "ledgerd_bridge_is_running"), 1.0);
        salma.report();

        // The page tells who may command what: without a certificate it is for the machine only.
        let elsewhere = settings(1, "to_ledger", "0.0.0.0:7461");
        let refused = world.bridge_refuses("Salma", &elsewhere);
        for word in ["limited to its own machine", "admin.listen = \"0.0.0.0:7461\"", "loopback", "TLS"] {
            assert!(refused.contains(word), "{word}: {refused}");
        }
        let half = elsewhere.replace("[admin]\n", "[admin]\ncertificate = \"page.pem\"\n");
        let refused = world.bridge_refuses("Salma", &half);
        assert!(refused.contains("1 of certificate, key and clients"), "{refused}");
    });
}

/// Asks for /livez over TLS as curl does, which trusts `ca` alone; `client` is a certificate and its key.
fn over_tls(ca: &Path, client: Option<[&Path; 2]>) -> Result<String, String> {
    let mut curl = Command::new("curl");
    curl.args(["--silent", "--show-error", "--cacert"]).arg(ca);
    if let Some([certificate, key]) = client {
        curl.arg("--cert").arg(certificate).arg("--key").arg(key);
    }
    let done = curl.arg("https://localhost:7461/livez").output().unwrap();
    let told = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    if done.status.success() { Ok(told(&done.stdout)) } else { Err(told(&done.stderr)) }
}

#[test]
fn with_a_certificate_of_its_operator_the_page_of_a_bridge_is_for_clients_of_the_authorities_that_it_names() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let world = World::start("/cmd_vel", TWIST).await;
        let place = tempfile::tempdir().unwrap();
        let file = |name: &str| place.path().join(name);
        let authority = |name: &str| {
            let mut params = CertificateParams::new(Vec::new()).unwrap();
            params.distinguished_name.push(DnType::CommonName, name);
            params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
            let key = KeyPair::generate().unwrap();
            std::fs::write(file(name), params.self_signed(&key).unwrap().pem()).unwrap();
            Issuer::new(params, key)
        };
        let [ours, others] = [authority("ours.pem"), authority("others.pem")];
        let issue = |issuer: &Issuer<'_, KeyPair>, name: &str| {
            let key = KeyPair::generate().unwrap();
            let mut params = CertificateParams::new(vec!["localhost".to_owned()]).unwrap();
            params.distinguished_name.push(DnType::CommonName, name);
            std::fs::write(file(&format!("{name}.pem")), params.signed_by(&key, issuer).unwrap().pem()).unwrap();
            std::fs::write(file(&format!("{name}.key")), key.serialize_pem()).unwrap();
        };
        issue(&ours, "page");
        issue(&ours, "prometheus");
        issue(&others, "stranger");
        let [certificate, key, clients] = ["page.pem", "page.key", "ours.pem"].map(file);
        let page =
            format!("listen = \"0.0.0.0:7461\"\ncertificate = {certificate:?}\nkey = {key:?}\nclients = {clients:?}\n");
        let text = settings(1, "to_ledger", USERS_PAGE).replace(&format!("listen = {USERS_PAGE:?}\n"), &page);
        let salma = world.start_bridge_as("Salma", &text, &[]);
        let as_client = |name: &str| [file(&format!("{name}.pem")), file(&format!("{name}.key"))];
        let ask = |name: &str| {
            let [certificate, key] = as_client(name);
            over_tls(&file("ours.pem"), Some([&certificate, &key]))
        };
        let said = eventually("the page answers", || ask("prometheus").inspect_err(|why| println!("{why}")).ok());
        assert_eq!(said, "ok\n");
        for refused in [ask("stranger"), over_tls(&file("ours.pem"), None)] {
            assert!(refused.is_err(), "{refused:?}");
        }
        // The page is there before the bridge has joined the graph, and only a bridge that has joined reports.
        world.line("Salma", &["is ready"]).await;
        salma.report();
    });
}

#[test]
fn a_node_with_a_bridge_inside_has_its_figures_too() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let mut world = World::start_with_inner_bridge("/cmd_vel", TWIST).await;
        world.restart_node(1, "Org2", |text| format!("{text}\n[admin]\nlisten = {ROBOTS_PAGE:?}\n"));
        until("the bridge inside runs", || async {
            (value(ROBOTS_PAGE, "ledgerd_bridge_route_is_open") > 0.0).then_some(())
        })
        .await;
        let metrics = get(ROBOTS_PAGE, "/metrics").1;
        let (of_nodes, of_bridges) = documented();
        let all = exposed(&metrics);
        assert!(all.contains("ledgerd_height") && all.is_subset(&(&of_nodes | &of_bridges)), "{all:?}");
        // Clients choose nodes by their readiness: the robot's route is none of their business.
        let said = get(ROBOTS_PAGE, "/readyz?verbose").1;
        assert!(said.contains("[+] quorum ok") && !said.contains("cmd_vel"), "{said}");
    });
}
