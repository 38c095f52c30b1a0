"""Writes trends as one HTML page that needs no network: a panel per joint and parameter."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from urllib.parse import quote

import numpy as np

from ...base.frames import Array
from ...viewer.player.page import fill_template, hash_of
from .trend import NUMBERS, Trend

_WIDTH, _HEIGHT = 200.0, 112.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 38.0, 194.0, 16.0, 96.0  # of the plotted area
_MARGIN = 5.0  # between the area's edges and the points
_MIN_RANGE = 0.2  # range of a panel as a share of the baseline, so that noise does not fill it
# A baseline that is more than this share of the other times earlier is drawn closer.
_FAR, _CLOSER = 0.5, 0.15
_TEXT = 5.8  # width of a character
_PAYLOAD = "payload"  # its parameters have columns of their own
# Sorts the table by the column whose heading is clicked.
_SCRIPT = """\
for(const button of document.querySelectorAll("th button"))button.onclick=()=>{
const head=button.parentElement,body=document.querySelector("tbody"),k=head.cellIndex;
const sign=head.ariaSort==="descending"?1:-1;
for(const each of head.parentElement.cells)each.ariaSort=null;
head.ariaSort=sign<0?"descending":"ascending";
const key=row=>row.cells[k].dataset.value??row.cells[k].textContent;
const compare=head.dataset.kind==="number"?(a,b)=>a-b:(a,b)=>a.localeCompare(b);
body.append(...[...body.rows].sort((a,b)=>sign*compare(key(a),key(b))));
};"""


def write_trend_page(
    path: Path,
    title: str,
    trends: Sequence[Trend],
    skipped: Sequence[tuple[str, str]] = (),
    notes: Sequence[str] = (),
) -> None:
    """Writes the page; raises OSError.

    Args:
        path: path of the .html file. Links to the recordings are relative to its folder.
        title: title of the page.
        trends: trends in the order of the joints.
        skipped: paths of skipped recordings, and the reasons.
        notes: further sentences.
    """
    columns = list(dict.fromkeys(
        each.parameter.name for each in trends if each.parameter.joint != _PAYLOAD
    ))  # fmt: skip
    changed = sum(each.is_changed for each in trends)
    dates = [run.date for each in trends for run in each.runs]
    ranked = sorted(trends, key=lambda each: each.significance, reverse=True)
    events = [f'<a href="#{_id(each)}">{escape(text)}</a>' for each in trends
              for text in each.events]  # fmt: skip
    template = (files(__package__) / "trend_page.html").read_text(encoding="utf-8")
    page = fill_template(template, {
        "POLICY": "default-src 'none'; style-src 'unsafe-inline'; img-src data:; "
                  f"script-src {hash_of(_SCRIPT)}; base-uri 'none'; form-action 'none'",
        "TITLE": escape(title),
        "COLUMNS": str(len(columns) or 1),
        "SUMMARY": f"{min(dates):%Y-%m-%d %H:%M} to {max(dates):%Y-%m-%d %H:%M}: {changed} of "
                   f"{len(trends)} parameters changed",
        "EVENTS": _list("Change points and drifts", events),
        "PANELS": "\n".join(_panels(path.absolute().parent, trends, columns)),
        "HEADINGS": "".join(map(_heading, trends[0].cells())),
        "ROWS": "\n".join(map(_row, ranked)),
        "NOTES": _list("Skipped recordings", [escape(f"{path}: {why}") for path, why in skipped])
                 + _list("Notes", list(map(escape, notes))),
        "SCRIPT": _SCRIPT,
    })  # fmt: skip
    path.write_text(page, encoding="utf-8")


def _list(heading: str, items: Sequence[str]) -> str:
    shown = "".join(f"<li>{item}</li>\n" for item in items)
    return f"<section><h2>{heading}</h2><ul>\n{shown}</ul></section>" if items else ""


def _id(trend: Trend) -> str:
    return quote(trend.parameter.key)


def _class(trend: Trend) -> str:
    return ' class="changed"' if trend.is_changed else ""


def _heading(name: str) -> str:
    kind = ' data-kind="number"' if name in NUMBERS else ""
    order = ' aria-sort="descending"' if name == "significance" else ""
    return f"<th{kind}{order}><button>{name}</button></th>"


def _row(trend: Trend) -> str:
    first, last = trend.values[[trend.baseline, trend.latest]]
    sorted_by = dict(zip(NUMBERS, (first, last, abs(trend.change), trend.significance),
                         strict=True))  # fmt: skip
    cells = [
        f'<td class="number" data-value="{sorted_by[name]:.9g}">{escape(text)}</td>'
        if name in sorted_by else f"<td>{escape(text)}</td>"
        for name, text in trend.cells().items()
    ]  # fmt: skip
    return f"<tr{_class(trend)}>{''.join(cells)}</tr>"


def _panels(folder: Path, trends: Sequence[Trend], columns: Sequence[str]) -> Iterator[str]:
    for joint in dict.fromkeys(each.parameter.joint for each in trends):
        yield f'<div class="joint"><h3>{escape(joint)}</h3>'
        for trend in (each for each in trends if each.parameter.joint == joint):
            name = trend.parameter.name
            # The first column contains the names of the joints.
            yield _figure(folder, trend, 2 + (columns.index(name) if name in columns else 0))
        yield "</div>"


def _figure(folder: Path, trend: Trend, column: int) -> str:
    name = escape(f"{trend.parameter.label}, {trend.parameter.unit}")
    badge = f"<b>{escape(trend.short_change)}</b>" if trend.is_changed else ""
    label = "; ".join(trend.events) or f"{trend.name}: {trend.shown_change}"
    return (
        f'<figure id="{_id(trend)}" style="--column:{column}"{_class(trend)}>'
        f"<figcaption><span>{name}</span>{badge}</figcaption>\n"
        f'<svg viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" aria-label="{escape(label)}">\n'
        + "\n".join(_drawing(folder, trend))
        + "</svg></figure>"
    )


def _drawing(folder: Path, trend: Trend) -> Iterator[str]:
    x, errors = _across(trend.times), 2.0 * np.nan_to_num(trend.errors)
    low, high = _range(trend, errors)

    def y(value: float) -> float:
        return float(np.interp(value, (low, high), (_BOTTOM - _MARGIN, _TOP + _MARGIN)))

    yield f'<path class="frame" d="M{_LEFT} {_TOP}V{_BOTTOM}H{_RIGHT}"/>'
    for value in (low, high):
        yield _text(_LEFT - 3, y(value) + 3, f"{value + 0.0:.3g}", anchor="end")
    yield f'<path class="baseline" d="M{_LEFT} {y(trend.values[trend.baseline]):.1f}H{_RIGHT}"/>'
    for segment in trend.segments:
        ends = segment.begin, segment.end - 1
        points = [f"{x[k]:.1f} {y(segment.at(trend.times[k])):.1f}" for k in ends]
        yield f'<path class="fit" d="M{"L".join(points)}"/>'
    at = _LEFT
    for k in trend.steps:
        at = 0.5 * (x[k - 1] + x[k])
        yield f'<path class="step" d="M{at:.1f} {_TOP - 3}V{_BOTTOM}"/>'
    if text := trend.shown_at:  # of the last step, because several texts would overlap
        at = min(max(at - 0.5 * _TEXT * len(text), _LEFT), _WIDTH - _TEXT * len(text))
        yield _text(at, _TOP - 6, text, kind="event")
    for k, (run, value, error) in enumerate(zip(trend.runs, trend.values, errors, strict=True)):
        unit = trend.parameter.unit
        title = f"{run.path}\n{run.date:%Y-%m-%d %H:%M}\n{trend.shown_value(k)} {unit}"
        link = quote(os.path.relpath(Path(run.path).absolute(), folder))
        good = " good" if k == trend.baseline else ""
        place = f'cx="{x[k]:.1f}" cy="{y(value):.1f}"'
        yield (
            f'<a href="{escape(link)}"><title>{escape(title)}</title>'
            f'<path class="bar" d="M{x[k]:.1f} {y(value - error):.1f}V{y(value + error):.1f}"/>'
            f'<circle class="point{good}" {place} r="2.2"/><circle class="hit" {place} r="6"/></a>'
        )
    first, last = trend.dates[0], trend.dates[-1]
    yield _text(_LEFT, _HEIGHT - 4, first)
    if _TEXT * len(first + last) < _RIGHT - _LEFT:
        yield _text(_RIGHT, _HEIGHT - 4, last, anchor="end")


def _text(x: float, y: float, text: str, *, anchor: str = "start", kind: str = "date") -> str:
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{text}</text>'


def _across(times: Array) -> Array:
    # Horizontal positions of the recordings.
    left, right = _LEFT + _MARGIN, _RIGHT - _MARGIN
    if times[0] == times[-1]:
        return np.linspace(left, right, len(times))
    if times[1] - times[0] > _FAR * (times[-1] - times[1]) > 0.0:
        middle = left + _CLOSER * (right - left)
        return np.interp(times, times[[0, 1, -1]], [left, middle, right])
    return np.interp(times, times[[0, -1]], [left, right])


def _range(trend: Trend, errors: Array) -> tuple[float, float]:
    low, high = float((trend.values - errors).min()), float((trend.values + errors).max())
    base = abs(float(trend.values[trend.baseline]))
    least = max(_MIN_RANGE * base, 2.0 * trend.parameter.min_change, 1e-9)
    pad = max(0.5 * (least - (high - low)), 0.0)
    return low - pad, high + pad
