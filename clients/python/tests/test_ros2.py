"""`ros2 ledger`, found by the entry points of the wheel as it is installed, within a ros2cli that is a fake."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import ledgerd
from network import SERVICE, Dev, eventually

HERE = Path(__file__).parent


class Ros2(unittest.TestCase):
    network: Dev
    site: tempfile.TemporaryDirectory[str]

    @classmethod
    def setUpClass(cls) -> None:
        cls.site = tempfile.TemporaryDirectory(prefix="ledgerd-site-")
        install = ["install", "--quiet", "--no-deps", "--no-build-isolation", "--disable-pip-version-check", "--no-index"]
        source = Path(cls.site.name) / "source"
        subprocess.run(["cp", "-r", str(HERE.parent), str(source)], check=True)
        subprocess.run([sys.executable, "-m", "pip", *install, "--target", cls.site.name, str(source)], check=True)
        cls.network = Dev()
        for name, attributes in (("Salma", ["Turtlebot4"]), ("Farhad", [])):
            cls.network.enrol(Dev.ADMIN, name, *attributes)

    @classmethod
    def tearDownClass(cls) -> None:
        cls.network.close()
        cls.site.cleanup()

    def start(self, *words: str) -> subprocess.Popen[bytes]:
        environment = {**self.network.environment, "PYTHONPATH": self.site.name}
        command = [sys.executable, str(HERE / "ros2cli_fake.py"), "ledger", *words]
        return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE)

    def ros2(self, *words: str) -> tuple[int, str, str]:
        child = self.start(*words)
        out, err = child.communicate(timeout=60)
        return child.returncode, out.decode(), err.decode()

    def holders(self) -> list[str]:
        with ledgerd.connect(Dev.OWNER, home=self.network.home) as owner:
            return [one["holder"] for one in owner.grants()]

    def test_the_verbs_are_found_and_say_what_they_do(self) -> None:
        status, out, err = self.ros2()
        self.assertEqual(status, 0, err)
        for verb in ("acquire", "release", "status", "stop"):
            self.assertIn(verb, out)
            self.assertEqual(self.ros2(verb, "--help")[0], 0)

    def test_a_robot_is_acquired_shown_and_released(self) -> None:
        status, out, err = self.ros2("acquire", SERVICE, "--context", "Salma", "--lease", "60")
        self.assertEqual((status, err), (0, ""))
        self.assertIn(f"{SERVICE} is acquired: epoch", out)
        status, out, _ = self.ros2("status", "--context", "Salma")
        self.assertEqual(status, 0)
        self.assertRegex(out, rf"Org1/Salma at Org1/node1 .* leader, block \d+")
        self.assertRegex(out, rf"{SERVICE} +exclusive +Org1/Salma +-")
        self.assertNotIn("Husky", self.ros2("status", "Turtlebot4", "--context", "Salma")[1])
        status, out, _ = self.ros2("release", SERVICE, "--context", "Salma")
        self.assertEqual(status, 0)
        self.assertRegex(out, rf"{SERVICE} is released; Org1/Salma held it with epoch \d+")
        self.assertEqual(self.holders(), [])

    def test_a_refusal_has_four_lines_and_the_exit_code_of_ledgerctl(self) -> None:
        status, out, err = self.ros2("acquire", SERVICE, "--context", "Farhad")
        self.assertEqual((status, out), (2, ""))
        for part in ("error: Org1/Farhad may not acquire", "[LGR-3001]", "  found ", "  wanted ", "  try "):
            self.assertIn(part, err)
        status, _, err = self.ros2("status", "--context", "Nobody")
        self.assertEqual(status, 3)
        self.assertIn("[LGR-7003]", err)

    def test_a_held_robot_is_given_back_on_ctrl_c(self) -> None:
        child = self.start("acquire", SERVICE, "--context", "Salma", "--hold", "--lease", "10")
        assert child.stdout
        child.stdout.readline()
        self.assertEqual(child.stdout.readline(), b"held until Ctrl-C\n")
        self.assertEqual(self.holders(), ["Org1/Salma"])
        child.send_signal(signal.SIGINT)
        out, err = child.communicate(timeout=60)
        self.assertEqual((child.returncode, out.decode(), err), (0, f"{SERVICE} is released\n", b""))
        self.assertEqual(self.holders(), [])

    def test_a_robot_is_stopped_by_its_owner_and_shown_so(self) -> None:
        with ledgerd.connect("Salma", home=self.network.home) as robot:
            robot.acquire(SERVICE)
            status, out, err = self.ros2("stop", "Turtlebot4", "--reason", "person in the cell", "--context", Dev.OWNER)
            self.assertEqual((status, err), (0, ""))
            self.assertIn("Turtlebot4 is stopped", out)
            self.assertIn("ended the grant of Turtlebot4/cmd_vel to Org1/Salma", out)
        self.assertRegex(self.ros2("status", "--context", "Salma")[1], rf"{SERVICE} +exclusive +- +stopped")
        self.network.ctl(Dev.OWNER, "resume", "Turtlebot4")
        self.assertEqual(self.ros2("stop", "--context", "Salma")[0], 2, "nothing to stop is named: a usage error of argparse")

    def test_nothing_else_of_the_package_needs_ros(self) -> None:
        code = "import ledgerd, sys; sys.exit(any(name.split('.')[0] in ('rclpy', 'ros2cli') for name in sys.modules))"
        environment = {**os.environ, "PYTHONPATH": self.site.name}
        subprocess.run([sys.executable, "-c", code], env=environment, check=True)
        eventually("nobody holds anything", lambda: not self.holders() or None)


if __name__ == "__main__":
    unittest.main()
