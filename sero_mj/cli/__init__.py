"""The command line `sero-mj COMMAND ...`, with one file per command.

A package adds a `Command` by an entry point in the group `sero_mj.commands`.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from .. import __version__
from ..base.errors import DeclarationError, PluginError, SeroError, UnknownName
from ..base.plugins import COMMANDS, is_own, load_all, load_plugin, plugins
from ..viewer.image.backend import check_backend, choose_backend
from .arguments import OneLineParser, join_negative_values
from .terminal import escape_output

log = logging.getLogger(__name__)

_DESCRIPTION = """\
sero-mj mirrors or simulates torque-controlled robots. It draws torques as arrows that rotate about
the joints, in a window, on a web page, in images and videos.
"""
_EPILOG = """\
Without a command, sero-mj shows a start page. To try it, run in two terminals:
  sero-mj send lwr_udp      send a motion to port 32000, as a robot would
  sero-mj view lwr_udp      show the moving robot

SCENE is a file or a name from `sero-mj list`. Help for one command: sero-mj render --help
"""
GROUPS = ("see", "receive", "simulate", "analyze", "files")


def main(arguments: list[str] | None = None) -> None:
    """Runs one command and exits with its status, or prints an error and exits with 2.

    `__main__` handles Ctrl+C, also during imports.
    """
    escape_output()
    logging.basicConfig(format="%(levelname)s: %(message)s", level=logging.WARNING)
    words = sys.argv[1:] if arguments is None else arguments
    if not words or (words[0].startswith("--") and words[0] not in ("--help", "--version")):
        words = ["view", *words]  # the start page
    words = translated(words)
    try:
        check_backend()
        choose_backend()
        if not words[0].startswith("-") and words[0] not in plugins(COMMANDS):
            raise UnknownName("command", words[0], plugins(COMMANDS))
        options = _parser(words[0]).parse_args(join_negative_values(words))
        status = options.run(options)
        sys.stdout.flush()
    except DeclarationError as error:
        count = len(error.problems)
        if count > 1:
            print(f"sero-mj: {count} errors:", file=sys.stderr)
        for problem in error.problems:
            print(f"sero-mj: {problem}" if count == 1 else f"  {problem}", file=sys.stderr)
        sys.exit(2)
    except SeroError as error:
        print(f"sero-mj: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:  # the reader of a pipe has ended, as in `sero-mj list | head -1`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    sys.exit(status)


class Command(Protocol):
    """A command of the command line: a module, or another object that an entry point names.

    Attributes:
        ORDER: position in the help; the commands of sero-mj have 10 to 99.
        GROUP: heading in the help: one of `GROUPS` or a new one (default: "more").
    """

    ORDER: int

    def add_to(self, commands: Any) -> None:
        """Adds the command to subparsers of argparse. `arguments.command` creates this function."""


class _CommandList:
    """A wrapper of argparse subparsers that sorts the help lines of commands by group."""

    def __init__(self, commands: Any) -> None:
        self._commands = commands
        self.groups: dict[str, list[str]] = {group: [] for group in GROUPS}
        self.group = ""

    def add_parser(self, name: str, *, help: str = "", **how: Any) -> Any:
        self.groups.setdefault(self.group, []).append(f"  {name:10} {help}")
        return self._commands.add_parser(name, **how)

    def text(self) -> str:
        return "\n".join(
            "\n".join([f"{group}:", *lines]) for group, lines in self.groups.items() if lines
        )


def _add_commands(listed: _CommandList) -> None:
    for name, command in sorted(load_all(COMMANDS).items(), key=lambda item: item[1].ORDER):
        try:
            listed.group = getattr(command, "GROUP", "more")
            command.add_to(listed)
        except Exception as error:  # an error in another package
            point = plugins(COMMANDS)[name]
            if is_own(point):
                raise
            log.warning("command skipped: %s", PluginError(COMMANDS, point, error))


def _parser(wanted: str) -> argparse.ArgumentParser:
    """Returns the parser of one command, or of all commands if there is no such command."""
    parser = OneLineParser(
        prog="sero-mj",
        usage="sero-mj [-h] [--version] COMMAND ...",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"sero-mj {__version__}")
    commands = parser.add_subparsers(
        prog="sero-mj", metavar="COMMAND", required=True, help=argparse.SUPPRESS
    )
    if wanted in plugins(COMMANDS):
        load_plugin(COMMANDS, wanted).add_to(commands)
        return parser
    listed = _CommandList(commands)
    _add_commands(listed)
    parser.description = f"{_DESCRIPTION}\n{listed.text()}"
    parser.epilog = _EPILOG
    return parser


def _renamed(*words: str, **options: str) -> Callable[[list[str]], list[str]]:
    def translate(rest: list[str]) -> list[str]:
        new = {f"--{old}": f"--{new}" for old, new in options.items()}
        parts = (word.partition("=") for word in rest)
        return [*words, *(f"{new.get(name, name)}{equals}{v}" for name, equals, v in parts)]

    return translate


def _network(rest: list[str]) -> list[str]:
    """Translates `ros2 list --host HOST --domain N` to `status ros2://HOST:N --topics`."""
    words = [part for word in rest for part in word.split("=", 1) if word != "list"]
    place = {"--host": "", "--domain": ""}
    for option in place:
        if option in words[:-1]:
            at = words.index(option)
            place[option] = words[at + 1]
            del words[at : at + 2]
    host, domain = place.values()
    return ["status", f"ros2://{host}{domain and f':{domain}'}", "--topics", *words]


_OLD: Mapping[str, tuple[str, Callable[[list[str]], list[str]]]] = {
    "export-csv": ("export REC -o OUT.csv", _renamed("export", start="from", stop="to")),
    "convert": ("export SCENE -o OUT", _renamed("export")),
    "fk": ("check ROBOT --fk", _renamed("check", "--fk")),
    "schema": ("check --schema KIND", _renamed("check", "--schema")),
    "doctor": ("check", _renamed("check")),
    "snippet": ("new --snippet NAME", _renamed("new", "--snippet")),
    "ros2": ("status ros2:// --topics", _network),
}


_OLD_OPTIONS: Mapping[str, str] = {"--finish-films": "--finish-videos"}


def translated(arguments: list[str]) -> list[str]:
    """Replaces the old names of a command and its options in a command line, and prints a note."""
    for old in _OLD_OPTIONS.keys() & {*arguments}:
        note = f"note: {old} is now {_OLD_OPTIONS[old]}; 0.2 still accepts the old name"
        print(note, file=sys.stderr)
    arguments = [_OLD_OPTIONS.get(each, each) for each in arguments]
    name, *rest = arguments
    if name not in _OLD or name in plugins(COMMANDS):
        return arguments
    new, translate = _OLD[name]
    if not {"-h", "--help"} & {*rest}:
        note = f"note: 'sero-mj {name}' is now 'sero-mj {new}'; 0.2 still accepts the old name"
        print(note, file=sys.stderr)
    return translate(rest)
