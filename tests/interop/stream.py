"""The other side in tests: CycloneDDS, the DDS of rmw_cyclonedds, with samples that are serialized here.

stream.py pub DOMAIN TOPIC COUNT RATE_HZ SIZE [best_effort|transient_local|keep_all]...
    Waits for a reader, prints "matched", then publishes COUNT samples.
stream.py sub DOMAIN TOPIC COUNT SECONDS SIZE [best_effort|transient_local|keep_all|until_left]...
    Prints "ready", "matched" when a writer is found, then for each sample its number and how long it was under way, in
    microseconds. Ends with 0 after COUNT samples, and with 3 after SECONDS; COUNT 0 receives until then. With
    "until_left" it prints "left" and ends with 0 as soon as no writer is there any more.

SIZE 0 is geometry_msgs/msg/Twist, more is sensor_msgs/msg/Image with so many bytes of data. The number stands in the time
stamp of an image, and in the first value of a Twist, divided by 2 to the power of 10. The time of publishing (nanoseconds of
the monotonic clock) stands in the first data of an image, and in the second value of a Twist, divided by 2 to the power of 60. The rest of the data is the number modulo 251. A transient-local
publisher does not wait for a reader, and stays for 30 s. QoS is as ROS 2 has it by default, reliable and the last 10 samples.
"""

import math
import struct
import sys
import time

from cyclonedds.core import Policy, Qos, ReadCondition, SampleState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from messages import Header, Image, Time, message_type

# Where the data of an image begin.
DATA = 52


class Raw:
    """The serialized sample as it came."""

    def __init__(self, data):
        self.data = bytes(data)


def quality(words):
    return Qos(
        Policy.Reliability.BestEffort if "best_effort" in words else Policy.Reliability.Reliable(duration(seconds=10)),
        Policy.Durability.TransientLocal if "transient_local" in words else Policy.Durability.Volatile,
        Policy.History.KeepAll if "keep_all" in words else Policy.History.KeepLast(10),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )


def scaled(number, sent):
    """As speeds that a gate lets pass, without loss."""
    return math.ldexp(number, -10), math.ldexp(sent, -60)


def unscaled(first, second):
    return int(math.ldexp(first, 10)), int(math.ldexp(second, 60))


def serialized(number, size, head):
    if size == 0:
        return struct.pack("<4x6d", *scaled(number, time.monotonic_ns()), 0, 0, 0, 0).replace(b"\0\0\0\0", b"\0\1\0\0", 1)
    rest = bytes([number % 251]) * (size - 8)
    return head[:4] + struct.pack("<I", number) + head[8:] + struct.pack("<q", time.monotonic_ns()) + rest


def is_whole(data, number, size):
    if size == 0:
        return len(data) == 52
    return data[DATA + 8 : DATA + size] == bytes([number % 251]) * (size - 8)


def publish(domain, topic, count, rate, size, *words):
    count, rate, size = int(count), float(rate), int(size)
    kind = message_type(size)
    participant = DomainParticipant(int(domain))
    writer = DataWriter(Publisher(participant), Topic(participant, topic, kind), qos=quality(words))
    latched = "transient_local" in words
    deadline = time.monotonic() + 30
    while not latched and not writer.get_matched_subscriptions():
        if time.monotonic() > deadline:
            sys.exit(f"no reader of {topic} in domain {domain} within 30 s")
        time.sleep(0.01)
    print("matched", flush=True)
    image = Image(Header(Time(0, 0), "camera"), 1, size, "mono8", 0, size, bytes(size))
    head = image.serialize(use_version_2=False)[:DATA]
    any_sample = object.__new__(kind)
    start = time.monotonic()
    for number in range(count):
        pause = start + number / rate - time.monotonic()
        if pause > 0:
            time.sleep(pause)
        sample = serialized(number, size, head)
        any_sample.serialize = lambda sample=sample, **_: sample
        writer.write(any_sample)
    if latched:
        time.sleep(max(0, deadline - time.monotonic()))
    elif "best_effort" not in words and not writer.wait_for_acks(duration(seconds=20)):
        sys.exit("not all samples were acknowledged within 20 s")


def subscribe(domain, topic, count, seconds, size, *words):
    count, size = int(count), int(size)
    kind = message_type(size)
    kind.deserialize = classmethod(lambda cls, data, has_header=True, use_version_2=None: Raw(data))
    participant = DomainParticipant(int(domain))
    reader = DataReader(Subscriber(participant), Topic(participant, topic, kind), qos=quality(words))
    news = WaitSet(participant)
    news.attach(ReadCondition(reader, SampleState.NotRead))
    print("ready", flush=True)
    deadline, received, matched = time.monotonic() + float(seconds), 0, False
    while count == 0 or received < count:
        if time.monotonic() > deadline:
            sys.exit(0 if count == 0 else 3)
        # A sample may be there before DDS says that its writer is.
        samples = reader.take(N=10)
        if not matched and (samples or reader.get_matched_publications()):
            matched = True
            print("matched", flush=True)
        if matched and "until_left" in words and not reader.get_matched_publications():
            print("left", flush=True)
            return
        if not samples:
            news.wait(duration(milliseconds=100 if matched else 10))
        for sample in samples:
            if not isinstance(sample, Raw):
                continue
            now = time.monotonic_ns()
            if size == 0:
                number, sent = unscaled(*struct.unpack_from("<2d", sample.data, 4))
            else:
                (number,), (sent,) = struct.unpack_from("<I", sample.data, 4), struct.unpack_from("<q", sample.data, DATA)
            if not is_whole(sample.data, number, size):
                sys.exit(f"sample {number} is damaged")
            received += 1
            print(number, (now - sent) // 1000, flush=True)


{"pub": publish, "sub": subscribe}[sys.argv[1]](*sys.argv[2:])
