"""Figures for reports: rows of small panels over one time axis, in the colours of the viewer.

matplotlib is imported only when a figure is made, and nothing of it is left changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import RenderError, UsageError
from .envelope import envelope

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

SUFFIXES = (".png", ".pdf", ".svg")
# The two that the round arrows have: told apart by any eye, and in grey as well.
ORANGE, BLUE = "#E8720C", "#0B5CC2"
INK, GREY, FAINT = "#23282E", "#6B737C", "#D9DDE1"
FAULT = "#8E3B8A"

A4_WIDTH = 190.0  # mm, within its margins
_A4_HEIGHT = 265.0
_ROW, _LEAST_ROW = 27.0, 14.0  # mm
_LEFT, _RIGHT, _BOTTOM, _GAP = 28.0, 2.0, 11.0, 11.0  # mm, about and between the panels
_TITLE_PAD, _LINE = 10.5, 6.5  # points; names of spans stand beneath the title
_MM = 1.0 / 25.4  # inch
_LEAST_MM = 60.0, 40.0
_MOST_MM = 2000.0, 20000.0
_DPI = 300
_POINTS = 1500  # bins of an envelope, more than a panel has printed dots
# A panel shows this share of the joint's limit at least, so that noise does not look like torque.
LEAST_SHARE = 0.01

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
    "svg.hashsalt": "sero-mj",
    "svg.fonttype": "none",
    "pdf.fonttype": 42,
}


@dataclass(frozen=True)
class Span:
    """Something that happens for a while, shown as a band behind the panels.

    Attributes:
        name: what.
        begin: s.
        end: s; None for the end of the run.
        is_fault: whether something is broken meanwhile.
    """

    name: str
    begin: float
    end: float | None = None
    is_fault: bool = False


def check_suffix(path: Path | str) -> Path:
    """Raises UsageError where a name does not end as a figure's does."""
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        found = f"found '{path.suffix}'" if path.suffix else "found none"
        expected = ", ".join(SUFFIXES)
        raise UsageError(f"{path}: {found}; expected a name that ends in {expected}")
    return path


@contextmanager
def styled() -> Iterator[None]:
    """Sets the style of figures while they are made and written."""
    import matplotlib as mpl

    with mpl.rc_context(_STYLE):
        yield


class Sheet:
    """A figure of rows and columns of panels that share their time. Use it within `styled`.

    Args:
        rows: what stands left of each row, its name and a line beneath.
        columns: title of each column, and its share of the width.
        title: of the whole.
        subtitle: beneath, in grey.
        times: first and last, s.
        size_mm: width and height; A4's width, and a height that suits the rows, when None.

    Attributes:
        figure: matplotlib's.
        axes: by row and column.

    Raises:
        UsageError: a size that is no figure's.
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
        top_mm: float = 21.0,
    ) -> None:
        from matplotlib.figure import Figure

        row = float(np.clip((_A4_HEIGHT - top_mm - _BOTTOM) / len(rows), _LEAST_ROW, _ROW))
        width, height = size_mm or (A4_WIDTH, top_mm + _BOTTOM + row * len(rows))
        for value, least, most, what in (
            (width, _LEAST_MM[0], _MOST_MM[0], "wide"), (height, _LEAST_MM[1], _MOST_MM[1], "high"),
        ):  # fmt: skip
            if not least <= value <= most:
                expected = f"expected {least:g} mm to {most:g} mm"
                raise UsageError(f"size_mm: found {value:g} mm {what}; {expected}")
        self.figure = Figure(figsize=(width * _MM, height * _MM), dpi=_DPI, facecolor="white")
        self._height = height
        self._width = width
        shares = [share for _, share in columns]
        grid = self.figure.add_gridspec(
            len(rows),
            len(columns),
            left=_LEFT / width,
            right=1.0 - _RIGHT / width,
            top=1.0 - top_mm / height,
            bottom=_BOTTOM / height,
            width_ratios=shares,
            hspace=0.22,
            wspace=_GAP * len(columns) / (width - _LEFT - _RIGHT - _GAP * (len(columns) - 1)),
        )
        self.axes: list[list[Axes]] = []
        first: Axes | None = None
        for i, (name, beneath) in enumerate(rows):
            self.axes.append([])
            for j, (heading, _) in enumerate(columns):
                panel = self.figure.add_subplot(grid[i, j], sharex=first)
                first = first or panel
                self.axes[-1].append(panel)
                panel.tick_params(labelbottom=i == len(rows) - 1)
                if i == 0:
                    panel.set_title(heading, fontsize=7.5, loc="left", pad=_TITLE_PAD, color=INK)
                if i == len(rows) - 1:
                    panel.set_xlabel("time, s", labelpad=2.0)
            self._label(self.axes[-1][0], name, beneath)
        assert first is not None
        margin = 0.0 if times[1] > times[0] else 0.5
        first.set_xlim(times[0] - margin, times[1] + margin)
        self._write(title, subtitle)

    def _label(self, panel: Axes, name: str, beneath: str) -> None:
        at = panel.get_position()
        x, y = 2.0 / self._width, at.y0 + 0.5 * at.height
        text = self.figure.text
        text(x, y, name, fontsize=9.0, fontweight="bold", va="bottom", color=INK)
        text(x, y - 0.7 / self._height, beneath, fontsize=6.0, va="top", color=GREY,
             linespacing=1.25)  # fmt: skip

    def _write(self, title: str, subtitle: str) -> None:
        x, text = 2.0 / self._width, self.figure.text
        text(x, 1.0 - 2.0 / self._height, title, fontsize=10.0, fontweight="bold", va="top")
        text(x, 1.0 - 7.0 / self._height, subtitle, fontsize=7.0, va="top", color=GREY)

    def line(self, panel: Axes, times: Array, values: Array, label: str, **look: Any) -> None:
        """Draws values (T,) over time; of many rows their smallest and largest."""
        panel.plot(*envelope(times, values, _POINTS), label=label, **look)

    def signed_area(self, panel: Axes, times: Array, values: Array, label: str) -> None:
        """Draws a difference: orange above zero, blue below, as the arrows are."""
        at, shown = envelope(times, values, _POINTS)
        for colour, side in ((ORANGE, np.maximum(shown, 0.0)), (BLUE, np.minimum(shown, 0.0))):
            panel.fill_between(at, side, 0.0, color=colour, alpha=0.45, linewidth=0.0)
        panel.axhline(0.0, color=GREY, linewidth=0.5)
        panel.plot(at, shown, color=INK, linewidth=0.5, label=label)

    def fit(
        self,
        panel: Axes,
        curves: Sequence[Array],
        *,
        least: float,
        floor: float,
        also: Sequence[float] = (),
    ) -> bool:
        """Sets the range of a panel to what it shows, `least` at least; says whether anything is.

        Args:
            panel: which one.
            curves: what is drawn in it.
            least: how much of the axis must be seen.
            floor: the same where `least` is not finite.
            also: what must be seen besides.
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
        """Writes small print into the upper right corner of a panel."""
        panel.text(1.0, 1.02, text, transform=panel.transAxes, ha="right", va="bottom",
                   fontsize=5.5, color=GREY)  # fmt: skip

    def spans(self, spans: Sequence[Span]) -> None:
        """Shows what happened behind all panels, with names above the first row."""
        begin, end = self.axes[0][0].get_xlim()
        shown = [span for span in spans if span.begin < end
                 and (span.end is None or span.end > begin)]  # fmt: skip
        free = [-np.inf] * 3
        for span in sorted(shown, key=lambda span: span.begin):
            left, right = max(span.begin, begin), end if span.end is None else min(span.end, end)
            colour, alpha = (FAULT, 0.10) if span.is_fault else (GREY, 0.16)
            for panel in (panel for row in self.axes for panel in row):
                panel.axvspan(left, right, color=colour, alpha=alpha, linewidth=0.0, zorder=0.5)
                if span.is_fault:
                    panel.axvline(left, color=FAULT, linewidth=0.7, zorder=0.6)
            level = next((k for k, until in enumerate(free) if until <= left), 0)
            # Names that would run into each other go into the panel.
            height = 2.5 if level == 0 else -_LINE * level
            first = self.axes[0][0]
            share = first.get_position().width * self._width  # mm
            free[level] = left + (len(span.name) * 1.15 + 2.0) / share * (end - begin)
            first.annotate(
                span.name, (left, 1.0), (0.0, height),
                xycoords=("data", "axes fraction"), textcoords="offset points", fontsize=5.5,
                color=FAULT if span.is_fault else GREY, annotation_clip=False, clip_on=False,
            )  # fmt: skip

    def legend(self, handles: Sequence[Any]) -> None:
        """Puts the legend into the upper right corner of the sheet."""
        self.figure.legend(
            handles=list(handles), loc="upper right", ncols=min(len(handles), 4), frameon=False,
            bbox_to_anchor=(1.0 - _RIGHT / self._width, 1.0 - 0.5 / self._height), borderpad=0.2,
            handlelength=1.8, columnspacing=1.2, fontsize=6.5,
        )  # fmt: skip

    def save(self, path: Path) -> None:
        """Writes it; raises RenderError."""
        # Dates would make two files of one run differ.
        dateless = {".svg": "Date", ".pdf": "CreationDate"}.get(path.suffix.lower())
        try:
            self.figure.savefig(path, dpi=_DPI, metadata={dateless: None} if dateless else None)
        except OSError as error:
            raise RenderError(f"{path}: cannot be written: {error.strerror or error}") from error
