"""Renders the images of the gallery and of the start page, and writes `docs/gallery.md`.

`make gallery` renders an image for each entry of `SHOTS`, and an image for each included scene,
scenario, robot and group in `scenes/pictures`. `make gallery SHOTS="justin lwr"` renders only these
images. Add an entry for each new robot, scene or visual feature.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from sero_mj.viewer.image.backend import choose_backend

choose_backend()

import mujoco
import numpy as np

from sero_mj import render_image
from sero_mj.base import paths
from sero_mj.data.drive.wiring import wire
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene

DOCS = Path(__file__).resolve().parent
PAGE = DOCS / "gallery.md"
PICTURES = DOCS / "pictures" / "gallery"
START_PICTURES = paths.scenes_dir() / "pictures"
SIZE = (600, 440)  # pixels
START_SIZE = (480, 300)  # pixels, images of the start page
# Pose of an LWR without data on the start page, rad.
POSE = [0.4, 0.6, 0.0, -1.3, 0.0, 0.7, 0.0]

SYSTEMS, FEATURES = "Robots", "Visual features"


@dataclass(frozen=True)
class Shot:
    """An image of the gallery.

    Attributes:
        name: name of the image file, without its ending.
        caption: line below the image.
        scene: name of an included scene, scenario or robot, or the text of a scene file.
        overrides: mapping from keys such as `robot.field` to values that override the scene.
        at: simulated time of the image, s.
        camera: camera as in `sero-mj render --camera`; None for the view of the scene.
        holds_itself: whether arrows show the gravity torques of the robots.
        played_by: script in the folder of the scene that sends its packets; None for none.
        group: heading on the page.
    """

    name: str
    caption: str
    scene: str
    overrides: Mapping[str, Any] = field(default_factory=dict)
    at: float = 0.0
    camera: str | None = None
    holds_itself: bool = False
    played_by: str | None = None
    group: str = SYSTEMS


PARALLEL = "parallel_sender.py"
LWR = """
[robots.lwr]
model = "lwr"
joint_angles = [0.4, 0.6, 0.0, -1.3, 0.0, 0.7, 0.0]
"""

GROUP = """
[groups.robot]
model = "{model}"
show_arrows = true

[view]
azimuth_deg = {azimuth}
elevation_deg = -10
distance = {distance}
look_at = [0.0, 0.0, {height}]

[toggles]
legend = false
"""


SHOTS = (
    Shot("justin", "Rollin' Justin, approximate geometry (not DLR data)",
         GROUP.format(model="justin", azimuth=205, distance=2.7, height=0.92), holds_itself=True),
    Shot("justin_push", "Simulated Justin with one arm pushed, which makes its arrows wide",
         "justin_push", {"toggles.legend": False}, at=2.5),
    Shot("space_justin", "SpaceJustin, approximate geometry (not DLR data)",
         GROUP.format(model="space_justin", azimuth=205, distance=2.7, height=0.95),
         holds_itself=True),
    Shot("lwr", "DLR/KUKA LWR with the torques that hold it against gravity", "lwr", {
        "lwr.joint_angles": [0.4, 0.6, 0.0, -1.3, 0.0, 0.7, 0.0], "lwr.show_arrows": True,
    }, holds_itself=True),
    Shot("hit_hand", "DLR/HIT Hand II, approximate meshes (not DLR data)",
         GROUP.format(model="hit_hand2", azimuth=165, distance=0.42, height=0.08)),
    Shot("dlr_hand2", "DLR Hand II, approximate geometry (not DLR data)",
         GROUP.format(model="dlr_hand2", azimuth=165, distance=0.56, height=0.1)),
    Shot("hit_hand_grasp", "Simulated hand that grasps a can by friction, with torques and forces",
         "hit_hand_grasp", at=4.5),
    Shot("biped", "Simulated DLR Biped, pushed while it stands with stiff ankles", "biped_stand",
         at=2.25),
    Shot("puma560", "Unimation Puma 560 with a standard DH table and published dynamics", "puma560",
         {"puma560.show_arrows": True}, holds_itself=True),
    Shot("panda", "Franka Emika Panda with a modified DH table", "panda",
         {"panda.show_arrows": True}, holds_itself=True),
    Shot("fr3", "Franka Research 3", "fr3", {"fr3.show_arrows": True}, holds_itself=True),
    Shot("iiwa14", "KUKA LBR iiwa 14", "iiwa14", {"iiwa14.show_arrows": True}, holds_itself=True),
    Shot("ur5e", "Universal Robots UR5e", "ur5e", {"ur5e.show_arrows": True}, holds_itself=True),
    Shot("ur10e", "Universal Robots UR10e", "ur10e", {"ur10e.show_arrows": True},
         holds_itself=True),
    Shot("scara", "Adept Cobra 600, a SCARA", "scara",
         {"scara.show_arrows": True}, holds_itself=True),
    Shot("stanford", "Stanford arm with a prismatic joint", "stanford",
         {"stanford.show_arrows": True}, holds_itself=True),
    Shot("five_bar", "Five-bar linkage with two serial legs", "five_bar", played_by=PARALLEL),
    Shot("stewart", "Stewart platform with six serial legs and a loop closure check", "stewart",
         played_by=PARALLEL),
    Shot("torques", "Round arrows: a push and the joint torques that it causes", "impedance_push",
         at=3.2, group=FEATURES),
    Shot("torque_error", "Torque error: commanded minus measured", LWR, {
        "lwr.show_arrows": True, "lwr.arrow_quantity": "torque_error",
        "lwr.torques": [0, 40, 5, -20, 2, -4, 0],
        "lwr.commanded_torques": [20, -10, 15, 10, -12, 6, 5],
    }, group=FEATURES),
    Shot("singularity", "Proximity to a singularity: the arm is almost straight",
         "singularity_pass", {"disturbances.elbow.force": [0.0, 1e-9, 0.0],
                              "disturbances.elbow.show": False}, at=3.0, group=FEATURES),
    Shot("billboards", "Billboards: angle and torque of each joint", LWR, {
        "lwr.show_billboards": True, "lwr.torques": [2.1, 38.6, 4.2, -17.9, 0.6, -3.2, 0.1],
        "lwr.billboard_lines": [
            {"value": "joint_angles", "unit": "deg", "scale": 57.29578, "decimals": 1}, "torques",
        ],
    }, group=FEATURES),
    Shot("path", "Transparent doubles: the path to a target", LWR + """
[doubles.plan]
of = "lwr"
path = [[0.4, 0.6, 0.0, -1.3, 0.0, 0.7, 0.0], [1.6, 0.9, 0.0, -0.9, 0.0, 0.9, 0.0]]
""", group=FEATURES),
    Shot("smart_arrows", "Smart arrows: force and moment at the flange", LWR + """
[arrows.force]
kind = "force"
at = "lwr/flange"
expressed_in = "world"
vector = [12.0, -18.0, -30.0]
[arrows.moment]
kind = "torque"
at = "lwr/flange"
vector = [0.0, 3.0, 5.0]
""", group=FEATURES),
    Shot("axes", "Axes of base, joints and flange", LWR, {"lwr.show_axes": True}, group=FEATURES),
    Shot("flange_check", "Flange check: two legs that do not meet", """
[robots.left]
dh_convention = "craig"
dh_params = [[0, 0, 0, 0.30], [0, 0.24, 0, 0]]
flange_frame = { xyz = [0.30, 0.0, 0.0] }
base_frame = { xyz = [-0.15, 0.0, 0.0] }
joint_angles = [1.712, -1.292]
[robots.right]
dh_convention = "craig"
dh_params = [[0, 0, 0, 0.30], [0, 0.24, 0, 0], [0, 0.30, 0, 0]]
base_frame = { xyz = [0.15, 0.0, 0.0] }
joint_angles = [0.828, 1.721, -2.029]
[routes]
"right.flange_check" = "left/flange"
""", camera="60,-40,1.4", group=FEATURES),
    Shot("position_mode", "Position mode: doubles at the commanded poses", "haptic_device", {
        "left_command.joint_angles": [-1.2, 0.95, 2.2, 1.25, -1.1, 0.9, 1.1],
        "right_command.joint_angles": [1.2, 1.15, -2.4, 0.9, 1.1, 1.0, -1.0],
    }, camera="120,-12,2.3", group=FEATURES),
    Shot("dark", "Dark appearance, for slides", LWR + '[view]\nlook = "dark"\n', {
        "lwr.show_arrows": True, "lwr.show_billboards": True,
    }, holds_itself=True, group=FEATURES),
)  # fmt: skip


def scene_of(shot: Shot) -> Scene:
    """Returns the scene of an image, with gravity torques if the image shows them.

    If no script sends packets to a live scene, its sources and routes are removed.
    """
    if "\n" not in shot.scene:
        scene = _held(load_scene(shot.scene, shot.overrides), shot, shot.scene)
        if _is_live(scene) and shot.played_by is None:
            scene.sources, scene.routes = {}, {}
        return scene
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{shot.name}.toml"
        file.write_text(shot.scene, "utf-8")
        return _held(load_scene(file, shot.overrides), shot, str(file))


def _is_live(scene: Scene) -> bool:
    return any(source.is_live for source in wire(scene).sources.values())


def _held(scene: Scene, shot: Shot, name: str) -> Scene:
    if not shot.holds_itself:
        return scene
    world = World(scene, dynamic=True)
    data = world.make_data()
    mujoco.mj_forward(world.model, data)  # at rest, `qfrc_bias` contains only gravity torques
    torques = {
        f"{robot}.torques": data.qfrc_bias[part.dofs].tolist()
        for robot, part in world.robots.items()
    }
    return load_scene(name, {**shot.overrides, **torques})


def make_page(shots: Sequence[Shot] = SHOTS) -> str:
    """Returns the text of the page in Markdown."""
    about = (
        "This page shows the robots and visual features of sero-mj. `make gallery` renders the "
        "images from the scenes in `docs/gallery.py`."
    )
    lines = ["# Gallery", "", about, ""]
    for group in (SYSTEMS, FEATURES):
        lines += [f"## {group}", ""]
        for shot in shots:
            if shot.group == group:
                lines += [f"![{shot.caption}](pictures/gallery/{shot.name}.webp)", shot.caption, ""]
    return "\n".join(lines).rstrip("\n") + "\n"


def start_shots() -> dict[str, Shot]:
    """Returns a mapping from names of included scenes and robots to images of the start page."""
    named = {shot.scene: shot for shot in reversed(SHOTS) if "\n" not in shot.scene}
    groups = {name: shot for shot in SHOTS for name in paths.list_group_models()
              if f'model = "{name}"' in shot.scene}  # fmt: skip
    simulated = dict.fromkeys(paths.list_scenarios(), 2.0) | {"drive_home": 1.0, "payload": 3.0}
    return {
        name: named.get(name)
        or groups.get(name)
        or Shot(name, "", name, at=simulated.get(name, 0.0), holds_itself=name not in simulated)
        for name in paths.list_all()
    }


def start_scene_of(shot: Shot) -> Scene:
    """Returns the scene of an image for the start page, without billboards and legend.

    Robots of live scenes show their gravity torques. Text would be too small on the start page.
    """
    is_as_shipped = "\n" not in shot.scene and not shot.overrides and shot.played_by is None
    if is_as_shipped and _is_live(load_scene(shot.scene)):
        poses = {
            f"{name}.joint_angles": POSE if _is_lwr(robot) else np.zeros(robot.n).tolist()
            for name, robot in load_scene(shot.scene).robots.items()
            if robot.joint_angles is None
        }
        shot = replace(shot, overrides=poses, holds_itself=True)
    scene = scene_of(shot)
    scene.toggles.legend = False
    for robot in scene.robots.values():
        robot.show_billboards = False
    return scene


def _is_lwr(robot: SerialRobot) -> bool:
    return robot._model is not None and paths.model_name(robot._model) == "lwr"


@contextmanager
def _sender(shot: Shot) -> Iterator[None]:
    """Sends the packets of a live scene while its image is rendered."""
    if shot.played_by is None:
        yield
        return
    script = DOCS.parent / "scenes" / shot.played_by
    with subprocess.Popen([sys.executable, str(script), shot.scene]) as process:
        yield
        process.terminate()


def main(names: Sequence[str]) -> None:
    """Renders all images, or the named ones, and writes the page."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    for shot in SHOTS:
        if not names or shot.name in names:
            file = PICTURES / f"{shot.name}.webp"
            with _sender(shot):
                render_image(
                    scene_of(shot), file, size=SIZE, camera=shot.camera, at=shot.at, quality="fine"
                )
            print(file)
    START_PICTURES.mkdir(parents=True, exist_ok=True)
    for name, shot in start_shots().items():
        if not names or name in names:
            file = START_PICTURES / f"{name}.jpg"
            with _sender(shot):
                scene = start_scene_of(shot)
                render_image(
                    scene, file, size=START_SIZE, camera=shot.camera, at=shot.at, quality="fine"
                )
            print(file)
    PAGE.write_text(make_page(), "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
