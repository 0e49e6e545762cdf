"""A client of ledgerd, the ledger that decides who commands which robot.

    import ledgerd

    with ledgerd.connect("Salma") as robot:
        with robot.acquire("Turtlebot4/cmd_vel", wait=30) as grant:
            grant.publish(twist)

`ledgerd.aio` has the same for programs with asyncio. Whatever is refused raises a `Refusal` with code, found, wanted and next.
"""

import os

# What gRPC does at a fork, which it does in spite of threads that call into it, ends the child by a segmentation fault now and then. A
# client refuses to work in a child anyhow. Must come before gRPC is imported.
os.environ.setdefault("GRPC_ENABLE_FORK_SUPPORT", "0")

from ledgerd import aio
from ledgerd.codes import CODES, Kind
from ledgerd.context import Context
from ledgerd.events import Event
from ledgerd.grant import Published
from ledgerd.in_flight import Committed
from ledgerd.plain import Client, Grant, Stream, connect, enrol
from ledgerd.refusal import Conflict, Denied, Expired, Failure, Invalid, Refusal, Unreachable
from ledgerd.senders import Message

__all__ = [
    "CODES",
    "Client",
    "Committed",
    "Conflict",
    "Context",
    "Denied",
    "Event",
    "Expired",
    "Failure",
    "Grant",
    "Invalid",
    "Kind",
    "Message",
    "Published",
    "Refusal",
    "Stream",
    "Unreachable",
    "aio",
    "connect",
    "enrol",
]
