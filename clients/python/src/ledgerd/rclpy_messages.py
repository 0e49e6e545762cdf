"""Messages of ROS 2 as bytes and back. rclpy is imported only where an object of one of its message classes comes or is
wanted: without ROS 2 everything works with raw CDR.
"""

from __future__ import annotations

import importlib
from typing import Any

from ledgerd.refusal import refusal

_HEADER_BYTES = 4


def serialize(message: object) -> bytes:
    """A message in CDR with its header of four bytes: these bytes themselves, or an object of a message class of rclpy."""
    if isinstance(message, (bytes, bytearray, memoryview)):
        raw = bytes(message)
        if len(raw) < _HEADER_BYTES or raw[0] != 0:
            raise refusal(
                "BAD_MESSAGE",
                "the bytes are no message in CDR",
                found=f"{len(raw)} bytes that begin with {raw[:_HEADER_BYTES].hex(' ')!r}",
                wanted="CDR with its header of four bytes in front, such as 00 01 00 00 for little endian",
                next="put the header in front, or give an object of a message class of rclpy",
            )
        return raw
    if not hasattr(message, "get_fields_and_field_types"):
        raise TypeError(f"a message is bytes or an object of a message class of rclpy, not {type(message).__name__}")
    return bytes(_serialization().serialize_message(message))


def deserialize(payload: bytes, message_type: type[Any]) -> Any:
    """The message in these bytes as an object of a message class of rclpy."""
    return _serialization().deserialize_message(payload, message_type)


def _serialization() -> Any:
    try:
        return importlib.import_module("rclpy.serialization")
    except ImportError as error:
        raise ImportError("rclpy is not there: source the setup of ROS 2, such as /opt/ros/jazzy/setup.bash") from error
