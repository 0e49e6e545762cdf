//! The example as its README tells it: a node with the chaincode, called by clients.

#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use bytes::Bytes;
use ledger_api::{Client, Context};
use ledger_base::rejection::Code;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use tempfile::TempDir;

/// The running example; it ends with the test, however that ends.
struct Node {
    child: Child,
    home: TempDir,
    facts: Value,
}

impl Node {
    fn start() -> Self {
        let home = tempfile::tempdir().unwrap();
        let mut child = Command::new(env!("CARGO_BIN_EXE_inventory"))
            .args(["dev", "--json", "--listen", "127.0.0.1:0"])
            .env("LEDGERD_HOME", home.path())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let facts = serde_json::from_str(&line);
        let mut node = Self { child, home, facts: Value::Null };
        node.facts = facts.unwrap();
        node
    }

    /// A client with the stored context at that place in the list that the node printed.
    async fn client(&self, context: usize) -> Client {
        Client::connect(&Context::load(self.home.path(), self.facts["contexts"][context].as_str()).unwrap())
            .await
            .unwrap()
    }

    /// `ledgerctl`, if it was built beside this test: `./test` does.
    fn ledgerctl(&self, args: &[&str]) -> Option<std::process::Output> {
        let program = PathBuf::from(env!("CARGO_BIN_EXE_inventory")).with_file_name("ledgerctl");
        let context = self.facts["contexts"][0].as_str().unwrap();
        program.is_file().then(|| {
            Command::new(program)
                .env("LEDGERD_HOME", self.home.path())
                .args(["--context", context])
                .args(args)
                .output()
                .unwrap()
        })
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        // In order, so that it removes its temporary directory.
        let pid = i32::try_from(self.child.id()).ok().and_then(rustix::process::Pid::from_raw).unwrap();
        let _gone = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        let _status = self.child.wait();
    }
}

fn arguments(args: &[&str]) -> Vec<Bytes> {
    args.iter().map(|arg| Bytes::copy_from_slice(arg.as_bytes())).collect()
}

#[tokio::test]
async fn a_node_with_the_example_executes_and_answers_calls_of_it() {
    let node = Node::start();
    let (org1, org2) = (node.client(0).await, node.client(1).await);

    let pallet = arguments(&["Turtlebot4", "pallet", "1.5", "-2"]);
    let found = org1.invoke("inventory", "found", pallet.clone()).await.unwrap();
    let find: Value = serde_json::from_slice(&found.response).unwrap();
    assert_eq!(find["id"], 1);
    assert_eq!(find["organisation"], "Org1");

    let listed = org2.query_at(found.height, "inventory", "list", vec![]).await.unwrap();
    assert_eq!(serde_json::from_slice::<Value>(&listed.response).unwrap(), Value::from(vec![find]));

    // The robots are those of access control on the same node.
    let unknown = org1.invoke("inventory", "found", arguments(&["Turtlebot5", "pallet", "0", "0"])).await.unwrap_err();
    assert_eq!(unknown.code, Code::UnknownRobot);
    let refused = org2.invoke("inventory", "collected", arguments(&["1"])).await.unwrap_err();
    assert_eq!(refused.code, Code::Refused);
    // Writes of a query are thrown away.
    org1.query("inventory", "found", pallet).await.unwrap();
    let again = org1.query("inventory", "list", vec![]).await.unwrap();
    assert_eq!(again.response, listed.response);

    if let Some(output) =
        node.ledgerctl(&["-o", "json", "invoke", "inventory", "found", "Husky", "crate", "0", "-7.25"])
    {
        assert!(output.status.success(), "{output:?}");
        let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(answer["response"]["y_mm"], -7250, "{output:?}");
        let listed = node.ledgerctl(&["-o", "json", "query", "inventory", "list"]).unwrap();
        let answer: Value = serde_json::from_slice(&listed.stdout).unwrap();
        assert_eq!(answer["response"].as_array().map(Vec::len), Some(2), "{listed:?}");
    }
}
