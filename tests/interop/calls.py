"""A client or a server of a ROS 2 service as rmw_cyclonedds has it, for std_srvs/srv/SetBool and Trigger.

calls.py serve DOMAIN NAME KIND [silent]       prints each request; replies with what came, unless it is silent
calls.py call DOMAIN NAME KIND WAIT_S VALUE…   calls once for each value, prints each reply, or "none" after the wait
calls.py late DOMAIN NAME KIND WAIT_S VALUE…   as call, and hears replies only some time after it has called first
"""

import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import int64, uint8, uint64
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration


@dataclass
class SetBoolRequest(IdlStruct, typename="std_srvs::srv::dds_::SetBool_Request_"):
    client: uint64
    number: int64
    data: bool


@dataclass
class SetBoolReply(IdlStruct, typename="std_srvs::srv::dds_::SetBool_Response_"):
    client: uint64
    number: int64
    success: bool
    message: str


@dataclass
class TriggerRequest(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Request_"):
    client: uint64
    number: int64
    data: uint8


@dataclass
class TriggerReply(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Response_"):
    client: uint64
    number: int64
    success: bool
    message: str


KINDS = {"SetBool": (SetBoolRequest, SetBoolReply), "Trigger": (TriggerRequest, TriggerReply)}
role, domain, name, kind = sys.argv[1], int(sys.argv[2]), sys.argv[3], sys.argv[4]
words = sys.argv[5:]
request_type, reply_type = KINDS[kind]
participant = DomainParticipant(domain)
own = int.from_bytes(participant.guid.bytes[:8], "little")
who = "serviceid" if role == "serve" else "clientid"
qos = Qos(
    Policy.Reliability.Reliable(duration(seconds=10)),
    Policy.History.KeepLast(10),
    Policy.DataRepresentation(use_cdrv0_representation=True),
    Policy.Userdata(f"{who}={own:x};".encode()),
)
requests = Topic(participant, f"rq{name}Request", request_type)
replies = Topic(participant, f"rr{name}Reply", reply_type)


def wait_for(condition, what):
    deadline = time.monotonic() + 40
    while not condition():
        if time.monotonic() > deadline:
            sys.exit(f"{what} within 40 s")
        time.sleep(0.005)


def valid(samples, kind):
    """Without the notices of writers that have left."""
    return [sample for sample in samples if isinstance(sample, kind)]


if role == "serve":
    reader = DataReader(Subscriber(participant), requests, qos=qos)
    writer = DataWriter(Publisher(participant), replies, qos=qos)
    print("ready", flush=True)
    while True:
        for request in valid(reader.take(N=10), request_type):
            print(f"request {bool(request.data)}", flush=True)
            if "silent" not in words:
                answer = f"from {name}"
                writer.write(reply_type(request.client, request.number, bool(request.data), answer))
        time.sleep(0.002)

writer = DataWriter(Publisher(participant), requests, qos=qos)
reader = DataReader(Subscriber(participant), replies, qos=qos) if role == "call" else None
wait_for(writer.get_matched_subscriptions, "no server")
if reader:
    wait_for(reader.get_matched_publications, "no server")
print("matched", flush=True)
patience = float(words[0])
for number, value in enumerate(words[1:], 1):
    data = value == "true" if kind == "SetBool" else int(value)
    writer.write(request_type(own, number, data))
    if reader is None:
        time.sleep(0.3)
        reader = DataReader(Subscriber(participant), replies, qos=qos)
    deadline, got = time.monotonic() + patience, None
    while got is None and time.monotonic() < deadline:
        mine = [reply for reply in valid(reader.take(N=10), reply_type) if (reply.client, reply.number) == (own, number)]
        got = mine[0] if mine else None
        time.sleep(0.002)
    line = "none" if got is None else f"{got.success} {got.message}".replace("\n", " | ")
    print(line, flush=True)
