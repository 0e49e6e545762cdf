"""A machine that is short of files or space for a while: connections wait for it, and clients go on afterwards."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import tempfile
import unittest
from collections.abc import Iterator
from typing import Any
from unittest import mock

import ledgerd
from network import PATIENCE, SERVICE, Dev, number_of, numbered

# What the system may refuse while a connection is made, and why.
SHORT: Any = (
    (os, "memfd_create", errno.EMFILE),
    (tempfile, "mkdtemp", errno.ENOSPC),
    (asyncio, "start_unix_server", errno.EMFILE),
)
TRIES = 2


@contextlib.contextmanager
def short(place: Any, name: str, reason: int) -> Iterator[asyncio.Event]:
    """The system refuses a call some times. The event says that it has."""
    real, tried, over = getattr(place, name), [0], asyncio.Event()

    def refused(*arguments: Any, **options: Any) -> Any:
        tried[0] += 1
        if tried[0] > TRIES:
            return real(*arguments, **options)
        if tried[0] == TRIES:
            over.set()
        raise OSError(reason, os.strerror(reason))

    with mock.patch.object(place, name, refused):
        yield over


class Shortage(unittest.TestCase):
    network: Dev

    @classmethod
    def setUpClass(cls) -> None:
        cls.network = Dev()
        cls.network.enrol(Dev.ADMIN, "Salma", "Turtlebot4")

    @classmethod
    def tearDownClass(cls) -> None:
        cls.network.close()

    def test_calls_and_streams_go_on_once_a_connection_finds_files_and_space_again(self) -> None:
        async def run() -> None:
            async with await ledgerd.aio.connect("Salma", home=self.network.home, deadline=PATIENCE) as robot:
                async with robot.acquire(SERVICE, wait=PATIENCE, lease=300) as grant:
                    stream = await robot.subscribe(SERVICE)
                    for number, (place, name, reason) in enumerate(SHORT):
                        with self.subTest(name), short(place, name, reason) as over:
                            robot._session._unwanted.set()
                            await asyncio.wait_for(over.wait(), PATIENCE)
                            await grant.publish(numbered(number), ttl=PATIENCE)
                            heard = await asyncio.wait_for(anext(stream), PATIENCE)
                            self.assertEqual(number_of(heard.payload), number)
                    await stream.aclose()

        asyncio.run(run())

    def test_whoever_connects_without_files_or_space_is_told_so(self) -> None:
        for place, name, reason in SHORT:
            with self.subTest(name), mock.patch.object(place, name, side_effect=OSError(reason, os.strerror(reason))):
                with self.assertRaises(ledgerd.Unreachable) as refused:
                    ledgerd.connect("Salma", home=self.network.home, deadline=5)
                self.assertIn(os.strerror(reason), refused.exception.found)


if __name__ == "__main__":
    unittest.main()
