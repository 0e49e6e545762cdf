"""Receives the points of tasks and prints them: DOMAIN GOAL_TOPIC PATH_TOPIC SECONDS.

Prints "goal FRAME X,Y,YAW" for a geometry_msgs/PoseStamped and "path FRAME X,Y,YAW …" for a nav_msgs/Path. It asks for
transient local durability, as a controller does that starts late. Ends with 0 after SECONDS.
"""

import math
import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, sequence
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from messages import Header


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    header: Header
    pose: Pose


@dataclass
class Path(IdlStruct, typename="nav_msgs::msg::dds_::Path_"):
    header: Header
    poses: sequence[PoseStamped]


QOS = Qos(
    Policy.Reliability.Reliable(duration(seconds=10)),
    Policy.Durability.TransientLocal,
    Policy.History.KeepLast(1),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)


def shown(stamped):
    position, turn = stamped.pose.position, stamped.pose.orientation
    yaw = 2 * math.atan2(turn.z, turn.w)
    return f"{position.x:g},{position.y:g},{yaw:.3f}"


participant = DomainParticipant(int(sys.argv[1]))
subscriber = Subscriber(participant)
goals = DataReader(subscriber, Topic(participant, sys.argv[2], PoseStamped), qos=QOS)
paths = DataReader(subscriber, Topic(participant, sys.argv[3], Path), qos=QOS)
deadline = time.monotonic() + float(sys.argv[4])
while time.monotonic() < deadline:
    for goal in goals.take(N=100):
        print("goal", goal.header.frame_id, shown(goal), flush=True)
    for path in paths.take(N=100):
        print("path", path.header.frame_id, *[shown(pose) for pose in path.poses], flush=True)
    time.sleep(0.001)
