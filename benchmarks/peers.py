"""Compares the speed of sero-mj and other packages for the same tasks, and writes docs/peers.md.

    make peers
    .venv/bin/python benchmarks/peers.py --rounds 1 --only fk_one,control --out out/peers.md

Each package has a script in benchmarks/peers/ and a virtual environment in .peers/NAME, which is
created on first use (10 GB, from PyPI). All packages read the same two robots, which are written as
URDF. They perform each task alternately for several rounds, and the page shows the median. If a
task has a numerical result, all results must agree. Needs Chromium, Xvfb and a C compiler.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import Any

from sero_mj.viewer.image.backend import choose_backend

choose_backend()

import numpy as np
from worlds import WORLDS, make_world

from sero_mj import World
from sero_mj.load import load_scene
from sero_mj.viewer.image.camera import find_camera

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "peers"))
from urdf_of import write_urdf

ROOT = HERE.parent
FOLDER = ROOT / "out" / "peers"
AGREE = 1e-6
SETTLE = 4.0  # time until a page has loaded and draws, s
TIMEOUT = 300.0  # timeout of one task with one package, s
_BROWSER = [
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist", "--no-sandbox",
]  # fmt: skip


@dataclass(frozen=True)
class Peer:
    """A script of benchmarks/peers/ and its packages from PyPI, if it needs more than sero-mj."""

    title: str
    environment: str = ""
    packages: tuple[str, ...] = ()


PEERS = {
    "ours": Peer("sero-mj"),
    "bare_mujoco": Peer("MuJoCo alone"),
    "with_pinocchio": Peer(
        "Pinocchio", "pinocchio", ("pin>=3", "meshcat>=0.3", "yourdfpy>=0.0.56")
    ),
    "with_roboticstoolbox": Peer(
        "roboticstoolbox", "roboticstoolbox", ("roboticstoolbox-python>=1.1",)
    ),
    "with_viser": Peer("viser with yourdfpy", "viser", ("viser>=1", "yourdfpy>=0.0.56")),
    "with_rerun": Peer("rerun with yourdfpy", "rerun", ("rerun-sdk>=0.24", "yourdfpy>=0.0.56")),
    "with_gymnasium": Peer("Gymnasium's Pusher", "gymnasium", ("gymnasium[mujoco]>=1.1",)),
    "with_mjlab": Peer("mjlab, lifting a cube", "mjlab", ("mjlab>=1.6",)),
    # robosuite finds no joints with later versions of MuJoCo.
    "with_robosuite": Peer("robosuite", "robosuite", ("robosuite>=1.5", "mujoco<3.4")),
}


@dataclass(frozen=True)
class Work:
    """A measured task: heading, description, and the scripts that perform the task."""

    title: str
    does: str
    peers: tuple[str, ...]
    unit: str = "s"  # or "times mj_step", "packets/s"
    why: dict[str, str] = field(default_factory=dict)  # reasons why a package is faster
    names: dict[str, str] = field(default_factory=dict)  # titles that override those of `PEERS`


_ARRAYS = "sero-mj calls the same functions, but also checks its input and returns a new array"
_PINOCCHIO = (
    "it only computes the frames of the joints, while MuJoCo, which sero-mj uses, also computes "
    "the axes, quaternions and inertial frames of all links"
)
_PAGE = (
    "In each call, a loop at 100 Hz sets new angles and torques for all joints, while a browser "
    "shows the page with software rendering. sero-mj copies the numbers to memory that it shares "
    "with the viewer process, which computes arrows, sizes and labels. The other packages compute "
    "frames in the loop and send one message per link and per bar or arrow. "
    "For rerun, no viewer is connected to the server."
)
_WINDOW = (
    "The same task with a window on a virtual screen. With MuJoCo's passive viewer, the loop "
    "computes kinematics and adds an arrow for each joint."
)
_MESHCAT = {"with_pinocchio": "MeshCat with Pinocchio's visualizer"}
_COUNTS = "it only counts packets, and neither reads nor renders them"

WORKS = {
    "fk_one": Work(
        "Forward kinematics, one pose",
        "The flange of an LWR as a 4 x 4 matrix.",
        ("ours", "bare_mujoco", "with_pinocchio", "with_roboticstoolbox"),
        why={"bare_mujoco": _ARRAYS, "with_pinocchio": _PINOCCHIO},
    ),
    "fk_many": Work(
        "Forward kinematics, 1000 poses",
        "One call for all poses if the package supports it, or else a loop in Python.",
        ("ours", "bare_mujoco", "with_pinocchio", "with_roboticstoolbox"),
        why={"bare_mujoco": _ARRAYS, "with_pinocchio": _PINOCCHIO},
    ),
    "mass_gravity": Work(
        "Mass matrix and gravity",
        "M(q) and g(q) of an LWR.",
        ("ours", "bare_mujoco", "with_pinocchio", "with_roboticstoolbox"),
        why={"with_pinocchio": _PINOCCHIO},
    ),
    "control": Work(
        "Hand-written control step",
        "K (q_d - q) - D dq + g(q). sero-mj uses its joint impedance controller, which designs D "
        "from M(q) at 10 Hz, while the others use a constant D.",
        ("ours", "bare_mujoco", "with_pinocchio"),
        why={
            "bare_mujoco": "sero-mj also designs D and adds the feedforward terms of the target",
            "with_pinocchio": "sero-mj also designs D, and its kinematics computes more frames "
            "(see above)",
        },
    ),
    "joint_control": Work(
        "Joint control step",
        "sero-mj controls an LWR with joint impedance, and robosuite a Panda with "
        "`JOINT_POSITION`. Both times include updating the model. robosuite 1.5 needs a MuJoCo "
        "version before 3.4.",
        ("ours", "with_robosuite"),
    ),
    "cartesian_control": Work(
        "Cartesian control step",
        "sero-mj controls an LWR with Cartesian impedance, and robosuite a Panda with `OSC_POSE`.",
        ("ours", "with_robosuite"),
    ),
    "show_page_7": Work(
        "Display of 7 moving joints and torques on a page", _PAGE,
        ("ours", "with_viser", "with_pinocchio", "with_rerun"), names=_MESHCAT,
    ),
    "show_page_51": Work(
        "Display of 51 joints on a page", "The same task with 51 joints.",
        ("ours", "with_viser", "with_pinocchio", "with_rerun"), names=_MESHCAT,
    ),
    "show_window_7": Work(
        "Display of 7 joints in a window", _WINDOW, ("ours", "bare_mujoco"),
    ),
    "show_window_51": Work(
        "Display of 51 joints in a window",
        "The same task with 51 joints.",
        ("ours", "bare_mujoco"),
    ),
    "first_picture": Work(
        "From the start of Python to an image of a URDF",
        "An image of 640 x 480 pixels without a window.",
        ("ours", "bare_mujoco"),
        why={
            "bare_mujoco": "it renders the URDF without a floor, lights or shadows (see the next "
            "table), and only reads the elements that its own parser supports"
        },
    ),
    "first_scene": Work(
        "From the start of Python to an image of the same scene",
        "The same task, but MuJoCo reads the scene that sero-mj has exported from the URDF, with "
        "the same floor, lights, shadows and camera.",
        ("ours", "bare_mujoco"),
        why={"bare_mujoco": "sero-mj also reads and checks the URDF and compiles the scene"},
    ),
    "first_page": Work(
        "From the start of Python to an image of a URDF in a browser",
        "The browser is already running and opens the page as soon as it is served.",
        ("ours", "with_viser", "with_pinocchio"),
        names=_MESHCAT,
        why={
            "with_pinocchio": "its image has no shadows, and its server compiles no model"
        },
    ),
    "packet_to_pixel": Work(
        "From a UDP packet to pixels",
        "A packet is sent, received and applied, and then an image of 640 x 480 pixels is "
        "rendered. The scene, lights and camera are the same. sero-mj checks and counts packets in "
        "a separate thread.",
        ("ours", "bare_mujoco"),
        why={"bare_mujoco": "it has no separate thread, no packet checks, and no arrows or labels"},
    ),
    "packets": Work(
        "Packets per second without loss",
        "A sender in C sends 112-byte packets over loopback at increasing rates of up to "
        "400,000/s. At the same time, sero-mj renders 30 images per second, while the other "
        "programs do nothing else.",
        ("ours",),
        unit="packets/s",
        why={
            "recvmmsg loop in C, alone": _COUNTS,
            "recv_into loop in Python, alone": _COUNTS,
            "UdpReceiver, latest wins, rendering": "if several packets are waiting, it applies "
            "only the last one",
        },
    ),
    "environment": Work(
        "Environment step, one robot",
        "`sero_mj/lwr-reach-v0` (20 physics steps per action), `Pusher-v5` (5 steps) and mjlab's "
        "`Mjlab-Lift-Cube-Yam` (4 steps, with MuJoCo Warp on the CPU), relative to the same number "
        "of `mj_step` calls for the same model.",
        ("ours", "with_gymnasium", "with_mjlab"),
        unit="times mj_step",
        why={
            "with_gymnasium": "Pusher sets its controls once per action, while sero-mj computes "
            "sensors, a torque controller, drives with limits and a log in each physics step"
        },
    ),
    "environments": Work(
        "Environment step, 64 robots together",
        "The same task with `gymnasium.make_vec`, measured per robot. sero-mj uses all cores by "
        "default. mjlab is designed for GPUs and thousands of robots.",
        ("ours", "with_gymnasium", "with_mjlab"),
        unit="times mj_step",
    ),
}  # fmt: skip
LEFT_OUT = (
    ("Time to the first image with rerun", "its page does not signal when it has rendered"),
    (
        "Packet to pixel with viser and MeshCat",
        "neither package receives packets, so we would only measure our own code",
    ),
)


def prepare() -> None:
    """Writes the robots that all packages read: an LWR, and a robot with 51 joints."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for joints in (7, 51):
        world = make_world(WORLDS[joints])
        flange = list(world.robots.values())[-1].flange_body
        write_urdf(world.model, flange, FOLDER / f"robot{joints}.urdf")
        poses = np.random.default_rng(0).uniform(-1.0, 1.0, (1000, joints))
        np.save(FOLDER / f"poses{joints}.npy", poses)
    view = find_camera(World(load_scene(FOLDER / "robot7.urdf")))
    camera = [*view.lookat, view.distance, view.azimuth, view.elevation]
    np.save(FOLDER / "camera7.npy", camera)
    export = ["export", str(FOLDER / "robot7.urdf"), str(FOLDER / "scene7.xml"), "--quiet"]
    subprocess.run(
        [sys.executable, "-m", "sero_mj", *export], check=True, stdout=subprocess.DEVNULL
    )


def python_of(peer: Peer) -> str:
    """Returns the interpreter of a package's environment, which is created if necessary.

    Raises:
        RuntimeError: pip failed; contains the last line of its output.
    """
    if not peer.environment:
        return sys.executable
    folder = ROOT / ".peers" / peer.environment
    python, done = folder / "bin" / "python", folder / "installed.json"
    if not (done.exists() and json.loads(done.read_text()) == list(peer.packages)):
        print(f"installing {', '.join(peer.packages)} ...", flush=True)
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
        pip = [str(python), "-m", "pip", "install", "--quiet", *peer.packages]
        made = subprocess.run(pip, capture_output=True, text=True, check=False)
        if made.returncode:
            raise RuntimeError((made.stderr.strip() or "pip failed").splitlines()[-1])
        done.write_text(json.dumps(peer.packages))
    return str(python)


def run(name: str, work: str, browser: Any) -> Iterator[dict[str, Any]]:
    """Performs a task with a package; yields the measurements that the script prints.

    Raises:
        RuntimeError: the script failed; contains the last line of its output.
        OSError: a required program is missing.
    """
    command = [python_of(PEERS[name]), str(HERE / "peers" / f"{name}.py"), str(FOLDER), work]
    is_window = work.startswith("show_window")
    if is_window:
        command = ["xvfb-run", "-a", "-s", "-screen 0 1600x1000x24", *command]
    backend = {"MUJOCO_GL": "glfw" if is_window else os.environ["MUJOCO_GL"]}
    begin, told, pages = time.time(), 0, []
    with (FOLDER / "stderr.txt").open("w+") as errors, subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True,
        env=os.environ | backend, start_new_session=True,
    ) as process:  # fmt: skip
        assert process.stdin is not None and process.stdout is not None
        late = threading.Timer(TIMEOUT, os.killpg, [process.pid, signal.SIGKILL])
        late.start()
        try:
            for line in process.stdout:
                found = json.loads(line) if line.startswith("{") else {}
                if "at" in found:
                    found["seconds"] = found["at"] - begin
                if "seconds" in found:
                    told += 1
                    yield found
                if "url" in found:
                    pages.append(open_page(browser, found["url"], found["until"]))
                    if work.startswith("show"):
                        pages[-1].wait_for_timeout(1e3 * SETTLE)
                    process.stdin.write("\n")
                    process.stdin.flush()
            process.wait()
        finally:
            late.cancel()
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # all that it has started, too
            for page in pages:
                page.close()
        errors.seek(0)
        last = (errors.read().strip() or f"ended with {process.returncode}").splitlines()[-1]
    if not told:
        raise RuntimeError(last)


def open_page(browser: Any, url: str, until: str) -> Any:
    """Opens a page, and returns it as soon as the JavaScript condition `until` is true.

    Raises:
        RuntimeError: the page cannot be opened, or the condition does not become true in time.
    """
    from playwright.sync_api import Error

    page = browser.new_page(viewport={"width": 480, "height": 320})
    try:
        page.goto(url, wait_until="commit")
        if until:
            page.wait_for_function(until, timeout=1e3 * TIMEOUT)
    except Error as error:
        page.close()
        raise RuntimeError(str(error).splitlines()[0]) from error
    return page


@dataclass
class Row:
    """The times of a package for a task, one per round, or the reason why there are none."""

    title: str
    seconds: list[float] = field(default_factory=list)
    slow: list[float] = field(default_factory=list)  # 99th percentile of a call, s
    version: str = ""
    problem: str = ""

    @property
    def median(self) -> float:
        """Median time of all rounds, s."""
        return float(np.median(self.seconds))


def measure(key: str, rounds: int, browser: Any) -> dict[str, Row]:
    """Measures a task with all of its packages alternately; returns one row per package.

    Raises:
        SystemExit: the numerical results differ.
    """
    work, rows, results = WORKS[key], {}, {}
    for _ in range(1 if key == "packets" else rounds):
        for name in work.peers:
            title = work.names.get(name, PEERS[name].title)
            row = rows.setdefault(name, Row(title))
            if row.problem:
                continue
            try:
                for found in run(name, key, browser):
                    one = (
                        rows.setdefault(found["who"], Row(found["who"])) if "who" in found else row
                    )
                    one.seconds.append(found["seconds"])
                    one.slow += [found["slow"]] if "slow" in found else []
                    one.version = f"{found['package']} {found['version']}"
                    results[name] = np.array(found.get("result", []))
            except (RuntimeError, OSError) as error:
                row.problem = str(error)
    ours = results.get("ours", np.zeros(0))
    scale = float(np.abs(ours).max(initial=1.0))
    for name, result in results.items():
        if ours.size and result.size and not np.allclose(result, ours, rtol=0, atol=AGREE * scale):
            raise SystemExit(f"{key}: {name} found {result}; expected {ours}, as sero-mj")
    return {name: row for name, row in rows.items() if row.seconds or row.problem}


def text_of(seconds: float, unit: str) -> str:
    """Formats a time with a suitable unit, or a rate."""
    if unit == "packets/s":
        return f"{1.0 / seconds:,.0f}/s"
    if unit != "s":
        return f"{seconds:.2f}"
    factor, name = next(
        (factor, name) for factor, name in ((1.0, "s"), (1e3, "ms"), (1e6, "us"))
        if seconds * factor >= 1.0 or name == "us"
    )  # fmt: skip
    return f"{seconds * factor:.3g} {name}"


def table_of(key: str, rows: dict[str, Row]) -> str:
    """Returns the section of the page for a task."""
    work = WORKS[key]
    is_ours = [name for name in rows if name == "ours" or name.startswith("UdpReceiver")]
    reference = rows[is_ours[-1]] if is_ours else None
    has_slow = any(row.slow for row in rows.values())
    head = ["", work.unit if work.unit != "s" else "time", "relative"]
    head[2:2] = ["99th percentile"] if has_slow else []
    lines = [f"## {work.title}", "", work.does, "", f"| {' | '.join(head)} |"]
    lines.append("|" + "---|" * len(head))
    reasons = []
    for name, row in rows.items():
        if row.problem:
            lines.append(f"| {row.title} | not measured: {row.problem} |" + " |" * (len(head) - 2))
            continue
        ratio = row.median / reference.median if reference and reference.seconds else np.nan
        is_faster = ratio < 0.95
        ratio = 1.0 / ratio if work.unit == "packets/s" else ratio
        cells = [row.title, text_of(row.median, work.unit)]
        cells += [text_of(float(np.median(row.slow)), "s")] if has_slow else []
        cells.append("1" if row is reference else f"{ratio:.2g}" if ratio < 100 else f"{ratio:.0f}")
        lines.append(f"| {' | '.join(cells)} |")
        if is_faster:
            why = work.why.get(name, "the reason is unknown")
            reasons.append(f"{row.title} is faster: {why}.")
    return "\n".join([*lines, *(f"\n{reason}" for reason in reasons), ""])


def machine() -> str:
    """Returns a description of processor, cores and system."""
    about = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    names = [line.partition(":")[2].strip() for line in about.splitlines() if "model name" in line]
    name = names[0] if names else platform.processor() or platform.machine()
    return (
        f"{name}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"
    )


def page_of(found: dict[str, dict[str, Row]], rounds: int, busy: Sequence[float]) -> str:
    """Returns the page in Markdown.

    Args:
        found: rows of all tasks.
        rounds: number of rounds.
        busy: minimum and maximum load average of the machine during the measurement.
    """
    versions = sorted(
        {row.version for rows in found.values() for row in rows.values() if row.version}
    )
    loads = " to ".join(f"{load:.1f}" for load in sorted({round(each, 1) for each in busy}))
    how = "one round" if rounds == 1 else f"median of {rounds} rounds"
    head = f"""# Performance compared with other packages

This page shows how long sero-mj and other packages take for the same tasks. The packages were
measured alternately in one run ({how}). `make peers` repeats the measurements and
writes this page. If a task has a numerical result, the results of all packages agree to 1e-6.
Images are rendered in software, without a GPU. Load is the average number of processes that were
ready to run. If it exceeds the number of cores, all rendering times are too long. The last column
is the ratio to the value of sero-mj.

{date.today().isoformat()} · {machine()}, load {loads} · {", ".join(versions)}
"""
    left = "\n".join(f"- {what}: {why}." for what, why in LEFT_OUT)
    tables = "\n".join(table_of(key, rows) for key, rows in found.items())
    return f"{head}\n{tables}\n## Not measured\n\n{left}\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", help=f"tasks, separated by commas: {', '.join(WORKS)}")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "peers.md")
    options = parser.parse_args()
    keys = options.only.split(",") if options.only else list(WORKS)
    if unknown := set(keys) - set(WORKS):
        parser.error(
            f"--only: found {', '.join(sorted(unknown))}; expected names of {', '.join(WORKS)}"
        )
    if options.only and options.out == ROOT / "docs" / "peers.md":
        parser.error("--only: docs/peers.md contains all tasks; choose another file with --out")
    from playwright.sync_api import sync_playwright

    prepare()
    found, loads = {}, []
    with sync_playwright() as playwright:
        chromium = shutil.which("chromium") or shutil.which("chromium-browser")
        browser = playwright.chromium.launch(executable_path=chromium, args=_BROWSER)
        for key in keys:
            print(f"measuring {key} ...", flush=True)
            found[key] = measure(key, options.rounds, browser)
            print(table_of(key, found[key]), flush=True)
            loads.append(os.getloadavg()[0])
        browser.close()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(page_of(found, options.rounds, (min(loads), max(loads))))
    print(f"written: {options.out}")


if __name__ == "__main__":
    main()
