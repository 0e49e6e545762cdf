"""A topic with keys: keyed.py pub DOMAIN TOPIC    publishes three instances in turn, and disposes of the first one half way
keyed.py sub DOMAIN TOPIC INSTANCES                  prints "ID NUMBER" of each sample; ends well when each instance had ten, and
                                                     every ID had an instance of its own"""

import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import key
from cyclonedds.idl.types import float64, int32
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration


@dataclass
class Tracked(IdlStruct, typename="tracking_msgs::msg::dds_::Tracked_"):
    id: int32
    key("id")
    number: float64
    label: str


qos = Qos(
    Policy.Reliability.Reliable(duration(seconds=10)),
    Policy.History.KeepLast(1),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)
role, domain, name = sys.argv[1], int(sys.argv[2]), sys.argv[3]
participant = DomainParticipant(domain)
topic = Topic(participant, name, Tracked)

if role == "pub":
    writer = DataWriter(Publisher(participant), topic, qos=qos)
    deadline = time.monotonic() + 90
    number = 0
    while time.monotonic() < deadline:
        for instance in (1, 2, 3):
            sample = Tracked(instance, float(number), f"thing {instance}")
            writer.write(sample)
        if number % 20 == 10:
            writer.dispose(Tracked(1, 0.0, ""))
        if number % 20 == 15:
            writer.unregister_instance(Tracked(2, 0.0, ""))
        number += 1
        time.sleep(0.05)
else:
    instances = int(sys.argv[4])
    reader = DataReader(Subscriber(participant), topic, qos=qos)
    print("ready", flush=True)
    deadline = time.monotonic() + 60
    counts, handles = {}, {}
    while len(counts) < instances or min(counts.values()) < 10:
        if time.monotonic() > deadline:
            sys.exit(f"only {counts}")
        for sample in reader.take(N=100):
            if isinstance(sample, Tracked):
                assert sample.label == f"thing {sample.id}", sample
                counts[sample.id] = counts.get(sample.id, 0) + 1
                handles[sample.id] = sample.sample_info.instance_handle
                print(sample.id, int(sample.number), flush=True)
        time.sleep(0.001)
    assert len(set(handles.values())) == instances, handles
