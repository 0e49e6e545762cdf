//! The examples in Python, which share no code with this crate, believe and refuse what the vectors say.
//!
//! The interpreter is `LEDGERD_TEST_PYTHON` or `python3`; it must have the package `cryptography`, as `./test` sees to.

use crate::vectors::{file, text, vectors};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn examples() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../examples/python-client")
}

fn python(script: &Path) -> Command {
    let python = std::env::var_os("LEDGERD_TEST_PYTHON").unwrap_or_else(|| "python3".into());
    let mut command = Command::new(python);
    command.arg("-B").arg(script);
    command
}

fn run(command: &mut Command) -> Output {
    command.output().unwrap_or_else(|error| panic!("{command:?} does not start: {error}; set LEDGERD_TEST_PYTHON"))
}

#[test]
fn another_language_believes_and_refuses_what_the_vectors_say() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("light/vectors.py");
    // So that the file is there.
    let wanted = vectors();
    let output = run(python(&script).arg(examples()).arg(file()));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "./test installs what this needs: {said}");
    let lines = String::from_utf8(output.stdout).unwrap();
    let found: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let mut checked = 0;
    for kind in ["ways", "votes", "lies", "faults", "facts", "governing_chain"] {
        for vector in wanted[kind].as_array().unwrap() {
            let found = &found[checked];
            checked += 1;
            assert_eq!((&found["kind"], &found["name"]), (&kind.into(), &vector["name"]), "{found}");
            assert_eq!(found["reason"].is_null(), vector["refused"].is_null(), "{found} {}", vector["refused"]);
        }
    }
    assert_eq!(checked, found.len());
}

#[test]
fn the_example_verifies_the_file_of_a_checkpoint_and_a_proof_and_says_why_it_refuses() {
    let place = std::env::temp_dir().join(format!("ledgerd-verify-{}", std::process::id()));
    std::fs::create_dir_all(&place).unwrap();
    let write = |name: &str, hexadecimal: &str| {
        std::fs::write(place.join(name), hex::decode(hexadecimal).unwrap()).unwrap();
        place.join(name)
    };
    let begin = &vectors()["beginnings"]["checkpoint"];
    let network = text(begin, "network");
    let checkpoint = write("checkpoint", text(begin, "checkpoint"));
    let way = |name: &str| {
        let ways = vectors()["ways"].as_array().unwrap();
        let way = ways.iter().find(|way| way["name"] == name).unwrap_or_else(|| panic!("no way {name}"));
        write("proof", text(&way["steps"][0], "proof"))
    };
    let verified = |network: &str, checkpoint: &Path, proof: Option<PathBuf>| {
        run(python(&examples().join("verify.py")).arg(network).arg(checkpoint).args(proof))
    };
    let good = verified(network, &checkpoint, Some(way("a block after a checkpoint")));
    let printed = String::from_utf8_lossy(&good.stdout);
    assert!(good.status.success(), "{good:?}");
    for part in ["block 8 at", "signed by Org1/node1 Org2/node3", "block 20 at", "Org1/node2 Org2/node3", "  ground "] {
        assert!(printed.contains(part), "{part:?} in {printed}");
    }
    let other = "00".repeat(32);
    let few = write("few", text(&vectors()["beginnings"]["a checkpoint that one voter has signed"], "checkpoint"));
    let lines = [
        (verified(&other, &checkpoint, None), "refused: this is of another network"),
        (verified(network, &few, None), "refused: nodes {1} of {1, 2, 3}"),
        (verified(network, &checkpoint, Some(way("a change after a checkpoint"))), "refused: who governs has changed"),
        (verified(network, &checkpoint, Some(checkpoint.clone())), "refused: these bytes do not begin"),
    ];
    for (output, wanted) in lines {
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(1) && said.contains(wanted), "{wanted:?} in {output:?}");
    }
    std::fs::remove_dir_all(&place).unwrap();
}

/// Lines that are neither empty, nor a comment, nor the text that describes what follows.
fn lines_of_code(source: &str) -> usize {
    let parts = source.split("\"\"\"").step_by(2);
    let lines = parts.flat_map(str::lines).map(str::trim);
    lines.filter(|line| !line.is_empty() && !line.starts_with('#')).count()
}

#[test]
fn the_examples_that_verify_have_less_than_a_hundred_lines_of_code_each_and_two_hundred_with_x509() {
    assert_eq!(lines_of_code("\"\"\"A\nB\"\"\"\n\n# C\ndef d():\n    \"\"\"E\"\"\"\n    return 1\n"), 2);
    let lines = |name: &str| lines_of_code(&std::fs::read_to_string(examples().join(name)).unwrap());
    for name in ["verify.py", "follow.py", "node_signature.py"] {
        assert!(lines(name) < 100, "{name} has {} lines of code", lines(name));
    }
    assert!(lines("verify.py") + lines("node_signature.py") < 200, "what it takes to believe a certificate of a block");
}
