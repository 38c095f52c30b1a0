from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from conftest import raises_with
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.colors import to_rgb
from matplotlib.legend import Legend
from matplotlib.text import Text
from PIL import Image
from runs import simulated, sine_run, two_joints

from sero_mj import SerialRobot
from sero_mj.base.errors import RenderError, UsageError
from sero_mj.base.reduction import envelope, peak, rms
from sero_mj.simulate.runs.monitor import Finding
from sero_mj.simulate.runs.run_log import RunLog
from sero_mj.study.align import align
from sero_mj.study.figure import BLUE, FAULT, INK, ORANGE, Figure, Span, save_figures, styled
from sero_mj.study.plot import plot_pair, plot_run, spans_of


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that were made; each has one legend."""
    made: list[Figure] = []
    legend = Figure.legend

    def keep(self: Figure, handles: Any) -> None:
        made.append(self)
        legend(self, handles)

    monkeypatch.setattr(Figure, "legend", keep)
    return made


def legend_of(figure: Figure) -> list[str]:
    (legend,) = figure.figure.findobj(Legend)
    return [text.get_text() for text in legend.get_texts()]


def line(panel: object, label: str) -> np.ndarray:
    """Returns the points of a line, (k, 2)."""
    found = [each for each in panel.lines if each.get_label() == label]  # type: ignore[attr-defined]
    assert len(found) == 1, label
    return np.asarray(found[0].get_xydata())


def pixels_of(path: Path, figure: Figure, panel: object) -> np.ndarray:
    """Returns the pixels within a panel's frame, (h, w, 3)."""
    picture = np.asarray(Image.open(path).convert("RGB")).astype(int)
    box = panel.get_window_extent()  # type: ignore[attr-defined]
    at = box.transformed(figure.figure.transFigure.inverted())
    height, width = picture.shape[:2]
    return picture[
        round((1 - at.y1) * height) : round((1 - at.y0) * height),
        round(at.x0 * width) : round(at.x1 * width),
    ]


def share_of(pixels: np.ndarray, colour: str) -> float:
    wanted = np.rint(255 * np.array(to_rgb(colour)))
    return float((np.abs(pixels - wanted).max(axis=-1) < 12).mean())


@pytest.mark.thorough
@pytest.mark.slow
def test_every_panel_has_its_lines_in_their_colors(tmp_path: Path, figures: list[Figure]) -> None:
    log = simulated().log
    path = tmp_path / "run.png"
    plot_run(log, path, findings=[Finding(0.2, "lwr", "A3", "torque_error", 9.0, 1.0)],
             spans=[Span("push", 0.1, 0.2), Span("broken", 0.3, None, True)])  # fmt: skip
    (figure,) = figures
    assert [len(row) for row in figure.axes] == [2] * 7
    texts = [text.get_text() for text in figure.figure.findobj(Text)]
    assert all(name in texts for name in (*log.robots["lwr"].names, "swing"))
    for k, (torques, error) in enumerate(figure.axes):
        measured, commanded = line(torques, "torques"), line(torques, "commanded_torques")
        np.testing.assert_array_equal(measured[:, 1], log.of("lwr", "torques")[:, k])
        np.testing.assert_array_equal(commanded[:, 1], log.of("lwr", "commanded_torques")[:, k])
        shown = line(error, "difference")
        np.testing.assert_array_equal(shown[:, 1], log.torque_error("lwr")[:, k])
        for panel in (torques, error):
            low, high = panel.get_ylim()
            for curve in (measured, commanded) if panel is torques else (shown,):
                assert low < np.nanmin(curve[:, 1]) <= np.nanmax(curve[:, 1]) < high
        pixels = pixels_of(path, figure, torques)
        assert share_of(pixels, ORANGE) > 1e-3
        assert share_of(pixels, BLUE) > 1e-3
        assert share_of(pixels_of(path, figure, error), INK) > 1e-4
    marks = [[each for each in panel.lines if each.get_label() == "torque error detected"]
             for row in figure.axes for panel in row]  # fmt: skip
    assert [bool(each) for each in marks] == [i == 7 for i in range(14)]  # A3, its error
    assert share_of(pixels_of(path, figure, figure.axes[3][1]), FAULT) > 1e-3
    legend = legend_of(figure)
    assert legend == ["commanded", "measured", "disturbance", "fault", "torque error detected"]


def test_limits_are_drawn_where_torques_come_close(tmp_path: Path, figures: list[Figure]) -> None:
    robot = two_joints(torque_limits=[6.0, 1000.0])
    plot_run(sine_run(robot=robot), tmp_path / "limits.png")
    turn, slide = figures[0].axes[0][0], figures[0].axes[1][0]
    limits = [each.get_ydata()[0] for each in turn.lines if each.get_label() == "limit"]
    assert limits == [-6.0, 6.0]
    assert turn.get_ylim()[0] < -6.0 < 6.0 < turn.get_ylim()[1]
    assert not [each for each in slide.lines if each.get_label() == "limit"]
    assert "limit" in legend_of(figures[0])
    assert any("N" in title for title in [turn.get_title(loc="left")])
    assert turn.get_title(loc="left") == "torque, Nm or N"


def test_small_torques_are_in_the_unit_of_their_robot(
    tmp_path: Path, figures: list[Figure]
) -> None:
    robot = two_joints(torque_limits=[1e-5, 0.02])
    log = sine_run(robot=robot)
    small = {
        name: (1e-6 if "torques" in name else 1.0) * each for name, each in log.signals.items()
    }
    plot_run(replace(log, signals=small), tmp_path / "small.png")
    (figure,) = figures
    texts = [text.get_text() for text in figure.figure.findobj(Text)]
    assert "torque, uNm or mN" in texts and "limit 10 uNm\npeak 40 %" in texts
    measured = line(figure.axes[0][0], "torques")
    assert np.nanmax(np.abs(measured[:, 1])) == pytest.approx(4.0, rel=1e-3)


def test_peak_of_one_row_in_a_million_is_in_the_figure(
    tmp_path: Path, figures: list[Figure]
) -> None:
    log = sine_run(rate=1e5, duration=10.0)
    torques = log.of("arm", "torques")
    torques[654_321, 0] = 55.0
    begin = time.perf_counter()
    plot_run(log, tmp_path / "long.png")
    assert time.perf_counter() - begin < 10.0
    points = line(figures[0].axes[0][0], "torques")
    assert len(points) < 5000
    assert points[np.argmax(points[:, 1])].tolist() == [log.times[654_321], 55.0]


@given(
    values=st.lists(st.floats(-1e6, 1e6) | st.just(np.nan), min_size=1, max_size=300),
    bins=st.integers(1, 40),
)
def test_envelope_preserves_extremes_and_contains_only_samples(
    values: list[float], bins: int
) -> None:
    given_values = np.array(values)
    times = np.arange(len(values)) * 0.5
    at, kept = envelope(times, given_values, bins)
    assert len(at) <= 2 * bins + 2
    assert (np.diff(at) > 0).all()
    np.testing.assert_array_equal(kept, given_values[np.rint(at / 0.5).astype(int)])
    if np.isfinite(given_values).any():
        assert np.nanmin(kept) == np.nanmin(given_values)
        assert np.nanmax(kept) == np.nanmax(given_values)
    assert (at[0], at[-1]) == (times[0], times[-1])


def test_envelope_preserves_gaps() -> None:
    values = np.sin(np.arange(10_000) * 1e-2)
    values[4000:6000] = np.nan
    at, kept = envelope(np.arange(10_000.0), values, 100)
    inside = (at > 4000) & (at < 5990)
    assert inside.any()
    assert np.isnan(kept[inside]).all()


def test_missing_signals_are_omitted(tmp_path: Path, figures: list[Figure]) -> None:
    log = sine_run()
    signals = {key: log.signals[key] for key in ("arm_joint_angles", "arm_torques")}
    plot_run(
        RunLog(log.robots, signals, log.times, "measured"), tmp_path / "m.svg", joints=["turn"]
    )
    (figure,) = figures
    assert [len(row) for row in figure.axes] == [1]
    blank = {**log.signals, "arm_torques": np.full((4001, 2), np.nan)}
    plot_run(RunLog(log.robots, blank, log.times, "blank"), tmp_path / "b.pdf")
    assert [text.get_text() for text in figures[1].axes[0][1].texts] == ["no data"]


def test_invalid_plots_are_rejected(tmp_path: Path) -> None:
    log = sine_run()
    with raises_with(
        UsageError,
        file=f"{tmp_path}/x.jpg",
        found=".jpg",
        expected="a name that ends in .png, .pdf, .svg",
    ):
        plot_run(log, tmp_path / "x.jpg")
    with raises_with(UsageError, reason="no robot", found="arn", of="in run", near="arm"):
        plot_run(log, tmp_path / "x.png", robots=["arn"])
    with raises_with(UsageError, reason="no joint", found="tur", of="in run", near="turn"):
        plot_run(log, tmp_path / "x.png", joints=["tur"])
    angles = RunLog(
        log.robots, {"arm_joint_angles": log.signals["arm_joint_angles"]}, log.times, "angles"
    )
    with raises_with(
        UsageError,
        key="run angles",
        reason="has no torques of robot 'arm'",
        expected="torques or commanded_torques",
    ):
        plot_run(angles, tmp_path / "x.png")
    expected = {"found": 1e6, "of": "mm wide", "expected": "60 mm to 2000 mm"}
    with raises_with(UsageError, key="size_mm", **expected):
        plot_run(log, tmp_path / "x.png", size_mm=(1e6, 100.0))
    missing = "cannot be written: No such file or directory"
    with raises_with(RenderError, reason=f"{tmp_path}/nowhere/x.png {missing}"):
        plot_run(log, tmp_path / "nowhere" / "x.png")


@pytest.mark.parametrize("last", [0.001, 5.0, 100.0, 12345.0])
def test_label_at_the_last_tick_is_not_clipped(tmp_path: Path, last: float) -> None:
    with styled():
        figure = Figure(
            [("A1", "")],
            [("torque", 1.25), ("error", 1.0)],
            title="",
            subtitle="",
            times=(0.0, last),
        )
        save_figures([figure], tmp_path / "x.png")
        labels = [each.get_window_extent() for each in figure.axes[0][1].get_xticklabels()]
        end = figure.axes[0][1].get_window_extent().x1
        shown = [box.x1 for box in labels if box.x0 <= end and box.width > 1]
    assert len(shown) >= 3
    assert max(shown) < figure.figure.bbox.width - 1


def test_figure_is_as_wide_as_a4_and_has_print_resolution(tmp_path: Path) -> None:
    plot_run(sine_run(), tmp_path / "a4.png")
    with Image.open(tmp_path / "a4.png") as picture:
        assert picture.width / 300.0 * 25.4 == pytest.approx(190.0, abs=0.1)
        assert picture.info["dpi"][0] == pytest.approx(300.0, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".png", ".pdf", ".svg"])
def test_two_figures_of_one_run_are_identical_files(tmp_path: Path, suffix: str) -> None:
    one, two = tmp_path / f"one{suffix}", tmp_path / f"two{suffix}"
    before = dict(mpl.rcParams)
    plot_run(sine_run(duration=0.5), one)
    plot_run(sine_run(duration=0.5), two)
    assert one.read_bytes() == two.read_bytes()
    assert dict(mpl.rcParams) == before


@pytest.mark.thorough
@pytest.mark.slow
def test_matplotlib_is_imported_for_a_figure_and_pyplot_never(tmp_path: Path) -> None:
    code = (
        "import sys; import sero_mj.study.plot;"
        "print('matplotlib' in sys.modules);"
        "from runs import sine_run; sero_mj.study.plot.plot_run(sine_run(), sys.argv[1]);"
        "print('matplotlib.pyplot' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "x.png")],
        capture_output=True, text=True, cwd=Path(__file__).parent, check=True,
    )  # fmt: skip
    assert done.stdout.split() == ["False", "False"]


@pytest.mark.slow
@pytest.mark.thorough
def test_comparison_shows_both_torques_and_both_differences(
    tmp_path: Path, figures: list[Figure]
) -> None:
    a, b = simulated(800.0).log, simulated(2000.0).log
    path = tmp_path / "both.png"
    plot_pair(align(a, b), path)
    (figure,) = figures
    assert [len(row) for row in figure.axes] == [3] * 7
    titles = [panel.get_title(loc="left") for panel in figure.axes[0]]
    assert titles == ["torque, Nm", "torque, A − B, Nm", "angle, A − B, deg"]
    for k, (both, torque, angle) in enumerate(figure.axes):
        np.testing.assert_array_equal(line(both, "a")[:, 1], a.of("lwr", "torques")[:, k])
        np.testing.assert_array_equal(line(both, "b")[:, 1], b.of("lwr", "torques")[:, k])
        difference = a.of("lwr", "torques")[:, k] - b.of("lwr", "torques")[:, k]
        np.testing.assert_array_equal(line(torque, "difference")[:, 1], difference)
        degrees = np.rad2deg(a.of("lwr", "joint_angles")[:, k] - b.of("lwr", "joint_angles")[:, k])
        np.testing.assert_allclose(line(angle, "difference")[:, 1], degrees, atol=1e-12)
        pixels = pixels_of(path, figure, both)
        assert share_of(pixels, ORANGE) > 1e-3
        assert share_of(pixels, BLUE) > 1e-4
    only = {"arm_joint_angles": sine_run().signals["arm_joint_angles"]}
    angles = RunLog(sine_run().robots, only, sine_run().times, "angles")
    plot_pair(align(angles, sine_run()), tmp_path / "angles.png", joints=["slide"])
    assert [panel.get_title(loc="left") for panel in figures[1].axes[0]] == [
        "angle, mm",
        "angle, A − B, mm",
    ]
    joints = ["A1", "A2", "E1", "A3", "A4", "A5", "A6"]
    with raises_with(UsageError, reason="no joint", found="A9", of="of lwr", available=joints):
        plot_pair(align(a, b), tmp_path / "x.png", joints=["A9"])


def test_disturbances_and_faults_of_a_scenario_become_spans() -> None:
    from sero_mj.simulate.scenario import Scenario

    scene = simulated().scenario.scene
    scenario = Scenario(
        scene,
        disturbances={"push": {"kind": "force", "at": "lwr/flange", "force": [0, 0, 9.0],
                               "begin": 0.1, "end": 0.2}},
        faults={"dead": {"kind": "dead_sensor", "begin": 0.3}},
    )  # fmt: skip
    assert spans_of(scenario) == [Span("push", 0.1, 0.2), Span("dead", 0.3, None, True)]


def test_span_labels_do_not_overlap(tmp_path: Path, figures: list[Figure]) -> None:
    spans = [Span("a_first_disturbance", 0.5 + 0.1 * k, 3.0) for k in range(3)]
    plot_run(sine_run(), tmp_path / "x.png", spans=spans)
    names = [
        text for text in figures[0].axes[0][0].texts if text.get_text() == "a_first_disturbance"
    ]
    boxes = [name.get_window_extent() for name in names]
    assert len(boxes) == 3
    assert not any(a.overlaps(b) for k, a in enumerate(boxes) for b in boxes[k + 1 :])


def test_peak_and_rms_ignore_unknown_values() -> None:
    values = np.array([np.nan, 3.0, -4.0, np.inf])
    assert peak(values) == 2
    assert rms(values) == pytest.approx(np.sqrt(12.5))
    assert peak(np.full(3, np.nan)) is None and np.isnan(rms(np.full(3, np.nan)))


@pytest.mark.thorough
def test_many_joints_are_split_into_pages_or_the_most_loaded_shown(
    tmp_path: Path, figures: list[Figure]
) -> None:
    robots, signals, times = {}, {}, np.arange(5) * 0.1
    for name, n, scale in (("a", 5, 1.0), ("b", 9, 5.0), ("c", 9, 2.0)):
        robots[name] = SerialRobot(
            name=name, dh_convention="craig", dh_params=np.zeros((n, 4)), torque_limits=[10.0] * n
        )
        signals[f"{name}_torques"] = np.outer(np.ones(5), np.linspace(0.1, 1.0, n) * scale)
    log = RunLog(robots, signals, times, "many")

    def pages(file: str, **options: Any) -> list[list[str]]:
        figures.clear()
        plot_run(log, tmp_path / file, **options)
        return [[row[0].texts[0].get_text() for row in each.axes] for each in figures]

    assert pages("many.pdf") == [[f"J{k + 1}" for k in range(n)] for n in (5, 9, 9)]
    assert pages("many.png") == [[f"J{k}" for k in (*range(3, 10), *range(5, 10))]]
    asked = pages("many.png", joints=[f"J{k + 1}" for k in range(9)])
    assert [len(page) for page in asked] == [23]
