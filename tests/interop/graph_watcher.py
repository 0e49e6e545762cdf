"""Prints what the nodes of a domain say of themselves: DOMAIN [SECONDS].

One line for each announcement on ros_discovery_info, as ROS 2 tools read it: "NAMESPACE NAME READERS WRITERS".
"""

import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, sequence, uint8
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration


@dataclass
class Gid(IdlStruct, typename="rmw_dds_common::msg::dds_::Gid_"):
    data: array[uint8, 16]


@dataclass
class Node(IdlStruct, typename="rmw_dds_common::msg::dds_::NodeEntitiesInfo_"):
    node_namespace: str
    node_name: str
    reader_gid_seq: sequence[Gid]
    writer_gid_seq: sequence[Gid]


@dataclass
class Participant(IdlStruct, typename="rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"):
    gid: Gid
    node_entities_info_seq: sequence[Node]


QOS = Qos(
    Policy.Reliability.Reliable(duration(seconds=1)),
    Policy.Durability.TransientLocal,
    Policy.History.KeepLast(1),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)
seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 30.0
participant = DomainParticipant(int(sys.argv[1]))
reader = DataReader(Subscriber(participant), Topic(participant, "ros_discovery_info", Participant), qos=QOS)
deadline = time.monotonic() + seconds
while time.monotonic() < deadline:
    for info in reader.take(N=100):
        for node in info.node_entities_info_seq:
            counts = f"{len(node.reader_gid_seq)} {len(node.writer_gid_seq)}"
            print(node.node_namespace, node.node_name, counts, flush=True)
    time.sleep(0.005)
