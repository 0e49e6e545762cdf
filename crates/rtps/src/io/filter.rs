//! A classic BPF program for sockets that take datagrams of this host and of given addresses only.
//!
//! It runs in the kernel before a datagram takes room in the receive buffer: a flood from other hosts costs that buffer nothing. It
//! looks first at the path. Datagrams by the loopback interface were sent here, and so were multicasts that the kernel hands back to its
//! own host. That holds whatever addresses this host has had since. Source addresses of this host count as well, for paths of another
//! kind (VRF). They cannot be forged from outside: the kernel drops such packets ("martian source").

use socket2::SockFilter;
use std::net::Ipv4Addr;

/// Most addresses that a program compares. Its size counts against `net.core.optmem_max`, 20 KiB by default.
const ADDRESSES_MAX: usize = 256;

/// `BPF_LD | BPF_W | BPF_ABS`: load a word.
const LOAD: u16 = 0x20;
/// `BPF_JMP | BPF_JEQ | BPF_K`: skip `when_equal` instructions if the word is `value`, otherwise `otherwise`.
const COMPARE: u16 = 0x15;
/// `BPF_RET | BPF_K`: take so many bytes of the datagram.
const RETURN: u16 = 0x06;
/// `SKF_AD_OFF + SKF_AD_PKTTYPE`: how the packet came.
const PACKET_TYPE: u32 = 0xffff_f004;
/// `SKF_AD_OFF + SKF_AD_IFINDEX`: by which interface it came.
const INTERFACE: u32 = 0xffff_f008;
/// `SKF_NET_OFF`, and the place of the source in an IPv4 header.
const SOURCE: u32 = 0xfff0_0000 + 12;
/// `PACKET_LOOPBACK`: a multicast of this host.
const PACKET_LOOPBACK: u32 = 5;
/// `LOOPBACK_IFINDEX`: `lo` has this number in every network namespace.
const LOOPBACK_INTERFACE: u32 = 1;
/// The whole datagram.
const ALL: u32 = u32::MAX;

#[derive(Clone, Copy, Debug)]
struct Instruction {
    code: u16,
    when_equal: u8,
    otherwise: u8,
    value: u32,
}

/// Takes what was sent on this host, and what comes from these addresses.
pub(super) fn local_or_from(addresses: &[Ipv4Addr]) -> Vec<SockFilter> {
    compiled(&program(addresses))
}

/// Takes nothing: for sockets that only send.
pub(super) fn nothing() -> Vec<SockFilter> {
    compiled(&[take(0)])
}

fn program(addresses: &[Ipv4Addr]) -> Vec<Instruction> {
    let mut program = vec![load(INTERFACE)];
    program.extend(take_if(LOOPBACK_INTERFACE));
    program.push(load(PACKET_TYPE));
    program.extend(take_if(PACKET_LOOPBACK));
    program.push(load(SOURCE));
    program.extend(addresses.iter().take(ADDRESSES_MAX).flat_map(|address| take_if(u32::from(*address))));
    program.push(take(0));
    program
}

/// Takes the datagram if the word that was loaded is this one.
fn take_if(value: u32) -> [Instruction; 2] {
    [Instruction { code: COMPARE, when_equal: 0, otherwise: 1, value }, take(ALL)]
}

fn take(bytes: u32) -> Instruction {
    Instruction { code: RETURN, when_equal: 0, otherwise: 0, value: bytes }
}

fn load(from: u32) -> Instruction {
    Instruction { code: LOAD, when_equal: 0, otherwise: 0, value: from }
}

fn compiled(program: &[Instruction]) -> Vec<SockFilter> {
    program.iter().map(|i| SockFilter::new(i.code, i.when_equal, i.otherwise, i.value)).collect()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::panic, reason = "tests")]
mod tests {
    use super::*;
    use socket2::{Domain, Socket, Type};
    use std::io::ErrorKind;
    use std::net::UdpSocket;

    const ETHERNET: u32 = 2;
    const PACKET_MULTICAST: u32 = 2;
    const PEER: Ipv4Addr = Ipv4Addr::new(10, 0, 0, 7);
    const STRANGER: Ipv4Addr = Ipv4Addr::new(10, 0, 0, 8);

    /// Runs a program as the kernel would, on a packet of this kind.
    fn takes(program: &[Instruction], interface: u32, packet_type: u32, source: Ipv4Addr) -> bool {
        let (mut word, mut at) = (0, 0);
        loop {
            let instruction = program.get(at).unwrap();
            at += 1;
            match (instruction.code, instruction.value) {
                (RETURN, bytes) => return bytes > 0,
                (COMPARE, value) => {
                    at += usize::from(if word == value { instruction.when_equal } else { instruction.otherwise });
                }
                (LOAD, INTERFACE) => word = interface,
                (LOAD, PACKET_TYPE) => word = packet_type,
                (LOAD, SOURCE) => word = u32::from(source),
                other => panic!("{other:?}"),
            }
        }
    }

    #[test]
    fn datagrams_of_this_host_and_of_given_addresses_are_taken_and_no_others() {
        let program = program(&[Ipv4Addr::new(10, 0, 0, 1), PEER]);
        assert!(takes(&program, LOOPBACK_INTERFACE, 0, STRANGER), "by the loopback");
        assert!(takes(&program, ETHERNET, PACKET_LOOPBACK, STRANGER), "an own multicast");
        assert!(takes(&program, ETHERNET, PACKET_MULTICAST, PEER), "a peer's multicast");
        assert!(takes(&program, ETHERNET, 0, PEER), "a peer");
        assert!(!takes(&program, ETHERNET, 0, STRANGER));
        assert!(!takes(&program, ETHERNET, PACKET_MULTICAST, STRANGER));
        assert!(!takes(&super::program(&[]), ETHERNET, 0, PEER));
    }

    #[test]
    fn addresses_beyond_the_limit_do_not_make_a_program_longer() {
        let many: Vec<Ipv4Addr> = (0..5000).map(Ipv4Addr::from).collect();
        assert_eq!(program(&many).len(), 8 + 2 * ADDRESSES_MAX);
    }

    #[test]
    fn the_kernel_accepts_the_longest_program_and_lets_the_loopback_through() {
        let many: Vec<Ipv4Addr> = (0..5000).map(Ipv4Addr::from).collect();
        assert_eq!(received_through(&local_or_from(&many)), 1);
        assert_eq!(received_through(&nothing()), 0);
    }

    /// How many of one datagram arrive. On the loopback it is delivered before `send_to` returns.
    fn received_through(filter: &[SockFilter]) -> usize {
        let socket = Socket::new(Domain::IPV4, Type::DGRAM, None).unwrap();
        socket.attach_filter(filter).unwrap();
        socket.bind(&std::net::SocketAddr::from((Ipv4Addr::LOCALHOST, 0)).into()).unwrap();
        let socket = UdpSocket::from(socket);
        socket.set_nonblocking(true).unwrap();
        let sender = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        sender.send_to(b"hello", socket.local_addr().unwrap()).unwrap();
        match socket.recv(&mut [0; 16]) {
            Ok(5) => 1,
            Err(error) if error.kind() == ErrorKind::WouldBlock => 0,
            other => panic!("{other:?}"),
        }
    }
}
