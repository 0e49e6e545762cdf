"""Prints the USER_DATA of the endpoints of a domain: DOMAIN [SECONDS].

One line for each endpoint, publishers first: "ROLE TOPIC USER_DATA". ROS 2 puts the hash of the type there.
"""

import sys
import time

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
from cyclonedds.core import Policy
from cyclonedds.domain import DomainParticipant

seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 30.0
participant = DomainParticipant(int(sys.argv[1]))
deadline = time.monotonic() + seconds
for role, topic in [("publisher", BuiltinTopicDcpsPublication), ("subscriber", BuiltinTopicDcpsSubscription)]:
    reader = BuiltinDataReader(participant, topic)
    seen = False
    while not seen and time.monotonic() < deadline:
        for sample in reader.take(N=100):
            data = sample.qos[Policy.Userdata] if sample.qos and Policy.Userdata in sample.qos else None
            print(role, sample.topic_name, data.data.decode() if data else "", flush=True)
            seen = seen or data is not None
        time.sleep(0.01)
