"""The parts of ros2cli that `ros2 ledger` is made of, as the `ros2` of Humble and Jazzy has them: ROS 2 is not where these tests
run. Extensions are found by the entry points of the installed package, one verb is loaded at a time, and `main` ends with its status.
"""

from __future__ import annotations

import argparse
import sys
import types
from importlib.metadata import EntryPoint, entry_points
from typing import Any


class PluginException(Exception):
    """An extension that does not fit."""


def satisfies_version(version: str, caret_range: str) -> None:
    """Refuses another version than that of the range."""
    if caret_range != "^" + version:
        raise PluginException(f"{version} is not in {caret_range}")


class CommandExtension:
    """The extension point of commands."""

    NAME = None
    EXTENSION_POINT_VERSION = "0.1"

    def __init__(self) -> None:
        super().__init__()
        satisfies_version("0.1", "^0.1")

    def add_arguments(self, parser: argparse.ArgumentParser, cli_name: str) -> None:
        """Adds nothing."""

    def main(self, *, parser: argparse.ArgumentParser, args: argparse.Namespace) -> int:
        """Does nothing."""
        raise NotImplementedError


def found(group: str) -> dict[str, EntryPoint]:
    """The entry points of a group by their names."""
    return {one.name: one for one in entry_points(group=group)}


def add_subparsers_on_demand(
    parser: argparse.ArgumentParser,
    cli_name: str,
    dest: str,
    group_name: str,
    hide_extensions: Any = None,
    required: bool = True,
    argv: list[str] | None = None,
) -> None:
    """Makes a parser for each extension, and loads the one that was typed."""
    known = ", ".join(sorted(found(group_name)))
    metavar = f"Call `{cli_name} <command> -h`"
    subparsers = parser.add_subparsers(title="Commands", description=known, metavar=metavar, dest=" " + dest)
    subparsers.required = required
    words = sys.argv[1:] if argv is None else argv
    for name, entry in sorted(found(group_name).items()):
        made = subparsers.add_parser(name)
        if name not in words:
            continue
        extension = entry.load()()
        extension.NAME = name
        made.set_defaults(**{dest: extension})
        extension.add_arguments(made, f"{cli_name} {name}")


def install() -> None:
    """Puts the modules where `import ros2cli` finds them."""
    package, command, plugins = (types.ModuleType(name) for name in ("ros2cli", "ros2cli.command", "ros2cli.plugin_system"))
    vars(command).update(CommandExtension=CommandExtension, add_subparsers_on_demand=add_subparsers_on_demand)
    vars(plugins).update(PLUGIN_SYSTEM_VERSION="0.1", satisfies_version=satisfies_version, PluginException=PluginException)
    sys.modules.update({"ros2cli": package, "ros2cli.command": command, "ros2cli.plugin_system": plugins})


def main() -> int:
    """The program `ros2`, which knows no command but those of packages that are installed."""
    parser = argparse.ArgumentParser(prog="ros2")
    add_subparsers_on_demand(parser, "ros2", "_command", "ros2cli.command", required=False)
    args = parser.parse_args()
    extension = getattr(args, "_command", None)
    if extension is None:
        parser.print_help()
        return 0
    status: int = extension.main(parser=parser, args=args)
    return status


if __name__ == "__main__":
    install()
    sys.exit(main())
