"""As ../twist_publisher.py, in a graph of rmw_zenoh: DOMAIN TOPIC COUNT RATE_HZ SIZE [FIRST]."""

import sys
import time

from graph import Node
from messages import message, message_type, ros_name

domain, topic, count, rate, size = int(sys.argv[1]), sys.argv[2], int(sys.argv[3]), float(sys.argv[4]), int(sys.argv[5])
first = int(sys.argv[6]) if len(sys.argv) > 6 else 0
node = Node(domain, "publisher")
publish = node.publisher(ros_name(topic), message_type(size))
print("matched", flush=True)

start = time.monotonic()
for index in range(count):
    sample = message(first + index, size)
    pause = start + index / rate - time.monotonic()
    if pause > 0:
        time.sleep(pause)
    print(sample.hex(), flush=True)
    publish(sample)
# Nothing tells a publisher that its messages have come, and a session that closes sends what it has.
node.leave()
