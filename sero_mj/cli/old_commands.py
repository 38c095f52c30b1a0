"""Names of commands up to version 0.2; they work for one more version."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping

from ..base.plugins import COMMANDS, plugins


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


def translated(arguments: list[str]) -> list[str]:
    """Returns a command line in which an old name is replaced, and prints a note about it."""
    name, *rest = arguments
    if name not in _OLD or name in plugins(COMMANDS):
        return arguments
    new, translate = _OLD[name]
    if not {"-h", "--help"} & {*rest}:
        note = f"note: 'sero-mj {name}' is now 'sero-mj {new}'; the old name works in version 0.2"
        print(note, file=sys.stderr)
    return translate(rest)
