"""The help: mouse gestures and keys, and their effects."""

from __future__ import annotations

from collections.abc import Sequence

from ..session.keys import Row
from ..session.widgets import Widgets

TITLE = "Mouse and keys"
WIDTH = 56.0  # in text heights; in a narrower dialog, columns are below each other
_INPUT = 9.6  # width of the column of keys, in text heights


def build_help(ui: Widgets, columns: Sequence[Sequence[Row]]) -> None:
    """Builds the help from `session.keys.help_columns`."""
    is_wide = ui.room()[0] >= 0.9 * WIDTH
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
    for how, words in rows:
        if words and not is_in_table:
            is_in_table = ui.table(f"##{how}", (_INPUT, 0.0))
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
