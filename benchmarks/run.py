"""Measures the time for decor, frames, kinematics and start-up, and compares it with MuJoCo.

    make bench                      all measurements (a few minutes with software rendering)
    .venv/bin/python benchmarks/run.py --quick

Times are medians of alternating measurements, so that other load affects all of them.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from sero_mj.viewer.image.backend import choose_backend

choose_backend()

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table
from worlds import WORLDS, make_world

from sero_mj import HeadlessRenderer, Placer, World
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.toggles import Toggles
from sero_mj.viewer.image.camera import find_camera
from sero_mj.viewer.image.picking import pick

Row = tuple[str, str, str, str, str]
SIZE = (1280, 800)
_BARE = """
import mujoco
model = mujoco.MjModel.from_xml_path({path!r})
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
model.vis.global_.offwidth, model.vis.global_.offheight = 1280, 800
with mujoco.Renderer(model, 800, 1280) as renderer:
    renderer.update_scene(data)
    pixels = renderer.render()
from PIL import Image
Image.fromarray(pixels).save({out!r})
"""


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def alternate(works: list[Callable[[], object]], rounds: int) -> list[float]:
    """Calls functions alternately; returns the median time of each function, s."""
    times = np.array([[seconds(work) for work in works] for _ in range(rounds)])
    return [float(t) for t in np.median(times, axis=0)]


def with_doubles(rounds: int) -> list[Row]:
    """Measures layout, frame, geoms, pick and place for 51 joints with doubles and all features."""
    world = make_world(WORLDS[51], doubles=True)
    data, placer = world.make_data(), Placer(world)
    placer.place(data)
    rng = np.random.default_rng(4)
    with HeadlessRenderer(world, *SIZE) as renderer:
        toggles = renderer.toggles
        everything = toggles.snapshot()

        def frame(bare: bool) -> None:
            toggles.restore(everything)
            if bare:
                toggles.arrows[:] = toggles.billboards[:] = toggles.axes[:] = False
                toggles.doubles[:] = False
            renderer.render(data)

        bare, full = alternate([lambda: frame(True), lambda: frame(False)], rounds)
        view, decor = renderer.decor.view, Decor(world)
        assert view is not None
        pixels = iter(rng.uniform((0, 0), SIZE, (100_000, 2)))
        (laid_out,) = alternate([lambda: decor.draw(data, toggles, view)], rounds * 20)
        (picked,) = alternate(
            [lambda: pick(world, data, decor.buffer, view, tuple(next(pixels)))], rounds * 40
        )
        (placed,) = alternate([lambda: placer.place(data)], rounds * 20)
    name = "51 joints and doubles"
    return [
        (f"layout, {name}", f"{laid_out * 1e3:.2f} ms", "", "", "under 2 ms"),
        (f"geoms, {name}", f"{decor.buffer.count}", f"{decor.buffer.dropped} dropped", "",
         "at most 1024"),
        (f"frame 1280x800, {name}", f"{full * 1e3:.1f} ms", f"bare {bare * 1e3:.1f} ms",
         f"{full / bare:.2f}", "at most 1.5"),
        (f"pick, {name}", f"{picked * 1e3:.2f} ms", "", "", "under 2 ms"),
        (f"place, {name}", f"{placed * 1e3:.2f} ms", "", "", ""),
    ]  # fmt: skip


def layout(rounds: int) -> list[Row]:
    """Measures the layout of decor for robots at rest and for moving robots."""
    rows = []
    goals = {7: "at most 200", 51: "at most 120"}
    for n, counts in WORLDS.items():
        world = make_world(counts)
        data, decor, toggles = world.make_data(), Decor(world), Toggles(world)
        with HeadlessRenderer(world, *SIZE) as renderer:
            renderer.render(data)
            view = renderer.decor.view
        assert view is not None
        start, angles = data.qpos.copy(), iter(np.linspace(0, 0.5, rounds * 20))

        def move() -> None:
            data.qpos[:] = start + next(angles)
            mujoco.mj_kinematics(world.model, data)

        times = {}
        for how, between in (("at rest", lambda: None), ("moving", move)):
            _, *times[how] = alternate(
                [
                    between,
                    lambda: decor.draw(data, toggles, view),
                    lambda: mujoco.mj_kinematics(world.model, data),
                ],
                rounds * 20,
            )
        rows += [
            (f"layout, {n} joints, {how}, {decor.buffer.count} geoms", f"{draw * 1e3:.3f} ms",
             f"mj_kinematics {kinematics * 1e3:.3f} ms", f"{draw / kinematics:.1f}",
             goals.get(n, "") if how == "at rest" else "")
            for how, (draw, kinematics) in times.items()
        ]  # fmt: skip
    return rows


def frames(rounds: int) -> list[Row]:
    """Measures headless frames with decor, relative to frames without decor."""
    rows = []
    for n, counts in WORLDS.items():
        world = make_world(counts)
        data = world.make_data()
        with HeadlessRenderer(world, *SIZE) as renderer:
            toggles = renderer.toggles

            def shown(arrows: bool, billboards: bool, axes: bool) -> None:
                toggles.arrows[:], toggles.billboards[:] = arrows, billboards
                toggles.axes[:] = axes
                renderer.render(data)

            cases = [(False, False, False), (True, True, False), (True, True, True)]
            for case in cases:
                shown(*case)
            bare, labelled, full = alternate([lambda c=c: shown(*c) for c in cases], rounds)
        for name, value in (("arrows, billboards", labelled), ("with axes", full)):
            goal = "at most 1.25" if n == 7 else ""
            rows.append(
                (f"frame 1280x800, {n} joints, {name}", f"{value * 1e3:.1f} ms",
                 f"bare {bare * 1e3:.1f} ms", f"{value / bare:.2f}", goal)
            )  # fmt: skip
    return rows


def kinematics(rounds: int) -> list[Row]:
    """Measures DH kinematics in NumPy relative to MuJoCo, for one pose and for 1000 poses."""
    world = make_world([7])
    data = world.make_data()
    table = world.robots["robot0"].robot.dh
    q = np.random.default_rng(2).uniform(-1, 1, (1000, 7))

    def batch() -> None:
        for row in q:
            data.qpos[:] = row
            mujoco.mj_kinematics(world.model, data)

    one, many, mj_one, mj_many = alternate(
        [lambda: table.frames(q[0]), lambda: table.frames(q),
         lambda: mujoco.mj_kinematics(world.model, data), batch], rounds * 5,
    )  # fmt: skip
    return [
        ("dh.frames, 7 joints, one pose", f"{one * 1e6:.0f} us",
         f"mj_kinematics {mj_one * 1e6:.1f} us", f"{one / mj_one:.0f}", ""),
        ("dh.frames, 1000 poses at once", f"{many * 1e6:.0f} us",
         f"1000 mj_kinematics {mj_many * 1e6:.0f} us", f"{many / mj_many:.2f}", ""),
    ]  # fmt: skip


def start_up(rounds: int) -> list[Row]:
    """Measures the time to the first image, relative to plain MuJoCo with the exported scene."""
    with tempfile.TemporaryDirectory() as folder:
        xml, out = Path(folder) / "lwr.xml", Path(folder) / "lwr.png"
        command = [sys.executable, "-m", "sero_mj"]
        subprocess.run([*command, "export", "lwr", str(xml)], check=True, stdout=subprocess.DEVNULL)
        bare = [sys.executable, "-c", _BARE.format(path=str(xml), out=str(out))]
        ours = [*command, "render", "lwr", "-o", str(out), "--quiet"]
        a, b = alternate(
            [lambda: subprocess.run(ours, check=True), lambda: subprocess.run(bare, check=True)],
            max(rounds // 4, 3),
        )
        nothing, ours_import = alternate(
            [lambda: subprocess.run([sys.executable, "-c", "pass"], check=True),
             lambda: subprocess.run([sys.executable, "-c", "import sero_mj"], check=True)],
            max(rounds // 4, 5),
        )  # fmt: skip
    cost = ours_import - nothing
    return [
        ("sero-mj render, to the first image", f"{a:.2f} s",
         f"bare mujoco {b:.2f} s", f"{a / b:.2f}", "at most 1.4"),
        ("import sero_mj", f"{cost * 1e3:.0f} ms",
         f"python -c pass {nothing * 1e3:.0f} ms", f"{cost / nothing:.2f}", "under 100 ms"),
    ]  # fmt: skip


def memory(count: int) -> list[Row]:
    """Measures resident memory after many frames, relative to the memory after a few frames."""
    world: World = make_world([7])
    data, decor, toggles = world.make_data(), Decor(world), Toggles(world)
    find_camera(world)
    with HeadlessRenderer(world, 64, 64) as renderer:
        renderer.render(data)
        view = renderer.decor.view
        assert view is not None
        q = np.random.default_rng(3).uniform(-1, 1, (97, 7))

        def run(n: int) -> float:
            for k in range(n):
                data.qpos[:] = q[k % len(q)]
                mujoco.mj_kinematics(world.model, data)
                decor.draw(data, toggles, view)
                if k % 100 == 0:
                    renderer.render(data)
            return resident_mib()

        before = run(count // 20)
        after = run(count)
    return [
        (f"memory after {count} frames", f"{after:.1f} MiB",
         f"after {count // 20}: {before:.1f} MiB", f"{after / before:.3f}", "no growth")
    ]  # fmt: skip


def resident_mib() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer rounds, 5,000 frames")
    options = parser.parse_args()
    rounds, count = (5, 5_000) if options.quick else (25, 100_000)
    console = Console(width=130)
    table = Table("measurement", "result", "reference", "ratio", "goal", title="sero-mj benchmarks")
    for case in (layout, with_doubles, frames, kinematics, start_up):
        console.print(f"measuring {case.__name__} ...", style="dim")
        for row in case(rounds):
            table.add_row(*row)
    if sys.platform == "linux":
        console.print("measuring memory ...", style="dim")
        for row in memory(count):
            table.add_row(*row)
    console.print(table)


if __name__ == "__main__":
    main()
