"""Grants, messages and refusals, as a program meets them."""

from __future__ import annotations

import asyncio
import json
import os
import pickle
import re
import signal
import subprocess
import sys
import threading
import types
import unittest
from typing import Any

import ledgerd
from network import PATIENCE, SERVICE, TWIST, Dev, eventually, number_of, numbered


class Grants(unittest.TestCase):
    network: Dev

    @classmethod
    def setUpClass(cls) -> None:
        cls.network = Dev()
        for name in ("Salma", "Omar"):
            cls.network.enrol(Dev.ADMIN, name, "Turtlebot4", "Husky")
        cls.network.enrol(Dev.ADMIN, "Farhad", "Turtlebot4", key="p256")

    @classmethod
    def tearDownClass(cls) -> None:
        cls.network.close()

    def connect(self, name: str = "Salma") -> ledgerd.Client:
        return ledgerd.connect(name, home=self.network.home)

    def holders(self, service: str = SERVICE) -> list[str]:
        with self.connect("Omar") as client:
            return [one["holder"] for one in client.grants() if one["service"] == service]

    def line(self, service: str) -> list[dict[str, Any]]:
        """Those who wait for a service."""
        found: list[dict[str, Any]] = self.network.json("Salma", "queue", service)["line"]
        return found

    def test_a_grant_is_renewed_in_the_background_and_released_at_the_end(self) -> None:
        with self.connect() as robot:
            with robot.acquire(SERVICE, lease=6) as grant:
                first = grant.expires
                eventually("it is renewed twice", lambda: grant.expires > first + 4_000_000 or None)
                grant.publish(TWIST)
                self.assertEqual(self.holders(), ["Org1/Salma"])
            self.assertEqual(self.holders(), [])

    def test_a_grant_is_released_when_the_program_fails_within_it(self) -> None:
        with self.connect() as robot:
            with self.assertRaises(ZeroDivisionError), robot.acquire(SERVICE):
                self.assertTrue(1 / 0)
            self.assertEqual(self.holders(), [])

    def test_a_refusal_has_the_facts_that_ledgerctl_shows(self) -> None:
        command = [os.environ["LEDGERCTL"], "--context", "Farhad", "acquire", "Husky", "-o", "json"]
        shown = subprocess.run(command, env=self.network.environment, capture_output=True, check=False)
        report = json.loads(shown.stderr)
        with self.connect("Farhad") as robot, self.assertRaises(ledgerd.Denied) as refused:
            robot.acquire("Husky")
        found = refused.exception
        facts = {name: getattr(found, name) for name in ("code", "name", "message", "found", "wanted")}
        self.assertEqual(facts | {"try": found.next}, report)
        self.assertEqual(found.kind.value, shown.returncode)
        text = subprocess.run(command[:-2], env=self.network.environment, capture_output=True, check=False).stderr
        self.assertEqual(str(found), text.decode().rstrip("\n"))
        self.assertEqual(str(pickle.loads(pickle.dumps(found))), str(found))

    def test_a_refusal_of_a_whole_call_has_them_too(self) -> None:
        with self.connect("Farhad") as robot, robot.subscribe("Husky/cmd_vel") as stream:
            with self.assertRaises(ledgerd.Denied) as refused:
                next(stream)
        self.assertEqual(refused.exception.name, "MISSING_ATTRIBUTE")
        self.assertIn("Husky=true", refused.exception.wanted)

    def test_whoever_waits_gets_a_service_without_a_line_when_it_is_free(self) -> None:
        with self.connect() as robot, self.connect("Omar") as other:
            grant = robot.acquire(SERVICE)
            with self.assertRaises(ledgerd.Conflict) as refused:
                other.acquire(SERVICE)
            self.assertEqual(refused.exception.name, "HELD")
            with self.assertRaises(ledgerd.Conflict):
                other.acquire(SERVICE, wait=0.3)
            threading.Timer(0.2, grant.release).start()
            with other.acquire(SERVICE, wait=PATIENCE) as theirs:
                self.assertEqual((theirs.holder, self.holders()), ("Org1/Omar", ["Org1/Omar"]))

    def test_whoever_waits_in_line_gets_its_turn_or_leaves_the_line(self) -> None:
        self.network.ctl(Dev.OWNER, "robot", "set", "Husky/cmd_vel", "on-conflict=queue")
        with self.connect() as robot, self.connect("Omar") as other:
            grant = robot.acquire("Husky/cmd_vel")
            with self.assertRaises(ledgerd.Conflict) as refused:
                other.acquire("Husky/cmd_vel", wait=0.4)
            self.assertIn("your whole waiting time", refused.exception.message)
            self.assertEqual(self.line("Husky/cmd_vel"), [])

            async def gives_up() -> None:
                async with await ledgerd.aio.connect("Omar", home=self.network.home) as client:
                    waiting = asyncio.ensure_future(_held(client))
                    while not await asyncio.to_thread(self.line, "Husky/cmd_vel"):
                        await asyncio.sleep(0.02)
                    waiting.cancel()
                    with self.assertRaises(asyncio.CancelledError):
                        await waiting

            async def _held(client: ledgerd.aio.Client) -> Any:
                return await client.acquire("Husky/cmd_vel", wait=PATIENCE)

            asyncio.run(gives_up())
            self.assertEqual(self.line("Husky/cmd_vel"), [], "whoever gave up has left the line")

            def hand_over() -> None:
                eventually("one waits", lambda: self.line("Husky/cmd_vel") or None)
                grant.release()

            release = threading.Thread(target=hand_over)
            release.start()
            with other.acquire("Husky/cmd_vel", wait=PATIENCE) as theirs:
                theirs.publish(TWIST)
            release.join()

    def test_a_lost_grant_says_why_and_nothing_is_published_under_it(self) -> None:
        with self.connect() as robot:
            with robot.acquire(SERVICE, lease=10) as grant:
                self.network.ctl(Dev.OWNER, "release", SERVICE, "--holder", "Org1/Salma")
                lost = grant.wait_lost()
                assert lost is not None
                self.assertEqual((lost.name, grant.lost), ("NOT_HOLDER", lost))
                with self.assertRaises(ledgerd.Denied):
                    grant.publish(TWIST)

    def test_a_later_grant_of_the_same_identity_is_left_alone_at_the_end_of_an_earlier_one(self) -> None:
        with self.connect() as robot, self.connect() as again:
            with robot.acquire(SERVICE, lease=60) as earlier:
                self.network.ctl(Dev.OWNER, "release", SERVICE, "--holder", "Org1/Salma")
                later = again.acquire(SERVICE)
                self.assertEqual((earlier.lost, later.epoch), (None, earlier.epoch + 1))
            self.assertEqual(self.holders(), ["Org1/Salma"])
            later.release()
            self.assertEqual(self.holders(), [])

    def test_messages_come_in_order_from_any_height_with_their_senders(self) -> None:
        with self.connect() as robot, robot.acquire(SERVICE) as grant:
            one = grant.publish(numbered(1))
            two = grant.publish(numbered(2), numbered(3))
            with self.connect("Farhad") as reader, reader.subscribe(SERVICE, from_height=one.height) as stream:
                seen = [next(stream) for _ in range(3)]
                self.assertEqual([number_of(message.payload) for message in seen], [1, 2, 3])
                self.assertEqual([message.seq for message in seen], [one.seq, two.seq, two.seq + 1])
                self.assertEqual({(message.sender, message.epoch) for message in seen}, {("Org1/Salma", grant.epoch)})
                self.assertEqual(stream.next_height, two.height + 1)
            with self.connect("Farhad") as reader, reader.subscribe(SERVICE, from_height=two.height) as stream:
                self.assertEqual((number_of(next(stream).payload), stream.next_height), (2, two.height))
            with self.connect("Farhad") as reader, reader.subscribe(SERVICE) as stream:
                grant.publish(numbered(4))
                self.assertEqual(number_of(next(stream).payload), 4)

    def test_a_confidential_service_is_none_for_a_client_that_does_not_encrypt(self) -> None:
        self.network.ctl(Dev.OWNER, "robot", "set", SERVICE, "confidential=true")
        try:
            with self.connect() as robot, robot.acquire(SERVICE) as grant, self.connect("Farhad") as reader:
                with self.assertRaises(ledgerd.Invalid) as plain:
                    grant.publish(TWIST)
                self.assertEqual(plain.exception.name, "BAD_ARGUMENT")
                with reader.subscribe(SERVICE) as stream:
                    self.network.ctl("Salma", "publish", SERVICE, "{}")
                    with self.assertRaises(ledgerd.Invalid) as sealed:
                        next(stream)
                self.assertEqual(sealed.exception.name, "BAD_MESSAGE")
        finally:
            self.network.ctl(Dev.OWNER, "robot", "set", SERVICE, "confidential=default")

    def test_events_tell_grants_and_releases(self) -> None:
        with self.connect("Omar") as reader, reader.events(SERVICE, names=["granted", "released"]) as stream:
            with self.connect() as robot, robot.acquire(SERVICE) as grant:
                told = next(stream)
                self.assertEqual((told.name, json.loads(told.payload)["epoch"]), ("granted", grant.epoch))
            self.assertEqual(next(stream).name, "released")

    def test_a_span_that_is_no_number_of_seconds_is_rejected(self) -> None:
        spans: list[Any] = ["10m", "10", None, float("nan"), float("inf"), -1.0, True]
        with self.connect() as client:
            for span in spans:
                if span is not None:
                    with self.assertRaisesRegex(ValueError, "lease is not usable: .*, wanted a number of seconds"):
                        client.acquire(SERVICE, lease=span)
                with self.assertRaisesRegex(ValueError, "wait is not usable: .*, wanted a number of seconds"):
                    client.acquire(SERVICE, wait=span)

    def test_an_open_service_needs_no_grant(self) -> None:
        self.network.ctl(Dev.OWNER, "robot", "set", "Husky/cmd_vel", "on-conflict=default", "mode=open")
        with self.connect() as robot, robot.subscribe("Husky/cmd_vel") as stream:
            robot.publish("Husky/cmd_vel", numbered(7))
            self.assertEqual(number_of(next(stream).payload), 7)
        self.network.ctl(Dev.OWNER, "robot", "set", "Husky/cmd_vel", "mode=exclusive")

    def test_a_robot_is_stopped_and_resumed_by_whoever_may(self) -> None:
        with self.connect() as robot, self.connect(Dev.OWNER) as owner:
            grant = robot.acquire(SERVICE)
            done = owner.stop("Turtlebot4", "person in the cell")
            self.assertEqual((done["robots"], done["ended"][0]["holder"]), (["Turtlebot4"], "Org1/Salma"))
            with self.assertRaises(ledgerd.Refusal):
                grant.publish(TWIST)
            with self.assertRaises(ledgerd.Conflict) as refused:
                robot.acquire(SERVICE)
            self.assertEqual(refused.exception.name, "STOPPED")
            with self.assertRaises(ledgerd.Denied):
                robot.stop("Turtlebot4")
            owner.resume("Turtlebot4")
            robot.acquire(SERVICE).release()

    def test_bytes_that_are_no_message_are_refused_here(self) -> None:
        with self.connect() as robot, robot.acquire(SERVICE) as grant:
            for wrong in (b"", b"\0\1", b"\1\0\0\0abcd"):
                with self.assertRaises(ledgerd.Invalid) as refused:
                    grant.publish(wrong)
                self.assertEqual(refused.exception.name, "BAD_MESSAGE")
            with self.assertRaises(TypeError):
                grant.publish("a text")
            with self.assertRaises(ledgerd.Invalid):
                grant.publish()

    def test_messages_of_rclpy_are_serialized_by_rclpy(self) -> None:
        class Twist:
            def __init__(self, raw: bytes) -> None:
                self.raw = raw

            @classmethod
            def get_fields_and_field_types(cls) -> dict[str, str]:
                return {}

        with self.connect() as robot, robot.acquire(SERVICE) as grant, robot.subscribe(SERVICE) as stream:
            with self.assertRaises(ImportError):
                grant.publish(Twist(TWIST))
            fake: Any = types.ModuleType("rclpy.serialization")
            fake.serialize_message = lambda message: message.raw
            fake.deserialize_message = lambda payload, kind: kind(payload)
            sys.modules["rclpy"], sys.modules["rclpy.serialization"] = types.ModuleType("rclpy"), fake
            try:
                grant.publish(Twist(numbered(9)))
                self.assertEqual(number_of(next(stream).decode(Twist).raw), 9)
            finally:
                del sys.modules["rclpy"], sys.modules["rclpy.serialization"]

    def test_asyncio_and_plain_programs_do_the_same_at_once(self) -> None:
        async def run() -> None:
            async with await ledgerd.aio.connect("Salma", home=self.network.home) as robot:
                async with robot.acquire(SERVICE, wait=PATIENCE) as grant:
                    stream = await robot.subscribe(SERVICE)
                    sent = await asyncio.gather(*(grant.publish(numbered(number)) for number in range(50)))
                    self.assertEqual([one.seq for one in sent], sorted(one.seq for one in sent))
                    seen = [number_of((await anext(stream)).payload) for _ in range(50)]
                    self.assertEqual(seen, list(range(50)))
                    await stream.aclose()
                    with self.assertRaises(ledgerd.Conflict):
                        await asyncio.to_thread(self.connect("Omar").acquire, SERVICE)
                self.assertEqual(await robot.grants(), [])

        asyncio.run(run())

    def test_a_wait_for_a_message_can_be_given_up_without_losing_one(self) -> None:
        async def run() -> None:
            async with await ledgerd.aio.connect("Salma", home=self.network.home) as robot:
                async with robot.acquire(SERVICE, wait=PATIENCE) as grant:
                    stream = await robot.subscribe(SERVICE)
                    seen = []
                    for number in range(20):
                        with self.assertRaises(asyncio.TimeoutError):
                            await asyncio.wait_for(anext(stream), 0.001 * (number % 4))
                        await grant.publish(numbered(number))
                        seen.append(number_of((await anext(stream)).payload))
                    self.assertEqual(seen, list(range(20)))
                    await stream.aclose()

        asyncio.run(run())

    def test_threads_share_a_client(self) -> None:
        with self.connect() as robot, robot.acquire(SERVICE) as grant, robot.subscribe(SERVICE) as stream:
            sent: list[int] = []
            threads = [
                threading.Thread(target=lambda: sent.extend(grant.publish(TWIST).seq for _ in range(25))) for _ in range(8)
            ]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            self.assertEqual(len(set(sent)), 200)
            self.assertEqual([next(stream).seq for _ in range(200)], sorted(sent))

    def test_ctrl_c_within_a_grant_gives_the_robot_back(self) -> None:
        for script in (
            "with robot.acquire(S) as grant:\n    print('ready', flush=True)\n    time.sleep(60)",
            "with robot.acquire(S) as grant, robot.subscribe(S) as stream:\n    print('ready', flush=True)\n    next(stream)",
        ):
            child = self.child(script)
            self.assertEqual(self.holders(), ["Org1/Salma"])
            child.send_signal(signal.SIGINT)
            _, said = child.communicate(timeout=PATIENCE)
            self.assertIn(b"KeyboardInterrupt", said)
            self.assertEqual(self.holders(), [])

    def test_ctrl_c_within_a_wait_leaves_the_line(self) -> None:
        self.network.ctl(Dev.OWNER, "robot", "set", SERVICE, "on-conflict=queue")
        with self.connect("Omar") as other, other.acquire(SERVICE):
            child = self.child("print('ready', flush=True)\nrobot.acquire(S, wait=60)")
            eventually("it is in line", lambda: self.line(SERVICE) or None)
            child.send_signal(signal.SIGINT)
            _, said = child.communicate(timeout=PATIENCE)
            self.assertIn(b"KeyboardInterrupt", said)
            self.assertEqual(self.line(SERVICE), [])
        self.network.ctl(Dev.OWNER, "robot", "set", SERVICE, "on-conflict=default")

    def test_a_fork_is_refused_and_leaves_the_grant_of_its_parent_alone(self) -> None:
        script = """
import os
with robot.acquire(S) as grant:
    child = os.fork()
    if child == 0:
        try:
            grant.publish(bytes(52))
        except ledgerd.Refusal as refused:
            print(refused.message, flush=True)
    else:
        os.waitpid(child, 0)
        grant.publish(bytes.fromhex('00010000') + bytes(48))
        print('still held:', grant.lost is None and len(robot.grants()) == 1, flush=True)
        print('ready', flush=True)
        os.read(0, 1)
"""
        child = self.child(script, ["this client was made by another process: a fork does not take it along", "still held: True"])
        child.communicate(b"x", timeout=PATIENCE)
        self.assertEqual(child.returncode, 0)

    def test_a_fork_after_the_client_was_closed_says_so(self) -> None:
        script = """
import os
robot.close()
child = os.fork()
if child == 0:
    try:
        ledgerd.connect('Salma')
    except ledgerd.Refusal as refused:
        print(refused.message, flush=True)
else:
    os.waitpid(child, 0)
    with ledgerd.connect('Salma') as again:
        print('connects again:', len(again.robots()) > 0, flush=True)
    print('ready', flush=True)
    os.read(0, 1)
"""
        wanted = ["this process was forked from one that has connected before: it cannot connect", "connects again: True"]
        child = self.child(script, wanted)
        child.communicate(b"x", timeout=PATIENCE)
        self.assertEqual(child.returncode, 0)

    def child(self, script: str, before: list[str] | None = None) -> subprocess.Popen[bytes]:
        """A program that has connected, and has printed `ready`."""
        head = f"import ledgerd, time\nS = {SERVICE!r}\nrobot = ledgerd.connect('Salma')\n"
        pipe = subprocess.PIPE
        command = [sys.executable, "-c", head + script]
        child = subprocess.Popen(command, env=self.network.environment, stdin=pipe, stdout=pipe, stderr=pipe)
        assert child.stdout
        for line in [*(before or []), "ready"]:
            told = child.stdout.readline().decode().strip()
            self.assertEqual(told, line, told or child.communicate()[1].decode())
        return child

    def test_a_program_that_ends_without_closing_anything_ends_and_says_nothing(self) -> None:
        plain = "import ledgerd; one = ledgerd.connect('Salma'); grant = one.acquire('Turtlebot4/cmd_vel', lease=3)"
        listening = "\nimport threading; stream = one.subscribe('Turtlebot4/cmd_vel')"
        thread = "\nthreading.Thread(target=lambda: next(stream), daemon=True).start()"
        within = "import asyncio, ledgerd\nasync def main():\n    one = await ledgerd.aio.connect('Salma')\nasyncio.run(main())"
        for program in (plain, plain + listening + thread, within):
            eventually("nobody holds it", lambda: not self.holders() or None)
            command = [sys.executable, "-c", program]
            done = subprocess.run(command, env=self.network.environment, capture_output=True, timeout=PATIENCE, check=False)
            self.assertEqual((done.returncode, done.stderr), (0, b""))
        eventually("nobody holds it", lambda: not self.holders() or None)

    def test_a_closed_client_refuses_and_does_not_wait(self) -> None:
        robot = self.connect()
        robot.close()
        with self.assertRaises(ledgerd.Refusal):
            robot.acquire(SERVICE)
        with self.assertRaises(ledgerd.Refusal):
            robot.robots()
        robot.close()

    def test_the_codes_are_those_of_the_paragraphs_of_errors(self) -> None:
        told = subprocess.run([os.environ["LEDGERCTL"], "explain", "LGR-3005"], capture_output=True, check=True).stdout.decode()
        self.assertTrue(re.search(rf"\b{ledgerd.CODES[3005][0]}\b", told), told)


if __name__ == "__main__":
    unittest.main()
