"""sero-mj: simulator and viewer for torque-controlled robots on MuJoCo.

Conventions, everywhere in this package:

- SI units: m, rad, s, kg, N, Nm. A name says its unit only where it is another one
  (`azimuth_deg`).
- Frames are 4x4 row-major numpy arrays, float64; `T_a_b` maps coordinates of b into a, so
  `T_world_flange[:3, 3]` is where the flange is. Quaternions are w, x, y, z. Roll, pitch and yaw
  turn about the fixed x, y and z axes, as in URDF. The world's z points up.
- A robot has n joints, numbered from 1 at the base in names and from 0 in arrays; per-joint
  arrays are (n,). Joint values are rad for revolute and m for prismatic joints, efforts Nm and N.
- Pictures are (height, width, 3), uint8, top row first, and pixels of clicks (`--click`,
  `HeadlessRenderer.click`) are counted from the upper left corner, x to the right, y down. Within
  `decor` and `show` they are counted from the lower left one, y up.
- The data moves one way: assemble, receive, drive, decor, show. A file imports only from folders
  above its own in the README's list, which has the others as well.

The public names are imported when they are first used, because `import mujoco` takes a while.
Where there is no display, `MUJOCO_GL` is not set and MuJoCo is not yet imported, importing this
package sets it to what works without one; no graphics driver is loaded before the first picture.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .assemble.cartesian import ReceivedFrame as ReceivedFrame
    from .assemble.cartesian import SmartArrow as SmartArrow
    from .assemble.dh import DhTable as DhTable
    from .assemble.double import Double as Double
    from .assemble.dynamics import Dynamics as Dynamics
    from .assemble.groups import Group as Group
    from .assemble.robot import SerialRobot as SerialRobot
    from .assemble.scene import Scene as Scene
    from .assemble.scene import SceneToggles as SceneToggles
    from .assemble.scene_file import group_from_model as group_from_model
    from .assemble.surroundings import Camera as Camera
    from .assemble.surroundings import Light as Light
    from .assemble.surroundings import Object as Object
    from .assemble.surroundings import View as View
    from .assemble.world import World as World
    from .drive.mirror import Mirror as Mirror
    from .drive.place import Placer as Placer
    from .drive.record_sources import record_sources as record_sources
    from .environment.make import make_environment as make_environment
    from .errors import DeclarationError as DeclarationError
    from .errors import SeroError as SeroError
    from .errors import SimulationError as SimulationError
    from .load import load_scene as load_scene
    from .receive.fri import FriReceiver as FriReceiver
    from .receive.shm import ShmReader as ShmReader
    from .receive.structure import Structure as Structure
    from .receive.udp import UdpReceiver as UdpReceiver
    from .record.recording import Recording as Recording
    from .record.replay import Replay as Replay
    from .show.headless.render import HeadlessRenderer as HeadlessRenderer
    from .show.headless.render import render_film as render_film
    from .show.headless.render import render_picture as render_picture
    from .show.overlay import Overlay as Overlay
    from .show.overlay import overlay as overlay
    from .show.viewer import Viewer as Viewer
    from .show.viewer import view as view
    from .simulate.plant import Plant as Plant
    from .simulate.scenario import Scenario as Scenario
    from .simulate.scenario_file import read_scenario as read_scenario
    from .simulate.sensors import SensorErrors as SensorErrors
    from .simulate.sensors import Sensors as Sensors
    from .simulate.simulation import Simulation as Simulation

from .environment.gymnasium_ids import register_with_gymnasium as _register_with_gymnasium
from .show.headless.backend import choose_backend as _choose_backend
from .show.headless.backend import has_display as _has_display

if not _has_display():
    _choose_backend()

_register_with_gymnasium()

__version__ = "0.1.0"

_HOME = {
    "ReceivedFrame": "assemble.cartesian",
    "SmartArrow": "assemble.cartesian",
    "DhTable": "assemble.dh",
    "Double": "assemble.double",
    "Dynamics": "assemble.dynamics",
    "Group": "assemble.groups",
    "group_from_model": "assemble.scene_file",
    "Object": "assemble.surroundings",
    "SerialRobot": "assemble.robot",
    "Camera": "assemble.surroundings",
    "Light": "assemble.surroundings",
    "Scene": "assemble.scene",
    "View": "assemble.surroundings",
    "SceneToggles": "assemble.scene",
    "World": "assemble.world",
    "Mirror": "drive.mirror",
    "load_scene": "load",
    "Placer": "drive.place",
    "record_sources": "drive.record_sources",
    "make_environment": "environment.make",
    "DeclarationError": "errors",
    "SeroError": "errors",
    "FriReceiver": "receive.fri",
    "Recording": "record.recording",
    "Replay": "record.replay",
    "ShmReader": "receive.shm",
    "SimulationError": "errors",
    "Structure": "receive.structure",
    "UdpReceiver": "receive.udp",
    "Plant": "simulate.plant",
    "Scenario": "simulate.scenario",
    "read_scenario": "simulate.scenario_file",
    "Simulation": "simulate.simulation",
    "SensorErrors": "simulate.sensors",
    "Sensors": "simulate.sensors",
    "render_film": "show.headless.render",
    "render_picture": "show.headless.render",
    "HeadlessRenderer": "show.headless.render",
    "Overlay": "show.overlay",
    "overlay": "show.overlay",
    "Viewer": "show.viewer",
    "view": "show.viewer",
}


__all__ = ["__version__", *_HOME]  # noqa: PLE0604


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'sero_mj' has no attribute '{name}'")
    value = getattr(import_module(f".{_HOME[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
