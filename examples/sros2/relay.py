"""Carries what a bridge delivers into a domain that SROS2 secures. Needs a ROS 2.

A bridge takes part in no secured domain. It delivers in a domain of its own, and this node passes that on, byte for byte:

    ROS_SECURITY_ENABLE=true ROS_SECURITY_STRATEGY=Enforce ROS_SECURITY_KEYSTORE=~/sros2_keystore \\
        python3 relay.py 42 0 /cmd_vel=geometry_msgs/msg/Twist --ros-args --enclave /ledgerd_relay

listens in domain 42, without security, and publishes in domain 0 with the enclave of the relay. `ledgerctl bridge export-sros2` writes
policies by which nobody else may publish there. Nothing passes while somebody beside the bridge publishes in domain 42, or nobody does.
When that begins, and whenever somebody comes or leaves meanwhile, the relay itself says the stop message three times: the type's zeros.
"""

import importlib
import os
import sys

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.utilities import remove_ros_args

ENABLE = "ROS_SECURITY_ENABLE"
# How often the stop message is said: a subscriber may miss one.
STOPS = 3
# How often the relay looks who publishes, in seconds: somebody new need not send anything.
LOOK_EVERY = 0.05


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


class Carrier:
    """Passes a topic on as long as one node alone publishes it: the bridge. Otherwise the robot is stopped."""

    def __init__(self, listening, publishing, topic, of):
        self.listening, self.topic, self.stop = listening, topic, of()
        self.publisher = publishing.create_publisher(of, topic, 10)
        # How many publish and how many listen, and how often the stop message is still to be said.
        self.known, self.stops = None, 0
        listening.create_subscription(of, topic, self.take, 10, raw=True)
        listening.create_timer(LOOK_EVERY, self.look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def take(self, message):
        """Passes a message on, unless somebody else publishes."""
        if self.is_alone():
            self.stops = 0
            self.publisher.publish(message)

    def look(self):
        """Looks who is there, and says the stop message again if it is still to be said."""
        self.is_alone()
        self.say_stop()

    def is_alone(self):
        """Does one node alone publish? Otherwise each change stops the robot at once."""
        now = self.listening.count_publishers(self.topic), self.publisher.get_subscription_count()
        changed, self.known = now != self.known, now
        if changed and now[0] != 1:
            self.stops = STOPS
            self.say_stop()
        return now[0] == 1

    def say_stop(self):
        """Says the stop message, if it is still to be said."""
        if self.stops > 0:
            self.stops -= 1
            self.publisher.publish(self.stop)


def main():
    listened, secured, *topics = remove_ros_args(sys.argv)[1:]
    if int(listened) == int(secured) or not topics:
        sys.exit("usage: relay.py LISTENED_DOMAIN SECURED_DOMAIN TOPIC=TYPE...   with two different domains")
    security = os.environ.get(ENABLE, "false")
    publishing, _ = node_in(int(secured), "ledgerd_relay", security)
    listening, context = node_in(int(listened), "ledgerd_relay_ear", "false")
    for topic, of in (text.split("=", 1) for text in topics):
        Carrier(listening, publishing, topic, type_of(of))
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(listening)
    print("ready", flush=True)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == "__main__":
    main()
