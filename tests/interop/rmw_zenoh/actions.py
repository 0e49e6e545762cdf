"""As ../actions.py, in a graph of rmw_zenoh.

actions.py serve DOMAIN NAME [silent|stubborn]  accepts goals; says feedback until the goal has as many numbers as its order
actions.py send DOMAIN NAME WAIT_S ORDER [cancel|beside]  sets a goal, and cancels it after the first feedback if told so
"""

import os
import sys
import time

from graph import Node, Reader, Writer, reply, taken, until

PACKAGE = "example_interfaces::action::dds_::Fibonacci"
FEEDBACK, STATUS = f"{PACKAGE}_FeedbackMessage_", "action_msgs::msg::dds_::GoalStatusArray_"
PARTS = {
    "send_goal": f"{PACKAGE}_SendGoal_",
    "cancel_goal": "action_msgs::srv::dds_::CancelGoal_",
    "get_result": f"{PACKAGE}_GetResult_",
}
EXECUTING, SUCCEEDED, CANCELED = 2, 4, 5
role, domain, name = sys.argv[1], int(sys.argv[2]), sys.argv[3]
words = sys.argv[4:]
node = Node(domain, f"actions_{role}")


def body(query):
    return Reader(query.payload.to_bytes())


def info(writer, goal, stamp):
    return writer.raw(goal).put("i", stamp[0]).put("I", stamp[1])


def serve():
    goals_in, cancels_in, results_in = (node.server(f"{name}/_action/{part}", of) for part, of in PARTS.items())
    # A publisher takes over the hash of its subscriber, so it comes with the first one.
    publishers = {}
    goals, asked = {}, []
    said = time.monotonic()

    def offer():
        for part, of, latched in [("feedback", FEEDBACK, False), ("status", STATUS, True)]:
            if part not in publishers and node.there("MS", f"{name}/_action/{part}", of):
                publishers[part] = node.publisher(f"{name}/_action/{part}", of, latched)

    def publish(part, payload):
        if part in publishers:
            publishers[part](payload)

    def tell():
        writer = Writer().put("I", len(goals))
        for goal, known in goals.items():
            info(writer, goal, known["stamp"]).put("b", known["status"])
        publish("status", writer.done())

    def end(goal, state):
        goals[goal]["status"] = state
        print(f"ended {state}", flush=True)
        tell()

    print("ready", flush=True)
    while True:
        offer()
        for query in taken(goals_in):
            request = body(query)
            goal, order = request.raw(16), request.get("i")
            print(f"goal {order}", flush=True)
            if "silent" in words:
                continue
            stamp = divmod(time.time_ns(), 10**9)
            goals[goal] = {"order": order, "numbers": [0, 1], "status": EXECUTING, "stamp": stamp}
            reply(query, Writer().put("?", True).put("i", stamp[0]).put("I", stamp[1]).done())
            tell()
        for query in taken(cancels_in):
            goal = body(query).raw(16)
            if goal in goals or "silent" in words:
                print("cancel", flush=True)
            code, told = 0, Writer()
            if goal not in goals:
                code = 2
            elif goals[goal]["status"] >= SUCCEEDED:
                code = 3
            elif "stubborn" in words:
                code = 1
            told.put("b", code).put("I", int(code == 0))
            if code == 0:
                info(told, goal, goals[goal]["stamp"])
            reply(query, told.done())
            if code == 0:
                end(goal, CANCELED)
        asked += taken(results_in)
        for query in list(asked):
            known = goals.get(body(query).raw(16))
            if known is None or known["status"] >= SUCCEEDED:
                state, numbers = (known["status"], known["numbers"]) if known else (0, [])
                reply(query, Writer().put("b", state).put("I", len(numbers)).put("i", *numbers).done())
                asked.remove(query)
        if time.monotonic() - said > 0.05:
            said = time.monotonic()
            for goal, known in goals.items():
                if known["status"] != EXECUTING:
                    continue
                known["numbers"].append(known["numbers"][-1] + known["numbers"][-2] & 0xFFFF)
                known["numbers"] = known["numbers"][-100:]
                known["order"] -= 1
                numbers = known["numbers"]
                publish("feedback", Writer().raw(goal).put("I", len(numbers)).put("i", *numbers).done())
                if known["order"] <= 0:
                    end(goal, SUCCEEDED)
        time.sleep(0.002)


def states_in(payload, goal):
    """The states of a goal in a message."""
    array, found = Reader(payload), set()
    for _ in range(array.get("I")):
        of = array.raw(16)
        array.get("i"), array.get("I")
        status = array.get("b")
        if of == goal:
            found.add(status)
    return found


def send():
    feedback = node.subscriber(f"{name}/_action/feedback", FEEDBACK)
    status = node.subscriber(f"{name}/_action/status", STATUS, latched=True)
    patience, order = float(words[0]), int(words[1])
    goal = os.urandom(16)
    (set_goal, goals), (cancel, cancels), (ask, results) = (
        node.client(f"{name}/_action/{part}", of) for part, of in PARTS.items()
    )
    for part, of in [("feedback", FEEDBACK), ("status", STATUS)]:
        until(lambda: node.there("MP", f"{name}/_action/{part}", of), "no server")
    print("matched", flush=True)
    set_goal(Writer().raw(goal).put("i", order).done())
    deadline = time.monotonic() + patience
    heard, states = False, set()
    while time.monotonic() < deadline:
        for _, payload in taken(goals):
            accepted = bool(Reader(payload).get("B"))
            print(f"accepted {accepted}", flush=True)
            if not accepted:
                return
            ask(Writer().raw(goal).done())
        for payload in taken(feedback):
            if Reader(payload).raw(16) != goal:
                if "beside" not in words:
                    print("feedback of another", flush=True)
            elif not heard:
                heard = True
                print("feedback", flush=True)
                if "cancel" in words:
                    cancel(info(Writer(), goal, (0, 0)).done())
        for _, payload in taken(cancels):
            answer = Reader(payload)
            print(f"cancelling {answer.get('b')} {answer.get('I')}", flush=True)
        for payload in taken(status):
            states |= states_in(payload, goal)
        for _, payload in taken(results):
            answer = Reader(payload)
            state, length = answer.get("b"), answer.get("I")
            print(f"result {state} {length}", flush=True)
            while state not in states and time.monotonic() < deadline:
                for told in taken(status):
                    states |= states_in(told, goal)
                time.sleep(0.002)
            print(f"states {sorted(states)}", flush=True)
            return
        time.sleep(0.002)
    print("none", flush=True)


serve() if role == "serve" else send()
node.leave()
