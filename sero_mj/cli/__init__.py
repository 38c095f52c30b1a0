"""The command line: `sero-mj COMMAND ...`, one file per command."""

from __future__ import annotations

import argparse
import logging
import os
import sys

from .. import __version__
from ..base.errors import DeclarationError, SeroError
from ..viewer.headless.backend import choose_backend
from . import (
    calibrate,
    check,
    compare,
    convert,
    demo,
    doctor,
    export,
    export_csv,
    fk,
    identify,
    import_robot,
    listing,
    new,
    plot,
    record,
    render,
    schema,
    send,
    simulate,
    status,
    structure,
    sweep,
    view,
)
from ._arguments import OneLineParser, join_negative_values

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
    choose_backend()
    logging.basicConfig(format="%(levelname)s: %(message)s", level=logging.WARNING)
    given = sys.argv[1:] if arguments is None else arguments
    if not given or (given[0].startswith("--") and given[0] not in ("--help", "--version")):
        given = ["view", *given]  # the start page
    options = _parser().parse_args(join_negative_values(given))
    try:
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


def _parser() -> argparse.ArgumentParser:
    parser = OneLineParser(
        prog="sero-mj",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"sero-mj {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for module in (
        view,
        render,
        calibrate,
        send,
        simulate,
        sweep,
        status,
        structure,
        record,
        export_csv,
        plot,
        compare,
        identify,
        fk,
        check,
        export,
        convert,
        listing,
        new,
        import_robot,
        schema,
        doctor,
        demo,
    ):
        module.add_to(commands)
    return parser
