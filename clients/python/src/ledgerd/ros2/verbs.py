"""The verbs of `ros2 ledger`. They say what `ledgerctl` says, and end with the same exit codes."""

from __future__ import annotations

import signal
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

from ros2cli.plugin_system import PLUGIN_SYSTEM_VERSION, satisfies_version

if TYPE_CHECKING:
    import ledgerd

VERBS: Final = "ledgerd.ros2.verb"
"""The group of entry points of the verbs."""


class VerbExtension:
    """The extension point of the verbs."""

    NAME: str | None = None
    EXTENSION_POINT_VERSION = "0.1"

    def __init__(self) -> None:
        satisfies_version(PLUGIN_SYSTEM_VERSION, "^0.1")

    def add_arguments(self, parser: ArgumentParser, cli_name: str) -> None:
        """Adds what every verb has: as whom it acts."""
        parser.add_argument("--context", metavar="NAME", help="use this context instead of the selected one")

    def main(self, *, args: Namespace) -> int:
        """Connects, and does it. A refusal is told in the four lines of ledgerctl."""
        # Not before: other commands of ros2 must not wait for gRPC.
        import ledgerd

        try:
            with ledgerd.connect(args.context) as client:
                for line in self.run(client, args):
                    print(line, flush=True)
        except ledgerd.Refusal as refused:
            print(refused, file=sys.stderr)
            return int(refused.kind.value)
        except KeyboardInterrupt:
            return 128 + signal.SIGINT
        return 0

    def run(self, client: ledgerd.Client, args: Namespace) -> Iterator[str]:
        """What the verb does; yields the lines that it prints."""
        raise NotImplementedError


class AcquireVerb(VerbExtension):
    """Acquire the right to use a service of a robot."""

    def add_arguments(self, parser: ArgumentParser, cli_name: str) -> None:
        """Adds the service, and how long."""
        super().add_arguments(parser, cli_name)
        parser.add_argument("service", metavar="ROBOT[/TOPIC]")
        parser.add_argument("--wait", metavar="SECONDS", type=float, default=0.0, help="wait at most this long while others hold it")
        parser.add_argument("--lease", metavar="SECONDS", type=float, help="lease: how long the grant lasts without use")
        parser.add_argument("--hold", action="store_true", help="renew it until Ctrl-C, then release it")

    def run(self, client: ledgerd.Client, args: Namespace) -> Iterator[str]:
        """Acquires it; it ends with its lease unless it is held."""
        grant = client.acquire(args.service, wait=args.wait, lease=args.lease)
        yield f"{grant.service} is acquired: epoch {grant.epoch}, for {grant.lease:g} s without use"
        if not args.hold:
            return
        with grant:
            yield "held until Ctrl-C"
            try:
                grant.wait_lost()
            except KeyboardInterrupt:
                pass
        if grant.lost is not None:
            raise grant.lost
        yield f"{grant.service} is released"


class ReleaseVerb(VerbExtension):
    """Release a service, or leave its queue."""

    def add_arguments(self, parser: ArgumentParser, cli_name: str) -> None:
        """Adds the service, and whose grant it is."""
        super().add_arguments(parser, cli_name)
        parser.add_argument("service", metavar="ROBOT[/TOPIC]")
        parser.add_argument("--holder", metavar="ORG/NAME", help="revoke the grant of this holder; for admins of its owner")

    def run(self, client: ledgerd.Client, args: Namespace) -> Iterator[str]:
        """Releases it."""
        ended = client.release(args.service, args.holder)
        if not ended:
            yield "no grant ended; if you were in the queue, you left it"
        for one in ended:
            yield f"{one['service']} is released; {one['holder']} held it with epoch {one['epoch']}"


class StatusVerb(VerbExtension):
    """Show the node, the robots and their holders."""

    def add_arguments(self, parser: ArgumentParser, cli_name: str) -> None:
        """Adds the robot, if only one is of interest."""
        super().add_arguments(parser, cli_name)
        parser.add_argument("robot", metavar="ROBOT", nargs="?")

    def run(self, client: ledgerd.Client, args: Namespace) -> Iterator[str]:
        """Tells how everything stands."""
        node = client.status()
        yield f"{client.context.id} at {node.organisation}/{node.node_name} ({client.node}), {node.role}, block {node.height}"
        found = [robot for robot in client.robots() if args.robot in (None, robot["Name"])]
        if not found:
            yield "there is no such robot" if args.robot else "there is no robot"
        yield from _table([row for robot in found for row in _rows(robot)])


class StopVerb(VerbExtension):
    """Stop a robot: its grants end, and no new ones are given until it is resumed."""

    def add_arguments(self, parser: ArgumentParser, cli_name: str) -> None:
        """Adds which robot, and why."""
        super().add_arguments(parser, cli_name)
        which = parser.add_mutually_exclusive_group(required=True)
        which.add_argument("robot", metavar="ROBOT", nargs="?")
        which.add_argument("--all", action="store_true", help="every robot for which you have this permission")
        parser.add_argument("--reason", metavar="TEXT", help="reason; visible to all members")

    def run(self, client: ledgerd.Client, args: Namespace) -> Iterator[str]:
        """Stops it."""
        done = client.stop("*" if args.all else args.robot, args.reason)
        yield from (f"{robot} is stopped" for robot in done["robots"])
        yield from (f"{robot} was stopped before" for robot in done.get("unchanged", ()))
        for grant in done.get("ended", ()):
            yield f"  ended the grant of {grant['service']} to {grant['holder']} (epoch {grant['epoch']})"


def _rows(robot: dict[str, Any]) -> Iterator[Sequence[str]]:
    state = "stopped" if robot.get("stopped") else "-"
    for service in robot["services"]:
        yield service["service"], service["mode"], ", ".join(service["holders"]) or "-", state


def _table(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    if not rows:
        return
    shown = [("SERVICE", "RULE", "HOLDER", "STATE"), *rows]
    widths = [max(len(row[column]) for row in shown) for column in range(4)]
    for row in shown:
        yield "  ".join(word.ljust(width) for word, width in zip(row, widths)).rstrip()
