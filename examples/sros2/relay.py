"""Carries what a bridge delivers into a domain that SROS2 secures. Needs a ROS 2.

A bridge takes part in no secured domain. It delivers in a domain of its own, and this node passes that on, byte for byte:

    ROS_SECURITY_ENABLE=true ROS_SECURITY_STRATEGY=Enforce ROS_SECURITY_KEYSTORE=~/sros2_keystore \\
        python3 relay.py 42 0 /cmd_vel=geometry_msgs/msg/Twist --ros-args --enclave /ledgerd_relay

listens in domain 42, without security, and publishes in domain 0 with the enclave of the relay. `ledgerctl bridge export-sros2` writes
policies by which nobody else may publish there. Nothing passes while somebody beside the bridge publishes in domain 42.
"""

import importlib
import os
import sys

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.utilities import remove_ros_args

ENABLE = "ROS_SECURITY_ENABLE"


def node_in(domain, name, secured):
    """A node in a domain. rcl reads the variable when a context begins."""
    os.environ[ENABLE] = secured
    context = rclpy.Context()
    rclpy.init(args=sys.argv, context=context, domain_id=domain)
    return rclpy.create_node(name, context=context), context


def type_of(name):
    """The class of a type such as geometry_msgs/msg/Twist."""
    package, kind, name = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), name)


def carry(listening, publishing, topic, of):
    """Passes a topic on as long as one node alone publishes it: the bridge."""
    publisher = publishing.create_publisher(of, topic, 10)

    def take(message):
        if listening.count_publishers(topic) == 1:
            publisher.publish(message)

    listening.create_subscription(of, topic, take, 10, raw=True)


def main():
    listened, secured, *topics = remove_ros_args(sys.argv)[1:]
    if int(listened) == int(secured) or not topics:
        sys.exit("usage: relay.py LISTENED_DOMAIN SECURED_DOMAIN TOPIC=TYPE...   with two different domains")
    security = os.environ.get(ENABLE, "false")
    publishing, _ = node_in(int(secured), "ledgerd_relay", security)
    listening, context = node_in(int(listened), "ledgerd_relay_ear", "false")
    for topic, of in (text.split("=", 1) for text in topics):
        carry(listening, publishing, topic, type_of(of))
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(listening)
    print("ready", flush=True)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == "__main__":
    main()
