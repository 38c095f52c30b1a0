"""Writes trends as one HTML page that needs no network: a panel per joint and parameter."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from urllib.parse import quote

import numpy as np

from ..viewer.player.page import fill_template, hash_of
from .trend import Trend

_WIDTH, _HEIGHT = 200.0, 112.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 38.0, 194.0, 16.0, 96.0  # of the plotted area
_MARGIN = 5.0  # between the area's edges and the points
_MIN_RANGE = 0.2  # range of a panel as a share of the baseline, so that noise does not fill it
_FAR = 0.5  # a baseline that is more than this share of the other times earlier is not to scale
_TEXT = 5.8  # width of a character
_HEADINGS = ("joint", "parameter", "unit", "baseline", "last", "change", "at", "significance",
             "verdict")  # fmt: skip
_NUMBERS = ("baseline", "last", "change", "significance")
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
    parameters = list(dict.fromkeys(each.parameter.name for each in trends))
    changed = sum(each.is_changed for each in trends)
    dates = [date for each in trends for date in each.dates]
    ranked = sorted(trends, key=lambda each: each.significance, reverse=True)
    template = (files(__package__) / "trend_page.html").read_text(encoding="utf-8")
    page = fill_template(template, {
        "POLICY": "default-src 'none'; style-src 'unsafe-inline'; img-src data:; "
                  f"script-src {hash_of(_SCRIPT)}; base-uri 'none'; form-action 'none'",
        "TITLE": escape(title),
        "COLUMNS": str(len([name for name in parameters if name != "mass"]) or 1),
        "SUMMARY": f"{min(dates):%Y-%m-%d %H:%M} to {max(dates):%Y-%m-%d %H:%M}: {changed} of "
                   f"{len(trends)} parameters changed",
        "EVENTS": _list(
            "Change points and drifts",
            [f'<a href="#{_id(each)}">{escape(text)}</a>' for each in trends
             for text in each.events],
        ),
        "PANELS": "\n".join(_panels(path.absolute().parent, trends, parameters)),
        "HEADINGS": "".join(_heading(name) for name in _HEADINGS),
        "ROWS": "\n".join(map(_row, ranked)),
        "NOTES": _list("Skipped recordings", [f"{escape(p)}: {escape(why)}" for p, why in skipped])
                 + _list("Notes", [escape(note) for note in notes]),
        "SCRIPT": _SCRIPT,
    })  # fmt: skip
    path.write_text(page, encoding="utf-8")


def _list(heading: str, items: Sequence[str]) -> str:
    shown = "".join(f"<li>{item}</li>\n" for item in items)
    return f"<section><h2>{heading}</h2><ul>\n{shown}</ul></section>" if items else ""


def _id(trend: Trend) -> str:
    return quote(trend.parameter.key)


def _heading(name: str) -> str:
    kind = ' data-kind="number"' if name in _NUMBERS else ""
    order = ' aria-sort="descending"' if name == "significance" else ""
    return f"<th{kind}{order}><button>{name}</button></th>"


def _row(trend: Trend) -> str:
    values = {
        "joint": trend.parameter.joint,
        "parameter": trend.parameter.label,
        "unit": trend.parameter.unit,
        "baseline": trend.shown_value(trend.baseline),
        "last": trend.shown_value(trend.latest),
        "change": trend.shown_change,
        "at": trend.shown_at,
        "significance": f"{trend.significance:.1f}",
        "verdict": "changed" if trend.is_changed else "ok",
    }
    numbers = {
        "baseline": trend.values[trend.baseline],
        "last": trend.values[trend.latest],
        "change": abs(trend.change),
        "significance": trend.significance,
    }
    cells = [
        f'<td class="number" data-value="{numbers[name]:.9g}">{escape(text)}</td>'
        if name in numbers else f"<td>{escape(text)}</td>"
        for name, text in values.items()
    ]  # fmt: skip
    kind = ' class="changed"' if trend.is_changed else ""
    return f"<tr{kind}>{''.join(cells)}</tr>"


def _panels(folder: Path, trends: Sequence[Trend], parameters: Sequence[str]) -> Iterator[str]:
    for joint in dict.fromkeys(each.parameter.joint for each in trends):
        mine = {each.parameter.name: each for each in trends if each.parameter.joint == joint}
        names = [name for name in parameters if name in mine]
        is_aligned = not names or names[0] != "mass"  # the payload has columns of its own
        yield f'<div class="joint"><h3>{escape(joint)}</h3>'
        for name in parameters if is_aligned else names:
            if name in mine:
                yield _figure(folder, mine[name])
            elif name != "mass":
                yield "<span></span>"
        yield "</div>"


def _figure(folder: Path, trend: Trend) -> str:
    is_changed = trend.is_changed
    name = escape(f"{trend.parameter.label}, {trend.parameter.unit}")
    badge = f"<b>{escape(trend.short_change)}</b>" if is_changed else ""
    label = "; ".join(trend.events) or f"{trend.name}: {trend.shown_change}"
    kind = ' class="changed"' if is_changed else ""
    return (
        f'<figure id="{_id(trend)}"{kind}><figcaption><span>{name}</span>{badge}</figcaption>\n'
        f'<svg viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" aria-label="{escape(label)}">\n'
        + "\n".join(_drawing(folder, trend))
        + "</svg></figure>"
    )


def _drawing(folder: Path, trend: Trend) -> Iterator[str]:
    x, y, low, high = _scales(trend)
    yield f'<path class="frame" d="M{_LEFT} {_TOP}V{_BOTTOM}H{_RIGHT}"/>'
    for value in (low, high):
        text = f"{value + 0.0:.3g}"
        yield f'<text x="{_LEFT - 3}" y="{y(value) + 3:.1f}" text-anchor="end">{text}</text>'
    at = trend.values[trend.baseline]
    yield f'<path class="baseline" d="M{_LEFT} {y(at):.1f}H{_RIGHT}"/>'
    for segment in trend.segments:
        ends = segment.begin, segment.end - 1
        points = [f"{x(k):.1f} {y(segment.at(trend.times[k])):.1f}" for k in ends]
        yield f'<path class="fit" d="M{"L".join(points)}"/>'
    for k in trend.steps:
        middle = 0.5 * (x(k - 1) + x(k))
        half = 0.5 * _TEXT * len(trend.date_texts[k])
        at_text = float(np.clip(middle, half, _WIDTH - half))
        yield f'<path class="step" d="M{middle:.1f} {_TOP - 3}V{_BOTTOM}"/>'
        if k == trend.steps[-1]:  # the texts of several would overlap
            yield (f'<text class="event" x="{at_text:.1f}" y="{_TOP - 6}" text-anchor="middle">'
                   f"{trend.date_texts[k]}</text>")  # fmt: skip
    if not trend.steps and trend.shown_at:
        yield f'<text class="event" x="{_LEFT}" y="{_TOP - 6}">{trend.shown_at}</text>'
    for k, value in enumerate(trend.values):
        error = 2.0 * float(np.nan_to_num(trend.errors[k]))
        told = f"{trend.recordings[k]}\n{trend.dates[k]:%Y-%m-%d %H:%M}\n{trend.shown_value(k)} "
        link = quote(os.path.relpath(Path(trend.recordings[k]).absolute(), folder))
        good = " good" if k == trend.baseline else ""
        yield (
            f'<a href="{escape(link)}"><title>{escape(told + trend.parameter.unit)}</title>'
            f'<path class="bar" d="M{x(k):.1f} {y(value - error):.1f}V{y(value + error):.1f}"/>'
            f'<circle class="point{good}" cx="{x(k):.1f}" cy="{y(value):.1f}" r="2.2"/>'
            f'<circle class="hit" cx="{x(k):.1f}" cy="{y(value):.1f}" r="6"/></a>'
        )
    first, last = trend.date_texts[0], trend.date_texts[-1]
    yield f'<text x="{_LEFT}" y="{_HEIGHT - 4}">{first}</text>'
    if _TEXT * len(first + last) < _RIGHT - _LEFT:
        yield f'<text x="{_RIGHT}" y="{_HEIGHT - 4}" text-anchor="end">{last}</text>'


def _scales(
    trend: Trend,
) -> tuple[Callable[[int], float], Callable[[float], float], float, float]:
    # Pixels by the index of a recording and by value, and the lowest and highest value.
    times, left, right = trend.times, _LEFT + _MARGIN, _RIGHT - _MARGIN
    span = times[-1] - times[0]
    at = np.linspace(left, right, len(times))
    if span > 0.0:
        at = np.interp(times, times[[0, -1]], [left, right])
    if len(times) > 2 and times[1] - times[0] > _FAR * (times[-1] - times[1]) > 0.0:
        begin = left + 0.15 * (right - left)
        at = np.append(left, np.interp(times[1:], times[[1, -1]], [begin, right]))
    errors = 2.0 * np.nan_to_num(trend.errors)
    low, high = float((trend.values - errors).min()), float((trend.values + errors).max())
    base = abs(float(trend.values[trend.baseline]))
    least = max(_MIN_RANGE * base, 2.0 * trend.parameter.min_change, 1e-9)
    pad = max(0.5 * (least - (high - low)), 0.0)
    low, high = low - pad, high + pad
    top, bottom = _TOP + _MARGIN, _BOTTOM - _MARGIN

    def y(value: float) -> float:
        return bottom - (value - low) / (high - low) * (bottom - top)

    return lambda k: float(at[k]), y, low, high
