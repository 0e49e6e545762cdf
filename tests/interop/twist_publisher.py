"""Publishes numbered messages: DOMAIN TOPIC COUNT RATE_HZ SIZE [FIRST].

SIZE 0 sends geometry_msgs/Twist, more sends sensor_msgs/Image with that many bytes of data. Waits for a reader, prints
"matched", then prints each message as hex of its CDR (with header) and sends it; ends when all are acknowledged.
"""

import sys
import time

from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from messages import QOS, message, message_type

domain, topic, count, rate, size = int(sys.argv[1]), sys.argv[2], int(sys.argv[3]), float(sys.argv[4]), int(sys.argv[5])
first = int(sys.argv[6]) if len(sys.argv) > 6 else 0

participant = DomainParticipant(domain)
writer = DataWriter(Publisher(participant), Topic(participant, topic, message_type(size)), qos=QOS)

deadline = time.monotonic() + 30
while not writer.get_matched_subscriptions():
    if time.monotonic() > deadline:
        sys.exit(f"no reader of {topic} in domain {domain} within 30 s")
    time.sleep(0.01)
print("matched", flush=True)

start = time.monotonic()
for index in range(count):
    sample = message(first + index, size)
    pause = start + index / rate - time.monotonic()
    if pause > 0:
        time.sleep(pause)
    print(sample.serialize(use_version_2=False).hex(), flush=True)
    writer.write(sample)
if not writer.wait_for_acks(duration(seconds=20)):
    sys.exit("not all messages were acknowledged within 20 s")
