"""Reads every URDF file of `example-robot-data`, and compares the robots with Pinocchio.

    make foreign                                      installs the packages and runs this script
    .venv/bin/python benchmarks/foreign.py [NAME ...]

For each file, the script compares the frames of all links in 50 random poses with Pinocchio (m and
rotation matrices), the compiled model with the NumPy kinematics in the same poses, the total mass,
and the time from the file to the first image with plain MuJoCo, if MuJoCo can read the meshes.
Images for the last comparison have no shadows, because plain MuJoCo draws none for a URDF, and
shadows take most of the time with software rendering. Writes a table (out/foreign/urdf.md) and
images of all robots (out/foreign/urdf.png). Fails if fewer than 95 % of the files load and agree to
1e-6.
"""

from __future__ import annotations

import gc
import logging
import os
import re
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import files
from pathlib import Path
from typing import Any

os.environ.setdefault("MUJOCO_GL", "egl")

import mujoco
import numpy as np
import pinocchio
from PIL import Image, ImageDraw

from sero_mj import HeadlessRenderer, World
from sero_mj.base.errors import SeroError
from sero_mj.load import load_scene
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.robots.importers import mesh_files
from sero_mj.robots.importers.package_files import find_file
from sero_mj.robots.importers.urdf import UrdfFile

OUT = Path("out/foreign")
POSES, WITHIN = 50, 1e-6
SIZE, COLUMNS = (320, 240), 8
REPEATS = 3  # number of time measurements, of which the shortest counts
_EXTENSION = (
    '<mujoco><compiler discardvisual="false" strippath="false" fusestatic="true" '
    'balanceinertia="true" boundmass="1e-6" boundinertia="1e-9"/></mujoco>'
)


@dataclass
class Row:
    """The result for one file; NaN for unknown values."""

    name: str
    joints: int = 0
    kinematics: str = ""
    frames: float = np.nan  # difference from Pinocchio
    compiled: float = np.nan  # difference of the compiled model from the NumPy kinematics, m
    mass: float = np.nan  # kg
    mass_difference: float = np.nan  # difference from Pinocchio, relative to the mass
    seconds: float = np.nan  # time from the file to an image without shadows, s
    normal_seconds: float = np.nan  # time to an image with shadows and antialiasing (default), s
    mujoco_seconds: float = np.nan  # time to an image with plain MuJoCo, s
    reason: str = ""
    warnings: list[str] = field(default_factory=list)

    @property
    def agrees(self) -> bool:
        """Whether the file loads and gives the same robot."""
        return max(self.frames, self.compiled, self.mass_difference) < WITHIN


def robots_of_package() -> list[Path]:
    """Returns the URDF files of the package `example-robot-data`."""
    found = [Path(str(file.locate())) for file in files("example-robot-data") or []]
    return sorted(path for path in found if path.suffix == ".urdf")


def compare(path: Path) -> tuple[Row, Any]:
    """Compares one robot with Pinocchio; returns its row and image."""
    row = Row(f"{path.parents[1].name.removesuffix('_description')}/{path.stem}")
    try:
        file = UrdfFile(path)
        scene = load_scene(path)
        (robot,) = scene.robots.values()
        world = World(scene)
    except SeroError as error:
        row.reason = str(error).splitlines()[0].replace(f"{path}", path.name)
        return row, None
    row.warnings = file.described.warnings
    row.joints, row.kinematics = robot.n, "DH" if robot.dh is not None else "frames"
    model = pinocchio.buildModelFromUrdf(str(path))
    row.frames, row.compiled = differences(file, world, robot, model)
    row.mass = float(robot_dynamics(robot).masses.sum())
    row.mass_difference = abs(sum(inertia.mass for inertia in model.inertias) / row.mass - 1.0)
    with HeadlessRenderer(world, *SIZE) as renderer:
        picture = renderer.render(world.make_data())
    return row, picture


def differences(file: UrdfFile, world: World, robot: Any, model: Any) -> tuple[float, float]:
    """Returns maximum differences: frames from Pinocchio, and compiled positions from NumPy."""
    data, state = model.createData(), world.make_data()
    turns = robot.kinematics.revolute
    span = np.where(turns, np.pi, 0.3)
    address = [world.model.joint(f"{robot.name}/{name}").qposadr[0] for name in robot.names]
    bodies = [world.model.body(f"{robot.name}/link{i + 1}").id for i in range(robot.n)]
    to_pinocchio = compiled = 0.0
    for q in np.random.default_rng(0).uniform(-1, 1, (POSES, robot.n)) * span:
        positions = pinocchio.neutral(model)
        for joint, value in zip(file.tree.joints, q, strict=True):
            its = model.joints[model.getJointId(joint.name)]
            values = [value] if its.nq == 1 else [np.cos(value), np.sin(value)]
            positions[its.idx_q : its.idx_q + its.nq] = values
        pinocchio.framesForwardKinematics(model, data, positions)
        frames = robot.kinematics.frames(q)
        for link, (body, T_body_link) in file.tree.T_body_link.items():
            its = data.oMf[model.getFrameId(link, pinocchio.FrameType.BODY)].homogeneous
            to_pinocchio = max(to_pinocchio, np.abs(frames[body] @ T_body_link - its).max())
        state.qpos[address] = q
        mujoco.mj_kinematics(world.model, state)
        ours = robot.kinematics.frames(q, robot.base_frame)[1:, :3, 3]
        compiled = max(compiled, np.abs(state.xpos[bodies] - ours).max())
    return float(to_pinocchio), float(compiled)


def forget() -> None:
    """Clears the mesh caches of sero-mj and MuJoCo."""
    mesh_files._kept.clear()
    mujoco.mj_clearCache(mujoco.mj_getCache())
    gc.collect()


def seconds_to_picture(path: Path, quality: Any) -> float:
    """Returns the time from the file to the first image with empty caches."""
    forget()
    begin = time.perf_counter()
    world = World(load_scene(path))
    with HeadlessRenderer(world, *SIZE, quality=quality) as renderer:
        renderer.render(world.make_data())
    return time.perf_counter() - begin


def seconds_of_mujoco(read: Callable[[str], Any], source: str) -> float:
    """Returns the time from a source, which `read` compiles, to plain MuJoCo's first image."""
    forget()
    begin = time.perf_counter()
    model = read(source)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, SIZE[1], SIZE[0]) as renderer:
        renderer.update_scene(data)
        renderer.render()
    return time.perf_counter() - begin


def for_mujoco(path: Path) -> str | None:
    """Returns the URDF with absolute names of meshes, or None if MuJoCo cannot read it."""

    def absolute(match: re.Match[str]) -> str:
        return f'filename="{find_file(match[1], path)}"'

    text = path.read_text(encoding="utf-8")
    text = re.sub(r'filename="([^"]*\.(?:stl|obj|dae|mesh))"', absolute, text, flags=re.IGNORECASE)
    text = text.replace("</robot>", f"{_EXTENSION}</robot>")
    try:
        mujoco.MjModel.from_xml_string(text)
    except ValueError:
        return None
    return text


def measure(path: Path, row: Row) -> None:
    """Measures the times with sero-mj and MuJoCo alternately, and stores the shortest ones."""
    text = for_mujoco(path)
    draft, normal, its = [], [], []
    for _ in range(REPEATS if text else 1):
        draft.append(seconds_to_picture(path, "draft"))
        its += [seconds_of_mujoco(mujoco.MjModel.from_xml_string, text)] if text else []
        normal.append(seconds_to_picture(path, "normal"))
    row.seconds, row.normal_seconds = min(draft), min(normal)
    row.mujoco_seconds = min(its, default=np.nan)


def table(rows: list[Row]) -> str:
    """Returns the rows as a Markdown table."""
    heads = ["robot", "joints", "kinematics", "frames", "compiled", "mass, kg", "difference",
             "image, s", "with shadows, s", "MuJoCo, s", "ratio", "note"]  # fmt: skip
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for row in rows:
        ratio = row.seconds / row.mujoco_seconds
        note = row.reason or f"{len(row.warnings)} warnings" * bool(row.warnings)
        cells = [row.name, str(row.joints), row.kinematics, f"{row.frames:.0e}",
                 f"{row.compiled:.0e}", f"{row.mass:.4g}", f"{row.mass_difference:.0e}",
                 f"{row.seconds:.2f}", f"{row.normal_seconds:.2f}", f"{row.mujoco_seconds:.2f}",
                 f"{ratio:.2f}", note]  # fmt: skip
        lines.append("| " + " | ".join("" if "nan" in cell else cell for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def contact_sheet(pictures: list[tuple[str, Any]]) -> Image.Image:
    """Returns one image with all images and their names."""
    count = -(-len(pictures) // COLUMNS)
    sheet = Image.new("RGB", (SIZE[0] * COLUMNS, SIZE[1] * count), "white")
    draw = ImageDraw.Draw(sheet)
    for k, (name, pixels) in enumerate(pictures):
        at = SIZE[0] * (k % COLUMNS), SIZE[1] * (k // COLUMNS)
        sheet.paste(Image.fromarray(pixels), at)
        draw.text((at[0] + 6, at[1] + 4), name, fill="black", font_size=15)
    return sheet


def main() -> None:
    """Writes the table and the contact sheet."""
    logging.disable(logging.WARNING)
    wanted = sys.argv[1:]
    rows, pictures = [], []
    paths = robots_of_package()
    for path in paths:
        if wanted and not any(word in str(path) for word in wanted):
            continue
        row, picture = compare(path)
        rows.append(row)
        if picture is not None:
            pictures.append((row.name, picture))
            measure(path, row)
        print(f"{row.name}: {'agrees' if row.agrees else row.reason or 'DIFFERS'}", flush=True)
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "urdf.md").write_text(table(rows), encoding="utf-8")
    contact_sheet(pictures).save(OUT / "urdf.png")
    good = sum(row.agrees for row in rows)
    ratios = [row.seconds / row.mujoco_seconds for row in rows if row.mujoco_seconds > 0]
    print(f"{good} of {len(rows)} load and agree to {WITHIN:g} ({100 * good / len(rows):.1f} %)")
    if ratios:
        print(
            f"time to an image relative to plain MuJoCo: median {np.median(ratios):.2f}, maximum "
            f"{max(ratios):.2f}, for the {len(ratios)} files whose meshes MuJoCo can read"
        )
    print(OUT / "urdf.md", OUT / "urdf.png")
    sys.exit(good < 0.95 * len(rows))


if __name__ == "__main__":
    main()
