"""Measures sero-mj beside its peers: the same work, in the same run; writes docs/peers.md.

    make peers
    .venv/bin/python benchmarks/peers.py --rounds 1 --only fk_one,control --out out/peers.md

Every peer has a script in benchmarks/peers/ and an environment of its own in .peers/NAME, made on
first use (10 GB, from PyPI). All read the same two robots, which are written as URDF. For every
work ours and theirs take turns for some rounds, of which the median counts; where a work has a
result, all must agree. Needs Chromium, Xvfb and a C compiler.
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
SETTLE = 4.0  # s, until a page has loaded and draws
TIMEOUT = 300.0  # s, of one work of one peer
_BROWSER = [
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist", "--no-sandbox",
]  # fmt: skip


@dataclass(frozen=True)
class Peer:
    """A script of benchmarks/peers/, and what it needs from PyPI; nothing: it runs beside ours."""

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
    "with_viser": Peer("viser and yourdfpy", "viser", ("viser>=1", "yourdfpy>=0.0.56")),
    "with_rerun": Peer("rerun and yourdfpy", "rerun", ("rerun-sdk>=0.24", "yourdfpy>=0.0.56")),
    "with_gymnasium": Peer("Gymnasium's Pusher", "gymnasium", ("gymnasium[mujoco]>=1.1",)),
    "with_mjlab": Peer("mjlab, lifting a cube", "mjlab", ("mjlab>=1.6",)),
    # With later versions of MuJoCo it finds no joints.
    "with_robosuite": Peer("robosuite", "robosuite", ("robosuite>=1.5", "mujoco<3.4")),
}


@dataclass(frozen=True)
class Work:
    """What is measured: its heading, what exactly is done, by whom."""

    title: str
    does: str
    peers: tuple[str, ...]
    unit: str = "s"  # or "times mj_step", "packets/s"
    why: dict[str, str] = field(default_factory=dict)  # a peer may be faster
    names: dict[str, str] = field(default_factory=dict)  # of peers, where others than above


_ARRAYS = "ours is this, and checks the length of what it is given and returns a new array"
_PINOCCHIO = (
    "its kinematics moves the joints' frames alone, MuJoCo's, on which ours stands, also axes, "
    "quaternions and frames of inertia of every link"
)
_PAGE = (
    "A call of a loop at 100 Hz that gives all joints new angles and torques, with a page of a "
    "browser open, in software. Ours copies numbers into memory that the viewer's process shares; "
    "arrows, their sizes and labels are laid out there. The others compute frames in the loop, and "
    "send one message for every link and for a bar or arrow at every joint. rerun's server has no "
    "viewer that is open."
)
_WINDOW = (
    "The same with a window on a virtual screen. MuJoCo's passive viewer takes kinematics and an "
    "arrow for every joint in the loop."
)
_MESHCAT = {"with_pinocchio": "MeshCat by Pinocchio's visualizer"}

WORKS = {
    "fk_one": Work(
        "Forward kinematics, one pose",
        "The flange of an LWR, as a 4 x 4 matrix.",
        ("ours", "bare_mujoco", "with_pinocchio", "with_roboticstoolbox"),
        why={"bare_mujoco": _ARRAYS, "with_pinocchio": _PINOCCHIO},
    ),
    "fk_many": Work(
        "Forward kinematics, 1000 poses",
        "As one call where there is one, else as a loop in Python.",
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
        "Control step by hand",
        "K (q_d - q) - D dq + g(q). Ours is its joint impedance, whose D is designed anew from "
        "M(q) at 10 Hz; the others have a constant D.",
        ("ours", "bare_mujoco", "with_pinocchio"),
        why={
            "bare_mujoco": "ours also designs D and adds what a target may bring besides",
            "with_pinocchio": f"ours also designs D, and {_PINOCCHIO}",
        },
    ),
    "joint_control": Work(
        "Joint control step",
        "Ours holds an LWR by joint impedance, robosuite a Panda by `JOINT_POSITION`; both with "
        "the update of their model. robosuite 1.5 needs a MuJoCo before 3.4.",
        ("ours", "with_robosuite"),
    ),
    "cartesian_control": Work(
        "Cartesian control step",
        "Ours holds an LWR by Cartesian impedance, robosuite a Panda by `OSC_POSE`.",
        ("ours", "with_robosuite"),
    ),
    "show_page_7": Work(
        "Showing 7 moving joints and torques on a page", _PAGE,
        ("ours", "with_viser", "with_pinocchio", "with_rerun"), names=_MESHCAT,
    ),
    "show_page_51": Work(
        "Showing 51 joints on a page", "The same.",
        ("ours", "with_viser", "with_pinocchio", "with_rerun"), names=_MESHCAT,
    ),
    "show_window_7": Work(
        "Showing 7 joints in a window", _WINDOW, ("ours", "bare_mujoco"),
    ),
    "show_window_51": Work(
        "Showing 51 joints in a window", "The same.", ("ours", "bare_mujoco"),
    ),
    "first_picture": Work(
        "From the start of Python to a picture of a URDF",
        "A picture of 640 x 480 without a window.",
        ("ours", "bare_mujoco"),
        why={
            "bare_mujoco": "it draws a URDF as it is, without floor, lights and shadows (see the "
            "next table), and reads nothing that its own reader does not know"
        },
    ),
    "first_scene": Work(
        "From the start of Python to a picture of the same scene",
        "The same, where MuJoCo reads what sero-mj has made of the URDF: with floor, lights and "
        "shadows, seen from the same side.",
        ("ours", "bare_mujoco"),
        why={"bare_mujoco": "ours reads the URDF, checks it and compiles the scene first"},
    ),
    "first_page": Work(
        "From the start of Python to a picture of a URDF in a browser",
        "The browser runs already; its page is opened as soon as it is served.",
        ("ours", "with_viser", "with_pinocchio"),
        names=_MESHCAT,
        why={
            "with_pinocchio": "its picture has no shadows, and its server compiles no model"
        },
    ),
    "packet_to_pixel": Work(
        "From a UDP packet to pixels",
        "A packet is sent, received, applied, and a picture of 640 x 480 drawn, of the same scene "
        "with the same lights from the same side. Ours checks and counts packets on a thread of "
        "its own.",
        ("ours", "bare_mujoco"),
        why={"bare_mujoco": "no thread, no check of packets, no arrows or labels to lay out"},
    ),
    "packets": Work(
        "Packets a second without loss",
        "112 bytes over loopback from a sender in C, on a ladder of rates up to 400,000/s; ours "
        "renders 30 pictures a second meanwhile, the others do nothing else.",
        ("ours",),
        unit="packets/s",
        why={
            "recvmmsg loop in C, alone": "it counts packets, reads none of them, draws none",
            "recv_into loop in Python, alone": "it counts packets, reads none of them, draws none",
            "UdpReceiver, latest wins, rendering": "of many packets it applies the last",
        },
    ),
    "environment": Work(
        "Step of an environment, one robot",
        "Of `sero_mj/lwr-reach-v0` (20 steps of physics an action), `Pusher-v5` (5 steps) and "
        "mjlab's `Mjlab-Lift-Cube-Yam` (4 steps, by MuJoCo Warp on the processor), over as many "
        "`mj_step` of the same model.",
        ("ours", "with_gymnasium", "with_mjlab"),
        unit="times mj_step",
        why={
            "with_gymnasium": "Pusher writes controls once an action; ours runs sensors, a torque "
            "controller, drives with limits and a log in every step of physics"
        },
    ),
    "environments": Work(
        "Step of an environment, 64 robots together",
        "The same, by `gymnasium.make_vec`, per robot; ours on all cores, as it does by default. "
        "mjlab is made for GPUs, with thousands of robots.",
        ("ours", "with_gymnasium", "with_mjlab"),
        unit="times mj_step",
    ),
}  # fmt: skip
LEFT_OUT = (
    ("rerun, to the first picture", "its page tells no program when it has drawn"),
    ("viser and MeshCat, packet to pixel", "neither reads packets; it would be our code"),
)


def prepare() -> None:
    """Writes the robots that all read: one LWR, and 51 joints as Rollin' Justin's chains."""
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
    """The interpreter of a peer, in an environment that has what it needs.

    Raises:
        RuntimeError: pip could not install it; its last line.
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
    """Does a work by a peer; gives what it tells.

    Raises:
        RuntimeError: it failed; its last line.
        OSError: a program that it needs is missing.
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
    """A page of the browser, when a function of it is true.

    Raises:
        RuntimeError: it never is.
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
    """What a peer took for a work, in every round; or why it could not be measured."""

    title: str
    seconds: list[float] = field(default_factory=list)
    slow: list[float] = field(default_factory=list)  # of 100 calls, one takes longer
    version: str = ""
    problem: str = ""

    @property
    def median(self) -> float:
        """Of all rounds."""
        return float(np.median(self.seconds))


def measure(key: str, rounds: int, browser: Any) -> dict[str, Row]:
    """A row for everyone who does a work, taken in turns.

    Raises:
        SystemExit: two have other results.
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
            raise SystemExit(f"{key}: {name} found {result}; expected {ours}, as ours")
    return {name: row for name, row in rows.items() if row.seconds or row.problem}


def text_of(seconds: float, unit: str) -> str:
    """A time for people, or a rate."""
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
    """A section of the page."""
    work = WORKS[key]
    is_ours = [name for name in rows if name == "ours" or name.startswith("UdpReceiver")]
    reference = rows[is_ours[-1]] if is_ours else None
    has_slow = any(row.slow for row in rows.values())
    head = ["", work.unit if work.unit != "s" else "time", "times ours"]
    head[2:2] = ["99 % of calls under"] if has_slow else []
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
            why = work.why.get(name, "we do not know why")
            reasons.append(f"{row.title} is faster: {why}.")
    return "\n".join([*lines, *(f"\n{reason}" for reason in reasons), ""])


def machine() -> str:
    """Processor, cores and system."""
    about = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    names = [line.partition(":")[2].strip() for line in about.splitlines() if "model name" in line]
    name = names[0] if names else platform.processor() or platform.machine()
    return (
        f"{name}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"
    )


def page_of(found: dict[str, dict[str, Row]], rounds: int, busy: Sequence[float]) -> str:
    """The page: what was measured, on what, with which versions.

    Args:
        found: rows of every work.
        rounds: how many of them there were.
        busy: the least and the greatest load average of the machine meanwhile.
    """
    versions = sorted(
        {row.version for rows in found.values() for row in rows.values() if row.version}
    )
    loads = " to ".join(f"{load:.1f}" for load in sorted({round(each, 1) for each in busy}))
    how = "one round" if rounds == 1 else f"the median of {rounds} rounds"
    head = f"""# Beside its peers

How long the same work takes with sero-mj and with other packages, measured in one run in turns
({how}). `make peers` measures anew and writes this page; no figure here is by hand. Where
there is a result (poses, matrices, torques), all have the same to 1e-6. Pictures are drawn in
software, without a GPU, which slows all that draws. Load is the average number of processes that
wanted a core; above the number of cores, times of pictures are too long for all.

{date.today().isoformat()} · {machine()}, load {loads} · {", ".join(versions)}
"""
    left = "\n".join(f"- {what}: {why}." for what, why in LEFT_OUT)
    tables = "\n".join(table_of(key, rows) for key, rows in found.items())
    return f"{head}\n{tables}\n## Not measured\n\n{left}\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", help=f"of {', '.join(WORKS)}; separated by commas")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "peers.md")
    options = parser.parse_args()
    keys = options.only.split(",") if options.only else list(WORKS)
    if unknown := set(keys) - set(WORKS):
        parser.error(f"--only: found {', '.join(sorted(unknown))}; expected of {', '.join(WORKS)}")
    if options.only and options.out == ROOT / "docs" / "peers.md":
        parser.error("--only: the page in docs has all works; name another one with --out")
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
