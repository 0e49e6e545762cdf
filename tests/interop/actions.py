"""A client or a server of a ROS 2 action as rmw_cyclonedds has it, for example_interfaces/action/Fibonacci.

actions.py serve DOMAIN NAME [silent|stubborn]  accepts goals; says feedback until the goal has as many numbers as its order
actions.py send DOMAIN NAME WAIT_S ORDER [cancel|beside]  sets a goal, and cancels it after the first feedback if told so

A server prints "goal ORDER", "cancel" for a goal that it has, and "ended STATUS". A silent one accepts nothing and prints "cancel" for
any goal, a stubborn one cancels nothing.
A client prints "matched", "accepted BOOL", "feedback", "cancelling CODE", "result STATUS LENGTH", and the states that it saw. One
beside others says nothing about their feedback.
"""

import os
import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, int8, int32, int64, sequence, uint8, uint32, uint64
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration

PACKAGE = "example_interfaces::action::dds_::Fibonacci"
EXECUTING, CANCELING, SUCCEEDED, CANCELED = 2, 3, 4, 5


@dataclass
class GoalRequest(IdlStruct, typename=f"{PACKAGE}_SendGoal_Request_"):
    client: uint64
    number: int64
    goal: array[uint8, 16]
    order: int32


@dataclass
class GoalReply(IdlStruct, typename=f"{PACKAGE}_SendGoal_Response_"):
    client: uint64
    number: int64
    accepted: bool
    sec: int32
    nanosec: uint32


@dataclass
class GoalInfo(IdlStruct, typename="action_msgs::msg::dds_::GoalInfo_"):
    goal: array[uint8, 16]
    sec: int32
    nanosec: uint32


@dataclass
class CancelRequest(IdlStruct, typename="action_msgs::srv::dds_::CancelGoal_Request_"):
    client: uint64
    number: int64
    goal: array[uint8, 16]
    sec: int32
    nanosec: uint32


@dataclass
class CancelReply(IdlStruct, typename="action_msgs::srv::dds_::CancelGoal_Response_"):
    client: uint64
    number: int64
    code: int8
    goals: sequence[GoalInfo]


@dataclass
class ResultRequest(IdlStruct, typename=f"{PACKAGE}_GetResult_Request_"):
    client: uint64
    number: int64
    goal: array[uint8, 16]


@dataclass
class ResultReply(IdlStruct, typename=f"{PACKAGE}_GetResult_Response_"):
    client: uint64
    number: int64
    status: int8
    numbers: sequence[int32]


@dataclass
class Feedback(IdlStruct, typename=f"{PACKAGE}_FeedbackMessage_"):
    goal: array[uint8, 16]
    numbers: sequence[int32]


@dataclass
class GoalStatus(IdlStruct, typename="action_msgs::msg::dds_::GoalStatus_"):
    info: GoalInfo
    status: int8


@dataclass
class StatusArray(IdlStruct, typename="action_msgs::msg::dds_::GoalStatusArray_"):
    states: sequence[GoalStatus]


role, domain, name = sys.argv[1], int(sys.argv[2]), sys.argv[3]
words = sys.argv[4:]
participant = DomainParticipant(domain)
own = int.from_bytes(participant.guid.bytes[:8], "little")
common = [
    Policy.Reliability.Reliable(duration(seconds=10)),
    Policy.DataRepresentation(use_cdrv0_representation=True),
]
plain = Qos(*common, Policy.History.KeepLast(10))
latched = Qos(*common, Policy.History.KeepLast(1), Policy.Durability.TransientLocal)


def ends(part, request, reply):
    """The ends of a service: of its server where this serves, else of its client."""
    who = "serviceid" if role == "serve" else "clientid"
    qos = Qos(*plain, Policy.Userdata(f"{who}={own:x}{part};".encode()))
    requests = Topic(participant, f"rq{name}/_action/{part}Request", request)
    replies = Topic(participant, f"rr{name}/_action/{part}Reply", reply)
    reads, writes = (requests, replies) if role == "serve" else (replies, requests)
    reader, writer = DataReader(Subscriber(participant), reads, qos=qos), DataWriter(Publisher(participant), writes, qos=qos)
    return reader, writer


def valid(reader, kind):
    """Without the notices of writers that have left."""
    return [sample for sample in reader.take(N=20) if isinstance(sample, kind)]


goals_in, goals_out = ends("send_goal", GoalRequest, GoalReply)
cancels_in, cancels_out = ends("cancel_goal", CancelRequest, CancelReply)
results_in, results_out = ends("get_result", ResultRequest, ResultReply)
feedback_topic = Topic(participant, f"rt{name}/_action/feedback", Feedback)
status_topic = Topic(participant, f"rt{name}/_action/status", StatusArray)


def serve():
    feedback = DataWriter(Publisher(participant), feedback_topic, qos=plain)
    status = DataWriter(Publisher(participant), status_topic, qos=latched)
    goals, asked = {}, []
    said = time.monotonic()

    def tell():
        states = [GoalStatus(GoalInfo(list(goal), *known["stamp"]), known["status"]) for goal, known in goals.items()]
        status.write(StatusArray(states))

    def end(goal, state):
        goals[goal]["status"] = state
        print(f"ended {state}", flush=True)
        tell()

    print("ready", flush=True)
    while True:
        for request in valid(goals_in, GoalRequest):
            print(f"goal {request.order}", flush=True)
            if "silent" not in words:
                stamp = divmod(time.time_ns(), 10**9)
                known = {"order": request.order, "numbers": [0, 1], "status": EXECUTING, "stamp": stamp}
                goals[bytes(request.goal)] = known
                goals_out.write(GoalReply(request.client, request.number, True, *stamp))
                tell()
        for request in valid(cancels_in, CancelRequest):
            goal = bytes(request.goal)
            if goal in goals or "silent" in words:
                print("cancel", flush=True)
            if goal not in goals:
                cancels_out.write(CancelReply(request.client, request.number, 2, []))
            elif goals[goal]["status"] >= SUCCEEDED:
                cancels_out.write(CancelReply(request.client, request.number, 3, []))
            elif "stubborn" in words:
                cancels_out.write(CancelReply(request.client, request.number, 1, []))
            else:
                info = GoalInfo(list(goal), *goals[goal]["stamp"])
                cancels_out.write(CancelReply(request.client, request.number, 0, [info]))
                end(goal, CANCELED)
        asked += valid(results_in, ResultRequest)
        for request in list(asked):
            known = goals.get(bytes(request.goal))
            if known is None or known["status"] >= SUCCEEDED:
                state, numbers = (known["status"], known["numbers"]) if known else (0, [])
                results_out.write(ResultReply(request.client, request.number, state, numbers))
                asked.remove(request)
        if time.monotonic() - said > 0.05:
            said = time.monotonic()
            for goal, known in goals.items():
                if known["status"] != EXECUTING:
                    continue
                known["numbers"].append(known["numbers"][-1] + known["numbers"][-2] & 0xFFFF)
                known["numbers"] = known["numbers"][-100:]
                known["order"] -= 1
                feedback.write(Feedback(list(goal), known["numbers"]))
                if known["order"] <= 0:
                    end(goal, SUCCEEDED)
        time.sleep(0.002)


def send():
    feedback = DataReader(Subscriber(participant), feedback_topic, qos=plain)
    status = DataReader(Subscriber(participant), status_topic, qos=latched)
    patience, order = float(words[0]), int(words[1])
    goal = list(os.urandom(16))
    deadline = time.monotonic() + 40
    while not all(
        [writer.get_matched_subscriptions() for writer in (goals_out, cancels_out, results_out)]
        + [reader.get_matched_publications() for reader in (goals_in, cancels_in, results_in, feedback, status)]
    ):
        if time.monotonic() > deadline:
            sys.exit("no server within 40 s")
        time.sleep(0.005)
    print("matched", flush=True)
    goals_out.write(GoalRequest(own, 1, goal, order))
    deadline = time.monotonic() + patience
    heard, states = False, set()
    while time.monotonic() < deadline:
        for reply in valid(goals_in, GoalReply):
            if reply.client == own:
                print(f"accepted {reply.accepted}", flush=True)
                if not reply.accepted:
                    return
                results_out.write(ResultRequest(own, 1, goal))
        for sample in valid(feedback, Feedback):
            if list(sample.goal) != goal:
                if "beside" not in words:
                    print("feedback of another", flush=True)
            elif not heard:
                heard = True
                print("feedback", flush=True)
                if "cancel" in words:
                    cancels_out.write(CancelRequest(own, 1, goal, 0, 0))
        for reply in valid(cancels_in, CancelReply):
            if reply.client == own:
                print(f"cancelling {reply.code} {len(reply.goals)}", flush=True)
        for sample in valid(status, StatusArray):
            states |= {state.status for state in sample.states if list(state.info.goal) == goal}
        for reply in valid(results_in, ResultReply):
            if reply.client == own:
                print(f"result {reply.status} {len(reply.numbers)}", flush=True)
                while reply.status not in states and time.monotonic() < deadline:
                    for sample in valid(status, StatusArray):
                        states |= {state.status for state in sample.states if list(state.info.goal) == goal}
                    time.sleep(0.002)
                print(f"states {sorted(states)}", flush=True)
                return
        time.sleep(0.002)
    print("none", flush=True)


serve() if role == "serve" else send()
