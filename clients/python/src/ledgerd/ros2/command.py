"""The command `ros2 ledger`."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import Final

from ros2cli.command import CommandExtension, add_subparsers_on_demand

from ledgerd.ros2.verbs import VERBS

_SELECTED: Final = "_verb"


class LedgerCommand(CommandExtension):  # type: ignore[misc]
    """Who may command which robot: acquire, release, status, stop."""

    def __init__(self) -> None:
        super().__init__()
        self._parser: ArgumentParser | None = None

    def add_arguments(self, parser: ArgumentParser, cli_name: str) -> None:
        """Adds the verbs, of which ros2cli loads only the one that was typed."""
        self._parser = parser
        add_subparsers_on_demand(parser, cli_name, _SELECTED, VERBS, required=False)

    def main(self, *, parser: ArgumentParser, args: Namespace) -> int:
        """Runs the verb that was typed."""
        verb = getattr(args, _SELECTED, None)
        if verb is None:
            (self._parser or parser).print_help()
            return 0
        status: int = verb.main(args=args)
        return status
