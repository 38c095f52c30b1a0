"""Creates figures of small panels with a common time axis, in the colors of the viewer.

matplotlib is imported only when a figure is created, and its global settings are not changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.errors import Problem, RenderError, UsageError
from ..base.frames import Array
from ..base.reduction import envelope

if TYPE_CHECKING:
    from matplotlib.axes import Axes


SUFFIXES = (".png", ".pdf", ".svg")
NO_MATPLOTLIB = "figures need matplotlib: pip install 'sero-mj[figures]'"
# The colors of the round arrows, distinguishable with color blindness and in grayscale.
ORANGE, BLUE = "#E8720C", "#0B5CC2"
INK, GREY, FAINT = "#23282E", "#6B737C", "#D9DDE1"
FAULT = "#8E3B8A"

A4_WIDTH = 190.0  # width of A4 within its margins, mm
_A4_HEIGHT = 265.0
_ROW, _MIN_ROW = 27.0, 14.0  # normal and minimum height of a row, mm
_HEAD, _FOOT = 12.0, 20.0  # heights of title and legend, and of headings and time axis, mm
_NAMES = 27.0  # width of the names to the left of the panels, mm
_MAX_NAME = 9  # maximum number of characters; longer names have smaller letters
_TITLE_PAD, _LINE = 10.5, 6.5  # points; names of spans are below the title
_MM = 1.0 / 25.4  # inch
_MIN_MM = 60.0, 40.0
_MAX_MM = 2000.0, 20000.0
_DPI = 300
_POINTS = 1500  # bins of an envelope, above a panel's printed resolution
# Minimum range of a panel as a share of the joint's limit, so that noise does not fill the panel.
MIN_SHARE = 0.01

_STYLE: Any = {
    "font.family": ["DejaVu Sans"],
    "font.size": 7.0,
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.5,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "axes.formatter.useoffset": False,
    "grid.color": FAINT,
    "grid.linewidth": 0.4,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.major.width": 0.5,
    "ytick.major.width": 0.5,
    "xtick.major.size": 2.0,
    "ytick.major.size": 2.0,
    "text.color": INK,
    "lines.solid_joinstyle": "round",
    "path.simplify": False,
    "text.parse_math": False,  # names of joints may have dollar signs
    "svg.hashsalt": "sero-mj",
    "svg.fonttype": "none",
    "pdf.fonttype": 42,
}


@dataclass(frozen=True)
class Span:
    """An event of a run that figures show as a band. An `end` of None is the end of the run."""

    name: str
    begin: float
    end: float | None = None
    is_fault: bool = False


def has_matplotlib() -> bool:
    """Whether figures can be drawn."""
    return find_spec("matplotlib") is not None


def check_suffix(path: Path | str) -> Path:
    """Returns the path; raises UsageError if the suffix is wrong or matplotlib is missing."""
    path = Path(path)
    if not has_matplotlib():
        raise UsageError(NO_MATPLOTLIB)
    if path.suffix.lower() not in SUFFIXES:
        expected = f"a name that ends in {', '.join(SUFFIXES)}"
        raise UsageError(Problem(file=str(path), found=path.suffix, expected=expected))
    return path


@contextmanager
def styled() -> Iterator[None]:
    """Sets the style of figures within the context."""
    import matplotlib as mpl

    with mpl.rc_context(_STYLE):
        mpl.rcParams["font.family"] = [*_STYLE["font.family"], *_more_families()]
        yield


def drawn_name(name: str, number: int) -> str:
    """Returns a joint name, or a text such as `joint 3` if no font has the characters."""
    from ..viewer.decor.font import drawable

    return name if drawable(name) else f"joint {number + 1}"


@cache
def _more_families() -> list[str]:
    from matplotlib import font_manager

    from ..viewer.decor.font import more_fonts

    found = []
    for file in more_fonts()[1:]:  # DejaVu Sans has all characters of the first font
        with suppress(OSError, RuntimeError):
            font_manager.fontManager.addfont(file)
            found.append(font_manager.get_font(file).family_name)
    return found


class Figure:
    """A figure with rows and columns of panels that share the time axis. Use it within `styled`.

    Args:
        rows: first and second line of the label to the left of each row.
        columns: title and relative width of each column.
        times: start and end of the time axis, s.
        size_mm: width and height, mm; None for the width of A4 and a height that fits the rows.
        below: height of the subfigure `below` the panels, mm.

    Raises:
        UsageError: the size is invalid.
    """

    def __init__(
        self,
        rows: Sequence[tuple[str, str]],
        columns: Sequence[tuple[str, float]],
        *,
        title: str,
        subtitle: str,
        times: tuple[float, float],
        size_mm: tuple[float, float] | None = None,
        below: float = 0.0,
    ) -> None:
        from matplotlib import figure as matplotlib_figure

        row = float(np.clip((_A4_HEIGHT - _HEAD - _FOOT) / max(len(rows), 1), _MIN_ROW, _ROW))
        panels_height = _FOOT + row * len(rows) if rows else 0.0
        width, height = size_mm or (A4_WIDTH, _HEAD + panels_height + below)
        for value, low, high, what in (
            (width, _MIN_MM[0], _MAX_MM[0], "wide"), (height, _MIN_MM[1], _MAX_MM[1], "high"),
        ):  # fmt: skip
            if not low <= value <= high:
                of, expected = f"mm {what}", f"{low:g} mm to {high:g} mm"
                raise UsageError(Problem("size_mm", found=value, of=of, expected=expected))
        self.figure = matplotlib_figure.Figure(
            figsize=(width * _MM, height * _MM), dpi=_DPI, facecolor="white", layout="constrained"
        )
        heights = [_HEAD, height - _HEAD - below, below]
        parts: Any = self.figure.subfigures(
            sum(each > 0.0 for each in heights), 1, height_ratios=[h for h in heights if h > 0.0]
        )
        self._head, self.below = parts[0], parts[-1]
        self.axes: list[list[Axes]] = []
        left = 1.0 / width
        self._head.text(left, 0.9, title, fontsize=10.0, fontweight="bold", va="top")
        self._head.text(left, 0.45, subtitle, fontsize=7.0, va="top", color=GREY)
        if rows:
            self._add_panels(parts[1], rows, columns, times)

    def _add_panels(
        self,
        body: Any,
        rows: Sequence[tuple[str, str]],
        columns: Sequence[tuple[str, float]],
        times: tuple[float, float],
    ) -> None:
        panels: Any = body.subplots(
            len(rows), len(columns), sharex=True, squeeze=False,
            width_ratios=[share for _, share in columns],
        )  # fmt: skip
        self.axes = panels.tolist()
        for row_of, (name, beneath) in zip(self.axes, rows, strict=True):
            self._label(row_of[0], name, beneath)
        for panel, (heading, _) in zip(self.axes[0], columns, strict=True):
            panel.set_title(heading, fontsize=7.5, loc="left", pad=_TITLE_PAD, color=INK)
        for panel in self.axes[-1]:
            panel.set_xlabel("time, s", labelpad=2.0)
        margin = 0.0 if times[1] > times[0] else 0.5
        self.axes[0][0].set_xlim(times[0] - margin, times[1] + margin)

    def _label(self, panel: Axes, name: str, beneath: str) -> None:
        left = -_NAMES * _MM * 72.0  # points
        look: Any = {"xycoords": "axes fraction", "textcoords": "offset points"}
        size = 9.0 * min(1.0, _MAX_NAME / max(len(name), 1))
        panel.annotate(name, (0.0, 0.5), (left, 0.0), **look, fontsize=size, fontweight="bold",
                       va="bottom", color=INK)  # fmt: skip
        panel.annotate(beneath, (0.0, 0.5), (left, -2.0), **look, fontsize=6.0, va="top",
                       color=GREY, linespacing=1.25)  # fmt: skip

    def line(self, panel: Axes, times: Array, values: Array, label: str, **look: Any) -> None:
        """Draws a curve of values, shape (T,), over time; draws the envelope of many values."""
        panel.plot(*envelope(times, values, _POINTS), label=label, **look)

    def signed_area(self, panel: Axes, times: Array, values: Array) -> None:
        """Draws a difference, shape (T,), as an area: orange above zero and blue below."""
        at, shown = envelope(times, values, _POINTS)
        for colour, side in ((ORANGE, np.maximum(shown, 0.0)), (BLUE, np.minimum(shown, 0.0))):
            panel.fill_between(at, side, 0.0, color=colour, alpha=0.45, linewidth=0.0)
        if np.isfinite(shown).any():  # else the panel shows "no data"
            panel.axhline(0.0, color=GREY, linewidth=0.5)
        panel.plot(at, shown, color=INK, linewidth=0.5, label="difference")

    def fit(
        self,
        panel: Axes,
        curves: Sequence[Array],
        *,
        least: float,
        floor: float,
        also: Sequence[float] = (),
    ) -> bool:
        """Sets the vertical range of a panel so that it contains the curves and the values `also`.

        The size of the range is at least `least`, or `floor` if `least` is infinite. Returns False
        if there are no data.
        """
        known = [curve[np.isfinite(curve)] for curve in curves]
        known = [curve for curve in known if len(curve)]
        if not known:
            panel.text(0.5, 0.5, "no data", transform=panel.transAxes, ha="center", va="center",
                       color=GREY)  # fmt: skip
            panel.set_yticks([])
            return False
        low, high = min([*map(np.min, known), *also]), max([*map(np.max, known), *also])
        least = least if np.isfinite(least) else floor
        pad = max(0.5 * (least - (high - low)), 0.08 * (high - low))
        panel.set_ylim(low - pad, high + pad)
        panel.locator_params(axis="y", nbins=4, min_n_ticks=3)
        return True

    def note(self, panel: Axes, text: str) -> None:
        """Writes a small text above the upper right corner of a panel."""
        panel.text(1.0, 1.02, text, transform=panel.transAxes, ha="right", va="bottom",
                   fontsize=5.5, color=GREY)  # fmt: skip

    def spans(self, spans: Sequence[Span]) -> None:
        """Draws events as bands behind all panels, with their names above the first row."""
        begin, end = self.axes[0][0].get_xlim()
        shown = [span for span in spans if span.begin < end
                 and (span.end is None or span.end > begin)]  # fmt: skip
        if not shown:
            return
        self.lay_out()  # determines the positions of the panels
        taken: list[Any] = []
        for span in sorted(shown, key=lambda span: span.begin):
            left, right = max(span.begin, begin), end if span.end is None else min(span.end, end)
            colour, alpha = (FAULT, 0.10) if span.is_fault else (GREY, 0.16)
            for panel in (panel for row in self.axes for panel in row):
                panel.axvspan(left, right, color=colour, alpha=alpha, linewidth=0.0, zorder=0.5)
                if span.is_fault:
                    panel.axvline(left, color=FAULT, linewidth=0.7, zorder=0.6)
            name = self.axes[0][0].annotate(
                span.name, (left, 1.0), (0.0, 2.5), xycoords=("data", "axes fraction"),
                textcoords="offset points", fontsize=5.5, color=FAULT if span.is_fault else GREY,
                annotation_clip=False, clip_on=False, in_layout=False,
            )  # fmt: skip
            # Overlapping names are moved down into the panel.
            for level in range(1, 4):
                box = name.get_window_extent()
                if not any(box.overlaps(other) for other in taken):
                    break
                name.set_position((0.0, -_LINE * level))
            taken.append(name.get_window_extent())

    def lay_out(self) -> None:
        """Computes the layout once, so that matplotlib does not repeat it at every drawing."""
        engine = self.figure.get_layout_engine()
        if engine is not None:
            engine.execute(self.figure)
            self.figure.set_layout_engine(None)

    def legend(self, handles: Sequence[Any]) -> None:
        """Draws the legend in the upper right corner of the figure."""
        self._head.legend(
            handles=list(handles), loc="upper right", ncols=min(len(handles), 4), frameon=False,
            borderpad=0.2, borderaxespad=0.2, handlelength=1.8, columnspacing=1.2, fontsize=6.5,
        )  # fmt: skip


def save_figures(figures: Sequence[Figure], path: Path) -> None:
    """Writes one figure, or several figures as pages of a .pdf file. Use it within `styled`.

    Raises:
        RenderError: the file cannot be written.
        UsageError: there are several figures, and the file is not a .pdf.
    """
    from matplotlib.backends.backend_pdf import PdfPages

    for each in figures:
        each.lay_out()
    suffix = path.suffix.lower()
    if len(figures) > 1 and suffix != ".pdf":
        problem = Problem(
            file=str(path), found=len(figures), of="pages", expected="a name that ends in .pdf"
        )
        raise UsageError(problem)
    try:
        if suffix == ".pdf":  # without dates, so that the same run gives the same file
            with PdfPages(path, metadata={"CreationDate": None}) as pages:
                for each in figures:
                    pages.savefig(each.figure, dpi=_DPI)
            return
        metadata: Any = {"Date": None} if suffix == ".svg" else None
        figures[0].figure.savefig(path, dpi=_DPI, metadata=metadata)
    except OSError as error:
        raise RenderError(f"{path} cannot be written: {error.strerror or error}") from error
