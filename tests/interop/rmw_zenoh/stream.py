"""As ../stream.py for a Twist, in a graph of rmw_zenoh.

stream.py pub DOMAIN TOPIC COUNT RATE_HZ 0
stream.py sub DOMAIN TOPIC COUNT SECONDS 0
"""

import math
import struct
import sys
import time

from graph import Node, Writer, taken
from messages import message_type, ros_name


def publish(node, topic, count, rate):
    send = node.publisher(ros_name(topic), message_type(0))
    print("matched", flush=True)
    start = time.monotonic()
    for number in range(int(count)):
        pause = start + number / float(rate) - time.monotonic()
        if pause > 0:
            time.sleep(pause)
        # As speeds that a gate lets pass, without loss.
        speeds = math.ldexp(number, -10), math.ldexp(time.monotonic_ns(), -60)
        send(Writer().put("d", *speeds, 0, 0, 0, 0).done())


def subscribe(node, topic, count, seconds):
    name, kind = ros_name(topic), message_type(0)
    samples = node.subscriber(name, kind)
    print("ready", flush=True)
    deadline, received, matched = time.monotonic() + float(seconds), 0, False
    while int(count) == 0 or received < int(count):
        if time.monotonic() > deadline:
            node.leave(3)
        if not matched and node.there("MP", name, kind):
            matched = True
            print("matched", flush=True)
        for sample in taken(samples):
            first, second = struct.unpack_from("<2d", sample, 4)
            if (first, second) == (0, 0):
                # A stop.
                continue
            received += 1
            sent = int(math.ldexp(second, 60))
            print(int(math.ldexp(first, 10)), (time.monotonic_ns() - sent) // 1000, flush=True)
        time.sleep(0.001)


role, domain, topic, count, rate, size = sys.argv[1:7]
assert size == "0", "only a Twist"
node = Node(int(domain), f"stream_{role}")
(publish if role == "pub" else subscribe)(node, topic, count, rate)
node.leave()
