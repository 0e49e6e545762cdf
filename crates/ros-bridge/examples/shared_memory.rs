//! A program of your own beside a bridge, over shared memory: `shared_memory say /cmd_vel`, or `shared_memory hear /cmd_vel`.
//! It needs iceoryx2 and nothing of ours. The contract stands at the top of `src/shm.rs`.

use std::{error::Error, fs, os::unix::fs::MetadataExt, time::Duration};

use iceoryx2::prelude::{Config, NodeBuilder, Path, SemanticString, ServiceName, ipc_threadsafe::Service};

/// The directory in which the bridge of this user is. A file `iceoryx2.toml` with its `root-path` says the same to all programs.
fn config() -> Result<Config, Box<dyn Error>> {
    let directory = match std::env::var("XDG_RUNTIME_DIR") {
        Ok(session) if session.starts_with('/') => format!("{session}/iceoryx2"),
        _ => format!("/tmp/iceoryx2-{}", fs::metadata("/proc/self")?.uid()),
    };
    let mut config = Config::global_config().clone();
    config.global.set_root_path(&Path::new(directory.as_bytes())?);
    Ok(config)
}

/// Publishes a message, its CDR with the header of four bytes, so often. A publisher that leaves takes with it whatever was not read.
pub(crate) fn say(topic: &str, message: &[u8], count: u64) -> Result<(), Box<dyn Error>> {
    let (node, name) =
        (NodeBuilder::new().config(&config()?).create::<Service>()?, ServiceName::new(&format!("rt{topic}"))?);
    let data = node.service_builder(&name).publish_subscribe::<[u8]>().user_header::<[u8; 32]>().open_or_create()?;
    let news = node.service_builder(&name).event().open_or_create()?.notifier_builder().create()?;
    let port = data.publisher_builder().initial_max_slice_len(message.len()).create()?;
    for sequence in 1..=count {
        let mut sample = port.loan_slice_uninit(message.len())?;
        let header = sample.user_header_mut();
        *header = [0; 32]; // No mark: it comes from no bridge.
        header[..4].copy_from_slice(&std::process::id().to_le_bytes()); // The publisher.
        header[16..24].copy_from_slice(&sequence.to_le_bytes());
        sample.write_from_slice(message).send()?;
        news.notify()?; // Wakes up those who wait.
        std::thread::sleep(Duration::from_millis(20));
    }
    Ok(())
}

/// Takes messages until `take` has enough.
pub(crate) fn hear(topic: &str, mut take: impl FnMut(&[u8]) -> bool) -> Result<(), Box<dyn Error>> {
    let (node, name) =
        (NodeBuilder::new().config(&config()?).create::<Service>()?, ServiceName::new(&format!("rt{topic}"))?);
    let data = node.service_builder(&name).publish_subscribe::<[u8]>().user_header::<[u8; 32]>().open_or_create()?;
    let news = node.service_builder(&name).event().open_or_create()?.listener_builder().create()?;
    let port = data.subscriber_builder().create()?;
    loop {
        while let Some(sample) = port.receive()? {
            if !take(sample.payload()) {
                return Ok(());
            }
        }
        news.timed_wait(|_| (), Duration::from_millis(100))?;
    }
}

#[expect(clippy::print_stdout, reason = "the output of the program")]
fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    match words.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["say", topic] => say(topic, &[[0, 1, 0, 0].as_slice(), &[0; 48]].concat(), 50),
        ["hear", topic] => hear(topic, |message| {
            println!("{message:02x?}");
            true
        }),
        _ => Err("say TOPIC or hear TOPIC".into()),
    }
}
