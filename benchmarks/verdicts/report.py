"""Tables and the diagram of the verdicts: reliability, wrong verdicts, and confusion."""

from __future__ import annotations

from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from faults import CLEAN, NAMED
from judge import UNEXPLAINED, wilson

from sero_mj.study import figure

EDGES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 1.01)
BINS = ("below 50 %", "50 to 80 %", "80 to 90 %", "90 to 95 %", "95 to 98 %", "98 to 99 %")
SURE = 0.9
Row = dict[str, Any]
_LISTED = 0.8  # minimum confidence of listed verdicts


def bin_of(confidence: float) -> int:
    return int(np.searchsorted(EDGES, confidence, side="right")) - 1


def counts(rows: list[Row], *, is_named: bool | None = None) -> list[tuple[int, int]]:
    """Returns the number of right verdicts and of all verdicts in each bin of confidence."""
    found = [[0, 0] for _ in BINS]
    for row in rows:
        for each in row["verdicts"]:
            if is_named is None or is_named == (each["kind"] != UNEXPLAINED):
                found[bin_of(each["confidence"])][0] += each["right"]
                found[bin_of(each["confidence"])][1] += 1
    return [(right, count) for right, count in found]


def reliability(rows: list[Row]) -> str:
    """Returns a Markdown table: right verdicts of all verdicts by robot and confidence."""
    lines = [f"| verdicts | {' | '.join(BINS)} |", f"|---|{'---|' * len(BINS)}"]
    for robot in dict.fromkeys(row["robot"] for row in rows):
        mine = [row for row in rows if row["robot"] == robot]
        for title, is_named in (("named", True), (UNEXPLAINED, False)):
            cells = [_cell(*each) for each in counts(mine, is_named=is_named)]
            lines.append(f"| {robot}, {title} | {' | '.join(cells)} |")
    lines.append(f"| all | {' | '.join(_cell(*each) for each in counts(rows))} |")
    return "\n".join(lines)


def _cell(right: int, count: int) -> str:
    low, high = wilson(right, count)
    share = f": {right / count:.0%} ({low:.0%} to {high:.0%})" if count else ""
    return f"{right} of {count}{share}".replace("%", " %")


def detection(rows: list[Row]) -> str:
    """Returns a Markdown table of the runs by what was reported about them."""
    lines = ["| robot | faults with a name | rightly named | only `unexplained` | only wrong names "
             "| nothing | faults without a name | no wrong name | clean runs | no verdict |",
             f"|{'---|' * 10}"]  # fmt: skip
    for robot in dict.fromkeys(row["robot"] for row in rows):
        mine = [row for row in rows if row["robot"] == robot]
        known = [row["verdicts"] for row in mine if row["fault"] in NAMED]
        names = [[each for each in found if each["kind"] != UNEXPLAINED] for found in known]
        named = sum(any(each["fits"] for each in found) for found in names)
        wrong = sum(bool(found) and not any(e["fits"] for e in found) for found in names)
        empty = sum(not found for found in known)
        other = [r["verdicts"] for r in mine if r["fault"] not in (*NAMED, CLEAN)]
        fine = sum(all(e["right"] or e["kind"] == UNEXPLAINED for e in found) for found in other)
        clean = [row["verdicts"] for row in mine if row["fault"] == CLEAN]
        numbers = [len(known), named, len(known) - named - wrong - empty, wrong, empty,
                   len(other), fine, len(clean), sum(not found for found in clean)]  # fmt: skip
        lines.append(f"| {robot} | {' | '.join(map(str, numbers))} |")
    return "\n".join(lines)


def wrong(rows: list[Row]) -> str:
    """Returns a Markdown list of the wrong verdicts of at least 90 %, most frequent first."""
    found: Counter[str] = Counter()
    robots = defaultdict(set)
    for row in rows:
        for each in row["verdicts"]:
            if not each["right"] and each["confidence"] >= SURE:
                name = f"{row['fault']} → {label(each)}"
                found[name] += 1
                robots[name].add(row["robot"])
    return "\n".join(
        f"- {count} x {name} ({', '.join(sorted(robots[name]))})"
        for name, count in found.most_common()
    )


def label(verdict: Row) -> str:
    name = f"{verdict['kind']}, {verdict['part']}"
    return verdict["kind"] if verdict["kind"] == verdict["part"] else name


def confusion(rows: list[Row]) -> str:
    """Returns a Markdown table: the verdicts of at least 80 % about each fault.

    The number behind a verdict is the number of runs in which it occurs.
    """
    lines = ["| fault | runs | right | wrong | no verdict |", "|---|---|---|---|---|"]
    for fault in dict.fromkeys(row["fault"] for row in rows):
        same = [row for row in rows if row["fault"] == fault]
        cells = []
        for is_right in (True, False):
            found: Counter[str] = Counter()
            for row in same:
                found.update({
                    label(each) for each in row["verdicts"]
                    if each["right"] == is_right and each["confidence"] >= _LISTED
                })  # fmt: skip
            cells.append("; ".join(f"{name} {count}" for name, count in found.most_common()))
        none = sum(not row["verdicts"] for row in same)
        name = fault.replace("_", " ")
        lines.append(f"| {name} | {len(same)} | {cells[0]} | {cells[1]} | {none or ''} |")
    return "\n".join(lines)


def draw(rows: list[Row], path: Path) -> None:
    """Draws the reliability diagram with 95 % Wilson intervals, and the number of verdicts."""
    robots = list(dict.fromkeys(row["robot"] for row in rows))
    with figure.styled():
        from matplotlib.figure import Figure

        drawn = Figure(figsize=(figure.A4_WIDTH / 25.4, 3.0), dpi=200, layout="constrained")
        panels = drawn.subplots(1, 1 + len(robots), sharey=True, squeeze=False)[0]
        for panel, title in zip(panels, ("all robots", *robots), strict=True):
            mine = [row for row in rows if title in ("all robots", row["robot"])]
            _panel(panel, mine)
            panel.set_title(title, loc="left", fontsize=7.5, pad=16.0)
            panel.set_xlabel("confidence, %")
        panels[0].set_ylabel("right verdicts, %")
        handles, labels = panels[0].get_legend_handles_labels()
        drawn.legend(
            handles, labels, frameon=False, fontsize=6.5, loc="outside lower center", ncols=3
        )
        drawn.savefig(path)


def _panel(panel: Any, rows: list[Row]) -> None:
    low = 100.0 * np.array(EDGES[:-1])
    high = np.minimum(100.0 * np.array(EDGES[1:]), 100.0)
    places = np.arange(len(BINS))
    panel.bar(places, high - low, 0.9, low, color=figure.FAINT, label="equal to the confidence")
    for shift, is_named, color in ((-0.15, True, figure.ORANGE), (0.15, False, figure.BLUE)):
        found = [(at, right, count) for at, (right, count) in
                 enumerate(counts(rows, is_named=is_named)) if count]  # fmt: skip
        shares = [100.0 * right / count for _, right, count in found]
        ends = 100.0 * np.array([wilson(right, count) for _, right, count in found]).reshape(-1, 2)
        sizes = np.abs(ends.T - np.array(shares))
        panel.errorbar(
            [at + shift for at, *_ in found], shares, sizes, fmt="o", color=color, markersize=3.0,
            elinewidth=0.9, label="named causes" if is_named else UNEXPLAINED,
        )  # fmt: skip
        for at, _, count in found:
            panel.annotate(
                f"{count}", (at, 107.0 if is_named else 102.5), ha="center", fontsize=5.0,
                color=color, annotation_clip=False,
            )  # fmt: skip
    names = [each.removesuffix(" %") for each in BINS]
    panel.set_xticks(places, names, rotation=45, ha="right", fontsize=6)
    panel.set_ylim(-2.0, 101.0)


def whole(rows: list[Row]) -> str:
    """Returns the whole report as Markdown."""
    false = [
        f"- {row['robot']}, seed {row['seed']}: {each['joint']}: {each['text']}, "
        f"{100 * each['confidence']:.0f} %"
        for row in rows
        if row["fault"] == CLEAN
        for each in row["verdicts"]
    ]
    errors = [f"- {row['robot']}, {row['fault']}: {row['error']}" for row in rows if row["error"]]
    parts = {
        "Right verdicts of all verdicts, by confidence": reliability(rows),
        "Runs": detection(rows),
        "Wrong verdicts of at least 90 %": wrong(rows),
        "Verdicts about runs without a fault": "\n".join(false),
        "Runs that could not be analyzed": "\n".join(errors),
        "Verdicts of at least 80 % by fault": confusion(rows),
    }
    return "\n\n".join(f"## {title}\n\n{text or 'none'}" for title, text in parts.items()) + "\n"
