"""Writes the vectors of certified blocks as seeds into corpus/: python3 seeds.py"""

import hashlib
import json
import struct
from pathlib import Path

PLACE = Path(__file__).parent
BEGINNINGS = ["genesis", "two voters", "one organisation", "four voters"]  # as in src/lib.rs


def seed(target, data):
    place = PLACE / "corpus" / target
    place.mkdir(parents=True, exist_ok=True)
    (place / hashlib.sha1(data).hexdigest()).write_bytes(data)


def parts_of(proof):
    """The certificate in a proof, its statement and its first signature."""
    length = int.from_bytes(proof[17:21], "big")
    certificate = proof[21 : 21 + length]
    return certificate, certificate[23:156], certificate[160:]


vectors = json.loads((PLACE / "../tests/fixtures/certified.json").read_text())
of = bytes.fromhex
for fact in vectors["facts"]:
    seed("fact", of(fact["bytes"]))
    seed("path", of(fact["path"]))
for lie in vectors["lies"]:
    seed("lie", of(lie["lie"]))
for vote in vectors["votes"]:
    seed("signature", of(vote["signature"]))
for begin in vectors["beginnings"].values():
    seed("checkpoint", of(begin["checkpoint"])) if "checkpoint" in begin else seed("change", of(begin["writes"]))
for way in vectors["ways"]:
    for step in way["steps"]:
        proof = of(step["proof"])
        certificate, statement, signature = parts_of(proof)
        seed("proof", proof)
        seed("certificate", certificate)
        seed("statement", statement)
        seed("signed", statement + signature)
        changes = [(change["height"], of(change["writes"])) for change in step["changes"]]
        for _, writes in changes:
            seed("change", writes)
        if way["begin"] in BEGINNINGS:
            begun = bytes([BEGINNINGS.index(way["begin"]), len(changes)])
            shown = [struct.pack(">QI", height, len(writes)) + writes for height, writes in changes]
            seed("follow", begun + b"".join(shown) + proof)
seed("envelope", of("e501000000000000002a020202020202020202020202") + bytes(30))
wrapped = {"readers": [{"reader": "Org1/Salma", "key": "00" * 32, "wrapped": "00" * 80}]}
seed("envelope", json.dumps(wrapped).encode() + b"\n" + of("e5010000000000000007") + bytes(40))
