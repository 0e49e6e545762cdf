"""Publishes geometry_msgs/msg/Twist with rclpy, numbered in linear.x: TOPIC COUNT RATE_HZ. Needs a sourced ROS 2."""

import sys
import time

import rclpy
from geometry_msgs.msg import Twist

topic, count, rate = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
rclpy.init()
node = rclpy.create_node("talker")
publisher = node.create_publisher(Twist, topic, 10)
deadline = time.monotonic() + 30
while publisher.get_subscription_count() == 0:
    if time.monotonic() > deadline:
        sys.exit(f"no subscriber of {topic} within 30 s")
    time.sleep(0.01)
print("matched", flush=True)
for number in range(count):
    message = Twist()
    message.linear.x = float(number)
    publisher.publish(message)
    time.sleep(1 / rate)
# It stays until its subscriber has everything, or the test ends it.
time.sleep(30)
