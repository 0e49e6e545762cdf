//! Every limit of memory and work. Each is checked before anything is allocated.

/// Largest sample, bytes with its encapsulation header.
pub const SAMPLE_BYTES_MAX: usize = 16 * 1024 * 1024;
/// Largest datagram that is taken in: what UDP over IPv4 can carry.
pub const DATAGRAM_BYTES_MAX: usize = 65_507;
/// Most submessages of a datagram that are looked at.
pub const SUBMESSAGES_MAX: usize = 1024;
/// Most parameters of a list that are looked at.
pub const PARAMETERS_MAX: usize = 512;
/// Longest topic or type name that is taken from others, bytes.
pub const NAME_BYTES_MAX: usize = 256;
/// Longest USER_DATA that is kept, bytes.
pub const USER_DATA_BYTES_MAX: usize = 1024;
/// Most partitions of an endpoint.
pub const PARTITIONS_MAX: usize = 64;
/// Most representations of an endpoint that are kept.
pub const REPRESENTATIONS_MAX: usize = 8;
/// Most locators of one kind of a peer or endpoint that are kept.
pub const LOCATORS_MAX: usize = 16;
/// Most participants of others that are followed.
pub const PARTICIPANTS_MAX: usize = 512;
/// Most endpoints of one other participant that are followed.
pub const ENDPOINTS_OF_PARTICIPANT_MAX: usize = 4096;
/// Most endpoints of all other participants that are followed.
pub const ENDPOINTS_MAX: usize = 16_384;
/// Most bytes that a writer keeps for repair and late readers.
pub const HISTORY_BYTES_MAX: usize = 32 * 1024 * 1024;
/// Deepest history, samples.
pub const HISTORY_SAMPLES_MAX: usize = 100_000;
/// Most bytes of samples in assembly or out of order, for each writer that a reader follows. A fragmented sample may take twice its
/// bytes.
pub const ASSEMBLY_BYTES_MAX: usize = 2 * SAMPLE_BYTES_MAX;
/// Most bytes of samples in assembly or out of order of all writers of a reader.
pub const READER_BYTES_MAX: usize = 64 * 1024 * 1024;
/// Most bytes of samples in assembly or out of order of all readers of a participant.
pub const PARTICIPANT_BYTES_MAX: usize = 128 * 1024 * 1024;
/// Most bytes of announcements that wait, for each participant and kind.
pub const ANNOUNCEMENTS_OF_PARTICIPANT_BYTES_MAX: usize = 128 * 1024;
/// Most bytes of announcements of all participants that wait, for each of the three kinds.
pub const ANNOUNCEMENTS_BYTES_MAX: usize = 16 * 1024 * 1024;
const _: () = assert!(ASSEMBLY_BYTES_MAX <= READER_BYTES_MAX && READER_BYTES_MAX <= PARTICIPANT_BYTES_MAX);
/// Time without a new fragment after which a best-effort sample is given up, microseconds: it is not repaired. A sample that a reliable
/// reader waits for longer gives way first where bytes are short.
pub const ASSEMBLY_MICROS_MAX: u64 = 10_000_000;
/// Most samples in assembly or out of order, for each writer that a reader follows.
pub const ASSEMBLY_SAMPLES_MAX: usize = 8192;
/// Payload of a fragment for readers on other hosts, bytes: with all headers it fits an Ethernet frame.
pub const FRAGMENT_BYTES: u16 = 1344;
/// Payload of a fragment where all readers are on this host, bytes.
pub const FRAGMENT_BYTES_LOCAL: u16 = 16_000;
/// Bytes of large samples that go out at once; the rest follows after [`BURST_PAUSE_MICROS`].
pub const BURST_BYTES: usize = 64 * 1024;
/// Pause between two bursts, microseconds.
pub const BURST_PAUSE_MICROS: u64 = 100;
/// Bytes of requested samples and fragments that go out at once; the rest follows after [`BURST_PAUSE_MICROS`].
pub const REPAIR_BYTES: usize = 64 * 1024;
/// Bits of a set of sequence or fragment numbers (§9.4.2.6).
pub const SET_BITS_MAX: u32 = 256;
