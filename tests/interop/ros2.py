"""The two commands of `ros2` that README.md uses, for a machine without ROS 2: on CycloneDDS, for geometry_msgs/msg/Twist.

ros2 topic pub [-r HZ] TOPIC TYPE YAML      publishes until it is ended
ros2 topic echo --once TOPIC TYPE           prints the first message
"""

import json
import os
import re
import sys
import time

from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic

from messages import QOS, Twist, Vector3

words = sys.argv[1:]
command, words = words[:2], words[2:]
rate = float(words.pop(words.index("-r") + 1)) if "-r" in words else 1.0
words = [word for word in words if not word.startswith("-")]
topic, kind = words[:2]
assert kind == "geometry_msgs/msg/Twist", kind
participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
topic = Topic(participant, "rt" + topic, Twist)

if command == ["topic", "pub"]:
    given = json.loads(re.sub(r"(\w+):", r'"\1":', words[2]))
    vectors = [Vector3(*(float(given.get(part, {}).get(axis, 0)) for axis in "xyz")) for part in ("linear", "angular")]
    writer = DataWriter(Publisher(participant), topic, qos=QOS)
    print("publisher: beginning loop", flush=True)
    while True:
        writer.write(Twist(*vectors))
        time.sleep(1 / rate)
elif command == ["topic", "echo"]:
    reader = DataReader(Subscriber(participant), topic, qos=QOS)
    deadline = time.monotonic() + 60
    while not (got := reader.take(N=1)):
        if time.monotonic() > deadline:
            sys.exit("nothing came within a minute")
        time.sleep(0.01)
    for name in ("linear", "angular"):
        vector = getattr(got[0], name)
        print(f"{name}:\n  x: {vector.x}\n  y: {vector.y}\n  z: {vector.z}", flush=True)
    print("---", flush=True)
else:
    sys.exit(f"not known here: {command}")
