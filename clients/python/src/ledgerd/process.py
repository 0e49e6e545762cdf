"""gRPC does not survive a fork. A child process that goes on with the client of its parent would wait for ever, or give back
what its parent holds: it is refused instead.
"""

from __future__ import annotations

import os

from ledgerd.refusal import Refusal, refusal


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
            raise _forked(
                "this client was made by another process: a fork does not take it along",
                f"process {self._id}, which connected",
            )


class _Use:
    """The process that has used gRPC first, if one has."""

    process: int | None = None


def check_fork() -> None:
    """Refuses to use gRPC in the child of a process that has used it, also if that has closed its clients."""
    if _Use.process is None:
        _Use.process = os.getpid()
    if _Use.process != os.getpid():
        raise _forked(
            "this process was forked from one that has connected before: it cannot connect",
            f"a process that was started anew, or process {_Use.process}",
        )


def _forked(message: str, wanted: str) -> Refusal:
    found = f"process {os.getpid()}, which was forked"
    advice = 'start the other process with subprocess, or multiprocessing with "spawn", and connect there'
    return refusal("INTERNAL", message, found=found, wanted=wanted, next=advice)
