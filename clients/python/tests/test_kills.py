"""Three voters, and `kill -9` of the leader and of the node of a client: nothing is lost, nothing comes twice."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
import unittest
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import ledgerd
from ledgerd.grant import COMMAND_TTL
from network import SERVICE, Place, Three, eventually, free_port, number_of, numbered

# Longer than an election takes on a busy machine, so that a message outlives it.
TTL = 60.0
DEADLINE = 60.0
ROUNDS = 3


class Kills(unittest.TestCase):
    network: Three

    @classmethod
    def setUpClass(cls) -> None:
        cls.network = Three()
        cls.network.enrol("admin", "Salma", "Turtlebot4", key="p256")

    @classmethod
    def tearDownClass(cls) -> None:
        cls.network.close()

    def connect(self) -> ledgerd.Client:
        return ledgerd.connect("Salma", home=self.network.home, deadline=DEADLINE)

    @contextmanager
    def nodes_die(self, client: ledgerd.Client) -> Iterator[threading.Event]:
        """Kills the leader, then the node of a client, then the leader; each starts again, and all three vote before the next
        one dies.
        """
        over = threading.Event()
        faults: list[BaseException] = []

        def die() -> None:
            try:
                for number in range(ROUNDS):
                    victim = self.network.at(client.node) if number % 2 else self.network.leader()
                    self.network.kill(victim)
                    eventually("another one leads", lambda: self.network.leader() != victim or None)
                    self.network.run(victim)
                    self.network.until_whole()
            except BaseException as fault:
                faults.append(fault)
            finally:
                over.set()

        killer = threading.Thread(target=die)
        killer.start()
        try:
            yield over
        finally:
            killer.join()
            if faults:
                raise faults[0]

    def test_every_published_message_is_executed_once_while_nodes_die(self) -> None:
        with self.connect() as robot, robot.acquire(SERVICE, wait=30, lease=300) as grant:
            published: list[ledgerd.Published] = []
            with self.nodes_die(robot) as over:
                while not over.is_set() or len(published) < 100:
                    published.append(grant.publish(numbered(len(published)), ttl=TTL))
                    time.sleep(0.002)
            last = grant.publish(numbered(len(published)), ttl=TTL)
            seen = []
            with robot.subscribe(SERVICE, from_height=published[0].height) as stream:
                for message in stream:
                    seen.append((message.height, message.seq, number_of(message.payload), message.transaction))
                    if message.transaction == last.transaction:
                        break
            wanted = [(one.height, one.seq, number, one.transaction) for number, one in enumerate([*published, last])]
            self.assertEqual(seen, wanted)

    def test_a_subscription_from_a_height_has_each_message_once_while_nodes_die(self) -> None:
        with self.connect() as reader, self.connect() as robot, robot.acquire(SERVICE, wait=30, lease=300) as grant:
            first = grant.publish(numbered(0), ttl=TTL)
            stop, sent = threading.Event(), [0]

            faults: list[BaseException] = []

            def drive() -> None:
                try:
                    while not stop.is_set():
                        grant.publish(numbered(sent[0] + 1), ttl=TTL)
                        sent[0] += 1
                        time.sleep(0.005)
                except BaseException as fault:
                    faults.append(fault)
                    # The reader waits for a message: it hears one that tells it to stop.
                    grant.publish(numbered(1 << 40), ttl=TTL)

            driver = threading.Thread(target=drive)
            with reader.subscribe(SERVICE, from_height=first.height) as stream:
                driver.start()
                try:
                    with self.nodes_die(reader) as over:
                        seen = []
                        nodes = set()
                        while not over.is_set() and not faults:
                            seen.append(number_of(next(stream).payload))
                            nodes.add(reader.node)
                finally:
                    stop.set()
                    driver.join()
                while len(seen) <= sent[0]:
                    seen.append(number_of(next(stream).payload))
            self.assertEqual(faults, [])
            self.assertEqual(seen, list(range(sent[0] + 1)))
            self.assertGreater(len(nodes - {None}), 1, "the reader never had to go elsewhere")

    def test_a_grant_outlives_the_death_of_nodes_and_is_given_back(self) -> None:
        with self.connect() as robot:
            with robot.acquire(SERVICE, wait=30, lease=20) as grant:
                before = grant.expires
                with self.nodes_die(robot) as over:
                    over.wait()
                grant.publish(numbered(0), ttl=TTL)
                self.assertIsNone(grant.lost)
                deadline = time.monotonic() + 60
                while grant.expires == before and time.monotonic() < deadline:
                    time.sleep(0.05)
                self.assertGreater(grant.expires, before)
            self.assertEqual(robot.grants(), [])



class Single(unittest.TestCase):
    """One node, killed and started again while a program drives."""

    def test_the_example_drives_on_after_its_only_node_was_killed_and_started_again(self) -> None:
        with Place() as place:
            address = f"127.0.0.1:{free_port()}"
            start = ["dev", "--json", "--data", str(place.directory / "data"), "--listen", address]

            def run() -> None:
                process = place.start(*start)
                assert process.stdout
                self.assertTrue(process.stdout.readline())

            run()
            place.enrol("dev-org1-admin", "Salma", "Turtlebot4")
            place.ctl(None, "context", "use", "Salma")
            printed = place.directory / "printed"
            example = Path(__file__).parent.parent / "examples/drive.py"
            with printed.open("wb") as out:
                driver = subprocess.Popen([sys.executable, str(example), SERVICE, "300"], env=place.environment, stdout=out, stderr=out)
            place.processes.append(driver)

            def drives(after: str) -> bool | None:
                self.assertIsNone(driver.poll(), printed.read_text())
                text = printed.read_text()
                return True if after in text and "block " in text[text.find(after) :] else None

            eventually("it drives", lambda: drives(""))
            node = place.processes[0]
            node.kill()
            node.wait()
            # Longer than a command may wait to be executed.
            time.sleep(COMMAND_TTL + 1)
            run()
            eventually("it leaves the command out that is too old, and drives on", lambda: drives("left out LGR-1006"))


if __name__ == "__main__":
    unittest.main()
