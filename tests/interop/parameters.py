"""The parameter services of a ROS 2 node as rmw_cyclonedds has them, with the types of rcl_interfaces.

parameters.py serve DOMAIN NODE     a node with parameters: prints each request
parameters.py call DOMAIN NODE      sets, gets, lists and describes them, and prints what it does; fails where an answer is wrong
"""

import sys
import time
from dataclasses import dataclass, field, make_dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int64, sequence, uint8, uint64
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration

BOOL, INTEGER, DOUBLE, STRING = 1, 2, 3, 4
BYTES, BOOLS, INTEGERS, DOUBLES, STRINGS = 5, 6, 7, 8, 9


@dataclass
class ParameterValue(IdlStruct, typename="rcl_interfaces::msg::dds_::ParameterValue_"):
    type: uint8 = 0
    bool_value: bool = False
    integer_value: int64 = 0
    double_value: float64 = 0.0
    string_value: str = ""
    byte_array_value: sequence[uint8] = field(default_factory=list)
    bool_array_value: sequence[bool] = field(default_factory=list)
    integer_array_value: sequence[int64] = field(default_factory=list)
    double_array_value: sequence[float64] = field(default_factory=list)
    string_array_value: sequence[str] = field(default_factory=list)


@dataclass
class Parameter(IdlStruct, typename="rcl_interfaces::msg::dds_::Parameter_"):
    name: str
    value: ParameterValue


@dataclass
class SetParametersResult(IdlStruct, typename="rcl_interfaces::msg::dds_::SetParametersResult_"):
    successful: bool
    reason: str


@dataclass
class ListParametersResult(IdlStruct, typename="rcl_interfaces::msg::dds_::ListParametersResult_"):
    names: sequence[str]
    prefixes: sequence[str]


@dataclass
class FloatingPointRange(IdlStruct, typename="rcl_interfaces::msg::dds_::FloatingPointRange_"):
    from_value: float64
    to_value: float64
    step: float64


@dataclass
class IntegerRange(IdlStruct, typename="rcl_interfaces::msg::dds_::IntegerRange_"):
    from_value: int64
    to_value: int64
    step: uint64


@dataclass
class ParameterDescriptor(IdlStruct, typename="rcl_interfaces::msg::dds_::ParameterDescriptor_"):
    name: str
    type: uint8
    description: str
    additional_constraints: str
    read_only: bool
    dynamic_typing: bool
    floating_point_range: sequence[FloatingPointRange, 1]
    integer_range: sequence[IntegerRange, 1]


# The services of a node, with the fields of request and reply.
SERVICES = {
    "get_parameters": ("GetParameters", [("names", sequence[str])], [("values", sequence[ParameterValue])]),
    "get_parameter_types": ("GetParameterTypes", [("names", sequence[str])], [("types", sequence[uint8])]),
    "set_parameters": ("SetParameters", [("parameters", sequence[Parameter])], [("results", sequence[SetParametersResult])]),
    "set_parameters_atomically": ("SetParametersAtomically", [("parameters", sequence[Parameter])], [("result", SetParametersResult)]),
    "describe_parameters": ("DescribeParameters", [("names", sequence[str])], [("descriptors", sequence[ParameterDescriptor])]),
    "list_parameters": ("ListParameters", [("prefixes", sequence[str]), ("depth", uint64)], [("result", ListParametersResult)]),
}


def struct(kind, half, fields):
    """The type of a request or a reply: rmw_cyclonedds puts who asks, and a number, before it."""
    head = [("client", uint64), ("number", int64)]
    made = make_dataclass(f"{kind}{half}", head + fields, bases=(IdlStruct,), namespace={"__module__": __name__})
    name = f"rcl_interfaces::srv::dds_::{kind}_{half}_"
    made.__idl_typename__ = name
    made.__idl__.idl_transformed_typename = name
    return made


role, domain, node = sys.argv[1], int(sys.argv[2]), sys.argv[3]
participant = DomainParticipant(domain)
own = int.from_bytes(participant.guid.bytes[:8], "little")
who = "serviceid" if role == "serve" else "clientid"
qos = Qos(
    Policy.Reliability.Reliable(duration(seconds=10)),
    Policy.History.KeepLast(10),
    Policy.DataRepresentation(use_cdrv0_representation=True),
    Policy.Userdata(f"{who}={own:x};".encode()),
)


class Service:
    """One end of a service: it hears requests and writes replies, or the other way round."""

    def __init__(self, name):
        kind, request, reply = SERVICES[name]
        self.name = name
        self.request, self.reply = struct(kind, "Request", request), struct(kind, "Response", reply)
        requests = Topic(participant, f"rq{node}/{name}Request", self.request)
        replies = Topic(participant, f"rr{node}/{name}Reply", self.reply)
        hears, says = (requests, replies) if role == "serve" else (replies, requests)
        self.hears = self.request if role == "serve" else self.reply
        self.reader = DataReader(Subscriber(participant), hears, qos=qos)
        self.writer = DataWriter(Publisher(participant), says, qos=qos)
        self.number = 0

    def heard(self):
        return [sample for sample in self.reader.take(N=10) if isinstance(sample, self.hears)]

    def is_matched(self):
        return bool(self.writer.get_matched_subscriptions() and self.reader.get_matched_publications())

    def call(self, *fields, wait=3.0):
        """The reply, or None after the wait."""
        self.number += 1
        self.writer.write(self.request(own, self.number, *fields))
        deadline = time.monotonic() + wait
        while time.monotonic() < deadline:
            for reply in self.heard():
                if (reply.client, reply.number) == (own, self.number):
                    return reply
            time.sleep(0.002)
        return None


services = {name: Service(name) for name in SERVICES}


def serve():
    values = {"frame": ParameterValue(STRING, string_value="base_link"), "limits": ParameterValue(DOUBLES, double_array_value=[0.5, 1.5])}
    descriptor = lambda name: ParameterDescriptor(
        name, values[name].type, f"what {name} is", "", False, False, [FloatingPointRange(0.0, 2.0, 0.1)], [IntegerRange(-3, 3, 1)]
    )

    def put(parameters):
        refused = next((it.name for it in parameters if it.name == "locked"), None)
        if refused is None:
            values.update({it.name: it.value for it in parameters})
        return SetParametersResult(refused is None, "" if refused is None else "it is read only")

    answers = {
        "get_parameters": lambda asked: [[values.get(name, ParameterValue()) for name in asked.names]],
        "get_parameter_types": lambda asked: [[values[name].type if name in values else 0 for name in asked.names]],
        "set_parameters": lambda asked: [[put([it]) for it in asked.parameters]],
        "set_parameters_atomically": lambda asked: [put(asked.parameters)],
        "describe_parameters": lambda asked: [[descriptor(name) for name in asked.names]],
        "list_parameters": lambda asked: [ListParametersResult(sorted(values), sorted(asked.prefixes))],
    }
    print("ready", flush=True)
    while True:
        for name, service in services.items():
            for asked in service.heard():
                print(name, flush=True)
                service.writer.write(service.reply(asked.client, asked.number, *answers[name](asked)))
        time.sleep(0.002)


def call():
    deadline = time.monotonic() + 60
    while not all(service.is_matched() for service in services.values()):
        if time.monotonic() > deadline:
            sys.exit("no node with parameters within 60 s")
        time.sleep(0.01)
    print("matched", flush=True)
    # The robot's bridge may not have found the node yet: whoever calls too soon has no reply.
    for name, fields in [("get_parameters", [["frame"]]), ("get_parameter_types", [[]]), ("set_parameters", [[]]),
                         ("set_parameters_atomically", [[]]), ("describe_parameters", [[]]), ("list_parameters", [[], 0])]:
        while services[name].call(*fields) is None:
            if time.monotonic() > deadline:
                sys.exit(f"{name}: no reply within 60 s")

    def answer(name, *fields):
        reply = services[name].call(*fields, wait=30)
        print(name, flush=True)
        return getattr(reply, SERVICES[name][2][0][0])

    every = [
        Parameter("b", ParameterValue(BOOL, bool_value=True)),
        Parameter("i", ParameterValue(INTEGER, integer_value=-(2**40))),
        Parameter("d", ParameterValue(DOUBLE, double_value=0.25)),
        Parameter("s", ParameterValue(STRING, string_value="Grüße")),
        Parameter("by", ParameterValue(BYTES, byte_array_value=[0, 255])),
        Parameter("bs", ParameterValue(BOOLS, bool_array_value=[True, False, True])),
        Parameter("is", ParameterValue(INTEGERS, integer_array_value=[1, -2, 3])),
        Parameter("ds", ParameterValue(DOUBLES, double_array_value=[1e300, -0.5])),
        Parameter("ss", ParameterValue(STRINGS, string_array_value=["", "a", "abc"])),
    ]
    names = [parameter.name for parameter in every]
    results = answer("set_parameters", every + [Parameter("locked", ParameterValue(BOOL))])
    assert [result.successful for result in results] == [True] * len(every) + [False], results
    assert results[-1].reason == "it is read only", results
    values = answer("get_parameters", names + ["nothing"])
    for parameter, value in zip(every, values, strict=False):
        as_lists = {key: list(it) if key.endswith("array_value") else it for key, it in vars(value).items()}
        assert as_lists == vars(parameter.value), (parameter, value)
    assert values[-1].type == 0, values
    assert list(answer("get_parameter_types", names)) == list(range(1, 10))
    told = answer("list_parameters", ["limits"], 0)
    assert told.names == sorted(names + ["frame", "limits"]) and told.prefixes == ["limits"], told
    frame, limits = answer("describe_parameters", ["frame", "limits"])
    assert (frame.name, frame.type, limits.description) == ("frame", STRING, "what limits is"), (frame, limits)
    assert limits.floating_point_range[0].to_value == 2.0 and limits.integer_range[0].from_value == -3, limits
    result = answer("set_parameters_atomically", every[:1] + [Parameter("locked", ParameterValue(BOOL))])
    assert (result.successful, result.reason) == (False, "it is read only"), result


{"serve": serve, "call": call}[role]()
