//! The pages and how they are typed: lines that they take for granted, and blocks that this test does not run, with the reasons.

/// A page and how it is typed here.
pub(super) struct Reading {
    pub(super) page: &'static str,
    /// Typed before its first block, because the page takes it for granted.
    pub(super) given: &'static [&'static str],
    /// Typed before the block that begins with a command, for the same reason.
    pub(super) before: &'static [(&'static str, &'static [&'static str])],
    /// Words of the page, and what stands for them here.
    pub(super) words: &'static [(&'static str, &'static str)],
    /// Words in capitals and others that stand for the output of an earlier command: the word behind a text, the newest.
    pub(super) captures: &'static [(&'static str, &'static str)],
    /// Commands that a reader ends by Ctrl-C, which they answer in order.
    pub(super) until_interrupted: &'static [&'static str],
    /// Blocks that are not run here, by the beginning of their first command, and why.
    pub(super) elsewhere: &'static [(&'static str, &'static str)],
}

impl Reading {
    const fn of(page: &'static str) -> Self {
        Self { page, given: &[], before: &[], words: &[], captures: &[], until_interrupted: &[], elsewhere: &[] }
    }
}

/// Registers people of Org1 and makes their keys, as docs/policies.md does.
const ENROL: &str =
    r#"enrol() { $(ledgerctl --context dev-org1-admin identity register "$@" -o json | jq -r .command); }"#;
const SALMA: &str = "enrol Salma --attr Turtlebot4 --attr Husky --attr OptiTrack";

/// The pages that are typed here.
pub(super) const READINGS: &[Reading] = &[
    Reading {
        elsewhere: &[(
            "cargo run --release -- demo",
            ".ci/run plays the demo; tests/repository compares this line with it",
        )],
        ..Reading::of("README.md")
    },
    Reading::of("docs/start.md"),
    Reading {
        captures: &[("PROCESS", "Org4/node4 voter "), ("DIRECTORY", "files ")],
        elsewhere: &[("ledgerd init", "tests/node/three.rs types this block, and kills each of the three nodes")],
        ..Reading::of("docs/cluster.md")
    },
    Reading {
        given: &["ledgerd dev", "ledgerctl context use dev-org2-admin"],
        // Without `--yes` it asks on a terminal, which this test has not.
        words: &[("ledgerctl share Rover", "ledgerctl share --yes Rover")],
        ..Reading::of("docs/robot.md")
    },
    Reading {
        given: &[
            "ledgerd dev",
            "ledgerctl context use dev-org2-admin",
            ENROL,
            SALMA,
            "ledgerctl robot remove Turtlebot4",
        ],
        before: &[("ledgerctl acquire Turtlebot4/camera:subscribe", &["ledgerctl context use Salma"])],
        until_interrupted: &["ledgerctl acquire Turtlebot4/cmd_vel --keep"],
        ..Reading::of("docs/conflict.md")
    },
    Reading {
        given: &[
            "ledgerd dev",
            "ledgerctl context use dev-org2-admin",
            ENROL,
            SALMA,
            "ledgerctl --context Salma acquire Turtlebot4 --for 10m",
            "ledgerctl --context Salma publish Turtlebot4/cmd_vel '{linear: {x: 0.5}}'",
            // That of the grant.
            "echo transaction: $(ledgerctl audit --robot Turtlebot4 -o json | jq -r 'select(.decision == \"granted\") | .transaction')",
        ],
        captures: &[("TX", "transaction: ")],
        until_interrupted: &["ledgerctl audit --organisation Org1 --follow"],
        ..Reading::of("docs/audit.md")
    },
    Reading {
        given: &[
            "ledgerd init --organisation Org1 --address 127.0.0.1:7450",
            r#"sed -i '/^\[admin\]/a listen = "127.0.0.1:7451"' ledgerd.toml"#,
            "ledgerd run --config ledgerd.toml &",
            "until curl -fs http://127.0.0.1:7451/readyz; do sleep 0.1; done",
        ],
        elsewhere: &[("cd ~/.config/ledgerd/contexts/admin", "tests/node/monitoring.rs types it, with grpcurl")],
        ..Reading::of("docs/metrics.md")
    },
    Reading {
        before: &[
            (
                "ledgerctl doctor",
                &[
                    "ledgerctl enroll admin --node 127.0.0.1:7450 --ca-fingerprint FINGERPRINT --secret SECRET",
                    r#"printf 'context = "admin"\n[[route]]\nservice = "Turtlebot4/camera"\ndirection = "from_ledger"\ntype = "sensor_msgs/msg/Image"\n' > bridge.toml"#,
                ],
            ),
            (
                "ledgerctl ca status",
                &[
                    "ledgerctl network invite --node node2",
                    "ledgerd join TOKEN --config b/ledgerd.toml --address 127.0.0.1:7451",
                    "ledgerd run --config b/ledgerd.toml &",
                ],
            ),
            (
                "ledgerctl ca backup",
                &[
                    "export LEDGERD_PASSPHRASE='correct horse battery staple'",
                    "ledgerctl network invite --node node3",
                    "ledgerd join TOKEN --config d/ledgerd.toml --address 127.0.0.1:7454",
                    "ledgerd run --config d/ledgerd.toml &",
                ],
            ),
            (
                "ledgerctl identity list",
                &["ledgerctl identity register Salma", "ledgerctl network invite --node node4"],
            ),
            (
                "ledgerctl network proposals",
                &[
                    "ledgerctl network invite --organisation Org2",
                    "ledgerd join TOKEN --config c/ledgerd.toml --address 127.0.0.1:7453",
                    "ledgerd run --config c/ledgerd.toml &",
                    "ledgerctl --context Org2-admin enroll admin --node 127.0.0.1:7453 --ca-fingerprint FINGERPRINT --secret SECRET",
                    // Another admin proposes what the page approves.
                    r#"ledgerctl --context Org2-admin network propose msp allow_nodes '{"organisation":"Org2","nodes":20}'"#,
                ],
            ),
            (
                "ledgerctl query msp quotas",
                &[
                    "ledgerctl robot add Turtlebot4 --attr-required Turtlebot4 --service /camera=sensor_msgs/msg/Image,direction=feed",
                ],
            ),
        ],
        words: &[("10.0.0.4", "127.0.0.1"), ("/backup/node1", "node1.backup")],
        captures: &[
            ("FINGERPRINT", "--ca-fingerprint "),
            ("SECRET", "--secret "),
            ("TOKEN", "ledgerd join "),
            ("3f9a0c77c1d2", "network approve "),
        ],
        elsewhere: &[
            ("ledgerd rejoin", "tests/node/three.rs brings nodes back by it, tests/cluster a contradicted one"),
            ("ledgerd restore", "tests/node/backup.rs restores nodes"),
            ("ledgerd checkpoint", "tests/node/disasters.rs makes one at a survivor"),
            (
                "ledgerctl network propose inventory",
                "needs a node with a chaincode of its own: examples/inventory tests it",
            ),
            (
                "ledgerctl network rules --activate",
                "no release speaks other rules yet; tests/node/rules.rs activates some",
            ),
        ],
        ..Reading::of("docs/operations.md")
    },
    Reading { elsewhere: &[("ssh -L 7452", "needs a second machine")], ..Reading::of("docs/console.md") },
    Reading {
        given: &[
            "ledgerd dev",
            ENROL,
            SALMA,
            "ledgerctl --context Salma acquire Turtlebot4 --for 10m",
            "ledgerctl --context Salma publish Turtlebot4/cmd_vel '{linear: {x: 0.5}}'",
            "ledgerctl context use Salma",
        ],
        // Times of today that are past at any time of the day.
        words: &[("--since 14:30 --until 14:45", "--since 0 --until 5")],
        until_interrupted: &[
            "ledgerctl record Turtlebot4 -o live.mcap",
            "ledgerctl record Turtlebot4 --since 0 --follow",
        ],
        elsewhere: &[(
            "ros2 bag info",
            "needs a ROS 2 with its tools; tests/interop/real_ros.rs plays a recording where there is one",
        )],
        ..Reading::of("docs/record.md")
    },
    Reading {
        given: &["ledgerd dev"],
        // As for the page about robots.
        words: &[
            ("ledgerctl share Turtlebot4", "ledgerctl share --yes Turtlebot4"),
            ("ledgerctl share Husky", "ledgerctl share --yes Husky"),
            ("ledgerctl unshare", "ledgerctl unshare --yes"),
        ],
        elsewhere: &[
            ("ledgerctl policy test cases.toml", "typed for each of the twelve examples with its files"),
            ("ledgerd policy prove", "tests/node/proofs.rs asks such questions, if it finds a solver"),
        ],
        ..Reading::of("docs/policies.md")
    },
];

/// Pages with commands that other tests type, or nobody can.
pub(super) const ELSEWHERE: &[(&str, &str)] = &[
    ("docs/arena.md", "tests/interop/arena.rs plays it; it takes minutes"),
    ("docs/benchmarks.md", "figures of an idle machine; benches are run by hand"),
    ("docs/bridge.md", "tests/interop types its calls through ROS 2; keys of SROS2 are in tests/interop/sros2.rs"),
    ("docs/clients.md", "tests/clients/languages.rs builds and runs the programs by these commands"),
    ("docs/fabric.md", "tests/node/fabric.rs types the ten lines with a Fabric MSP"),
    ("docs/http.md", "tests/node/http.rs types each of them"),
    ("docs/output.md", "tests/node/output.rs runs every command of that page"),
    ("docs/reliability.md", "runs the tests themselves, for hours"),
];
