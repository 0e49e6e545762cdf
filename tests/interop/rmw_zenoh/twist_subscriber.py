"""As ../twist_subscriber.py, in a graph of rmw_zenoh: DOMAIN TOPIC COUNT RATE_HZ SIZE [SECONDS]."""

import sys
import time

from graph import Node, taken
from messages import message_type, ros_name

domain, topic, count, size = int(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[5])
seconds = float(sys.argv[6]) if len(sys.argv) > 6 else 30.0
name, kind = ros_name(topic), message_type(size)
node = Node(domain, "subscriber")
samples = node.subscriber(name, kind)
print("ready", flush=True)

deadline = time.monotonic() + seconds
received, matched = 0, False
stop = bytes([0, 1] + 50 * [0])
stands = True
while count == 0 or received < count:
    if time.monotonic() > deadline:
        node.leave(0 if count == 0 else 3)
    if not matched and node.there("MP", name, kind):
        matched = True
        print("matched", flush=True)
    for sample in taken(samples):
        stood, stands = stands, sample == stop
        if stood and stands:
            continue
        received += 1
        print(sample.hex(), flush=True)
    time.sleep(0.001)
node.leave()
