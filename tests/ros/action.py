"""A server or a client of a Fibonacci action with rclpy. Needs a ROS 2 with example_interfaces or test_msgs.

action.py type                               prints the type that there is
action.py serve NAME                         accepts goals; says feedback until a goal has as many numbers as its order
action.py send NAME WAIT_S ORDER [cancel]    sets a goal, and cancels it after the first feedback if told so

A server prints "ready", "goal ORDER", "cancel", "ended STATUS". A client prints "matched", "accepted BOOL", "feedback",
"cancelling CODE", "result STATUS LENGTH"; or "none" if an answer is not there after WAIT_S.
"""

import sys
import threading
import time

import rclpy
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.executors import MultiThreadedExecutor

try:
    from example_interfaces.action import Fibonacci
except ImportError:
    from test_msgs.action import Fibonacci

SUCCEEDED, CANCELED = 4, 5


def say(*words):
    print(*words, flush=True)


def serve(node, name):
    def goal_came(request):
        say("goal", request.order)
        return GoalResponse.ACCEPT

    def cancel_came(_goal):
        say("cancel")
        return CancelResponse.ACCEPT

    def execute(goal):
        numbers = [0, 1]
        while len(numbers) < goal.request.order + 2:
            if goal.is_cancel_requested:
                goal.canceled()
                say("ended", CANCELED)
                return Fibonacci.Result(sequence=numbers[:100])
            numbers.append((numbers[-1] + numbers[-2]) % 1_000_000)
            goal.publish_feedback(Fibonacci.Feedback(sequence=numbers[-2:]))
            time.sleep(0.05)
        goal.succeed()
        say("ended", SUCCEEDED)
        return Fibonacci.Result(sequence=numbers)

    # Goals run and are cancelled side by side.
    executor = MultiThreadedExecutor(4)
    executor.add_node(node)
    group = rclpy.callback_groups.ReentrantCallbackGroup()
    ActionServer(
        node, Fibonacci, name, execute, goal_callback=goal_came, cancel_callback=cancel_came, callback_group=group
    )
    say("ready")
    executor.spin()


def send(node, name, wait, order, cancels):
    client = ActionClient(node, Fibonacci, name)
    if not client.wait_for_server(timeout_sec=30):
        sys.exit(f"nobody serves {name} within 30 s")
    say("matched")
    fed = threading.Event()

    def feedback(_message):
        if not fed.is_set():
            fed.set()
            say("feedback")

    def answer(future):
        rclpy.spin_until_future_complete(node, future, timeout_sec=wait)
        if not future.done():
            say("none")
            sys.exit(0)
        return future.result()

    goal = answer(client.send_goal_async(Fibonacci.Goal(order=order), feedback_callback=feedback))
    say("accepted", goal.accepted)
    if not goal.accepted:
        return
    result = goal.get_result_async()
    if cancels:
        deadline = time.monotonic() + wait
        while not fed.is_set() and time.monotonic() < deadline:
            rclpy.spin_once(node, timeout_sec=0.1)
        say("cancelling", answer(goal.cancel_goal_async()).return_code)
    ended = answer(result)
    say("result", ended.status, len(ended.result.sequence))


def main():
    role, words = sys.argv[1], sys.argv[2:]
    if role == "type":
        say(f"{Fibonacci.__module__.split('.')[0]}/action/Fibonacci")
        return
    rclpy.init()
    node = rclpy.create_node(f"action_{role}")
    if role == "serve":
        serve(node, words[0])
    else:
        send(node, words[0], float(words[1]), int(words[2]), "cancel" in words[3:])


main()
