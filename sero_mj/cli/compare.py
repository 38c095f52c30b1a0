"""`sero-mj compare`: reports how recordings of a robot differ, and what explains the difference."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import create_model, model_validator

from ..base.declaration import expecting
from ..base.errors import UsageError
from ..base.options import NotNegative, Option, ending, positional
from ..base.plugins import COMPARISONS, load_all
from ..study.explanation import OF_ONE_RUN
from ..viewer.image.image_options import VIDEO_FORMATS, SizeOptions, VideoOptions
from .arguments import Commands, command, print_json, print_table, print_wrapped, progress_bar
from .shared_options import EngineOptions, Figure, Flag, JsonOptions, RunOptions

if TYPE_CHECKING:
    from rich.table import Table

    from ..simulate.runs.run_log import RunLog
    from ..study.align import Pair
    from ..study.explanation import Explanation
    from .each_recording import Rows

_HELP = """\
examples:
  sero-mj compare simulated.mcap real.mcap --offset auto --plot difference.pdf
  sero-mj compare good.mcap runs/*.mcap --table table.csv   one row per recording
  sero-mj compare --each runs/*.mcap                        commanded and measured torques

Differences are A minus B. Time starts at the beginning of a simulation, or at the first packet of a
robot. For each joint, the report explains the difference: sign, gain, bias, delay or noise of a
torque sensor or drive, friction, a payload, or a stuck joint. Several recordings are compared in
parallel by local processes or by the workers of a Dask cluster, and the report has one row for each
recording. The exit status is 1 if a tolerance is exceeded, and 2 if a recording cannot be compared.
"""
GROUP, ORDER = "analyze", 40
_WIDTH = 70  # maximum width of explanations in a table of many recordings, characters
_BATCH_OPTIONS = ("b", "more", "each", "table", "jobs", "engine", "scheduler", "ship")


class CompareOptions(SizeOptions, RunOptions, JsonOptions, EngineOptions):
    """Compare recordings of a robot, joint by joint.

    A subclass that an entry point of the group `sero_mj.comparisons` names adds options and
    comparisons.

    Attributes:
        notes: paragraphs of the help that the class adds.
        a: first recording or table (.csv).
        b: second recording or table (default: compare commanded and measured torques of A).
        more: further recordings to compare with A.
        each: compare commanded and measured torques in each recording.
        against_model: compare A with the robot's model in the same motion.
        robot: robot to compare; NAME,NAME if the robot's name differs in A and B.
        source: source to read; NAME,NAME for A and B (default: all sources).
        offset: offset in seconds added to the times of B; auto estimates it from the motion.
        plot: draw a figure: .png, .pdf or .svg.
        csv: write both recordings and their difference to a table.
        table: write one row per recording to a table.
        output: write a page that plays A and B, with explanations of the difference on the
            timeline, or a report (.md).
        render: render a video of A with the difference as arrows, and a transparent double for B.
        tolerance_torque: maximum difference in measured torques, in Nm or N; exit with 1 if
            exceeded.
        tolerance_angle: maximum difference in joint values, in degrees or mm; exit with 1 if
            exceeded.
        as_json: print the result as JSON.
        quiet: print no table and no progress bar.
    """

    notes: ClassVar[str] = ""
    a: Annotated[Path, positional("A.mcap")]
    b: Annotated[Path | None, positional("B.mcap")] = None
    more: Annotated[list[Path], positional("MORE.mcap")] = []
    each: bool = False
    against_model: bool = False
    robot: Flag = None
    offset: Annotated[
        float | Literal["auto"], expecting("a number of seconds, or auto"), Option("S|auto")
    ] = 0.0
    plot: Figure | None = None
    csv: Annotated[Path | None, ending(".csv"), Option("OUT.csv")] = None
    table: Annotated[Path | None, ending(".csv"), Option("OUT.csv")] = None
    output: Annotated[
        Path | None, ending(".html", ".md"), Option("OUT.html", ("-o", "--output"))
    ] = None
    render: Annotated[Path | None, ending(*VIDEO_FORMATS), Option("OUT.mp4")] = None
    tolerance_torque: Annotated[NotNegative | None, Option("NM")] = None
    tolerance_angle: Annotated[NotNegative | None, Option("DEG")] = None
    quiet: bool = False

    @model_validator(mode="after")
    def _check_combination(self) -> Self:
        self.check_combination()
        return self

    def check_combination(self) -> None:
        """Raises ValueError or UsageError if the options cannot be combined."""
        if self.b is not None and self.against_model and not self.each:
            expected = "one recording, or the option --each"
            raise ValueError(f"--against-model: found a second recording; expected {expected}")
        if self.b is None or self.each:
            why = "--each" if self.each else "a single recording"
            self.refuse(("offset", "tolerance_angle"), f" cannot be combined with {why}")
        if self.is_batch:
            why = " needs a single comparison. Use --table for several."
            self.refuse(("plot", "output", "render", "csv"), why)
        else:
            self.refuse(("jobs", "engine"), " needs --table or --each")

    @property
    def is_batch(self) -> bool:
        """Whether the result has one row per recording."""
        return self.each or bool(self.more) or self.table is not None

    def compare(self) -> int:
        """Compares the recordings.

        Returns 0, 1 if a tolerance is exceeded, or 2 if a recording cannot be compared.
        """
        return _compare_many(self) if self.is_batch else _compare_two(self)


def add_to(commands: Commands) -> None:
    """Adds the command, with the options of all comparisons, to the program's parser."""
    kinds = load_all(COMPARISONS, CompareOptions).values()
    summary, *_ = str(CompareOptions.__doc__).splitlines()
    kind = create_model("AllOptions", __base__=(*kinds, CompareOptions), __doc__=summary)
    text = "\n".join([_HELP, *(each.notes for each in kinds)])
    command("compare", kind.compare, kind, text)(commands)


def _compare_two(options: CompareOptions) -> int:
    from ..study.compare import (
        as_json,
        as_table,
        compare,
        exceeded,
        explanations_table,
        next_lines,
        write_csv,
    )

    pair, explanations, about = _compared(options)
    if not pair.signals:
        raise UsageError(f"{pair.names[0]} and {pair.names[1]} have no common signal")
    differences = compare(pair)
    over = exceeded(differences, **_tolerances(options))
    if options.tolerance_torque is not None and "torques" not in pair.signals:
        raise UsageError("--tolerance-torque needs torques in both recordings")
    if options.as_json:
        found = as_json(pair, differences, explanations)
        print_json({**found, "about": about, "exceeded": list(map(str, over))})
    elif not options.quiet:
        print_table(as_table(pair, differences))
        if pair.correlation is not None:
            print(f"offset {pair.offset:+.4f} s, correlation of the motions {pair.correlation:.3f}")
        print_wrapped(about)
        if explanations is not None:
            print_table(explanations_table(pair, explanations))
            print_wrapped(next_lines(explanations))
    if options.csv is not None:
        write_csv(pair, options.csv)
    if options.plot is not None:
        from ..study.plot import plot_pair

        plot_pair(pair, options.plot, explanations=explanations or ())
    if options.output is not None and options.output.suffix.lower() == ".md":
        from ..study.verdict_report import write_markdown

        verdicts = explanations or []
        write_markdown(pair, differences, verdicts, about, options.output, options.plot)
    elif options.output is not None:
        _page(pair, options.output, explanations or [], options)
    if options.render is not None:
        _render(pair, options.render, options)
    for each in over:
        print(f"sero-mj: {each}", file=sys.stderr)
    return 1 if over else 0


def outcomes(shared: Mapping[str, Any], file: Path) -> dict[str, Any]:
    """Compares one recording of a batch; returns a mapping from column names to results.

    `shared` contains the options of the command. The columns are the duration (`seconds`), `peak`
    and `rms` of each signal at its worst `joint`, the `exceeded` tolerances, the explanations
    (`explained`), and their short forms (`faults`).
    """
    from ..study.compare import compare, exceeded

    single = {key: value for key, value in shared.items() if key not in _BATCH_OPTIONS}
    option = "a" if shared.get("each") else "b"
    options = CompareOptions(**{**single, option: str(file)})
    pair, explanations, _ = _compared(options)
    differences = compare(pair)
    row: dict[str, Any] = {"seconds": float(pair.times[-1] - pair.times[0])}
    for signal in pair.signals:
        found = [each for each in differences if each.signal == signal]
        worst = max(found, key=lambda each: np.nan_to_num(abs(each.peak), nan=-1.0))
        if np.isnan(worst.peak):
            continue
        row |= {f"{signal}.peak": worst.peak, f"{signal}.rms": worst.rms,
                f"{signal}.unit": worst.unit, f"{signal}.joint": worst.joint}  # fmt: skip
    if pair.correlation is not None:
        row |= {"offset": pair.offset, "correlation": pair.correlation}
    over = exceeded(differences, **_tolerances(options))
    long = [f"{each.joint}: {each}" for each in explanations or ()]
    first = "" if shared.get("each") else options.a.name
    short = [f"{each.joint}: {_short_in(each, first)}" for each in explanations or ()]
    return {**row, "exceeded": "; ".join(map(str, over)), "explained": "; ".join(long),
            "faults": "; ".join(short)}  # fmt: skip


def _short_in(fault: Explanation, first: str) -> str:
    is_in_first = bool(first) and not fault.is_second and fault.kind in OF_ONE_RUN
    return fault.short.removesuffix(" in B") + (f" in {first}" if is_in_first else "")


def _compare_many(options: CompareOptions) -> int:
    from ..study.align import choose_robot
    from .each_recording import examine_each, report_rows

    others = [path for path in (options.b, *options.more) if path is not None]
    recordings = [options.a, *others] if options.each else others
    needed = [] if options.each else [options.a]
    if needed:  # report an error in A once, not for each recording
        of_a, _, _ = (options.source or "").partition(",")
        name, _, _ = (options.robot or "").partition(",")
        choose_robot(options.read(options.a, of_a or None), name or None)
    needed += options.files()
    rows = examine_each(options, f"{__name__}:outcomes", recordings, needed, quiet=options.quiet)
    # With --each, both sides have the same angles.
    signals = {"torques": "torque peak"} | ({} if options.each else {"joint_angles": "angle peak"})
    status = report_rows(
        rows,
        len(recordings),
        options,
        options.table,
        lambda: _table_of(rows, signals, "" if options.each else f"each minus {options.a}"),
        quiet=options.quiet,
    )
    over = [(path, row["exceeded"]) for path, row in rows if row.get("exceeded")]
    for path, text in over:
        print(f"sero-mj: {path}: {text}", file=sys.stderr)
    return status or (1 if over else 0)


def _table_of(rows: Rows, signals: Mapping[str, str], title: str) -> Table:
    from rich.table import Table

    from ..study.compare import shown_as

    table = Table(box=None, pad_edge=False, title=title, title_justify="left", title_style="bold")
    headings = [each for heading in signals.values() for each in (heading, "at")]
    numbers = ("over", *signals.values())
    for heading in ("recording", "over", *headings):
        table.add_column(heading, justify="right" if heading in numbers else "left", no_wrap=True)
    table.add_column("explained by", max_width=_WIDTH)
    for path, row in rows:
        cells = [f"{row['seconds']:.3g} s" if "seconds" in row else ""]
        for signal in signals:
            peak = row.get(f"{signal}.peak")
            factor, unit = shown_as(row.get(f"{signal}.unit", ""))
            cells.append("" if peak is None else f"{factor * peak:.3g} {unit}")
            cells.append(row[f"{signal}.joint"] if peak else "")
        error = f"not examined: {row['error'].removeprefix(f'{path}: ')}"
        table.add_row(str(path), *cells, row.get("faults", error) or "no difference found")
    return table


_Compared = tuple["Pair", "list[Explanation] | None", list[str]]


def _compared(options: CompareOptions) -> _Compared:
    a, *others = _read(options)
    return _two_runs(a, others[0], options) if others else _one_run(a, options)


def _two_runs(a: RunLog, b: RunLog, options: CompareOptions) -> _Compared:
    from ..study.align import align, choose_robots
    from ..study.explanation import find_explainer

    pair = align(a, b, options.robot, options.offset)
    robots = choose_robots(a, b, options.robot)
    if "torques" not in pair.signals:
        return pair, None, ["no explanation: both recordings must have torques"]
    explainer = find_explainer()
    if explainer is None:
        return pair, None, []
    try:
        return pair, *explainer.of_two(a, b, robots, pair.offset)
    except UsageError as error:
        return pair, None, [f"no explanation: {error}"]


def _one_run(run: RunLog, options: CompareOptions) -> _Compared:
    from ..study.align import choose_robot, pair_with_commands
    from ..study.explanation import differing, find_explainer

    name, explainer = choose_robot(run, options.robot), find_explainer()
    if options.against_model:
        if explainer is None:
            raise UsageError("--against-model needs an extension that explains differences")
        return explainer.with_model(run, name)
    pair = pair_with_commands(run, name)
    if explainer is None:
        return pair, None, []
    try:
        found, about = explainer.of_one(run, name)
    except UsageError as error:
        return pair, None, [f"no explanation: {error}"]
    return pair, differing(pair, found), about


def _tolerances(options: CompareOptions) -> dict[str, float | None]:
    angle = options.tolerance_angle
    known = {} if angle is None else {"angle": math.radians(angle), "travel": 1e-3 * angle}
    return {"torque": options.tolerance_torque, **known}


def _read(options: CompareOptions) -> list[RunLog]:
    of_a, _, of_b = (options.source or "").partition(",")
    wanted = [(options.a, of_a), (options.b, of_b or of_a)]
    return [options.read(path, source or None) for path, source in wanted if path is not None]


def _page(
    pair: Pair, output: Path, explanations: Sequence[Explanation], options: CompareOptions
) -> None:
    from ..study.compare import compare_scene
    from ..study.explanation_marks import marks_of_explanations
    from ..viewer.player.page import export_html

    last = float(pair.times[-1] - pair.times[0])
    marks = marks_of_explanations(pair, explanations)
    compared = pair.names if options.b is None else (str(options.a), str(options.b))
    with progress_bar("collecting", quiet=options.quiet) as update:
        export_html(
            compare_scene(pair), output, seconds=last, marks=marks, on_progress=update,
            meanings=dict(zip("AB", compared, strict=True)),
        )  # fmt: skip


def _render(pair: Pair, output: Path, options: CompareOptions) -> None:
    from ..study.compare import compare_scene
    from .render import video_with_progress

    duration = float(pair.times[-1] - pair.times[0])
    video = VideoOptions.taken_from(options).model_copy(update={"duration": duration, "wait": 0.0})
    video_with_progress(compare_scene(pair), output, video, quiet=options.quiet)
