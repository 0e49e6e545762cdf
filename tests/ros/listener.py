"""Prints linear.x of each geometry_msgs/msg/Twist that rclpy receives: TOPIC COUNT. Needs a sourced ROS 2."""

import sys

import rclpy
from geometry_msgs.msg import Twist

topic, count = sys.argv[1], int(sys.argv[2])
rclpy.init()
node = rclpy.create_node("listener")
received = 0


def take(message):
    global received
    received += 1
    print(int(message.linear.x), flush=True)


subscription = node.create_subscription(Twist, topic, take, 10)
print("ready", flush=True)
while received < count:
    rclpy.spin_once(node, timeout_sec=0.1)
