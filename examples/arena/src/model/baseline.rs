//! Latencies of other systems, drawn next to ours; docs/comparison.md describes the measurements.

/// Latencies against frequency.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Curve {
    /// The setting that was measured.
    pub name: &'static str,
    /// Frequency (Hz) and median latency (milliseconds).
    pub points: &'static [(f64, f64)],
}

/// Hyperledger Fabric 3.1.5 with the paper's network and contract, from submission to commit status, without ROS.
pub(crate) const FABRIC: [Curve; 3] = [
    Curve {
        name: "Fabric, its defaults (2 s, 10 messages a block)",
        points: &[(1.0, 1015.0), (50.0, 116.0), (100.0, 65.0), (200.0, 43.0)],
    },
    Curve { name: "Fabric, blocks of 10 ms", points: &[(1.0, 23.0), (50.0, 21.0), (100.0, 20.0), (200.0, 23.0)] },
    Curve {
        name: "Fabric, one message a block (diverges at 200 Hz)",
        points: &[(1.0, 12.4), (50.0, 10.2), (100.0, 9.1)],
    },
];

/// The paper: "position feedback … will arrive at the controller almost 300 ms later".
pub(crate) const PAPER_FEEDBACK_MS: f64 = 300.0;
/// The paper: both users at 50 Hz without access control gave the robot about 70 Hz.
pub(crate) const PAPER_OPEN_HZ: f64 = 70.0;
