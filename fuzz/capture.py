#!/usr/bin/env python3
"""Captures datagrams of other implementations of DDS on a loopback of its own: capture.py OUTPUT COMMENT BYTES_MAX PEER...

Each PEER is a command; all run at once in a new network namespace, on domain 7, until the first one ends. Of the datagrams those are
kept that are new in kind: another set of submessages, entities and lengths. With CAPTURE_ALL=1 all are kept that are not the same
bytes as one before. At most BYTES_MAX bytes of them are written to OUTPUT as hexadecimal lines, under COMMENT. It needs root, `unshare`, `ip`, and nothing but the standard library of Python:

    fuzz/capture.py crates/rtps/src/announcement/captures/rustdds-0.15.1.hex "RustDDS 0.15.1" 12000 "rustdds-peer 7"
"""

import os
import shlex
import socket
import subprocess
import sys
import threading

ETH_P_IP = 0x0800
# Longer datagrams are left out.
LINE_BYTES = 4200


def shape(datagram):
    """What distinguishes datagrams: the kinds of submessages, their entities, and their lengths as a power of two."""
    kinds, at = [], 20
    while at + 4 <= len(datagram):
        kind, flags = datagram[at], datagram[at + 1]
        length = int.from_bytes(datagram[at + 2 : at + 4], "little" if flags & 1 else "big")
        body = datagram[at + 4 : at + 4 + length] if length else datagram[at + 4 :]
        entities = body[4:12] if kind in (0x15, 0x16) else body[:8] if kind in (0x06, 0x07, 0x08, 0x12, 0x13) else b""
        kinds.append((kind, flags, bytes(entities), len(body).bit_length()))
        at += 4 + (length or len(body))
    return tuple(kinds)


def sniff(raw, found, seen):
    while True:
        frame = raw.recv(70000)
        ip = frame[14:]
        header = (ip[0] & 15) * 4
        payload = ip[header + 8 :] if ip[9] == 17 else b""
        if payload[:4] != b"RTPS" or len(payload) > LINE_BYTES:
            continue
        kind = payload if os.environ.get("CAPTURE_ALL") == "1" else (payload[8:20], shape(payload))
        if kind not in seen:
            seen.add(kind)
            found.append(payload)


def main(output, comment, bytes_max, peers):
    subprocess.run("ip link set lo up && ip link set lo multicast on && ip route add 224.0.0.0/4 dev lo", shell=True, check=True)
    raw = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETH_P_IP))
    raw.bind(("lo", 0))
    found, seen = [], set()
    threading.Thread(target=sniff, args=(raw, found, seen), daemon=True).start()
    processes = [subprocess.Popen(shlex.split(peer), stdout=subprocess.DEVNULL) for peer in peers]
    processes[0].wait()
    for process in processes[1:]:
        process.terminate()
        process.wait()
    with open(output, "w") as file:
        file.write(f"# Datagrams of {comment}, captured on `lo` by fuzz/capture.py. One a line.\n")
        left = bytes_max
        for datagram in found:
            if len(datagram) <= left:
                left -= len(datagram)
                file.write(datagram.hex() + "\n")
    print(f"{len(found)} kinds of datagrams, {bytes_max - left} bytes kept")


if __name__ == "__main__":
    if os.environ.get("CAPTURE_INSIDE") != "1":
        os.environ["CAPTURE_INSIDE"] = "1"
        os.execvp("unshare", ["unshare", "-n", sys.executable, *sys.argv])
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4:])
