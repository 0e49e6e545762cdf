//! The programs of docs/clients.md, built by its commands as they stand, against a real node.

use crate::support::Dev;
use crate::{blocks, python, ran, repository};
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

/// The first lines that the programs print in every language.
const PRINTED: [&str; 3] = [
    "heard 52 bytes",
    "refused: LGR-3001 wanted attribute Husky=true, as Husky requires",
    "refused: NOT_ADMIN found role member",
];

fn document() -> PathBuf {
    repository().join("docs/clients.md")
}

/// A machine of somebody who has enrolled and checked out this repository.
struct Machine {
    dev: Dev,
    place: TempDir,
}

impl Machine {
    fn new() -> Self {
        let (dev, place) = (Dev::start(), TempDir::new().unwrap());
        dev.user("Salma", &["Turtlebot4"], "ed25519");
        fs::create_dir(place.path().join(".config")).unwrap();
        symlink(dev.home.path(), place.path().join(".config/ledgerd")).unwrap();
        symlink(repository().join("crates"), place.path().join("crates")).unwrap();
        Self { dev, place }
    }

    fn path(&self) -> &Path {
        self.place.path()
    }

    /// Types the commands of a section.
    fn types(&self, commands: &str, tools: &Path) -> String {
        let path = std::env::var("PATH").unwrap();
        let mut shell = Command::new("bash");
        shell.args(["-ec", commands]).current_dir(self.path()).env("HOME", self.path()).env_remove("LEDGERD_HOME");
        shell.env("PATH", format!("{}:{path}:/usr/local/go/bin", tools.display()));
        // What Go has fetched and built lies where it always does.
        for (variable, below) in [("GOCACHE", ".cache/go-build"), ("GOMODCACHE", "go/pkg/mod")] {
            let kept = std::env::var_os("HOME").map(|home| Path::new(&home).join(below));
            shell.envs(std::env::var_os(variable).map(PathBuf::from).or(kept).map(|kept| (variable, kept)));
        }
        String::from_utf8(ran(&mut shell).stdout).unwrap()
    }
}

/// The commands of the section of a language.
fn commands(language: &str) -> String {
    let text = fs::read_to_string(document()).unwrap();
    let section = text.split_once(&format!("\n## {language}\n")).unwrap().1;
    section.split_once("```sh\n").and_then(|(_, rest)| rest.split_once("\n```")).unwrap().0.to_owned()
}

#[test]
fn the_program_in_go_does_what_the_page_says() {
    let machine = Machine::new();
    let others = repository().join("tests/interop/go-client");
    let module = fs::read_to_string(others.join("go.mod")).unwrap().replace("module go-client", "module example");
    fs::write(machine.path().join("go.mod"), module).unwrap();
    for file in ["go.sum", "tools.go"] {
        fs::copy(others.join(file), machine.path().join(file)).unwrap();
    }
    fs::write(machine.path().join("main.go"), &blocks(&document(), "go")[0]).unwrap();
    let tools = machine.path().join("bin");
    let plugins = "google.golang.org/protobuf/cmd/protoc-gen-go google.golang.org/grpc/cmd/protoc-gen-go-grpc";
    machine.types(&format!("GOBIN=$PWD/bin go install {plugins}"), &tools);
    let printed = machine.types(&commands("Go"), &tools);
    assert_eq!(printed.lines().collect::<Vec<_>>(), PRINTED, "{:?}", machine.dev.facts);
    assert_eq!(machine.types("gofmt -l main.go && go vet .", &tools), "");
}

#[test]
fn the_program_in_cpp_does_what_the_page_says() {
    let machine = Machine::new();
    fs::write(machine.path().join("client.cpp"), &blocks(&document(), "cpp")[0]).unwrap();
    let site = "import pathlib, google.rpc.status_pb2 as one; print(pathlib.Path(one.__file__).parents[2])";
    let site = String::from_utf8(ran(Command::new(python()).args(["-c", site])).stdout).unwrap();
    let printed = machine.types(&commands("C++").replace("GOOGLE", site.trim()), machine.path());
    assert_eq!(printed.lines().collect::<Vec<_>>(), PRINTED, "{:?}", machine.dev.facts);
}

#[test]
fn the_program_in_python_does_what_the_page_says() {
    let machine = Machine::new();
    let program = machine.path().join("program.py");
    fs::write(&program, &blocks(&document(), "python")[0]).unwrap();
    let package = repository().join("clients/python/src");
    let mut command = Command::new(python());
    command.arg(&program).env("PYTHONPATH", package).env("LEDGERD_HOME", machine.dev.home.path());
    let printed = String::from_utf8(ran(&mut command).stdout).unwrap();
    let wanted = ["heard from Org1/Salma", "refused: MISSING_ATTRIBUTE wanted attribute Husky=true, as Husky requires"];
    assert_eq!(printed.lines().collect::<Vec<_>>(), wanted);
}
