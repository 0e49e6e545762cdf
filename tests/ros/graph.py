"""Prints what `ros2 node` and `ros2 topic` show of a node, from the same functions of rclpy. Needs a ROS 2.

graph.py NODE TOPIC

Prints "node NAME", then for each topic of it "publishes TOPIC TYPE" or "subscribes TOPIC TYPE", then for each publisher on TOPIC
"publisher NODE HASH RELIABILITY DURABILITY".
"""

import sys
import time

import rclpy

wanted, topic = sys.argv[1:]
rclpy.init()
node = rclpy.create_node("graph")
deadline = time.monotonic() + 30
while wanted not in node.get_node_names() or not node.get_publishers_info_by_topic(topic):
    if time.monotonic() > deadline:
        sys.exit(f"{wanted} and a publisher on {topic} are not found within 30 s: {node.get_node_names()}")
    time.sleep(0.1)
print("node", wanted, flush=True)
for name, types in sorted(node.get_publisher_names_and_types_by_node(wanted, "/")):
    print("publishes", name, *types, flush=True)
for name, types in sorted(node.get_subscriber_names_and_types_by_node(wanted, "/")):
    print("subscribes", name, *types, flush=True)
for end in node.get_publishers_info_by_topic(topic):
    profile = end.qos_profile
    print("publisher", end.node_name, end.topic_type_hash, profile.reliability.name, profile.durability.name, flush=True)
