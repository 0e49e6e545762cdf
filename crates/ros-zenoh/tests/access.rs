//! Mutual TLS with access control that denies by default: only the bridge's certificate publishes on the guarded topic.

use std::path::{Path, PathBuf};

use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, DnType, IsCa, KeyPair};
use ros_zenoh::{
    node::Node,
    qos::TokenQos,
    settings::{Mode, Settings, Tls},
    token::Kind,
};
use tempfile::TempDir;

use crate::support::{DOMAIN, Received, free_endpoint, message, seen, subject, until};

/// The rules that docs/bridge.md shows: everything that ROS 2 needs, and one certificate on the guarded topic.
fn rules() -> String {
    let page = include_str!("../../../docs/bridge.md");
    let (_, rest) = page.split_once("```json5\n").unwrap();
    rest.split_once("```").unwrap().0.to_owned()
}

/// A certificate authority, and the certificates of a router, a bridge and another node.
struct Files {
    directory: TempDir,
    endpoint: String,
}

impl Files {
    fn new() -> Self {
        let directory = tempfile::tempdir().unwrap();
        let mut params = CertificateParams::default();
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        params.distinguished_name.push(DnType::CommonName, "robot graph");
        let ca = CertifiedIssuer::self_signed(params, KeyPair::generate().unwrap()).unwrap();
        std::fs::write(directory.path().join("ca.pem"), ca.pem()).unwrap();
        for name in ["router", "bridge", "camera"] {
            let mut params = CertificateParams::new(["127.0.0.1".to_owned()]).unwrap();
            params.distinguished_name.push(DnType::CommonName, name);
            let key = KeyPair::generate().unwrap();
            let certificate = params.signed_by(&key, &ca).unwrap();
            std::fs::write(directory.path().join(format!("{name}.pem")), certificate.pem()).unwrap();
            std::fs::write(directory.path().join(format!("{name}.key")), key.serialize_pem()).unwrap();
        }
        Self { directory, endpoint: free_endpoint().replace("tcp/", "tls/") }
    }

    fn file(&self, name: &str) -> Option<PathBuf> {
        Some(Path::new(self.directory.path()).join(name))
    }

    fn tls(&self, name: &str) -> Tls {
        let (certificate, key) = (self.file(&format!("{name}.pem")), self.file(&format!("{name}.key")));
        Tls { ca: self.file("ca.pem"), certificate, key }
    }

    async fn router(&self) -> Node {
        let settings = Settings {
            mode: Mode::Router,
            listen: vec![self.endpoint.parse().unwrap()],
            tls: self.tls("router"),
            access_control: Some(rules()),
            ..Settings::default()
        };
        Node::join(DOMAIN, "router", &settings).await.unwrap()
    }

    fn client(&self, tls: Tls) -> Settings {
        Settings { connect: vec![self.endpoint.parse().unwrap()], tls, ..Settings::default() }
    }

    async fn node(&self, name: &str) -> Node {
        Node::join(DOMAIN, name, &self.client(self.tls(name))).await.unwrap()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn another_nodes_valid_certificate_does_not_publish_on_the_guarded_topic() {
    let files = Files::new();
    let _router = files.router().await;
    let (bridge, camera, robot) = (files.node("bridge").await, files.node("camera").await, files.node("camera").await);
    let (guarded, open) = (subject("/cmd_vel"), subject("/image"));
    let received = [&guarded, &open].map(|topic| Received::open(&robot, topic, TokenQos::default()));
    let [rogue, image] = [&guarded, &open].map(|topic| camera.publisher(topic, TokenQos::default()).unwrap());
    let allowed = bridge.publisher(&guarded, TokenQos::default()).unwrap();
    for (node, name) in [(&bridge, "/cmd_vel"), (&camera, "/cmd_vel"), (&camera, "/image")] {
        until("the subscribers are seen", || seen(node, Kind::Subscriber, name).len() == 1).await;
    }
    rogue.publish(message(1)).unwrap();
    // On one link after it: when this is there, the other one has been dropped.
    image.publish(message(2)).unwrap();
    assert_eq!(received[1].messages(1).await[0].0, message(2), "the same certificate publishes elsewhere");
    allowed.publish(message(3)).unwrap();
    let messages = received[0].messages(1).await;
    assert_eq!((messages.len(), &messages[0].0), (1, &message(3)), "only what the bridge has published");
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_certificate_of_this_authority_nobody_joins() {
    let (files, others) = (Files::new(), Files::new());
    let _router = files.router().await;
    let foreign = Tls { ca: files.file("ca.pem"), ..others.tls("bridge") };
    for tls in [foreign, Tls { ca: files.file("ca.pem"), ..Tls::default() }] {
        let joined = Node::join(DOMAIN, "rogue", &files.client(tls)).await;
        // With TLS 1.3 a client learns after its handshake that it was refused.
        if let Ok(rogue) = joined {
            let bridge = files.node("bridge").await;
            let received = Received::open(&bridge, &subject("/image"), TokenQos::default());
            rogue.publisher(&subject("/image"), TokenQos::default()).unwrap().publish(message(1)).unwrap();
            let camera = files.node("camera").await;
            let image = camera.publisher(&subject("/image"), TokenQos::default()).unwrap();
            until("the subscriber is seen", || seen(&camera, Kind::Subscriber, "/image").len() == 1).await;
            image.publish(message(2)).unwrap();
            assert_eq!(received.messages(1).await[0].0, message(2), "nothing of the rogue");
        }
    }
}
