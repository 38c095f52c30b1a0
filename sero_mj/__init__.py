"""sero-mj: simulator and viewer for torque-controlled robots on MuJoCo.

Conventions in this package:

- Units are SI: m, rad, s, kg, N, Nm. A name includes the unit only if the unit is not an SI
  unit (`azimuth_deg`).
- Frames are 4x4 row-major numpy arrays, float64. `T_a_b` maps coordinates of b to a, so
  `T_world_flange[:3, 3]` is the position of the flange. Quaternions are w, x, y, z. Roll, pitch and
  yaw rotate about the fixed x, y and z axes, as in URDF. The z axis of the world points up.
- A robot has n joints, numbered from 1 at the base in names and from 0 in arrays. Arrays over
  joints have the shape (n,). Joint values are in rad (revolute) or m (prismatic), efforts in Nm or
  N.
- Images have the shape (height, width, 3) and type uint8, top row first. Pixel coordinates of
  clicks (`--click`, `HeadlessRenderer.click`) are counted from the upper left corner, x to the
  right, y down. Inside `viewer`, they are counted from the lower left corner, y up.
- Data flows in one direction: assemble, receive, drive, decor, windows and pages. A file imports
  only from packages above its own in the table of the README.

Public names are imported on first use, because `import mujoco` is slow. Extensions add names
through entry points in the group `sero_mj.names`. Importing this package without a display sets
`MUJOCO_GL` to a backend that needs none, unless it is set or MuJoCo is already imported.
"""

import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .base.errors import DeclarationError as DeclarationError
    from .base.errors import SeroError as SeroError
    from .base.errors import SimulationError as SimulationError
    from .data.drive.mirror import Mirror as Mirror
    from .data.drive.place import Placer as Placer
    from .data.drive.record_sources import record_sources as record_sources
    from .data.receive.shm import ShmReader as ShmReader
    from .data.receive.structure import Structure as Structure
    from .data.receive.udp import UdpReceiver as UdpReceiver
    from .data.record.recording import Recording as Recording
    from .data.record.replay import Replay as Replay
    from .load import load_scene as load_scene
    from .robots.assemble.forward_kinematics import ForwardKinematics as ForwardKinematics
    from .robots.assemble.world import World as World
    from .robots.declared.cartesian import ReceivedFrame as ReceivedFrame
    from .robots.declared.cartesian import SmartArrow as SmartArrow
    from .robots.declared.double import Double as Double
    from .robots.declared.dynamics import Dynamics as Dynamics
    from .robots.declared.groups import Group as Group
    from .robots.declared.robot import SerialRobot as SerialRobot
    from .robots.declared.scene import Scene as Scene
    from .robots.declared.scene import SceneToggles as SceneToggles
    from .robots.declared.scene_file import group_from_model as group_from_model
    from .robots.declared.surroundings import Camera as Camera
    from .robots.declared.surroundings import Light as Light
    from .robots.declared.surroundings import Object as Object
    from .robots.declared.surroundings import View as View
    from .robots.kinematics.dh import DhTable as DhTable
    from .simulate.plant import Plant as Plant
    from .simulate.scenario import Scenario as Scenario
    from .simulate.scenario_file import read_scenario as read_scenario
    from .simulate.sensors import SensorErrors as SensorErrors
    from .simulate.sensors import Sensors as Sensors
    from .simulate.simulation import Simulation as Simulation
    from .viewer.image.render import HeadlessRenderer as HeadlessRenderer
    from .viewer.image.render import render_image as render_image
    from .viewer.image.render import render_video as render_video
    from .viewer.player.capture import Mark as Mark
    from .viewer.player.page import export_html as export_html
    from .viewer.program.overlay import Overlay as Overlay
    from .viewer.program.overlay import overlay as overlay
    from .viewer.program.viewer import Viewer as Viewer
    from .viewer.program.viewer import view as view

from .base.when_imported import when_imported as _when_imported
from .viewer.image.backend import choose_backend as _choose_backend
from .viewer.image.backend import has_display as _has_display

if not _has_display():
    _choose_backend()

_when_imported("gymnasium")

__version__ = "0.2.0"

_HOME = {
    "ReceivedFrame": "robots.declared.cartesian",
    "SmartArrow": "robots.declared.cartesian",
    "DhTable": "robots.kinematics.dh",
    "Double": "robots.declared.double",
    "Dynamics": "robots.declared.dynamics",
    "Group": "robots.declared.groups",
    "group_from_model": "robots.declared.scene_file",
    "Object": "robots.declared.surroundings",
    "SerialRobot": "robots.declared.robot",
    "Camera": "robots.declared.surroundings",
    "Light": "robots.declared.surroundings",
    "Scene": "robots.declared.scene",
    "View": "robots.declared.surroundings",
    "SceneToggles": "robots.declared.scene",
    "ForwardKinematics": "robots.assemble.forward_kinematics",
    "World": "robots.assemble.world",
    "Mirror": "data.drive.mirror",
    "load_scene": "load",
    "Placer": "data.drive.place",
    "record_sources": "data.drive.record_sources",
    "DeclarationError": "base.errors",
    "SeroError": "base.errors",
    "Recording": "data.record.recording",
    "Replay": "data.record.replay",
    "ShmReader": "data.receive.shm",
    "SimulationError": "base.errors",
    "Structure": "data.receive.structure",
    "UdpReceiver": "data.receive.udp",
    "Plant": "simulate.plant",
    "Scenario": "simulate.scenario",
    "read_scenario": "simulate.scenario_file",
    "Simulation": "simulate.simulation",
    "SensorErrors": "simulate.sensors",
    "Sensors": "simulate.sensors",
    "render_video": "viewer.image.render",
    "render_image": "viewer.image.render",
    "HeadlessRenderer": "viewer.image.render",
    "export_html": "viewer.player.page",
    "Mark": "viewer.player.capture",
    "Overlay": "viewer.program.overlay",
    "overlay": "viewer.program.overlay",
    "Viewer": "viewer.program.viewer",
    "view": "viewer.program.viewer",
}
# Earlier names of public functions, available until the next version.
_RENAMED = {"render_film": "render_video", "render_picture": "render_image"}


__all__ = ["__version__", *_HOME]  # noqa: PLE0604


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        warnings.warn(
            f"'{name}' is deprecated; use '{_RENAMED[name]}'", DeprecationWarning, stacklevel=2
        )
        return __getattr__(_RENAMED[name])
    if name in _HOME:
        value = getattr(import_module(f".{_HOME[name]}", __name__), name)
    elif name.startswith("_") or name not in _added_names():
        raise AttributeError(f"module 'sero_mj' has no attribute '{name}'")
    else:
        value = _added_names()[name].load()
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME, *_added_names()])


def _added_names() -> Any:
    from .base.plugins import NAMES, plugins

    return plugins(NAMES)
