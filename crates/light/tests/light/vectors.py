"""Checks the examples in Python against the vectors: vectors.py DIRECTORY_OF_EXAMPLES VECTORS.

Prints a line of JSON for each vector: its kind, its name, and the reason if it is refused. A vector that is believed
must give what the vectors say, to the byte.
"""

import json
import struct
import sys

sys.path.insert(0, sys.argv[1])

import follow  # noqa: E402
import node_signature  # noqa: E402
import verify  # noqa: E402


def of(text):
    return bytes.fromhex(text)


def begun(begin):
    network = of(begin["network"])
    if "genesis" in begin:
        known = follow.founded(network, begin["genesis"].encode())
        assert known.chain == of(begin["governing"])
        try:
            follow.founded(network, begin["genesis"].encode() + b" ")
        except ValueError:
            return known
        raise AssertionError("the genesis of another network is believed")
    records, proof = verify.read_checkpoint(of(begin["checkpoint"]))
    verify.signers(network, records, proof)
    return follow.Governance(network, verify.STATEMENT.unpack(proof[0])[3], proof[2][0][1:33], records)


def shown(fact):
    """A fact as the vectors write it."""
    reader = verify.Reader(fact)
    kind = reader.number(4, 1)
    digest, text = lambda: reader.take(32).hex(), lambda: reader.part(4096).decode()
    if kind == 2:
        found = {"kind": "verdict", "index": reader.number(), "id": digest(), "code": reader.number()}
        found["response_hash"] = digest()
    elif kind == 3:
        found = {"kind": "event", "index": reader.number() if reader.number(1, 1) else None}
        found |= {"chaincode": text(), "name": text(), "subject": text(), "payload_hash": digest()}
    else:
        found = {"kind": "control", "key": text(), "value_hash": digest() if reader.number(1, 1) else None}
    reader.end()
    return found


def way(vector):
    known, facts = begun(vectors["beginnings"][vector["begin"]]), []
    for step in vector["steps"]:
        proof = verify.read_proof(of(step["proof"]))
        known = known.follow([(change["height"], of(change["writes"])) for change in step["changes"]], proof)
        facts = [shown(fact) for fact in proof[2][1:]]
    members, gives = json.loads(known.records[b"msp\0members"]), vector.get("gives")
    found = {"height": known.height, "governing": known.chain.hex(), "facts": facts}
    found |= {"voters": members["voters"], "outgoing": members["outgoing"]}
    assert gives is None or found | {"time": gives["time"]} == gives, f"{found} is not {gives}"


def sworn(message, time, signature):
    """Checks a signature by the nodes that are not those of a way."""
    reader = verify.Reader(signature)
    number, der, signed = reader.number(2**64 - 1, 8), reader.part(16384), reader.part(72)
    reader.end()
    nodes = {node["id"]: node for node in vectors["nodes"]}
    organisations = [{"name": each["name"], "roots": [each["root"]]} for each in vectors["organisations"]]
    authorities = node_signature.read_authorities(organisations)
    node_signature.check_node(nodes[number], authorities, {}, time, der, message, signed)
    return number, f"{nodes[number]['organisation']}/{nodes[number]['name']}"


def vote(vector):
    head = b"ledgerd vote v1\0" + of(vector["network"])
    message = head + struct.pack(">QQQQ", vector["recoveries"], vector["term"], vector["candidate"], vector["voter"])
    assert message == of(vector["bytes"])
    number, signer = sworn(message, vectors["time"], of(vector["signature"]))
    verify.need(number == vector["voter"], "a vote of another node")
    verify.need(vector["recoveries"] == 0, "a vote after another number of forced recoveries")
    assert signer == vector.get("signer", signer)


def pair(vector, kind):
    """The two statements in a proof, if one node has signed them for one place."""
    reader = verify.Reader(of(vector[kind]), b"ledgerd %s v1\0" % kind.encode())
    first, second = (verify.Reader(reader.part()) for _ in range(2))
    reader.end()
    said = [one.take(verify.STATEMENT.size) for one in (first, second)]
    fields = [verify.STATEMENT.unpack(each) for each in said]
    verify.need(fields[0][:4] == fields[1][:4], "two statements for two places")
    signers = {sworn(each + one.rest[:8], at[4], one.rest) for each, at, one in zip(said, fields, (first, second))}
    verify.need(len(signers) == 1, "two statements of two nodes")
    assert {vector.get("signer", name) for _, name in signers} == {name for _, name in signers}
    return fields


def lie(vector):
    first, second = pair(vector, "lie")
    verify.need(first[5] != second[5], "two statements about one block")


def fault(vector):
    first, second = pair(vector, "fault")
    verify.need(first[5] == second[5] and first != second, "two statements that do not contradict")


def fact(vector):
    read = verify.read_fact(of(vector["bytes"]), of(vector["path"]), of(vectors["root"]))
    assert verify.FACTS[read[:1]].split()[0] == vector["kind"]
    if vector["kind"] != "ground":
        assert shown(read).items() <= vector.items()


def change(vector):
    global governing
    governing = governing.changed(vector["height"], verify.read_writes(of(vector["writes"])))
    assert governing.chain == of(vector["chain"])


vectors = json.load(open(sys.argv[2]))
governing = follow.Governance(b"", 0, bytes(32), {})
sworn_things = ("votes", vote), ("lies", lie), ("faults", fault)
for kind, check in (("ways", way), *sworn_things, ("facts", fact), ("governing_chain", change)):
    for vector in vectors[kind]:
        try:
            reason = check(vector)
        except (ValueError, LookupError, node_signature.InvalidSignature) as refused:
            reason = repr(refused)
        print(json.dumps({"kind": kind, "name": vector.get("name"), "reason": reason}))
