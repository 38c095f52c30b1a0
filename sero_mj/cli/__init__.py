"""The command line: `sero-mj COMMAND ...`, one file per command.

A package adds one by an entry point in the group `sero_mj.commands`, see `Command`.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
from typing import Any, Protocol

from .. import __version__
from ..base.errors import DeclarationError, PluginError, SeroError, UnknownName
from ..base.plugins import COMMANDS, is_own, load_all, load_plugin, plugins
from ..viewer.image.backend import check_backend, choose_backend
from .arguments import OneLineParser, join_negative_values
from .terminal import escape_output

log = logging.getLogger(__name__)

_DESCRIPTION = """\
sero-mj shows what a torque-controlled robot feels.

It mirrors a robot from packets or simulates one, draws round arrows that turn about the joints to
show torques, and billboards with their numbers: in a window, on a web page, in pictures and films.
"""

_EPILOG = """\
Without a command it shows a page with all that can be opened, as `sero-mj view` does.

Try it, in two terminals:
  sero-mj send lwr_udp                     play a motion as the robot would, on port 32000
  sero-mj render lwr_udp -o lwr.mp4        film it for 5 s

SCENE is a file (TOML; a robot's URDF or MJCF; X3D as in the paper), or a name of `sero-mj list`.
Every command has its own help: sero-mj render --help
"""


def main(arguments: list[str] | None = None) -> None:
    """Runs one command; exits with 0, or with 2 and a clear line when it cannot be done.

    Ctrl+C is left to `__main__`, where it is caught while commands are loaded as well.
    """
    escape_output()
    logging.basicConfig(format="%(levelname)s: %(message)s", level=logging.WARNING)
    given = sys.argv[1:] if arguments is None else arguments
    if not given or (given[0].startswith("--") and given[0] not in ("--help", "--version")):
        given = ["view", *given]  # the start page
    try:
        check_backend()
        choose_backend()
        if not given[0].startswith("-") and given[0] not in plugins(COMMANDS):
            raise UnknownName("command", given[0], plugins(COMMANDS))
        options = _parser(given[0]).parse_args(join_negative_values(given))
        status = options.run(options)
        sys.stdout.flush()
    except DeclarationError as error:
        count = len(error.problems)
        if count > 1:
            print(f"sero-mj: {count} things are wrong:", file=sys.stderr)
        for problem in error.problems:
            print(f"sero-mj: {problem}" if count == 1 else f"  {problem}", file=sys.stderr)
        sys.exit(2)
    except SeroError as error:
        print(f"sero-mj: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:  # the reader of a pipe has gone, as in `sero-mj list | head -1`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    sys.exit(status)


class Command(Protocol):
    """The interface of a command: a module, or another object that an entry point names.

    Attributes:
        ORDER: in the help, lowest first; sero-mj's own have 10 to 90.
    """

    ORDER: int

    def add_to(self, commands: Any) -> None:
        """Adds the command to the subparsers of argparse, see `_arguments.command`."""


def _add_commands(commands: Any, wanted: str) -> None:
    """Adds the command of that name alone, or all if there is none of that name."""
    if wanted in plugins(COMMANDS):
        load_plugin(COMMANDS, wanted).add_to(commands)
        return
    for name, command in sorted(load_all(COMMANDS).items(), key=lambda item: item[1].ORDER):
        try:
            command.add_to(commands)
        except Exception as error:  # whatever another package does wrong
            point = plugins(COMMANDS)[name]
            if is_own(point):
                raise
            log.warning("%s; left out", PluginError(COMMANDS, point, error))


def _parser(wanted: str) -> argparse.ArgumentParser:
    parser = OneLineParser(
        prog="sero-mj",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"sero-mj {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    _add_commands(commands, wanted)
    return parser
