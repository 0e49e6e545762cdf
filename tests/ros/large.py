"""Messages of many sizes over each kind of channel, with rclpy: SIZE...

Serves /theirs/ask (GetParameters: the request is large) and /theirs/tell (SetBool: the replies have the sizes, one after the other),
subscribes to /ours/topic and to each /ours/latched_SIZE, publishes on each /theirs/latched_SIZE. When /theirs/topic has a subscriber
it does the same from its side for each size: publishes there, calls /ours/ask and /ours/tell. Prints "ready", "CHANNEL SIZE" for what
it gets, and "done". It runs until it is ended.
"""

import sys
import threading
import time

import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from std_srvs.srv import SetBool

sizes = [int(word) for word in sys.argv[1:]]
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
rclpy.init()
node = rclpy.create_node("large")
told = iter(sizes)


def text(size):
    return "x" * size


def say(channel, received):
    assert set(received) <= {"x"}
    print(f"{channel} {len(received)}\n", end="", flush=True)


def ask(request, response):
    say("ask", request.names[0])
    return response


def tell(request, response):
    response.success, response.message = True, text(next(told) if request.data else 0)
    return response


node.create_service(GetParameters, "/theirs/ask", ask)
node.create_service(SetBool, "/theirs/tell", tell)
node.create_subscription(String, "/ours/topic", lambda message: say("topic", message.data), 10)
publishers = []
for size in sizes:
    node.create_subscription(
        String, f"/ours/latched_{size}", lambda message: say("latched", message.data), latched
    )
    publishers.append(node.create_publisher(String, f"/theirs/latched_{size}", latched))
    publishers[-1].publish(String(data=text(size)))
publisher = node.create_publisher(String, "/theirs/topic", 10)
asker, teller = node.create_client(GetParameters, "/ours/ask"), node.create_client(SetBool, "/ours/tell")
executor = SingleThreadedExecutor()
executor.add_node(node)
threading.Thread(target=executor.spin, daemon=True).start()
print("ready\n", end="", flush=True)
while publisher.get_subscription_count() == 0:
    time.sleep(0.01)


def call(client, request):
    done = threading.Event()
    assert client.wait_for_service(timeout_sec=30)
    future = client.call_async(request)
    future.add_done_callback(lambda _: done.set())
    assert done.wait(60), "no reply within a minute"
    return future.result()


for size in sizes:
    publisher.publish(String(data=text(size)))
    call(asker, GetParameters.Request(names=[text(size)]))
    say("told", call(teller, SetBool.Request(data=True)).message)
print("done\n", end="", flush=True)
while True:
    time.sleep(60)
