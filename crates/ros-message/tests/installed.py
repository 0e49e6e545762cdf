"""Writes two messages of each type in the arguments in hexadecimal digits, as rclpy serializes them.

An argument is TYPE=DIGITS. The first message has the defaults of the type. The second one is what rclpy reads from the digits, with bytes behind
them that belong to no message.
"""

import importlib
import sys

from rclpy.serialization import deserialize_message, serialize_message

for argument in sys.argv[1:]:
    name, _, ours = argument.partition("=")
    package, kind, message = name.split("/")
    of = getattr(importlib.import_module(f"{package}.{kind}"), message)
    read = deserialize_message(bytes.fromhex(ours) + b"\x01\x02\x03\x04\x05\x06\x07\x08\x09", of)
    print(serialize_message(of()).hex(), serialize_message(read).hex())
