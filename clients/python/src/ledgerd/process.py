"""gRPC does not survive a fork. A child process that goes on with the client of its parent would wait for ever, or give back
what its parent holds: it is refused instead.
"""

from __future__ import annotations

import os

from ledgerd.refusal import refusal


class Process:
    """The process in which something was made."""

    def __init__(self) -> None:
        self._id = os.getpid()

    def is_ours(self) -> bool:
        """Is it this one?"""
        return os.getpid() == self._id

    def check(self) -> None:
        """Refuses what a child process would do with its parent's client."""
        if not self.is_ours():
            raise refusal(
                "INTERNAL",
                "this client was made by another process: a fork does not take it along",
                found=f"process {os.getpid()}",
                wanted=f"process {self._id}, which connected",
                next='start the other process with subprocess, or multiprocessing with "spawn", and connect there',
            )
