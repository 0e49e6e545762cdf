"""A server or a client of a std_srvs/srv/SetBool with rclpy. Needs a ROS 2.

service.py serve NAME                 says yes to true and no to false
service.py call NAME WAIT_S BOOL...   calls once for each value

A server prints "ready", then "request BOOL". A client prints "matched", then "SUCCESS MESSAGE" or, after WAIT_S, "none".
"""

import sys

import rclpy
from std_srvs.srv import SetBool

role, name, words = sys.argv[1], sys.argv[2], sys.argv[3:]
rclpy.init()
node = rclpy.create_node(f"service_{role}")


def serve():
    def reply(request, response):
        print(f"request {request.data}", flush=True)
        response.success, response.message = request.data, f"from {name}"
        return response

    node.create_service(SetBool, name, reply)
    print("ready", flush=True)
    rclpy.spin(node)


def call(wait, values):
    client = node.create_client(SetBool, name)
    if not client.wait_for_service(timeout_sec=30):
        sys.exit(f"nobody serves {name} within 30 s")
    print("matched", flush=True)
    for value in values:
        future = client.call_async(SetBool.Request(data=value == "true"))
        rclpy.spin_until_future_complete(node, future, timeout_sec=wait)
        reply = future.result() if future.done() else None
        print(f"{reply.success} {reply.message}" if reply else "none", flush=True)


if role == "serve":
    serve()
else:
    call(float(words[0]), words[1:])
