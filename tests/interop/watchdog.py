"""A robot with a watchdog, as tests/ros/watchdog.py, on CycloneDDS: DOMAIN TOPIC MILLISECONDS.

Prints "drive" or "stop" for each geometry_msgs/Twist, "alive" and "lost" when a publisher proves that it is alive or stops to, and
"late" for a deadline that was missed.
"""

import sys
import threading
import time

from cyclonedds.core import Listener, Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from messages import Twist

one_at_a_time = threading.Lock()


def say(line):
    """Listeners have threads of their own."""
    with one_at_a_time:
        print(line, flush=True)


class Watchdog(Listener):
    def on_liveliness_changed(self, reader, status):
        if status.alive_count_change > 0:
            say("alive")
        elif status.not_alive_count_change > 0:
            say("lost")

    def on_requested_deadline_missed(self, reader, status):
        say("late")

    def on_requested_incompatible_qos(self, reader, status):
        say("incompatible")


domain, topic, milliseconds = int(sys.argv[1]), sys.argv[2], int(sys.argv[3])
qos = Qos(
    Policy.Reliability.Reliable(duration(seconds=10)),
    Policy.History.KeepLast(100),
    Policy.Deadline(duration(milliseconds=milliseconds)),
    Policy.Liveliness.ManualByTopic(duration(milliseconds=milliseconds)),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)
participant = DomainParticipant(domain)
reader = DataReader(Subscriber(participant), Topic(participant, topic, Twist), qos=qos, listener=Watchdog())
say("ready")
while True:
    for sample in reader.take(N=100):
        if isinstance(sample, Twist):
            say("drive" if sample.linear.x else "stop")
    time.sleep(0.001)
