"""Believes what enough voters of a network have signed, and no single node: docs/format.md, "Certified blocks".

    ledgerctl light Turtlebot4 --checkpoint fleet.checkpoint
    python3 -m venv venv && venv/bin/pip install cryptography
    venv/bin/python verify.py NETWORK fleet.checkpoint [PROOF ...]

NETWORK is the network's name, as in context.toml. A checkpoint says whom to believe, so take one that you made. A PROOF
is a file of a node, such as certificates/newest.proof: it is believed if enough voters of the checkpoint have signed,
and still govern. follow.py goes over changes of voters, from the genesis. node_signature.py has what concerns X.509.
"""

import hashlib
import json
import struct
import sys
from pathlib import Path

from node_signature import check_node, need, quorum, read_authorities

FACTS = {b"\1": "ground", b"\2": "verdict", b"\3": "event", b"\4": "control write"}
# First bytes, network, forced recoveries, height, block time, block, results root.
STATEMENT = struct.Struct(">21s 32s Q Q Q 32s 32s")


def sha256(*parts):
    return hashlib.sha256(b"".join(parts)).digest()


class Reader:
    """Reads hostile bytes from the front."""

    def __init__(self, data, begin=b""):
        self.rest = memoryview(data)
        need(self.take(len(begin)) == begin, f"these bytes do not begin with {begin}")

    def take(self, count):
        need(count <= len(self.rest), "these are too few bytes")
        part, self.rest = bytes(self.rest[:count]), self.rest[count:]
        return part

    def number(self, most=2**32 - 1, size=4):
        number = int.from_bytes(self.take(size), "big")
        need(number <= most, f"the number {number} is above {most}")
        return number

    def part(self, most=2**24):
        return self.take(self.number(most))

    def end(self):
        need(not self.rest, f"these are {len(self.rest)} bytes too many")


def read_writes(data):
    """Governing writes: values by their keys, None for a deleted key."""
    reader = Reader(data, b"ledgerd governing writes v1\0")
    writes = [(reader.part(4096), reader.part(2**20) if reader.number(1, 1) else None) for _ in range(reader.number())]
    need([key for key, _ in writes] == sorted(dict(writes)), "keys are out of order, or stand twice")
    reader.end()
    return dict(writes)


def read_fact(fact, path, root):
    """The kind and content of a fact, if its Merkle path (RFC 6962) leads to the results root."""
    path = Reader(path)
    index, last = path.number(), path.number() - 1
    at, reached = index, sha256(b"\0", fact)
    need(at <= last and 32 * path.number(32, 1) == len(path.rest), "this is no Merkle path")
    while last:
        if at % 2:
            reached = sha256(b"\1", path.take(32), reached)
        elif at < last:
            reached = sha256(b"\1", reached, path.take(32))
        at, last = at // 2, last // 2
    need(reached == root and not path.rest, "a fact is not one of the block")
    content = Reader(fact, b"ledgerd fact v1\0").rest.tobytes()
    need(content[:1] in FACTS and (index == 0) == (content[:1] == b"\1"), "the ground is the first fact of a block")
    return content


def read_proof(data):
    """The statement in a proof, the signatures below it, which are not checked yet, and the facts, the ground first."""
    proof = Reader(data, b"ledgerd proof v1\0")
    certificate = Reader(proof.part(), b"ledgerd certificate v1\0")
    statement = certificate.take(STATEMENT.size)
    begin, *_, root = STATEMENT.unpack(statement)
    one = lambda: (certificate.number(2**64 - 1, 8), certificate.part(16384), certificate.part(72))
    signatures = [one() for _ in range(certificate.number(128))]
    certificate.end()
    nodes = [node for node, _, _ in signatures]
    need(nodes == sorted(set(nodes) - {0}), "signatures are out of order, or one node has two")
    facts = [read_fact(proof.part(), proof.part(), root) for _ in range(proof.number(64))]
    proof.end()
    need(begin == b"ledgerd statement v1\0" and facts and facts[0][:1] == b"\1", "this is no statement with a ground")
    return statement, signatures, facts


def read_checkpoint(data):
    """The governing records in a checkpoint, and its proof."""
    reader = Reader(data, b"ledgerd checkpoint v1\0")
    records, proof = read_writes(reader.part()), read_proof(reader.part())
    need(not reader.rest and None not in records.values(), "this is no checkpoint")
    return records, proof


def signers(network, records, proof):
    """The voters who have signed, by these governing records. Refuses if they are too few."""
    _, of, recoveries, _, time, _, _ = STATEMENT.unpack(proof[0])
    under = lambda kind: [json.loads(records[key]) for key in records if key.startswith(b"msp\0" + kind)]
    nodes, authorities = {node["id"]: node for node in under(b"node/")}, read_authorities(under(b"organisation/"))
    need((of, recoveries) == (network, len(under(b"recovery/"))), "this is of another network or forced recovery")
    members, good, reasons = json.loads(records[b"msp\0members"]), set(), []
    voters, outgoing = set(members["voters"]), set(members["outgoing"])
    for node, certificate, signature in proof[1]:
        try:
            check_node(nodes[node], authorities, records, time, certificate, proof[0] + node.to_bytes(8, "big"), signature)
            good |= {node} & (voters | outgoing)
        except Exception as reason:  # A signature that is not good counts for nothing, and spoils nothing.
            reasons.append(f"; node {node}: {reason!r}")
    for group in (voters, outgoing or voters):
        signed, (needed, of, hands) = group & good, quorum(records, nodes, group)
        enough = len(signed) >= needed and len({hands[node] for node in signed}) >= of
        need(enough, f"nodes {signed} of {group}, of {hands}, are fewer than {needed}" + "".join(reasons))
    return sorted(f"{nodes[node]['organisation']}/{nodes[node]['name']}" for node in good)


def main(network, checkpoint, *proofs):
    (records, first), network = read_checkpoint(Path(checkpoint).read_bytes()), bytes.fromhex(network)
    for proof in [first] + [read_proof(Path(file).read_bytes()) for file in proofs]:
        need(proof[2][0][1:33] == first[2][0][1:33], "who governs has changed since the checkpoint: make it anew")
        _, _, _, height, time, block, _ = STATEMENT.unpack(proof[0])
        print(f"block {height} at {time} µs, hash {block.hex()}: signed by", *signers(network, records, proof))
        for fact in proof[2]:
            print(f"  {FACTS[fact[:1]]} {fact[1:].hex()}")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except (LookupError, ValueError) as refused:
        sys.exit(f"refused: {refused}")
