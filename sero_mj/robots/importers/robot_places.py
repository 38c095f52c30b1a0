"""Finds robots by name that are not included in sero-mj.

Robots are searched for in the package `robot_descriptions`, in MuJoCo Menagerie and in ROS
packages. Packages add a `RobotPlace` with an entry point in the group `sero_mj.robots`.
"""

from __future__ import annotations

import os
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar
from xml.sax.saxutils import quoteattr

from ...base.errors import UsageError, nearest
from ...base.paths import ROBOT_FILE, list_models, model_in, models_dir
from ...base.trust import import_listed
from .package_files import find_file

# Included robots by the names that manufacturers and drivers use.
_ALIASES: Mapping[str, str] = {
    "frankaemikapanda": "panda",
    "frankapanda": "panda",
    "frankafr3": "fr3",
    "frankaresearch3": "fr3",
    "iiwa": "iiwa14",
    "iiwa14r820": "iiwa14",
    "iiwa7r800": "iiwa7",
    "kinovagen3": "gen3",
    "lbriiwa14": "iiwa14",
    "lbriiwa14r820": "iiwa14",
    "lbriiwa7": "iiwa7",
    "universalrobotsur10e": "ur10e",
    "universalrobotsur5e": "ur5e",
}
_ENDINGS = ("_description", "_mj_description")  # endings of module names in robot_descriptions
_BESIDE = ("mujoco_menagerie", "menagerie")  # usual folders of a local clone
_WRAPPER = """\
<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name={name}>
{arguments}
  <xacro:include filename={file}/>
</robot>
"""


class RobotPlace(ABC):
    """Base class of collections in which robots are found by name, such as a package.

    Attributes:
        title: displayed name of the collection.
        none: text that `sero-mj list` shows if `names` is empty, for example an install command.
        order: search priority; the lowest comes first. Built-in collections use 10 to 90.
    """

    title: ClassVar[str]
    none: ClassVar[str] = ""
    order: ClassVar[int] = 100

    @abstractmethod
    def names(self) -> list[str]:
        """Returns the names of known robots without accessing the network."""

    @abstractmethod
    def find(self, name: str) -> Path | None:
        """Returns the file of the robot with a name, or None if the name is unknown.

        Raises SeroError if the name is known but the file is not available.
        """

    def near(self, name: str) -> str | None:
        """Returns the known name that is most similar to an unknown name, or None."""
        return nearest(name, self.names())


class RobotDescriptions(RobotPlace):
    """Robots of the package `robot_descriptions`, which clones robot repositories into a cache.

    The name of a robot is the name of its module, such as `ur5e_description`. Shorter names are not
    accepted, because a download can have hundreds of megabytes.
    """

    order: ClassVar[int] = 90
    title: ClassVar[str] = "robot_descriptions"
    none: ClassVar[str] = "install it with pip install 'sero-mj[robots]'"

    def names(self) -> list[str]:
        if find_spec("robot_descriptions") is None:
            return []
        from robot_descriptions._descriptions import DESCRIPTIONS

        return [name for name, about in DESCRIPTIONS.items() if about.has_urdf or about.has_mjcf]

    def find(self, name: str) -> Path | None:
        if not _plain(name).endswith(_plain(_ENDINGS[0])):  # importing the package is slow
            return None
        module = {_plain(each): each for each in self.names()}.get(_plain(name))
        if module is None:
            return None
        try:
            found = import_listed("robot_descriptions", module, self.names())
        except Exception as error:  # Git, the network or the package can fail.
            reason = " ".join(str(error).split())[:300]
            raise UsageError(
                f"robot_descriptions cannot fetch {module}: {type(error).__name__}: {reason}"
            ) from error
        for attribute in ("URDF_PATH", "MJCF_PATH"):
            if (path := getattr(found, attribute, None)) is not None:
                return Path(path)
        return _wrapped(module, found)

    def near(self, name: str) -> str | None:
        known = {_plain(each): each for each in self.names()}
        longer = [_plain(f"{_common(name)}{ending}") for ending in _ENDINGS]
        return next((known[each] for each in longer if each in known), super().near(name))


def _wrapped(module: str, found: Any) -> Path:
    arguments = [
        f"  <xacro:arg name={quoteattr(key)} default={quoteattr(str(value))}/>"
        for key, value in getattr(found, "XACRO_ARGS", {}).items()
    ]
    text = _WRAPPER.format(
        name=quoteattr(module), arguments="\n".join(arguments), file=quoteattr(found.XACRO_PATH)
    )
    path = Path(found.REPOSITORY_PATH) / ".sero-mj" / f"{module}.urdf.xacro"
    try:
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path} cannot be written: {error.strerror}") from error
    return path


class Menagerie(RobotPlace):
    """Robots in a clone of MuJoCo Menagerie, in `$MENAGERIE_PATH` or the folder `mujoco_menagerie`.

    The name of a robot is the name of its folder, with or without the manufacturer, such as
    `universal_robots_ur5e` or `ur5e`.
    """

    order: ClassVar[int] = 20
    title: ClassVar[str] = "MuJoCo Menagerie"
    none: ClassVar[str] = "no clone in $MENAGERIE_PATH or ./mujoco_menagerie"

    def names(self) -> list[str]:
        return [folder.name for folder in _menagerie()]

    def find(self, name: str) -> Path | None:
        wanted = _plain(_common(name))
        folders = {_plain(folder.name): folder for folder in _menagerie()}
        ends = [each for each in folders if each.endswith(wanted)]
        found = folders.get(_plain(name)) or (folders[min(ends, key=len)] if ends else None)
        return None if found is None or len(wanted) < 2 else model_in(found)


def _menagerie() -> list[Path]:
    named = os.environ.get("MENAGERIE_PATH")
    for folder in [Path(named)] if named else [Path(each) for each in _BESIDE]:
        try:
            inner = sorted(each for each in folder.iterdir() if not each.name.startswith("."))
        except OSError:
            continue
        return [each for each in inner if any(each.glob("*.xml"))]
    return []


class OtherSpellings(RobotPlace):
    """Included robots by the names of manufacturers and drivers, such as `franka_research_3`."""

    order: ClassVar[int] = 30
    title: ClassVar[str] = "other spellings of included robots"

    def names(self) -> list[str]:
        return sorted(name for name, usual in _ALIASES.items() if usual in list_models())

    def find(self, name: str) -> Path | None:
        shipped = {_plain(each): each for each in list_models()}
        found = shipped.get(_plain(_common(name)))
        return None if found is None else models_dir() / found / ROBOT_FILE


class RosPackages(RobotPlace):
    """Robots in ROS packages, such as `package://ur_description/urdf/ur.urdf.xacro`."""

    order: ClassVar[int] = 10
    title: ClassVar[str] = "ROS packages"
    none: ClassVar[str] = "use package://NAME/FILE"

    def names(self) -> list[str]:
        return []

    def find(self, name: str) -> Path | None:
        if not name.startswith("package://"):
            return None
        found = find_file(name, Path.cwd() / "scene.toml")
        if found is None:
            raise UsageError(
                f"{name}: no such file in a package. Set the folder of the package with --package "
                "NAME=DIR, $ROS_PACKAGE_PATH or $AMENT_PREFIX_PATH."
            )
        return found


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


@cache
def _common(name: str) -> str:
    return _ALIASES.get(_plain(name), name)
