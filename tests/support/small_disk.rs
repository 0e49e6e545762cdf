//! A disk that can be full: a small tmpfs over a node's data directory.

use super::network::NodePlace;
use super::process::Process;
use super::wait::eventually;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Size of the disk.
const DISK: &str = "size=96m";

/// A small disk in a mount namespace of its own, which ends with the process that holds it: nothing stays mounted.
pub struct SmallDisk {
    holder: Process,
    users: bool,
}

impl SmallDisk {
    /// Mounts a tmpfs over a directory, for processes that [`SmallDisk::enter`]. Needs root or user namespaces.
    pub fn over(directory: &Path, logs: &Path) -> Self {
        let mut reasons = Vec::new();
        for (flags, users) in [("-rm", true), ("-m", false)] {
            let name = format!("disk{flags}");
            let mut command = Command::new("unshare");
            command.args([
                flags,
                "sh",
                "-c",
                "mount -t tmpfs -o \"$1\" ledgerd-test \"$0\" && echo mounted && exec sleep 600",
            ]);
            command.arg(directory).arg(DISK);
            let mut holder = Process::start(&name, logs, command);
            let mounted = eventually("a disk is mounted or refused", || {
                let mounted = holder.stdout().contains("mounted");
                (mounted || !holder.is_running()).then_some(mounted)
            });
            if mounted {
                return Self { holder, users };
            }
            reasons.push(format!("unshare {flags}: {}", holder.stderr().trim()));
        }
        panic!(
            "this test needs a small disk: run it as root, or allow unprivileged user namespaces\n{}",
            reasons.join("\n")
        );
    }

    /// The data directory of a node that does not run moves onto a small disk, into the same place.
    pub fn under(place: &NodePlace, logs: &Path) -> Self {
        let seed = logs.join(format!("{}-seed", place.name));
        fs::rename(&place.data, &seed).unwrap();
        fs::create_dir(&place.data).unwrap();
        let disk = Self::over(&place.data, logs);
        let mut copy = Command::new("cp");
        copy.arg("-a").arg(seed.join(".")).arg(&place.data).stdin(Stdio::null());
        assert!(disk.enter(&copy).status().unwrap().success());
        disk
    }

    /// The command, on the small disk.
    pub fn enter(&self, command: &Command) -> Command {
        let mut entered = Command::new("nsenter");
        entered.arg("-t").arg(self.holder.id().to_string());
        if self.users {
            entered.args(["--preserve-credentials", "-U"]);
        }
        entered.args(["-m", "--"]).arg(command.get_program()).args(command.get_args());
        for (name, value) in command.get_envs() {
            match value {
                Some(value) => entered.env(name, value),
                None => entered.env_remove(name),
            };
        }
        entered
    }

    /// A path on the small disk, as seen from here.
    pub fn seen(&self, path: &Path) -> PathBuf {
        Path::new("/proc").join(self.holder.id().to_string()).join("root").join(path.strip_prefix("/").unwrap())
    }
}

/// Writes until nothing fits any more.
pub fn fill(path: &Path) {
    let mut file = File::create(path).unwrap();
    for size in [1 << 20, 4096, 1] {
        while file.write_all(&vec![0x55; size]).is_ok() {}
    }
}
