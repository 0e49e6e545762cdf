//! Compiles the proto files with `protox`, so that no `protoc` needs to be installed.

use prost::Message;
use std::path::PathBuf;
use std::{env, fs};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let files = ["transaction", "gateway", "enrolment", "peer"].map(|name| format!("ledgerd/v1/{name}.proto"));
    println!("cargo:rerun-if-changed=proto");
    let descriptors = protox::compile(files, ["proto"])?;
    let place = PathBuf::from(env::var("OUT_DIR")?).join("descriptors.bin");
    fs::write(place, descriptors.encode_to_vec())?;
    tonic_prost_build::configure().bytes(".").btree_map(".").compile_fds(descriptors)?;
    Ok(())
}
