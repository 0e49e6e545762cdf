"""Receives messages and prints them: DOMAIN TOPIC COUNT RATE_HZ SIZE [SECONDS].

Prints "ready" when its reader exists and "matched" when a writer is found, then the CDR of every message as it came
(hex, with header). Ends with 0 after COUNT messages, with 3 after SECONDS (default 30) without the full count. RATE_HZ
is not used: the arguments are those of the publisher. COUNT 0 receives until SECONDS are over. A stop message is printed
and counted once, however often it is said; the first ones, before anybody drives, are not.
"""

import sys
import time

from cyclonedds.domain import DomainParticipant
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic

from messages import QOS, message_type

domain, topic, count, size = int(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[5])
seconds = float(sys.argv[6]) if len(sys.argv) > 6 else 30.0


class Raw:
    """The serialized sample as it came."""

    def __init__(self, data):
        self.data = bytes(data)


kind = message_type(size)
kind.deserialize = classmethod(lambda cls, data, has_header=True, use_version_2=None: Raw(data))

participant = DomainParticipant(domain)
reader = DataReader(Subscriber(participant), Topic(participant, topic, kind), qos=QOS)
print("ready", flush=True)

deadline = time.monotonic() + seconds
received, matched = 0, False
stop = bytes([0, 1] + 50 * [0])
stands = True
while count == 0 or received < count:
    if time.monotonic() > deadline:
        sys.exit(0 if count == 0 else 3)
    if not matched and reader.get_matched_publications():
        matched = True
        print("matched", flush=True)
    for sample in reader.take(N=100):
        if isinstance(sample, Raw):
            stood, stands = stands, sample.data == stop
            if stood and stands:
                continue
            received += 1
            print(sample.data.hex(), flush=True)
    time.sleep(0.001)
