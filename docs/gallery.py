"""Makes a picture of every system and of every visual feature, and the page that shows them.

`make gallery` writes `docs/pictures/gallery/*.png` and `docs/gallery.md` from the list `SHOTS`, and
`make gallery SHOTS="justin lwr"` only these pictures. A new robot, scene or feature gets an entry.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sero_mj.show.headless.backend import choose_backend

choose_backend()

import mujoco

from sero_mj import render_picture
from sero_mj.assemble.scene import Scene
from sero_mj.assemble.world import World
from sero_mj.load import load_scene

DOCS = Path(__file__).resolve().parent
PAGE = DOCS / "gallery.md"
PICTURES = DOCS / "pictures" / "gallery"
SIZE = (600, 440)  # pixels

SYSTEMS, FEATURES = "Robots", "What is drawn"


@dataclass(frozen=True)
class Shot:
    """A picture of the gallery.

    Attributes:
        name: of the file.
        caption: one line under the picture.
        scene: a shipped scene, scenario or robot by name, or the text of a scene file.
        overrides: `robot.field` to its value, over what the scene says.
        at: time of a simulation, s.
        camera: as `sero-mj render --camera` takes it; the scene's view when None.
        holds_itself: whether arrows show what holds the robots against gravity.
        played_by: a script beside the scene that sends its packets; without one a scene with a
            source would say that no data has come.
        group: the part of the page where it is shown.
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

# Where fingers stand in the palm of a right hand, as their robot files have it: position, m, and
# roll, pitch and yaw by the name of their unit.
HIT_HAND = {
    "thumb": ([0.062569, 0.044545, 0.080045], "rpy", [0.41136, -1.08366, 0.225804]),
    "index": ([-0.00253, 0.0368, 0.108744], "rpy", [3.05433, -1.570796, 0.0]),
    "middle": ([-0.0037, 0.01, 0.119044], "rpy", [3.14159, -1.570796, 0.0]),
    "ring": ([-0.00253, -0.0168, 0.114044], "rpy", [-3.05433, -1.570796, 0.0]),
    "little": ([0.000972, -0.043396, 0.095044], "rpy", [-2.96706, -1.570796, 0.0]),
}
DLR_HAND2 = {
    "thumb": ([0.068, 0.066, 0.108], "rpy_deg", [25, -60, 15]),
    "index": ([-0.003, 0.045, 0.142], "rpy_deg", [174, -90, 0]),
    "middle": ([-0.003, 0.0, 0.150], "rpy_deg", [180, -90, 0]),
    "ring": ([-0.003, -0.045, 0.142], "rpy_deg", [186, -90, 0]),
}
Bases = Mapping[str, tuple[Sequence[float], str, Sequence[float]]]


def hand(model: str, bases: Bases, bend: Sequence[float], arm: str = "", left: bool = False) -> str:
    """Returns the text of a hand, on the flange of an arm or standing on its wrist.

    Args:
        model: of its fingers.
        bases: where these stand in a right hand.
        bend: joint angles of every finger, rad.
        arm: name of the robot that carries it; none when empty.
        left: whether it is a left hand, the right one in a mirror.
    """
    table = f"[[robots.{arm}.children]]" if arm else "[objects.palm]"
    name = 'name = "palm"\n' if arm else ""
    palm = "palm_left.xml" if left else "palm.xml"
    text = f'{table}\n{name}directory = "{DOCS.parent}/models/{model}"\nmjcf = "{palm}"\n'
    sign = -1 if left else 1
    for finger, ((x, y, z), unit, (roll, pitch, yaw)) in bases.items():
        text += (
            f'[robots.{arm}{finger}]\nmodel = "{model}"\njoint_angles = {list(bend)}\n'
            f"base_frame = {{ xyz = [{x}, {sign * y}, {z}], "
            f"{unit} = [{sign * roll}, {pitch}, {sign * yaw}] }}\n"
        )
        text += f'mount = "{arm}/flange"\n' if arm else ""
        text += "mirrored = true\n" if left else ""
    return text


def upper_body(model: str, bases: Bases, bend: Sequence[float]) -> str:
    """Returns the text of the head, the arms and the hands on a torso, with a view of it all."""
    arms = "".join(
        f"""
[robots.{side}]
model = "lwr"
mount = "torso/flange"
base_frame = {{ xyz = [0.0, {0.19 * sign}, 0.0], rpy_deg = [{-60 * sign}, 0, 0] }}
joint_angles = [{-1.05 * sign}, 1.05, {0.3 * sign}, -1.5, {-0.6 * sign}, 0.5, {-0.4 * sign}]
show_arrows = true
"""
        + hand(model, bases, bend, side, left=sign > 0)
        for side, sign in (("left", 1), ("right", -1))
    )
    return f"""
[robots.head]
model = "justin_head"
mount = "torso/flange"
base_frame = {{ xyz = [-0.008, 0.0, 0.115] }}
joint_angles = [0.25, 0.2]
{arms}
[view]
azimuth_deg = 210
elevation_deg = -10
distance = 2.9
look_at = [0.0, 0.0, 0.92]

[toggles]
legend = false
"""


WHEELS = "".join(
    f"""
[robots.{name}_wheel]
model = "justin_wheel"
mount = "torso/base"
base_frame = {{ xyz = [{x}, {y}, 0.0], rpy_deg = [0, 0, {turn}] }}
"""
    for name, x, y, turn in [
        ("front_left", 0.36, 0.31, 40.7), ("front_right", 0.36, -0.31, -40.7),
        ("rear_left", -0.36, 0.31, 139.3), ("rear_right", -0.36, -0.31, -139.3),
    ]
)  # fmt: skip
JUSTIN = """
[robots.torso]
model = "justin_torso"
joint_angles = [0.0, 0.2, -0.12]
show_arrows = true
"""
SPACE_JUSTIN = """
[robots.torso]
model = "space_justin_torso"
"""
NEAR = """
[view]
azimuth_deg = 165
elevation_deg = -12
distance = {distance}
look_at = [0.0, 0.0, {height}]
"""


SHOTS = (
    Shot("justin", "Rollin' Justin: approximate, not DLR data",
         JUSTIN + WHEELS + upper_body("dlr_hand2_finger", DLR_HAND2, [0.0, 0.4, 0.5]),
         holds_itself=True),
    Shot("space_justin", "SpaceJustin: approximate, not DLR data",
         SPACE_JUSTIN + upper_body("hit_finger", HIT_HAND, [0.0, 0.45, 0.45]),
         holds_itself=True),
    Shot("lwr", "DLR/KUKA LWR, holding itself", "lwr", {
        "lwr.joint_angles": [0.4, 0.6, 0.0, -1.3, 0.0, 0.7, 0.0], "lwr.show_arrows": True,
    }, holds_itself=True),
    Shot("hit_hand", "DLR/HIT Hand II: meshes are approximate, not DLR data",
         hand("hit_finger", HIT_HAND, [0.0, 0.45, 0.45]) + NEAR.format(distance=0.42, height=0.08)),
    Shot("dlr_hand2", "DLR Hand II: approximate, not DLR data",
         hand("dlr_hand2_finger", DLR_HAND2, [0.0, 0.4, 0.5])
         + NEAR.format(distance=0.56, height=0.1)),
    Shot("hit_hand_grasp", "It holds a can by friction, simulated: torques and forces of the grasp",
         "hit_hand_grasp", at=4.5),
    Shot("biped", "DLR Biped, simulated: it stands by stiff ankles, and is pushed", "biped_stand",
         at=2.25),
    Shot("puma560", "Unimation Puma 560: a standard table, published dynamics", "puma560",
         {"puma560.show_arrows": True}, holds_itself=True),
    Shot("panda", "Franka Emika Panda: a modified table", "panda",
         {"panda.show_arrows": True}, holds_itself=True),
    Shot("scara", "Adept Cobra 600, a SCARA", "scara",
         {"scara.show_arrows": True}, holds_itself=True),
    Shot("stanford", "Stanford arm: a prismatic joint", "stanford",
         {"stanford.show_arrows": True}, holds_itself=True),
    Shot("five_bar", "A five-bar of two serial legs", "five_bar", played_by=PARALLEL),
    Shot("stewart", "A Stewart platform of six serial legs: do they close?", "stewart",
         played_by=PARALLEL),
    Shot("torques", "Round arrows: a push, and the joints that feel it", "impedance_push",
         at=3.2, group=FEATURES),
    Shot("torque_error", "Torque error: commanded less measured", LWR, {
        "lwr.show_arrows": True, "lwr.arrow_quantity": "torque_error",
        "lwr.torques": [0, 40, 5, -20, 2, -4, 0],
        "lwr.commanded_torques": [20, -10, 15, 10, -12, 6, 5],
    }, group=FEATURES),
    Shot("singularity", "Nearness to a singularity: the arm is almost stretched",
         "singularity_pass", at=3.0, group=FEATURES),
    Shot("billboards", "Billboards: angles and torques at every joint", LWR, {
        "lwr.show_billboards": True, "lwr.torques": [2.1, 38.6, 4.2, -17.9, 0.6, -3.2, 0.1],
        "lwr.billboard_lines": [
            {"value": "joint_angles", "unit": "deg", "scale": 57.29578, "decimals": 1}, "torques",
        ],
    }, group=FEATURES),
    Shot("path", "Transparent doubles: the way to a target", LWR + """
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
    Shot("flange_check", "Flange check: two legs that should meet, and do not", """
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
    Shot("position_mode", "Position mode: doubles at commanded poses", "haptic_position",
         at=2.5, group=FEATURES),
    Shot("dark", "Dark, for slides", LWR + '[view]\nlook = "dark"\n', {
        "lwr.show_arrows": True, "lwr.show_billboards": True,
    }, holds_itself=True, group=FEATURES),
)  # fmt: skip


def scene_of(shot: Shot) -> Scene:
    """Returns the scene of a picture, its robots held against gravity where that is wanted."""
    if "\n" not in shot.scene:
        return _held(load_scene(shot.scene, shot.overrides), shot, shot.scene)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{shot.name}.toml"
        file.write_text(shot.scene, "utf-8")
        return _held(load_scene(file, shot.overrides), shot, str(file))


def _held(scene: Scene, shot: Shot, name: str) -> Scene:
    if not shot.holds_itself:
        return scene
    world = World(scene, dynamic=True)
    data = world.make_data()
    mujoco.mj_forward(world.model, data)  # at rest, so that the bias is gravity's
    torques = {
        f"{robot}.torques": data.qfrc_bias[part.dofs].tolist()
        for robot, part in world.robots.items()
    }
    return load_scene(name, {**shot.overrides, **torques})


def make_page(shots: Sequence[Shot] = SHOTS) -> str:
    """Returns the text of the page."""
    about = "`make gallery` makes these pictures; `docs/gallery.py` lists them."
    lines = ["# Gallery", "", about, ""]
    for group in (SYSTEMS, FEATURES):
        lines += [f"## {group}", ""]
        for shot in shots:
            if shot.group == group:
                lines += [f"![{shot.caption}](pictures/gallery/{shot.name}.png)", shot.caption, ""]
    return "\n".join(lines).rstrip("\n") + "\n"


@contextmanager
def _sender(shot: Shot) -> Iterator[None]:
    """Sends the packets of a live scene, as long as its picture takes."""
    if shot.played_by is None:
        yield
        return
    script = DOCS.parent / "scenes" / shot.played_by
    with subprocess.Popen([sys.executable, str(script), shot.scene]) as process:
        yield
        process.terminate()


def main(names: Sequence[str]) -> None:
    """Makes all pictures, or those named, and the page."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    for shot in SHOTS:
        if not names or shot.name in names:
            file = PICTURES / f"{shot.name}.png"
            with _sender(shot):
                render_picture(scene_of(shot), file, size=SIZE, camera=shot.camera, at=shot.at)
            print(file)
    PAGE.write_text(make_page(), "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
