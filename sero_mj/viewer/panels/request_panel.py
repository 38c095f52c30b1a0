"""The dialog about a file that requests to run programs, see `base.trust`."""

from __future__ import annotations

from collections.abc import Callable

from ...base.errors import printable
from ...base.paths import without_temporary
from ...base.trust import Request
from ..session.widgets import Widgets

TITLE = "This file requests to run programs"
WIDTH = 34.0  # in text heights
_MAX_SHOWN = 2000  # characters of an action


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
    """Builds the dialog.

    Args:
        can_allow: whether the user may allow the request: only on the machine that runs the
            programs.
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
