"""A robot with a watchdog: its subscription of geometry_msgs/msg/Twist requests a deadline and a liveliness. TOPIC MILLISECONDS.

Prints "drive" or "stop" for each message, "alive" and "lost" when a publisher proves that it is alive or stops to, and "late" for a
deadline that was missed. Needs rclpy.
"""

import sys

import rclpy
from geometry_msgs.msg import Twist
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import LivelinessPolicy, QoSProfile, ReliabilityPolicy

topic, milliseconds = sys.argv[1], int(sys.argv[2])
rclpy.init()
node = rclpy.create_node("watchdog")
lease = Duration(nanoseconds=milliseconds * 1_000_000)
qos = QoSProfile(
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    deadline=lease,
    liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
    liveliness_lease_duration=lease,
)


def changed(event):
    if event.alive_count_change > 0:
        print("alive", flush=True)
    elif event.not_alive_count_change > 0:
        print("lost", flush=True)


events = SubscriptionEventCallbacks(
    liveliness=changed,
    deadline=lambda event: print("late", flush=True),
    incompatible_qos=lambda event: print("incompatible", flush=True),
)
subscription = node.create_subscription(
    Twist,
    topic,
    lambda message: print("drive" if message.linear.x else "stop", flush=True),
    qos,
    event_callbacks=events,
)
print("ready", flush=True)
while True:
    rclpy.spin_once(node, timeout_sec=0.1)
