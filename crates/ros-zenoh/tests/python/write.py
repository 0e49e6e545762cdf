"""Writes messages and a request by hand, and prints the reply: write.py ENDPOINT TOPIC_KEY SERVICE_KEY."""

import json
import struct
import sys
import time

import zenoh

endpoint, topic, service = sys.argv[1:]
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([endpoint]))
config.insert_json5("scouting/multicast/enabled", "false")


def attachment(sequence, nanos):
    return struct.pack("<qqB", sequence, nanos, 16) + b"\xab" * 16


def message(number):
    return bytes([0, 1, 0, 0]) + bytes([number]) * 4


with zenoh.open(config) as session:
    publisher = session.declare_publisher(topic)
    until = time.monotonic() + 20
    while not publisher.matching_status.matching and time.monotonic() < until:
        time.sleep(0.01)
    publisher.put(message(1))
    publisher.put(message(2), attachment=attachment(1, 1)[:-1])
    publisher.put(message(2), attachment=attachment(1, 1) + bytes(1000))
    publisher.put(message(3), attachment=attachment(7, 1_700_000_000_000_000_000))
    # Without an attachment there is no reply.
    assert not list(session.get(service, payload=message(4), timeout=5))
    for reply in session.get(service, payload=message(4), attachment=attachment(5, 2), timeout=20):
        print(reply.ok.payload.to_bytes().hex())
        print(reply.ok.attachment.to_bytes().hex())
