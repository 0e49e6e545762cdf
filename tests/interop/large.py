"""Messages of many sizes over each kind of channel, as tests/ros/large.py has them, with CycloneDDS: DOMAIN SIZE..."""

import sys
import threading
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import int64, sequence, uint64
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration


@dataclass
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str


@dataclass
class GetParametersRequest(IdlStruct, typename="rcl_interfaces::srv::dds_::GetParameters_Request_"):
    client: uint64
    number: int64
    names: sequence[str]


@dataclass
class GetParametersReply(IdlStruct, typename="rcl_interfaces::srv::dds_::GetParameters_Response_"):
    """Its values are never sent here."""

    client: uint64
    number: int64
    values: sequence[str]


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


sizes = [int(word) for word in sys.argv[2:]]
participant = DomainParticipant(int(sys.argv[1]))
own = int.from_bytes(participant.guid.bytes[:8], "little")
one_at_a_time = threading.Lock()


def text(size):
    return "x" * size


def say(channel, received):
    assert set(received) <= {"x"}
    with one_at_a_time:
        print(f"{channel} {len(received)}\n", end="", flush=True)


def qos(*more):
    return Qos(
        Policy.Reliability.Reliable(duration(seconds=10)),
        Policy.History.KeepLast(1 if more else 10),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        *more,
    )


def writer(name, kind, *more):
    return DataWriter(Publisher(participant), Topic(participant, name, kind), qos=qos(*more))


def reader(name, kind, *more):
    return DataReader(Subscriber(participant), Topic(participant, name, kind), qos=qos(*more))


def valid(reader, kind):
    """Without the notices of writers that have left."""
    return [sample for sample in reader.take(N=10) if isinstance(sample, kind)]


latched, server, client = Policy.Durability.TransientLocal, f"serviceid={own:x};", f"clientid={own:x};"
serving, calling = Policy.Userdata(server.encode()), Policy.Userdata(client.encode())
asked = reader("rq/theirs/askRequest", GetParametersRequest, serving)
answers = writer("rr/theirs/askReply", GetParametersReply, serving)
wanted = reader("rq/theirs/tellRequest", SetBoolRequest, serving)
tells = writer("rr/theirs/tellReply", SetBoolReply, serving)
topic = reader("rt/ours/topic", String)
kept = [reader(f"rt/ours/latched_{size}", String, latched) for size in sizes]
keeping = [writer(f"rt/theirs/latched_{size}", String, latched) for size in sizes]
for size, keeper in zip(sizes, keeping):
    keeper.write(String(text(size)))
publisher = writer("rt/theirs/topic", String)
asker = writer("rq/ours/askRequest", GetParametersRequest, calling), reader("rr/ours/askReply", GetParametersReply, calling)
teller = writer("rq/ours/tellRequest", SetBoolRequest, calling), reader("rr/ours/tellReply", SetBoolReply, calling)


def serve():
    told = iter(sizes)
    while True:
        for request in valid(asked, GetParametersRequest):
            say("ask", request.names[0])
            # As rmw_cyclonedds: a reply waits until its client can be reached.
            wait_for(answers.get_matched_subscriptions)
            answers.write(GetParametersReply(request.client, request.number, []))
        for request in valid(wanted, SetBoolRequest):
            wait_for(tells.get_matched_subscriptions)
            tells.write(SetBoolReply(request.client, request.number, True, text(next(told) if request.data else 0)))
        for message in valid(topic, String):
            say("topic", message.data)
        for message in [message for keeper in kept for message in valid(keeper, String)]:
            say("latched", message.data)
        time.sleep(0.002)


def wait_for(condition):
    deadline = time.monotonic() + 60
    while not (result := condition()):
        if time.monotonic() > deadline:
            sys.exit("nothing within a minute")
        time.sleep(0.002)
    return result


def call(ends, request, kind):
    requests, replies = ends
    wait_for(lambda: requests.get_matched_subscriptions() and replies.get_matched_publications())
    requests.write(request)
    return wait_for(lambda: valid(replies, kind))[0]


threading.Thread(target=serve, daemon=True).start()
print("ready\n", end="", flush=True)
wait_for(publisher.get_matched_subscriptions)
for number, size in enumerate(sizes, 1):
    publisher.write(String(text(size)))
    call(asker, GetParametersRequest(own, number, [text(size)]), GetParametersReply)
    say("told", call(teller, SetBoolRequest(own, number, True), SetBoolReply).message)
with one_at_a_time:
    print("done\n", end="", flush=True)
while True:
    time.sleep(60)
