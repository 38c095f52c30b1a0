"""Fixed objects of a scene or of a robot's flange."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from ..declaration import Declaration, Frame, Name, Rgba, Vector
from .mjcf_piece import is_mjcf_object

_MJCF_KINDS = "a file's name, MJCF text, a mujoco.MjSpec, a PyMJCF RootElement or a composer entity"
MESH_FORMATS = (".stl", ".obj", ".msh")

# Meaning of the entries of `size` for each shape, m.
SHAPE_SIZES = {
    "box": "length x, length y, length z",
    "sphere": "radius",
    "cylinder": "radius, length",
    "capsule": "radius, length between the two centres",
    "ellipsoid": "radius x, radius y, radius z",
    "axes": "length",
}


def check_inside(file: str) -> str:
    """Returns a file name after checking that it does not leave its folder.

    Raises:
        ValueError: it is absolute or contains `..`.
    """
    path = Path(file)
    if "\0" in file:
        raise ValueError(f"found {file!r}; expected a file's name")
    if path.is_absolute() or ".." in path.parts:
        raise ValueError(f"found '{file}'; expected a file inside the directory, without '..'")
    return file


def check_mesh_file(file: str) -> str:
    """Returns a file name after checking its folder and that MuJoCo can read the format.

    Raises:
        ValueError: it is absolute, contains `..`, or has another ending.
    """
    if Path(check_inside(file)).suffix.lower() not in MESH_FORMATS:
        formats = ", ".join(MESH_FORMATS)
        raise ValueError(f"found '{file}'; expected a mesh that MuJoCo reads ({formats})")
    return file


class Object(Declaration):
    """A fixed object: a primitive shape, coordinate axes, a mesh, or a piece of MJCF.

    Attributes:
        name: unique in its scene or robot.
        shape: a primitive; `axes` shows coordinate axes at the object's frame.
        size: full lengths and radii in m, see `SHAPE_SIZES`.
        mesh: mesh file, relative to `directory`.
        mesh_scale: metres per unit of the mesh file.
        mjcf: MJCF file relative to `directory`, MJCF text that starts with `<mujoco`, or in
            Python an object that contains MJCF: a `mujoco.MjSpec`, a PyMJCF
            `mjcf.RootElement`, a dm_control composer entity.
        frame: pose in the world, or in the flange's frame for a robot's child.
        rgba: colour; an MJCF piece has its own.
        directory: base folder of the files, set by the reader of the declaration.
    """

    name: Name
    shape: Literal["box", "sphere", "cylinder", "capsule", "ellipsoid", "axes"] | None = None
    size: Vector | None = None
    mesh: str | None = None
    mesh_scale: float = Field(1.0, gt=0)
    mjcf: Any = None
    frame: Frame = Field(default_factory=lambda: np.eye(4))
    rgba: Rgba = Field(default_factory=lambda: np.array([0.62, 0.66, 0.70, 1.0]))
    directory: str = ""

    @field_validator("mesh")
    @classmethod
    def _mesh_is_inside(cls, mesh: str | None) -> str | None:
        return mesh if mesh is None else check_mesh_file(mesh)

    @field_validator("mjcf")
    @classmethod
    def _mjcf_is_inside(cls, mjcf: Any) -> Any:
        if mjcf is None or is_mjcf_object(mjcf):
            return mjcf
        if not isinstance(mjcf, str):
            raise ValueError(f"found {type(mjcf).__name__}; expected {_MJCF_KINDS}")
        if mjcf.lstrip().startswith("<"):
            return mjcf
        if not mjcf.strip():
            raise ValueError("is empty; expected an MJCF file or text that starts with <mujoco")
        return check_inside(mjcf)

    @model_validator(mode="after")
    def _one_kind(self) -> Object:
        given = [key for key in ("shape", "mesh", "mjcf") if getattr(self, key) is not None]
        if len(given) != 1:
            found = " and ".join(given) or "none of them"
            raise ValueError(f"found {found}; expected exactly one of shape, mesh, mjcf")
        if self.shape is None:
            return self
        meaning = SHAPE_SIZES[self.shape]
        wanted = len(meaning.split(","))
        if self.size is None and self.shape == "axes":
            self.__dict__["size"] = np.array([0.2])
        found_count = 0 if self.size is None else len(self.size)
        if self.size is None or found_count != wanted or (self.size <= 0).any():
            found = "none" if self.size is None else self.size.tolist()
            article = "an" if self.shape[0] in "ae" else "a"
            raise ValueError(
                f"size of {article} {self.shape}: found {found}; expected positive {meaning} in m"
            )
        return self


def set_directory(children: Any, folder: Path) -> None:
    """Makes the folders of children relative to the folder of the file that declares them."""
    for child in children if isinstance(children, list) else []:
        if isinstance(child, dict) and isinstance(child.setdefault("directory", ""), str):
            child["directory"] = str(folder / child["directory"])
