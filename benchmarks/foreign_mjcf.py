"""Reads the MJCF robots of `robosuite` and `dm_control`, and compares them with plain MuJoCo.

    make foreign                                      installs the packages and runs this script
    .venv/bin/python benchmarks/foreign_mjcf.py [NAME ...]

For each file that MuJoCo can read and that has hinge or slide joints, the script compares the
frames of all bodies in 50 random poses (m and rotation matrices), the gravity torques in these
poses, the total mass, and the time from the file to the first image with plain MuJoCo. Writes a
table (out/foreign/mjcf.md) and images of all robots (out/foreign/mjcf.png). Fails if fewer than
95 % of the files load and agree to 1e-6.
"""

from __future__ import annotations

import logging
import os
import sys
import time
import warnings
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

os.environ.setdefault("MUJOCO_GL", "egl")

import mujoco
import numpy as np
from foreign import OUT, POSES, SIZE, WITHIN, contact_sheet, forget, seconds_of_mujoco

from sero_mj import HeadlessRenderer, World
from sero_mj.base.errors import DeclarationError, SeroError
from sero_mj.load import load_scene
from sero_mj.robots.importers.mjcf_model import MjcfTree
from sero_mj.robots.importers.mjcf_robot import tree_of

FOLDERS = {
    "robosuite": ("models/assets/robots", "models/assets/grippers"),
    "dm_control": ("suite", "locomotion/walkers/assets", "third_party"),
}
NO_ROBOT = "found no hinge and no slide"


@dataclass
class Row:
    """The result for one file; NaN for unknown values."""

    name: str
    joints: int = 0
    frames: float = np.nan  # difference from plain MuJoCo
    torques: float = np.nan  # difference of gravity torques, relative to the largest one
    mass: float = np.nan  # kg
    mass_difference: float = np.nan  # difference from plain MuJoCo, relative to the mass
    seconds: float = np.nan  # time from the file to an image without shadows, s
    mujoco_seconds: float = np.nan  # time to an image with plain MuJoCo, s
    reason: str = ""

    @property
    def agrees(self) -> bool:
        """Whether the file loads and gives the same robot."""
        return max(self.frames, self.torques, self.mass_difference) < WITHIN


def files_of_packages() -> list[Path]:
    """Returns the MJCF files of the installed packages."""
    found: list[Path] = []
    for package, folders in FOLDERS.items():
        spec = find_spec(package)
        roots = [] if spec is None else [Path(p) for p in spec.submodule_search_locations or []]
        found += [path for root in roots for f in folders for path in (root / f).rglob("*.xml")]
    return sorted(found)


def is_robot(path: Path) -> str:
    """Returns the reason why a file cannot be compared, or "" for a robot."""
    try:
        tree_of(path.name, path.parent)
    except DeclarationError as error:
        text = str(error).splitlines()[0]
        return "no joints" if NO_ROBOT in text else f"MuJoCo does not read it: {text[:60]}"
    return ""


def compare(path: Path, row: Row) -> Any:
    """Compares one robot with plain MuJoCo and fills its row; returns its image."""
    tree = tree_of(path.name, path.parent)
    scene = load_scene(path)
    (robot,) = scene.robots.values()
    world = World(scene, dynamic=True)
    row.joints = robot.n
    row.frames, row.torques = differences(tree, world, robot)
    row.mass = float(tree.model.body_mass[tree.links >= 0].sum())
    part = world.robots[robot.name]
    row.mass_difference = abs(float(world.model.body_mass[part.bodies].sum()) / row.mass - 1.0)
    drawn = World(scene)
    with HeadlessRenderer(drawn, *SIZE) as renderer:
        return renderer.render(drawn.make_data())


def differences(tree: MjcfTree, world: World, robot: Any) -> tuple[float, float]:
    """Returns the maximum differences of frames and gravity torques from plain MuJoCo."""
    model, data, own = tree.model, mujoco.MjData(tree.model), world.make_data()
    model.opt.gravity[:] = world.model.opt.gravity
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    part, mine = world.robots[robot.name], np.flatnonzero(tree.links >= 0)
    at, dofs = model.jnt_qposadr[tree.joints], model.jnt_dofadr[tree.joints]
    to_body = np.linalg.inv(tree.poses[tree.links[mine]]) @ tree.bodies[mine]
    frames = torques = 0.0
    for q in np.random.default_rng(0).uniform(-1.5, 1.5, (POSES, robot.n)):
        data.qpos[:], data.qpos[at] = model.qpos0, q
        mujoco.mj_forward(model, data)
        found = robot.kinematics.frames(q, tree.poses[0])[tree.links[mine]] @ to_body
        frames = max(frames, np.abs(found[:, :3, 3] - data.xpos[mine]).max())
        rotations = found[:, :3, :3].reshape(-1, 9)
        frames = max(frames, np.abs(rotations - data.xmat[mine]).max())
        own.qpos[part.qpos] = q
        if len(part.free):
            quat = np.empty(4)
            mujoco.mju_mat2Quat(quat, tree.poses[0][:3, :3].ravel())
            own.qpos[part.free] = [*tree.poses[0][:3, 3], *quat]
        mujoco.mj_forward(world.model, own)
        theirs = data.qfrc_bias[dofs]
        torques = max(torques, float(np.abs(own.qfrc_bias[part.dofs] - theirs).max()))
    return float(frames), torques / max(1.0, float(np.abs(theirs).max()))


def seconds_to_picture(path: Path) -> float:
    """Returns the time from the file to the first image with empty caches."""
    forget()
    begin = time.perf_counter()
    world = World(load_scene(path))
    with HeadlessRenderer(world, *SIZE, quality="draft") as renderer:
        renderer.render(world.make_data())
    return time.perf_counter() - begin


def table(rows: list[Row]) -> str:
    """Returns the rows as a Markdown table."""
    heads = ["robot", "joints", "frames", "gravity", "mass, kg", "difference", "image, s",
             "MuJoCo, s", "ratio", "note"]  # fmt: skip
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for row in rows:
        cells = [row.name, str(row.joints or ""), f"{row.frames:.0e}", f"{row.torques:.0e}",
                 f"{row.mass:.4g}", f"{row.mass_difference:.0e}", f"{row.seconds:.2f}",
                 f"{row.mujoco_seconds:.2f}", f"{row.seconds / row.mujoco_seconds:.2f}",
                 row.reason]  # fmt: skip
        lines.append("| " + " | ".join("" if "nan" in cell else cell for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Writes the table and the contact sheet."""
    logging.disable(logging.WARNING)
    warnings.simplefilter("ignore")
    wanted = sys.argv[1:]
    rows, pictures = [], []
    for path in files_of_packages():
        if wanted and not any(word in str(path) for word in wanted):
            continue
        row = Row(f"{path.parent.name}/{path.stem}")
        rows.append(row)
        row.reason = is_robot(path)
        if row.reason:
            continue
        try:
            pictures.append((row.name, compare(path, row)))
            pairs = [
                (
                    seconds_to_picture(path),
                    seconds_of_mujoco(mujoco.MjModel.from_xml_path, str(path)),
                )
                for _ in range(2)
            ]
            row.seconds, row.mujoco_seconds = np.min(pairs, axis=0)
        except SeroError as error:
            row.reason = f"error: {str(error).splitlines()[0]}"
        print(f"{row.name}: {'agrees' if row.agrees else row.reason or 'DIFFERS'}", flush=True)
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "mjcf.md").write_text(table(rows), encoding="utf-8")
    contact_sheet(pictures).save(OUT / "mjcf.png")
    robots = [row for row in rows if row.joints or row.reason.startswith("error")]
    good = sum(row.agrees for row in robots)
    ratios = [row.seconds / row.mujoco_seconds for row in robots if row.mujoco_seconds > 0]
    print(f"{good} of {len(robots)} load and agree to {WITHIN:g}; {len(rows) - len(robots)} others")
    print(f"time to an image relative to plain MuJoCo: median {np.median(ratios):.2f}")
    print(OUT / "mjcf.md", OUT / "mjcf.png")
    sys.exit(good < 0.95 * len(robots))


if __name__ == "__main__":
    main()
