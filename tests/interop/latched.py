"""Latched topics: say DOMAIN TOPIC NUMBER, or hear DOMAIN TOPIC.

"say" publishes one geometry_msgs/Twist with this number, transient local, prints its CDR (hex, with header), and stays.
"hear" subscribes transient local and prints the CDR of every message as it came. Both run until they are ended.
"""

import sys
import time

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from messages import Twist, message



def latched(depth):
    """Each publisher keeps one message; who hears several publishers keeps more."""
    return Qos(
        Policy.Reliability.Reliable(duration(seconds=10)),
        Policy.Durability.TransientLocal,
        Policy.History.KeepLast(depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )


class Raw:
    """The serialized sample as it came."""

    def __init__(self, data):
        self.data = bytes(data)


role, domain, topic = sys.argv[1], int(sys.argv[2]), sys.argv[3]
participant = DomainParticipant(domain)
if role == "say":
    writer = DataWriter(Publisher(participant), Topic(participant, topic, Twist), qos=latched(1))
    sample = message(int(sys.argv[4]), 0)
    writer.write(sample)
    print(sample.serialize(use_version_2=False).hex(), flush=True)
    while True:
        time.sleep(60)
Twist.deserialize = classmethod(lambda cls, data, has_header=True, use_version_2=None: Raw(data))
reader = DataReader(Subscriber(participant), Topic(participant, topic, Twist), qos=latched(100))
while True:
    for sample in reader.take(N=100):
        if isinstance(sample, Raw):
            print(sample.data.hex(), flush=True)
    time.sleep(0.002)
