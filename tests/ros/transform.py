"""Waits for a static transform with tf2 and prints its translation: PARENT CHILD. Needs a sourced ROS 2."""

import sys

import rclpy
from tf2_ros import Buffer, TransformException, TransformListener

parent, child = sys.argv[1:]
rclpy.init()
node = rclpy.create_node("transform")
buffer = Buffer()
listener = TransformListener(buffer, node)
while True:
    rclpy.spin_once(node, timeout_sec=0.1)
    try:
        found = buffer.lookup_transform(parent, child, rclpy.time.Time()).transform.translation
    except TransformException:
        continue
    print(found.x, found.y, found.z, flush=True)
    break
