"""The help dialog, and the dialog that asks whether a file may run programs (`base.trust`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import takewhile

from ...base.errors import printable
from ...base.paths import without_temporary
from ...base.trust import Request
from ..session.keys import Row
from ..session.widgets import Widgets

HELP_TITLE = "Mouse and keys"
REQUEST_TITLE = "This file requests to run programs"
# Widths in text heights. If the columns of the help would be narrower than `_MIN_COLUMN`, they are
# one below the other.
REQUEST_WIDTH = 34.0
_HELP_COLUMN, _MIN_COLUMN = 28.0, 22.0
_MIN_INPUT, _MAX_INPUT = 4.0, 12.0  # widths of the column of keys
_INPUT_GAP = 0.8  # gap beside the longest key
_MAX_SHOWN = 2000  # maximum length of the text of an action, characters


def help_width(columns: Sequence[Sequence[Row]]) -> float:
    """Returns the width of the help dialog, in text heights."""
    return _HELP_COLUMN * len(columns)


def build_help(ui: Widgets, columns: Sequence[Sequence[Row]]) -> None:
    """Builds the help dialog from columns of `session.keys.help_columns`."""
    is_wide = ui.room()[0] >= _MIN_COLUMN * len(columns)
    if not ui.table("##help", (0.0,) * (len(columns) if is_wide else 1)):
        return
    ui.row()
    for number, rows in enumerate(columns):
        if is_wide or not number:
            ui.cell()
        ui.scope(f"{number}")
        _sections(ui, rows)
        ui.end_scope()
    ui.end_table()


def _sections(ui: Widgets, rows: Sequence[Row]) -> None:
    is_in_table = False
    for index, (how, words) in enumerate(rows):
        if words and not is_in_table:
            is_in_table = ui.table(f"##{how}", (_input_width(ui, rows[index:]), 0.0))
        elif not words and is_in_table:
            ui.end_table()
            is_in_table = False
        if not words and how:
            ui.title(how)
        elif words and is_in_table:
            ui.row()
            ui.cell()
            ui.text(how, "good")
            ui.cell()
            ui.text(words)
    if is_in_table:
        ui.end_table()


def _input_width(ui: Widgets, rows: Sequence[Row]) -> float:
    """Returns the width of the column of keys for the rows up to the next heading."""
    section = takewhile(lambda row: row[1], rows)
    longest = max(ui.wide(how) for how, _ in section)
    return min(max(longest + _INPUT_GAP, _MIN_INPUT), _MAX_INPUT)


def _shortened(text: str) -> str:
    line = without_temporary(text)
    if len(line) <= _MAX_SHOWN:
        return line
    left_out = f" ... {len(line) - _MAX_SHOWN} more characters ... "
    return line[: _MAX_SHOWN // 2] + left_out + line[-_MAX_SHOWN // 2 :]


def build_request(
    ui: Widgets,
    request: Request,
    *,
    can_allow: bool,
    allow: Callable[[], object],
    dismiss: Callable[[], object],
) -> None:
    """Builds the dialog that asks whether a file may run programs.

    Args:
        can_allow: whether the user can allow the request. This is possible only on the machine
            that runs the programs.
        allow: function that is called if the user allows the request.
        dismiss: function that is called if the user declines the request.
    """
    ui.text(f"{printable(without_temporary(str(request.file)))} is displayed but not simulated.")
    ui.text("Simulating it would run the following on your computer, with your permissions:")
    for action in request.actions:
        ui.text(f"{_shortened(action.text)}   ({printable(action.key)})", "bad")
    ui.text("Allow this only if you trust the author of the file.")
    if not can_allow:
        ui.text("Only a browser on the computer that serves this page can allow this.", "quiet")
    if ui.button("display only"):
        dismiss()
    if can_allow:
        ui.same_line()
        if ui.button("run and simulate"):
            allow()
