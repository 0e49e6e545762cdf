//! Bytes that change on a disk while the node is down. The node repairs any of it, refuses it with file and offset, or
//! makes its state again from the blocks; it never answers wrong and never panics.
//!
//! | module | what is damaged |
//! |---|---|
//! | `log` | the segments: cut at every byte of the last records, a bit flipped in every sector; thousands of variants |
//! | `state` | the state store: bits flipped in its sectors; a node in this process opens it |
//! | `nodes` | a sample of all that on a voter whose cluster runs on: it catches up, or says why not |

mod log;
mod nodes;
mod state;

use std::fs;

use crate::audit::{Chain, audit};
use crate::cluster::{Cluster, NODES};
use crate::load::Load;
use crate::support::network::message;

/// Bytes of a large message, and how many of them fill a segment.
const LARGE_BYTES: usize = 30_000;
const FILL_A_SEGMENT: u64 = 36;

/// A network with some history, and its chain.
struct History {
    cluster: Cluster,
    chain: Chain,
}

impl History {
    /// A history with so many large messages. All nodes run.
    async fn new(large: u64) -> Self {
        let mut cluster = Cluster::found();
        for place in &cluster.fleet.nodes {
            place.configure("[limits]\npayload_bytes_max = 262144");
            let text = fs::read_to_string(&place.config).unwrap();
            fs::write(&place.config, text.replace("segment_mib = 4", "segment_mib = 1")).unwrap();
        }
        cluster.run("open").await;
        let load = Load::start(&cluster).await;
        let guest = cluster.client_from(&cluster.guest, 0).await;
        for number in 1..=large {
            guest.invoke("abac", "set", message(0, number, &vec![number as u8; LARGE_BYTES])).await.unwrap();
        }
        load.more("small messages too", 100, &mut cluster).await;
        let told = load.finish().await;
        let chain = audit(&mut cluster, &told).await;
        Self { cluster, chain }
    }

    /// All nodes are gone, as after a power cut.
    async fn killed(large: u64) -> Self {
        let mut history = Self::new(large).await;
        for node in 0..NODES {
            history.cluster.kill(node);
        }
        history
    }
}
