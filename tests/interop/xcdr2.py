"""Sends numbered texts in XCDR2 on rt/from/KIND, and takes them back from rt/to/KIND: DOMAIN KIND.

KIND is Final, Appendable or Mutable. Ends well when three texts of different lengths have come back whole.
"""

import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import appendable, final, mutable
from cyclonedds.idl.types import float64, uint8
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration


@dataclass
@final
class Final(IdlStruct, typename="test_msgs::msg::dds_::Final_"):
    small: uint8
    large: float64
    text: str


@dataclass
@appendable
class Appendable(IdlStruct, typename="test_msgs::msg::dds_::Appendable_"):
    small: uint8
    large: float64
    text: str


@dataclass
@mutable
class Mutable(IdlStruct, typename="test_msgs::msg::dds_::Mutable_"):
    small: uint8
    large: float64
    text: str


kind = {"Final": Final, "Appendable": Appendable, "Mutable": Mutable}[sys.argv[2]]
participant = DomainParticipant(int(sys.argv[1]))
qos = Qos(
    Policy.Reliability.Reliable(duration(seconds=10)),
    Policy.History.KeepLast(100),
    Policy.DataRepresentation(use_xcdrv2_representation=True),
)
writer = DataWriter(Publisher(participant), Topic(participant, f"rt/from/{sys.argv[2]}", kind), qos=qos)
reader = DataReader(Subscriber(participant), Topic(participant, f"rt/to/{sys.argv[2]}", kind), qos=qos)
wanted = [kind(number, number + 0.5, "x" * number) for number in (1, 2, 3, 4)]
back = []
deadline = time.monotonic() + 25
while not all(sample in back for sample in wanted):
    if time.monotonic() > deadline:
        sys.exit(f"only {len(back)} came back")
    for sample in wanted:
        writer.write(sample)
    for sample in reader.take(N=100):
        if isinstance(sample, kind):
            assert sample in wanted, sample
            back.append(sample)
    time.sleep(0.05)
