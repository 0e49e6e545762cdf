//! Packages: hardened units, a Debian package and an image, each made by one command and read back.

use crate::own_network::isolated;
use crate::support::programs::{self, ran, repository};
use ledger_base::hash::Hash;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

/// The exposure at which a unit is exposed.
const EXPOSURE_MAX: f64 = 2.5;

fn is_there(program: &str) -> bool {
    let found = Command::new("sh").args(["-c", &format!("command -v {program}")]).output().unwrap().status.success();
    if !found {
        println!("skipped: there is no {program}");
    }
    found
}

fn text(output: &std::process::Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

#[test]
fn systemd_finds_each_unit_hardened() {
    if !is_there("systemd-analyze") {
        return;
    }
    let units = repository().join("packaging/systemd");
    let units: Vec<_> = fs::read_dir(units).unwrap().map(|entry| entry.unwrap().path()).collect();
    let units: Vec<_> = units.iter().filter(|path| path.extension().is_some_and(|kind| kind == "service")).collect();
    assert_eq!(units.len(), 2, "a node and a bridge");
    for unit in units {
        let mut command = Command::new("systemd-analyze");
        command.args(["security", "--offline=true", "--no-pager"]).arg(unit).env("SYSTEMD_COLORS", "0");
        let told = text(&ran(&mut command));
        let line = told.lines().find(|line| line.contains("Overall exposure level")).expect("an overall level");
        let level: f64 = line.rsplit_once(": ").unwrap().1.split(' ').next().unwrap().parse().unwrap();
        assert!(level < EXPOSURE_MAX, "{line}");
        let unit = fs::read_to_string(unit).unwrap();
        for line in [
            "CapabilityBoundingSet=\n",
            "NoNewPrivileges=yes",
            "SocketBindDeny=any",
            // Each may have a bridge, which speaks DDS.
            "SocketBindAllow=udp\n",
            "SystemCallFilter=@system-service",
        ] {
            assert!(unit.contains(line), "{line:?} is missing");
        }
    }
}

#[test]
fn a_program_with_the_switches_of_deliberate_bugs_is_no_release() {
    // .ci/run and packaging/deb/build look at releases; this program must be found out.
    for program in [programs::ledgerd(), programs::ledgerctl()] {
        let looked = Command::new(repository().join("packaging/check-release")).arg(program).output().unwrap();
        let told = String::from_utf8_lossy(&looked.stderr);
        assert!(!looked.status.success() && told.contains("has the switches of the deliberate bugs"), "{told}");
    }
}

#[test]
fn no_revocation_list_is_taken_for_a_certificate_near_its_end() {
    let read = |name: &str| fs::read_to_string(repository().join("packaging").join(name)).unwrap();
    let dashboard: Value = serde_json::from_str(&read("grafana/ledgerd.json")).unwrap();
    let panels = dashboard["panels"].as_array().unwrap();
    let first = panels.iter().find(|panel| panel["title"] == "First certificate ends").expect("the panel");
    let asked = first["targets"][0]["expr"].as_str().unwrap();
    assert!(asked.contains("kind!=\"list\""), "{asked}");
}

#[test]
fn the_configuration_of_the_example_robot_is_accepted() {
    let config = repository().join("examples/networks/robot/ledgerd.toml");
    let told = text(&ran(programs::node().args(["check", "--config"]).arg(config)));
    assert!(told.contains("is valid"), "{told}");
}

#[test]
fn the_network_of_the_example_laptop_runs_as_it_stands() {
    if !isolated(&|| ()) {
        return;
    }
    let place = TempDir::new().unwrap();
    let programs = programs::ledgerctl().parent().unwrap().display().to_string();
    let mut command = Command::new(repository().join("examples/networks/laptop/up"));
    command.arg(place.path().join("fleet")).env_remove("LEDGERCTL_CONTEXT").env_remove("RUST_LOG");
    command.env("PATH", format!("{programs}:{}", std::env::var("PATH").unwrap()));
    let done = command.output().unwrap();
    let node = fs::read_to_string(place.path().join("fleet/node.pid")).unwrap();
    Command::new("kill").arg(node.trim()).status().unwrap();
    let told = String::from_utf8_lossy(&done.stdout).into_owned();
    assert!(done.status.success(), "{told}\n{}", String::from_utf8_lossy(&done.stderr));
    assert!(told.contains("Turtlebot4/cmd_vel is acquired (exclusive)"), "{told}");
}

/// Makes the package of these programs.
fn package(place: &Path) -> PathBuf {
    let bin = programs::ledgerctl().parent().unwrap();
    let mut command = Command::new(repository().join("packaging/deb/build"));
    let told = text(&ran(command.arg("--fast").arg("--bin").arg(bin).arg(place)));
    PathBuf::from(told.trim())
}

/// The libraries that a program names.
fn libraries(program: &Path) -> Vec<String> {
    let shown = text(&ran(Command::new("readelf").arg("-d").arg(program)));
    let named = shown.lines().filter(|line| line.contains("(NEEDED)"));
    named.filter_map(|line| Some(line.split_once('[')?.1.split_once(']')?.0.to_owned())).collect()
}

#[test]
fn one_command_makes_a_package_whose_programs_need_glibc_alone_and_an_image_that_runs() {
    if !["dpkg-deb", "readelf", "python3", "chroot"].into_iter().all(is_there) {
        return;
    }
    let place = TempDir::new().unwrap();
    let package = package(place.path());
    let root = place.path().join("root");
    ran(Command::new("dpkg-deb").arg("-x").arg(&package).arg(&root));
    for file in [
        "usr/bin/ledgerd",
        "usr/bin/ledgerctl",
        "lib/systemd/system/ledgerd.service",
        "lib/systemd/system/ledgerd-bridge@.service",
        "usr/lib/sysusers.d/ledgerd.conf",
        "usr/share/bash-completion/completions/ledgerctl",
        "usr/share/bash-completion/completions/ledgerd",
        "usr/share/zsh/vendor-completions/_ledgerctl",
        "usr/share/fish/vendor_completions.d/ledgerd.fish",
        "usr/share/man/man1/ledgerd.1.gz",
        "usr/share/man/man1/ledgerd-backup.1.gz",
        "usr/share/man/man1/ledgerctl.1.gz",
        "usr/share/doc/ledgerd/copyright",
        "usr/share/doc/ledgerd/ledgerd.toml",
    ] {
        assert!(fs::metadata(root.join(file)).is_ok_and(|found| found.len() > 0), "{file} is missing");
    }
    for program in ["ledgerd", "ledgerctl"] {
        for library in libraries(&root.join("usr/bin").join(program)) {
            let of_glibc = ["libc.so.6", "libm.so.6", "libgcc_s.so.1"].contains(&library.as_str());
            assert!(of_glibc || library.starts_with("ld-linux"), "{program} needs {library}");
        }
    }
    let depends = text(&ran(Command::new("dpkg-deb").arg("-f").arg(&package).arg("Depends")));
    assert!(depends.starts_with("libc6 (>= 2."), "{depends}");
    let tried = text(&ran(Command::new(repository().join("packaging/deb/try")).arg(&package)));
    assert!(tried.contains("founds a network, answers and orders"), "{tried}");
    image_of(&package, place.path());
}

/// Makes the image twice, checks every digest in it, and runs its programs in its own root.
fn image_of(package: &Path, place: &Path) {
    let [one, two] = ["one.tar", "two.tar"].map(|name| {
        let out = place.join(name);
        ran(Command::new(repository().join("packaging/oci/build")).arg("--fast").arg(package).arg(&out));
        out
    });
    assert!(fs::read(&one).unwrap() == fs::read(&two).unwrap(), "the same package gives the same image");
    let layout = place.join("layout");
    fs::create_dir(&layout).unwrap();
    ran(Command::new("tar").arg("-xf").arg(&one).arg("-C").arg(&layout));
    let read = |path: PathBuf| -> Value { serde_json::from_slice(&fs::read(path).unwrap()).unwrap() };
    assert_eq!(read(layout.join("oci-layout"))["imageLayoutVersion"], "1.0.0");
    let blob = |described: &Value| {
        let digest = described["digest"].as_str().unwrap().strip_prefix("sha256:").unwrap().to_owned();
        let path = layout.join("blobs/sha256").join(&digest);
        let content = fs::read(&path).unwrap();
        assert_eq!(described["size"], content.len());
        assert_eq!(digest, hex(&content));
        path
    };
    let manifest = read(blob(&read(layout.join("index.json"))["manifests"][0]));
    let config = read(blob(&manifest["config"]));
    assert_eq!(config["config"]["Entrypoint"][0], "/usr/bin/ledgerd");
    assert_ne!(config["config"]["User"], "0:0");
    let layer = blob(&manifest["layers"][0]);
    let unpacked = Command::new("gzip").arg("-dc").arg(&layer).output().unwrap().stdout;
    assert_eq!(config["rootfs"]["diff_ids"][0], format!("sha256:{}", hex(&unpacked)));

    let root = place.join("image");
    fs::create_dir(&root).unwrap();
    ran(Command::new("tar").arg("-xf").arg(&layer).arg("-C").arg(&root).arg("--no-same-owner"));
    assert!(!root.join("bin").exists(), "there is no shell in it");
    let inside = |arguments: &[&str]| {
        let mut command = Command::new("unshare");
        command
            .args(["-r", "chroot"])
            .arg(&root)
            .args(arguments)
            .env("LD_LIBRARY_PATH", "/usr/lib")
            .env_remove("RUST_LOG");
        text(&ran(&mut command))
    };
    let version = env!("CARGO_PKG_VERSION");
    assert_eq!(inside(&["/usr/bin/ledgerd", "--version"]).trim(), format!("ledgerd {version}"));
    assert!(inside(&["/usr/bin/ledgerctl", "--version"]).contains(version));
    let founded = [
        "/usr/bin/ledgerd",
        "init",
        "--organisation",
        "Org1",
        "--address",
        "127.0.0.1:7450",
        "--config",
        "/config/ledgerd.toml",
    ];
    assert!(inside(&founded).contains("is created"));
    assert!(inside(&["/usr/bin/ledgerd", "check", "--config", "/config/ledgerd.toml"]).contains("is valid"));
}

fn hex(content: &[u8]) -> String {
    Hash::of(&[content]).to_string()
}
