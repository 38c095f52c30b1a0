"""The dialog of a file that asks to run programs, see `base.trust`."""

from __future__ import annotations

from collections.abc import Callable

from ...base.errors import printable
from ...base.paths import without_temporary
from ...base.trust import Request
from ..session.widgets import Widgets

TITLE = "This file asks to run programs"
WIDTH = 34.0  # of the text's height


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
        can_allow: whether who has control may allow it: only on the machine that would run it.
    """
    ui.text(f"{printable(without_temporary(str(request.file)))} is shown without simulating it.")
    ui.text("Its simulation would do this on your computer, with all your rights:")
    for action in request.actions:
        ui.text(f"{_shortened(action.text)}   ({printable(action.key)})", "bad")
    ui.text("Allow this only if you trust the author of the file.")
    if not can_allow:
        ui.text("Only a browser on the computer that serves this page can allow it.", "quiet")
    if ui.button("show only"):
        dismiss()
    if can_allow:
        ui.same_line()
        if ui.button("run and simulate"):
            allow()
