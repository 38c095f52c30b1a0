"""`RobotPlace`: where robots are found by a name that is no file, and none of ours.

They are those of the package `robot_descriptions`, of a checkout of MuJoCo Menagerie, and of ROS
packages. Another package adds a place by an entry point in the group `sero_mj.robots`.
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

# Names of makers and of their drivers, for what others call otherwise.
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
_ENDINGS = ("_description", "_mj_description")  # of the modules of robot_descriptions
_BESIDE = ("mujoco_menagerie", "menagerie")  # folders of a checkout
_WRAPPER = """\
<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name={name}>
{arguments}
  <xacro:include filename={file}/>
</robot>
"""


class RobotPlace(ABC):
    """A place where robots have names.

    Attributes:
        none: what is said there where it knows no names.
        order: in which places are asked, lowest first; sero-mj's own have 10 to 90.
    """

    title: ClassVar[str]
    none: ClassVar[str] = ""
    order: ClassVar[int] = 100

    @abstractmethod
    def names(self) -> list[str]:
        """Returns the names that are known there; it takes no network."""

    @abstractmethod
    def find(self, name: str) -> Path | None:
        """Returns the file of a robot; None if none has that name.

        Raises SeroError if it has the name, but cannot be had.
        """

    def near(self, name: str) -> str | None:
        """Returns the name there that may be meant by one that is unknown; None for none."""
        return nearest(name, self.names())


class RobotDescriptions(RobotPlace):
    """The package `robot_descriptions`, which clones repositories of robots into its cache.

    A robot is named as its module, `ur5e_description`; shorter names are not taken, because what
    they would fetch may have hundreds of megabytes.
    """

    order: ClassVar[int] = 90
    title: ClassVar[str] = "robot_descriptions"
    none: ClassVar[str] = "pip install 'sero-mj[robots]' brings it"

    def names(self) -> list[str]:
        if find_spec("robot_descriptions") is None:
            return []
        from robot_descriptions._descriptions import DESCRIPTIONS

        return [name for name, about in DESCRIPTIONS.items() if about.has_urdf or about.has_mjcf]

    def find(self, name: str) -> Path | None:
        if not _plain(name).endswith(_plain(_ENDINGS[0])):  # importing the package takes a while
            return None
        module = {_plain(each): each for each in self.names()}.get(_plain(name))
        if module is None:
            return None
        try:
            found = import_listed("robot_descriptions", module, self.names())
        except Exception as error:  # of git, of the network, of the package
            told = " ".join(str(error).split())[:300]
            raise UsageError(
                f"{module}: robot_descriptions cannot fetch it: {type(error).__name__}: {told}"
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
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from error
    return path


class Menagerie(RobotPlace):
    """A checkout of MuJoCo Menagerie: `$MENAGERIE_PATH`, or a folder `mujoco_menagerie` beside.

    A robot is named as its folder, with or without its maker: `universal_robots_ur5e`, `ur5e`.
    """

    order: ClassVar[int] = 20
    title: ClassVar[str] = "MuJoCo Menagerie"
    none: ClassVar[str] = "no checkout in $MENAGERIE_PATH, nor in a folder mujoco_menagerie here"

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
    """Shipped robots as their makers and drivers call them: `franka_research_3`, `UR5e`."""

    order: ClassVar[int] = 30
    title: ClassVar[str] = "other spellings of shipped robots"

    def names(self) -> list[str]:
        return sorted(name for name, usual in _ALIASES.items() if usual in list_models())

    def find(self, name: str) -> Path | None:
        shipped = {_plain(each): each for each in list_models()}
        found = shipped.get(_plain(_common(name)))
        return None if found is None else models_dir() / found / ROBOT_FILE


class RosPackages(RobotPlace):
    """ROS packages of the environment: `package://ur_description/urdf/ur.urdf.xacro`."""

    order: ClassVar[int] = 10
    title: ClassVar[str] = "ROS packages"
    none: ClassVar[str] = "by their files, package://NAME/FILE"

    def names(self) -> list[str]:
        return []

    def find(self, name: str) -> Path | None:
        if not name.startswith("package://"):
            return None
        found = find_file(name, Path.cwd() / "scene.toml")
        if found is None:
            raise UsageError(
                f"{name}: no such file in a package; --package NAME=DIR, $ROS_PACKAGE_PATH and "
                "$AMENT_PREFIX_PATH say where packages are"
            )
        return found


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


@cache
def _common(name: str) -> str:
    return _ALIASES.get(_plain(name), name)
