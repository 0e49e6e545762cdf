"""A call that a node has executed on a branch which the network does not have."""

from __future__ import annotations

import asyncio
import unittest
from unittest import mock

import ledgerd
from ledgerd.refusal import refusal
from network import SERVICE, Dev


class Branches(unittest.TestCase):
    network: Dev

    @classmethod
    def setUpClass(cls) -> None:
        cls.network = Dev()
        cls.network.enrol(Dev.ADMIN, "Salma", "Turtlebot4")

    @classmethod
    def tearDownClass(cls) -> None:
        cls.network.close()

    def test_a_call_on_a_branch_that_the_network_does_not_have_says_so_and_what_to_do(self) -> None:
        async def run() -> None:
            async with await ledgerd.aio.connect("Salma", home=self.network.home) as robot:
                # Its node has stopped, because a certificate of another branch contradicts it: the next node has no such transaction.
                unknown = refusal("NOT_FOUND", "the transaction is unknown to this node")
                with mock.patch.object(robot, "certified", side_effect=unknown), self.assertRaises(ledgerd.Refusal) as raised:
                    await robot.call("abac", "acquire", SERVICE.encode(), b"600000")
                found = raised.exception
                self.assertEqual((found.code, found.name), ("LGR-5009", "CONTRADICTED"))
                self.assertIn("is not part of the network's chain", found.message)
                self.assertIn("repeat calls that are still wanted", found.next)
                # A node that cannot answer now has said nothing about the branch.
                silent = refusal("UNREACHABLE", "no node answers")
                with mock.patch.object(robot, "certified", side_effect=silent):
                    done = await robot.call("abac", "release", SERVICE.encode())
                    self.assertFalse(done.certified)

        asyncio.run(run())


if __name__ == "__main__":
    unittest.main()
