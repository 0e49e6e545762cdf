"""ROS 2 messages as CycloneDDS types, under the names that ROS 2 gives them on DDS."""

from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, sequence, uint8, uint32
from cyclonedds.util import duration

QOS = Qos(
    Policy.Reliability.Reliable(duration(seconds=10)),
    Policy.History.KeepAll,
    Policy.DataRepresentation(use_cdrv0_representation=True),
)


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


def message(index: int, size: int):
    """The message with this number: a Twist, or an Image with `size` bytes of data."""
    if size == 0:
        value = float(index)
        return Twist(Vector3(value, value + 0.25, -value), Vector3(value * 0.5, 0.0, value / 3.0))
    stamp = Header(Time(index, index + 1), "camera")
    return Image(stamp, 1, size, "mono8", 0, size, bytes((index + at) % 251 for at in range(size)))


def message_type(size: int):
    return Twist if size == 0 else Image
