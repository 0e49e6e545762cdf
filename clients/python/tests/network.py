"""Real networks for tests: `ledgerd dev`, and three voters that may be killed. The programs are `$LEDGERD` and `$LEDGERCTL`."""

from __future__ import annotations

import json
import os
import re
import select
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Final, TypeVar

import ledgerd

# A shell that starts the tests in the background lets them, and what they start, ignore Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)

SERVICE: Final = "Turtlebot4/cmd_vel"
TWIST: Final = bytes.fromhex("00010000") + bytes(48)
# Far longer than anything here takes: reaching it means that it never happens.
PATIENCE: Final = 60.0

Found = TypeVar("Found")


def program(name: str) -> str:
    """A program of ours, as built."""
    return os.environ.get(name.upper(), name)


def eventually(what: str, look: Callable[[], Found | None]) -> Found:
    """Waits until the condition answers; fails with `what` if it never does."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        found = look()
        if found is not None:
            return found
        time.sleep(0.02)
    raise AssertionError(f"never happened: {what}")


def numbered(number: int) -> bytes:
    """A message with a number in it."""
    return bytes.fromhex("00010000") + number.to_bytes(8, "little") + bytes(40)


def number_of(payload: bytes) -> int:
    """The number in a message."""
    return int.from_bytes(payload[4:12], "little")


class Place:
    """A directory with a home for contexts, and what runs in it."""

    def __init__(self) -> None:
        self.directory = Path(tempfile.mkdtemp(prefix="ledgerd-python-"))
        self.home = self.directory / "home"
        self.processes: list[subprocess.Popen[bytes]] = []
        self.environment = {**os.environ, "LEDGERD_HOME": str(self.home), "TMPDIR": str(self.directory)}
        for variable in ("LEDGERCTL_CONTEXT", "RUST_LOG"):
            self.environment.pop(variable, None)

    def start(self, *arguments: str) -> subprocess.Popen[bytes]:
        """Starts a node; its log is a file beside it."""
        command = [program("ledgerd"), *arguments]
        with (self.directory / f"log-{len(self.processes)}").open("wb") as log:
            options: dict[str, Any] = {"cwd": self.directory, "env": self.environment, "stderr": log}
            process = subprocess.Popen(command, stdout=subprocess.PIPE, **options)
        self.processes.append(process)
        return process

    def ctl(self, context: str | None, *arguments: str) -> str:
        """Runs `ledgerctl`; it must succeed. Where nobody answers yet, it is typed again."""
        command = [program("ledgerctl"), *(["--context", context] if context else []), *arguments]

        def tried() -> str | None:
            done = subprocess.run(command, cwd=self.directory, env=self.environment, capture_output=True, check=False)
            if done.returncode == 4:
                return None
            assert done.returncode == 0, f"{command}: {done.stdout.decode()}{done.stderr.decode()}"
            return done.stdout.decode()

        return eventually(" ".join(command), tried)

    def json(self, context: str | None, *arguments: str) -> Any:
        """The same with `-o json`."""
        return json.loads(self.ctl(context, *arguments, "-o", "json"))

    def user(self, admin: str, name: str, *attributes: str, role: str = "member") -> dict[str, Any]:
        """Registers a name; the answer is what `ledgerd.enrol` wants."""
        words = [word for attribute in attributes for word in ("--attr", attribute)]
        told = self.ctl(admin, "identity", "register", name, "--role", role, *words)
        found = re.search(r"--node (\S+) --ca-fingerprint (\S+) --secret (\S+)", told)
        assert found, told
        return {"node": found[1], "ca_fingerprint": found[2], "secret": found[3]}

    def enrol(self, admin: str, name: str, *attributes: str, **options: Any) -> ledgerd.Context:
        """Registers and enrols."""
        invited: dict[str, Any] = {**self.user(admin, name, *attributes), **options}
        return ledgerd.enrol(name, home=self.home, **invited)

    def close(self) -> None:
        """Ends everything."""
        for process in self.processes:
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.kill()
            process.wait()
            if process.stdout:
                process.stdout.close()
        shutil.rmtree(self.directory, ignore_errors=True)

    def __enter__(self) -> Any:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if error is not None:
            for log in sorted(self.directory.glob("log-*")):
                print(f"--- {log.name}\n{log.read_text()[-4000:]}")
        self.close()


class Dev(Place):
    """A network of one node, with robots that exist: `ledgerd dev`."""

    ADMIN: Final = "dev-org1-admin"
    OWNER: Final = "dev-org2-admin"

    def __init__(self) -> None:
        super().__init__()
        process = self.start("dev", "--json", "--listen", "127.0.0.1:0")
        assert process.stdout
        ready, _, _ = select.select([process.stdout], [], [], PATIENCE)
        line = process.stdout.readline() if ready else b""
        assert line, (self.directory / "log-0").read_text()
        self.facts: dict[str, Any] = json.loads(line)


def free_port() -> int:
    """A port below those that the system gives to outgoing connections, so that it is still free after a kill."""
    for step in range(18_000):
        port = 12_000 + (os.getpid() * 257 + step) % 18_000
        with socket.socket() as taken:
            try:
                taken.bind(("127.0.0.1", port))
            except OSError:
                continue
            if port not in _GIVEN:
                _GIVEN.add(port)
                return port
    raise AssertionError("no free port on 127.0.0.1")


_GIVEN: set[int] = set()


class Three(Place):
    """Three voters of two organisations, as docs/cluster.md founds them, and the robots of the paper."""

    ADMIN: Final = "admin"
    OWNER: Final = "Org2-admin"
    NAMES: Final = ("a", "b", "c")

    def __init__(self) -> None:
        super().__init__()
        try:
            self.addresses = {name: f"127.0.0.1:{free_port()}" for name in self.NAMES}
            self.nodes: dict[str, subprocess.Popen[bytes]] = {}
            self._found()
        except BaseException:
            self.close()
            raise

    def run(self, name: str) -> None:
        """Starts a node, or starts it again."""
        process = self.start("run", "--config", f"{name}/ledgerd.toml")
        assert process.stdout
        process.stdout.close()
        process.stdout = None
        self.nodes[name] = process

    def kill(self, name: str) -> None:
        """`kill -9`."""
        self.nodes[name].kill()
        self.nodes[name].wait()

    def leader(self) -> str:
        """The node that leads, by those that answer."""

        def look() -> str | None:
            nodes = self.json(self.ADMIN, "network", "status")["nodes"]
            leads = [node["address"] for node in nodes if node["leader"] and node["reachable"]]
            return next((name for name, at in self.addresses.items() if at in leads), None)

        return eventually("somebody leads", look)

    def at(self, address: str | None) -> str:
        """The node at an address; the leader if it is none, or elsewhere."""
        return next((name for name, at in self.addresses.items() if at == address), None) or self.leader()

    def until_whole(self) -> None:
        """Waits until all three vote and answer."""
        eventually("three vote", lambda: self._voters() == 3 or None)

    def _typed(self, *command: str) -> str:
        done = subprocess.run(command, cwd=self.directory, env=self.environment, capture_output=True, check=False)
        text = done.stdout.decode() + done.stderr.decode()
        assert done.returncode == 0, f"{command}: {text}"
        return text

    def _found(self) -> None:
        ledger = program("ledgerd")
        config = {name: f"{name}/ledgerd.toml" for name in self.NAMES}
        a, b, c = (self.addresses[name] for name in self.NAMES)
        told = self._typed(ledger, "init", "--organisation", "Org1", "--config", config["a"], "--address", a)
        self.run("a")
        self._enroll(None, a, told)
        token = self._token(self.ctl("admin", "network", "invite", "--node", "node2"))
        self._typed(ledger, "join", token, "--config", config["b"], "--address", b)
        self.run("b")
        self.ctl("admin", "network", "promote", "Org1/node2")
        token = self._token(self.ctl("admin", "network", "invite", "--organisation", "Org2"))
        told = self._typed(ledger, "join", token, "--config", config["c"], "--address", c)
        self.run("c")
        self._enroll("Org2-admin", c, told)
        proposed = self.ctl("Org2-admin", "network", "promote", "Org2/node1")
        found = re.search(r"network approve (\S+)", proposed)
        assert found, proposed
        self.ctl("admin", "network", "approve", found[1])
        self.until_whole()
        service = {"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist", "mode": "exclusive"}
        robot = {"name": "Turtlebot4", "attribute_required": "Turtlebot4", "trusted": ["Org1", "Org2"], "services": [service]}
        self.ctl("Org2-admin", "invoke", "abac", "setup", json.dumps(robot))

    def _voters(self) -> int:
        status = self.json("admin", "network", "status")
        return int(status["voters_reachable"]) if status["voters"] == 3 else 0

    def _enroll(self, context: str | None, node: str, told: str) -> None:
        words = [re.search(rf"--{name} (\S+)", told) for name in ("ca-fingerprint", "secret")]
        assert all(words), told
        fingerprint, secret = (word[1] for word in words if word)
        self.ctl(context, "enroll", "admin", "--node", node, "--ca-fingerprint", fingerprint, "--secret", secret)

    @staticmethod
    def _token(told: str) -> str:
        found = re.search(r"ledgerd join (\S+)", told)
        assert found, told
        return found[1]
