//! Writes a corpus for every target: `fuzz-seeds DIRECTORY`.

#![expect(clippy::indexing_slicing, reason = "vectors that are shorter end the program")]

use bytes::Bytes;
use ledger::block::{Header, Payload};
use ledger::branch::CertifiedBranch;
use ledger_abac::DEFAULT_POLICY;
use ledger_base::hash::Hash;
use ledger_contract::Envelope;
use ledger_fuzz::dds::conversations;
use ledger_fuzz::files::File;
use ledger_fuzz::{BEGINNINGS, bytes, evidence, list, messages, vectors};
use ledger_light::{Certificate, Statement};
use mcap::WriteOptions;
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, DnType, IsCa, KeyPair, KeyUsagePurpose};
use rcgen::{CertificateRevocationListParams, KeyIdMethod, SerialNumber, date_time_ymd};
use rtps::wire::read::submessages;
use rtps::wire::submessage::{Data, Payload as Sample, Submessage};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

type Done = Result<(), Box<dyn Error>>;

/// Bytes of a proof in front of the length of its certificate.
const PROOF_HEAD: usize = 17;
/// Where a certificate's statement begins and ends, and where its first signature begins.
const STATEMENT: std::ops::Range<usize> = 23..156;
const SIGNATURE: usize = 160;
/// Bytes of the hash at the end of evidence.
const HASH_BYTES: usize = 32;
/// Most bytes of a sequence of datagrams.
const SEQUENCE_BYTES_MAX: usize = 12_000;
/// The configuration of a Fabric organisation, as its tools write it.
const UNITS: &str = "NodeOUs:\n  Enable: true\n  ClientOUIdentifier:\n    Certificate: cacerts/ca.pem\n    \
    OrganizationalUnitIdentifier: client\n  AdminOUIdentifier:\n    OrganizationalUnitIdentifier: admin\n";

fn main() -> Done {
    let place = std::env::args_os().nth(1).ok_or("wanted: fuzz-seeds DIRECTORY")?;
    let corpus = Corpus(PathBuf::from(place));
    certified(&corpus)?;
    envelopes(&corpus)?;
    policies(&corpus)?;
    recordings(&corpus)?;
    directories(&corpus)?;
    dds(&corpus)?;
    for number in 0..u8::try_from(messages::ALL.len())? {
        corpus.seed("protobuf", &[number])?;
        corpus.seed("protobuf", &[number, 0x0a, 2, 0x08, 1, 0x10, 1])?;
    }
    let payload = Payload { time: 1, ..Payload::default() };
    corpus.seed("block", &payload.to_bytes())?;
    corpus.seed("peer-message", &[0x0a, 4, 0x08, 1, 0x10, 2])?;
    corpus.seed("transaction", &[0x0a, 4, 0x08, 1, 0x10, 2, 0x12, 1, 0])
}

/// Datagrams of other implementations of DDS, as fuzz/capture.py wrote them.
const CAPTURES: [&str; 6] = [
    include_str!("../../crates/rtps/src/announcement/captures/cyclonedds-11.0.1.hex"),
    include_str!("../../crates/rtps/src/announcement/captures/cyclonedds-11.0.1-fragments.hex"),
    include_str!("../../crates/rtps/src/announcement/captures/fastdds-2.14.5.hex"),
    include_str!("../../crates/rtps/src/announcement/captures/fastdds-2.14.5-large-data.hex"),
    include_str!("../../crates/rtps/src/announcement/captures/fastdds-2.14.5-more.hex"),
    include_str!("../../crates/rtps/src/announcement/captures/rustdds-0.15.1.hex"),
];

/// A directory with a directory for each target.
struct Corpus(PathBuf);

impl Corpus {
    fn seed(&self, target: &str, bytes: &[u8]) -> Done {
        let place = self.0.join(target);
        fs::create_dir_all(&place)?;
        Ok(fs::write(place.join(Hash::of(&[bytes]).to_string()), bytes)?)
    }
}

/// The vectors of certified blocks.
fn certified(corpus: &Corpus) -> Done {
    for fact in list("facts") {
        corpus.seed("fact", &bytes(&fact["bytes"]))?;
        corpus.seed("path", &bytes(&fact["path"]))?;
    }
    for lie in list("lies") {
        corpus.seed("lie", &bytes(&lie["lie"]))?;
    }
    for vote in list("votes") {
        corpus.seed("signature", &bytes(&vote["signature"]))?;
    }
    for begin in vectors()["beginnings"].as_object().into_iter().flat_map(|begin| begin.values()) {
        match &begin["checkpoint"] {
            Value::Null => corpus.seed("change", &bytes(&begin["writes"]))?,
            checkpoint => corpus.seed("checkpoint", &bytes(checkpoint))?,
        }
    }
    for evidence in evidence() {
        corpus.seed("evidence", &evidence)?;
        // The target also adds the hash at the end by itself.
        corpus.seed("evidence", &evidence[..evidence.len() - HASH_BYTES])?;
    }
    list("ways").try_for_each(|way| items(&way["steps"]).try_for_each(|step| steps(corpus, way, step)))
}

/// The certificate alone, and behind two headers.
fn branches(corpus: &Corpus, mut certificate: Certificate) -> Done {
    corpus.seed("branch", &CertifiedBranch::of(certificate.clone()).to_bytes())?;
    let first = Header { height: 7, term: 1, time: 1, previous: Hash::ZERO, root: Hash::ZERO };
    let last = Header { height: 8, previous: first.hash(), ..first };
    let Statement { height, time, block, .. } = &mut certificate.statement;
    (*height, *time, *block) = (last.height, last.time, last.hash());
    corpus.seed("branch", &CertifiedBranch::new(vec![first, last], certificate)?.to_bytes())
}

fn steps(corpus: &Corpus, way: &Value, step: &Value) -> Done {
    let proof = bytes(&step["proof"]);
    corpus.seed("proof", &proof)?;
    // Some of them are cut off.
    if let Some(certificate) = certificate(&proof) {
        corpus.seed("certificate", certificate)?;
        if let Ok(certificate) = Certificate::from_bytes(certificate) {
            branches(corpus, certificate)?;
        }
        if let Some((statement, signature)) = certificate.get(STATEMENT).zip(certificate.get(SIGNATURE..)) {
            corpus.seed("statement", statement)?;
            corpus.seed("signed", &[statement, signature].concat())?;
        }
    }
    let mut shown = Vec::new();
    for change in items(&step["changes"]) {
        let (height, writes) = (change["height"].as_u64().ok_or("a height")?, bytes(&change["writes"]));
        corpus.seed("change", &writes)?;
        shown.extend(height.to_be_bytes());
        shown.extend(u32::try_from(writes.len())?.to_be_bytes());
        shown.extend(writes);
    }
    let Some(begin) = BEGINNINGS.iter().position(|begin| way["begin"] == *begin) else { return Ok(()) };
    let head = [u8::try_from(begin)?, u8::try_from(items(&step["changes"]).count())?];
    corpus.seed("follow", &[&head, &shown[..], &proof].concat())
}

/// The certificate in a proof.
fn certificate(proof: &[u8]) -> Option<&[u8]> {
    let (length, rest) = proof.get(PROOF_HEAD..)?.split_first_chunk()?;
    rest.get(..usize::try_from(u32::from_be_bytes(*length)).ok()?)
}

fn items(list: &Value) -> impl Iterator<Item = &Value> {
    list.as_array().into_iter().flatten()
}

/// A message under a content key, and a key that was shared in front of one.
fn envelopes(corpus: &Corpus) -> Done {
    let message = [&Envelope::head(42, &[2; 12])[..], &[0; 30]].concat();
    corpus.seed("envelope", &message)?;
    let reader = json!({"reader": "Org1/Salma", "key": "00".repeat(32), "wrapped": "00".repeat(80)});
    let share = json!({"readers": [reader]}).to_string();
    corpus.seed("envelope", &[share.as_bytes(), b"\n", &message].concat())
}

/// The policies of the documentation.
fn policies(corpus: &Corpus) -> Done {
    corpus.seed("policy", DEFAULT_POLICY.as_bytes())?;
    let page = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/policies.md"))?;
    let blocks = page.split("```").skip(1).step_by(2);
    blocks.filter_map(|block| block.strip_prefix("cedar\n")).try_for_each(|text| corpus.seed("policy", text.as_bytes()))
}

fn recordings(corpus: &Corpus) -> Done {
    let mut file = Vec::new();
    let options = WriteOptions::new().profile("ros2").library("fuzz").compression(None).disable_seeking(true);
    let mut writer = options.create(NoSeek::new(&mut file))?;
    let facts = BTreeMap::from([("robot".to_owned(), "Husky".to_owned())]);
    let schema = writer.add_schema("geometry_msgs/msg/Twist", "ros2msg", b"Vector3 linear\nVector3 angular\n")?;
    let channel_id = writer.add_channel(schema, "/cmd_vel", "cdr", &facts)?;
    for sequence in 0..3 {
        let time = u64::from(sequence);
        let header = MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, &[0, 1, 0, 0, 0, 0, 0, 0])?;
    }
    writer.write_metadata(&Metadata { name: "network".to_owned(), metadata: facts })?;
    writer.finish()?;
    drop(writer);
    corpus.seed("mcap", &file)
}

/// An organisation of Fabric with a revocation list.
fn directories(corpus: &Corpus) -> Done {
    let mut params = CertificateParams::default();
    params.distinguished_name.push(DnType::CommonName, "ca.org3");
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    let authority = CertifiedIssuer::self_signed(params, KeyPair::generate()?)?;
    let list = CertificateRevocationListParams {
        this_update: date_time_ymd(2026, 1, 1),
        next_update: date_time_ymd(2027, 1, 1),
        crl_number: SerialNumber::from(1u64),
        issuing_distribution_point: None,
        revoked_certs: Vec::new(),
        key_identifier_method: KeyIdMethod::Sha256,
    };
    let list = list.signed_by(&authority)?;
    let whole = [File(0x80, authority.der()), File(0x83, list.der()), File(5, UNITS.as_bytes())];
    corpus.seed("revocation-list", list.der())?;
    corpus.seed("msp", &Bytes::from(whole.map(|file| file.to_bytes()).concat()))?;
    corpus.seed("msp", &File(0x80, authority.der()).to_bytes())
}

/// Each captured datagram as one step, those of a capture as steps of two participants, and the parameter lists in them.
fn dds(corpus: &Corpus) -> Done {
    for capture in CAPTURES {
        let mut all = Vec::new();
        for line in capture.lines().filter(|line| !line.starts_with('#')) {
            let datagram = hex::decode(line)?;
            let sender = u8::from(!all.is_empty());
            let step = [&[0, sender][..], &u16::try_from(datagram.len())?.to_le_bytes(), &datagram].concat();
            corpus.seed("rtps-datagrams", &step)?;
            if all.len() + step.len() < SEQUENCE_BYTES_MAX {
                all.extend(step);
            }
            for message in submessages(&Bytes::from(datagram)) {
                if let Submessage::Data(Data { payload: Sample::Data(list) | Sample::Key(list), .. }) =
                    message.submessage
                    && [&[0, 2][..], &[0, 3]].iter().any(|encapsulation| list.starts_with(encapsulation))
                {
                    corpus.seed("rtps-parameters", &list)?;
                }
            }
        }
        corpus.seed("rtps-datagrams", &all)?;
    }
    // Own endpoints write, assert themselves, and time passes.
    for kind in 5..8 {
        corpus.seed("rtps-datagrams", &[kind, 2, 0xff, 0x0f, kind, 1, 4, 0])?;
    }
    // What they are matched with sends samples, fragments and heartbeats.
    for steps in conversations() {
        corpus.seed("rtps-datagrams", &steps)?;
    }
    Ok(())
}
