"""Reads and writes messages as CycloneDDS does: TYPE=HEX...

For each argument, CDR with its header, prints two lines: the fields as JSON, and the message written again as hex.
"""

import json
import sys
from dataclasses import asdict, dataclass

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int32, sequence, uint8, uint64

from messages import Header, Image, Twist, Vector3


@dataclass
class TwistStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TwistStamped_"):
    header: Header
    twist: Twist


@dataclass
class Joy(IdlStruct, typename="sensor_msgs::msg::dds_::Joy_"):
    header: Header
    axes: sequence[float32]
    buttons: sequence[int32]


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Imu(IdlStruct, typename="sensor_msgs::msg::dds_::Imu_"):
    header: Header
    orientation: Quaternion
    orientation_covariance: array[float64, 9]
    angular_velocity: Vector3
    angular_velocity_covariance: array[float64, 9]
    linear_acceleration: Vector3
    linear_acceleration_covariance: array[float64, 9]


@dataclass
class KeyValue(IdlStruct, typename="diagnostic_msgs::msg::dds_::KeyValue_"):
    key: str
    value: str


@dataclass
class DiagnosticStatus(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticStatus_"):
    level: uint8
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]


@dataclass
class DiagnosticArray(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticArray_"):
    header: Header
    status: sequence[DiagnosticStatus]


@dataclass
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str


@dataclass
class UInt64(IdlStruct, typename="std_msgs::msg::dds_::UInt64_"):
    data: uint64


TYPES = {
    f"{package}/msg/{kind.__name__}": kind
    for package, kinds in {
        "geometry_msgs": [Twist, TwistStamped],
        "sensor_msgs": [Joy, Imu, Image],
        "diagnostic_msgs": [DiagnosticArray],
        "std_msgs": [String, UInt64],
    }.items()
    for kind in kinds
}


def plain(value):
    """Sequences of bytes may come as bytes."""
    return list(value) if isinstance(value, (bytes, bytearray)) else value


for argument in sys.argv[1:]:
    name, text = argument.split("=")
    message = TYPES[name].deserialize(bytes.fromhex(text))
    print(json.dumps(asdict(message), default=plain), flush=True)
    print(message.serialize(use_version_2=False).hex(), flush=True)
