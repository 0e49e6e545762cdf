//! The live parts of `ledgerctl`: `watch`, `top` on a terminal, and the completions of a shell.

use crate::support::{Ctl, Dev, Process, eventually};
use serde_json::Value;
use std::io::Write;
use std::process::{Command, Stdio};

#[test]
fn watch_tells_grants_refusals_and_stops_as_they_happen_and_no_command() {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    let farhad = dev.user("Farhad", &["Turtlebot4"], "ed25519");
    let mut watch = Process::start("watch", dev.home.path(), dev.owner().command(&["watch", "-o", "json"]));
    // Rows are those of the time after its begin: this one is seen whenever that was.
    let rows = |watch: &Process| -> Vec<Value> {
        watch.stdout().split_inclusive('\n').filter_map(|line| serde_json::from_str(line).ok()).collect()
    };
    let seen = |rows: &[Value], decision: &str, who: &str| {
        rows.iter().any(|row| row["decision"] == decision && row["who"] == who)
    };
    eventually("a grant is told", || {
        watch.check();
        salma.run(&["acquire", "Turtlebot4/cmd_vel", "--for", "30s"]).ok();
        salma.publish(&["Turtlebot4/cmd_vel", "{linear: {x: 0.1}}"]).ok();
        salma.run(&["release", "Turtlebot4/cmd_vel"]).ok();
        seen(&rows(&watch), "granted", "Org1/Salma").then_some(())
    });
    salma.run(&["acquire", "Turtlebot4/cmd_vel"]).ok();
    farhad.run(&["acquire", "Turtlebot4/cmd_vel"]).refused(5, &["LGR-3005"]);
    dev.owner().run(&["stop", "Turtlebot4"]).ok();
    eventually("a refusal and a stop are told", || {
        let rows = rows(&watch);
        let is_stopped = rows.iter().any(|row| row["decision"] == "stopped");
        (is_stopped && seen(&rows, "refused", "Org1/Farhad")).then_some(())
    });
    let rows = rows(&watch);
    assert!(rows.iter().all(|row| row["decision"] != "used"), "{rows:?}");
    assert!(rows[0]["time"].is_u64() && rows[0]["time_utc"].as_str().unwrap().ends_with('Z'), "{rows:?}");
    watch.interrupt();
}

/// The command on a terminal of so many columns, with keys from its standard input.
fn on_terminal(columns: usize, ctl: &Ctl, arguments: &[&str]) -> Command {
    let inner = ctl.command(arguments);
    let quote = |word: &std::ffi::OsStr| format!("'{}'", word.to_string_lossy());
    let words: Vec<String> = std::iter::once(inner.get_program()).chain(inner.get_args()).map(quote).collect();
    let mut command = Command::new("script");
    command.args(["-qec", &format!("stty cols {columns} rows 30; exec {}", words.join(" ")), "/dev/null"]);
    command.envs(inner.get_envs().filter_map(|(name, value)| Some((name, value?))));
    command.env("SHELL", "/bin/sh").env_remove("LEDGERCTL_CONTEXT");
    command
}

#[test]
fn top_shows_robots_and_nodes_and_a_key_stops_the_chosen_robot_and_asks_before_it_is_resumed() {
    let dev = Dev::start();
    let log = dev.home.path().join("top.out");
    let mut child = on_terminal(100, &dev.owner(), &["top"])
        .stdin(Stdio::piped())
        .stdout(std::fs::File::create(&log).unwrap())
        .spawn()
        .unwrap();
    let mut keys = child.stdin.take().unwrap();
    let screen = || String::from_utf8_lossy(&std::fs::read(&log).unwrap()).into_owned();
    eventually("robots and nodes are shown", || {
        let screen = screen();
        ["Husky/cmd_vel", "OptiTrack/poses", "Org1/node1", "leader", "q quit"]
            .iter()
            .all(|word| screen.contains(word))
            .then_some(())
    });
    // The first service is chosen: that of Husky.
    keys.write_all(b"s").unwrap();
    eventually("the robot is stopped", || {
        let robots = dev.owner().json(&["robot", "list"]);
        let stopped = robots.as_array().unwrap().iter().filter(|robot| robot["stopped"].is_object()).count();
        let husky = robots.as_array().unwrap().iter().find(|robot| robot["Name"] == "Husky").unwrap();
        (stopped == 1 && husky["stopped"].is_object()).then_some(())
    });
    eventually("the stop is shown", || screen().contains("STOPPED by Org2/Admin").then_some(()));
    // To resume it is asked first: a key alone, a repeated one, and Esc resume nothing.
    let is_stopped = || {
        let robots = dev.owner().json(&["robot", "list"]);
        robots.as_array().unwrap().iter().any(|robot| robot["Name"] == "Husky" && robot["stopped"].is_object())
    };
    keys.write_all(b"u").unwrap();
    eventually("the reason is asked for", || screen().contains("resume Husky: why?").then_some(()));
    keys.write_all(b"\x1b").unwrap();
    eventually("Esc cancels", || screen().contains("not resumed").then_some(()));
    assert!(is_stopped());
    keys.write_all(b"u").unwrap();
    eventually("the reason is asked for again", || {
        (screen().matches("resume Husky: why? _").count() > 1).then_some(())
    });
    keys.write_all(b"floor is clear").unwrap();
    eventually("the reason is shown", || screen().contains("floor is clear_").then_some(()));
    keys.write_all(b"\r").unwrap();
    eventually("the robot is resumed", || (!is_stopped()).then_some(()));
    let resumed = dev.owner().run(&["audit", "--robot", "Husky", "-o", "json"]).ok().stdout;
    assert!(resumed.contains("floor is clear"), "{resumed}");
    keys.write_all(b"q").unwrap();
    let status = eventually("top ends", || child.try_wait().unwrap());
    assert!(status.success() && screen().contains("\u{1b}[?1049l"), "{status}: {:?}", screen());
}

#[test]
fn tables_fit_a_narrow_terminal_and_lose_nothing() {
    let dev = Dev::start();
    let run = |columns| {
        let told = on_terminal(columns, &dev.owner(), &["robot", "list"]).stdin(Stdio::null()).output().unwrap();
        String::from_utf8(told.stdout).unwrap()
    };
    let (wide, narrow) = (run(200), run(90));
    let signs = |text: &str| {
        let mut signs: Vec<char> = text.chars().filter(|c| !c.is_whitespace()).collect();
        signs.sort_unstable();
        signs
    };
    assert!(wide.lines().any(|line| line.chars().count() > 90), "{wide}");
    assert!(narrow.lines().all(|line| line.trim_end().chars().count() <= 90), "{narrow}");
    assert_eq!(signs(&wide), signs(&narrow));
}

#[test]
fn a_shell_completes_the_names_of_now() {
    let dev = Dev::start();
    dev.user("Salma", &["Turtlebot4"], "ed25519");
    let asked = |shell: &str, words: &[&str]| {
        let mut command = dev.ctl().command(&[&["--", "ledgerctl"][..], words].concat());
        command.env("LEDGERCTL_COMPLETE", shell).env("_CLAP_COMPLETE_INDEX", words.len().to_string());
        let done = command.output().unwrap();
        assert!(done.status.success() && done.stderr.is_empty(), "{done:?}");
        String::from_utf8(done.stdout).unwrap()
    };
    // A shell does not wait for a node that takes long: it is asked again.
    let completes = |shell: &str, words: &[&str], wanted: &str| {
        eventually(&format!("{shell} completes {words:?} with {wanted}"), || {
            asked(shell, words).contains(wanted).then_some(())
        });
    };
    for shell in ["zsh", "fish"] {
        completes(shell, &["acquire", ""], "Turtlebot4/cmd_vel");
        completes(shell, &["robot", "show", "Hus"], "Husky");
        completes(shell, &["--context", "dev-org1-admin", "identity", "revoke", ""], "Salma");
        completes(shell, &["network", "demote", ""], "Org1/node1");
        completes(shell, &["context", "use", ""], "dev-org2-admin");
    }
    // bash itself, with the script that people install.
    let program = crate::support::programs::ledgerctl();
    let line = "PATH=$(dirname \"$0\"):$PATH; source <(ledgerctl completions bash); \
                COMP_WORDS=(ledgerctl acquire Tur); COMP_CWORD=2; COMP_TYPE=9; _clap_complete_ledgerctl ledgerctl Tur acquire; echo \"${COMPREPLY[@]}\"";
    let mut bash = Command::new("bash");
    bash.args(["-c", line]).arg(program).env("LEDGERD_HOME", dev.home.path()).env_remove("LEDGERCTL_CONTEXT");
    eventually("bash completes the service", || {
        let done = bash.output().unwrap();
        let is_complete = String::from_utf8_lossy(&done.stdout).contains("Turtlebot4/cmd_vel");
        if !is_complete {
            println!("{done:?}");
        }
        is_complete.then_some(())
    });
}
