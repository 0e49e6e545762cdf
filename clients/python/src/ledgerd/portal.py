"""The way from plain programs to the event loop: one thread of the process runs it, for all clients.

A call that is interrupted (Ctrl-C) is cancelled there, and waited for: what it had begun, such as a place in line, is given back
before the program goes on to end.
"""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Coroutine
from typing import Any, Final, TypeVar

Result = TypeVar("Result")

# How long an interrupted call may take to give back what it had begun, in seconds. A second Ctrl-C ends the wait.
_CANCEL_MAX: Final = 10.0


class Portal:
    """A thread with an event loop."""

    def __init__(self) -> None:
        self._process = os.getpid()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="ledgerd", daemon=True)
        self._thread.start()

    def is_usable(self) -> bool:
        """After a fork the thread is only in the parent."""
        return self._process == os.getpid() and self._thread.is_alive()

    def run(self, work: Coroutine[Any, Any, Result]) -> Result:
        """Runs it in the loop and waits for its result."""
        if threading.get_ident() == self._thread.ident:
            work.close()
            raise RuntimeError("a plain call within the event loop of ledgerd would wait for itself: use ledgerd.aio")
        done = threading.Event()
        started: list[asyncio.Task[Result]] = []

        def start() -> None:
            task = self._loop.create_task(work)
            started.append(task)
            task.add_done_callback(lambda _: done.set())

        self._loop.call_soon_threadsafe(start)
        try:
            done.wait()
        except BaseException:
            self._loop.call_soon_threadsafe(lambda: started[0].cancel())
            done.wait(_CANCEL_MAX)
            if started and started[0].done() and not started[0].cancelled():
                # It was done already when it was to be cancelled: nobody hears of its fault.
                started[0].exception()
            raise
        return started[0].result()


class _Place:
    """Where the portal of this process is kept."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.portal: Portal | None = None


_PLACE: Final = _Place()


def portal() -> Portal:
    """The one of this process."""
    with _PLACE.lock:
        if _PLACE.portal is None or not _PLACE.portal.is_usable():
            _PLACE.portal = Portal()
        return _PLACE.portal


# A child process has neither the thread nor, perhaps, the lock as it was.
os.register_at_fork(after_in_child=_PLACE.__init__)  # type: ignore[misc]
