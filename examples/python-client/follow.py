"""Follows who governs a network from its genesis, over every change of its voters: docs/format.md, "Certified blocks".

    venv/bin/python follow.py ~/.config/ledgerd/contexts/Salma

Needs what client.py needs. The context pins the network's name, and no node is believed, not even the one that answers.
"""

import dataclasses
import json
import struct
import sys
from pathlib import Path

from node_signature import strict_quorum
from verify import STATEMENT, need, read_proof, read_writes, sha256, signers


@dataclasses.dataclass(frozen=True)
class Governance:
    """Who governs after a block: the records by their keys, and the chain over all changes that led to them."""

    network: bytes
    height: int
    chain: bytes
    records: dict

    def changed(self, height, writes):
        """After the governing writes of the block at a height."""
        body = b"".join(map(hashed, writes, writes.values()))
        head = b"ledgerd control v1\0" + self.chain + struct.pack(">QI", height, len(writes))
        records = {key: value for key, value in (self.records | writes).items() if value is not None}
        return dataclasses.replace(self, chain=sha256(head, body) if writes else self.chain, records=records)

    def follow(self, changes, proof):
        """After the block of a proof, with all changes up to it, as pairs of height and governing writes."""
        height = STATEMENT.unpack(proof[0])[3]
        need(height >= self.height, "this is older than what is known")
        before = after = self
        for at, writes in sorted(changes):
            if self.height < at <= height:
                after = after.changed(at, read_writes(writes))
                before = after if at < height else before
        governing = proof[2][0][1:33]
        need(governing == after.chain, "changes were left out or made up")
        signers(self.network, self.records, proof)
        signers(self.network, before.records, proof)
        return dataclasses.replace(after, height=height)


def hashed(key, value):
    return struct.pack(">I", len(key)) + key + (b"\0" if value is None else b"\1" + sha256(value))


def founded(network, genesis):
    """The beginning: the network is named by the hash of its genesis, so nobody needs to be believed."""
    need(sha256(b"ledgerd genesis v1\0", genesis) == network, "this is the genesis of another network")
    document = json.loads(genesis)
    members = {"voters": [], "learners": [], "outgoing": [], "learners_next": [], "auto_leave": False}
    records = {"members": members}
    for node in sorted(document["nodes"], key=lambda node: node["id"]):
        role = "voter" if node["voter"] else "learner"
        members[role + "s"].append(node["id"])
        record = {field: node[field] for field in ("id", "name", "organisation", "address")}
        records[f"node/{node['id']:020}"] = record | {"role": role}
    for organisation in sorted(document["organisations"], key=lambda each: each["name"].encode()):
        fields = [field for field in ("name", "roots", "intermediates") if organisation.get(field)]
        records["organisation/" + organisation["name"]] = {field: organisation[field] for field in fields}
    owners = [node["organisation"] for node in document["nodes"] if node["voter"]]
    if owners and strict_quorum(len(owners), owners) < len(owners):
        records["certificates"] = {"strict_since": 0}
    text = lambda record: json.dumps(record, ensure_ascii=False, separators=(",", ":")).encode()
    writes = {b"msp\0" + key.encode(): text(record) for key, record in records.items()}
    return Governance(network, 0, bytes(32), {}).changed(0, writes)


def main(context):
    from client import Client, api

    client, known, changes = Client(Path(context).expanduser()), None, []
    for step in client.gateway.Governance(api.GovernanceRequest()):
        known = founded(client.network, step.genesis) if step.genesis else known
        changes += [(change.height, change.writes) for change in step.changes]
        if step.proof:
            known = known.follow(changes, read_proof(step.proof))
    print(f"block {known.height} of network {known.network.hex()}:")
    since = json.loads(known.records.get(b"msp\0certificates", b"{}")).get("strict_since")
    print("  certificates are not strict" if since is None else f"  certificates are strict since block {since}")
    for key, value in known.records.items():
        print(f"  {key!r} {value.decode()}")


if __name__ == "__main__":
    main(*sys.argv[1:])
