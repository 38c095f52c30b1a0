"""Surroundings of robots: objects, cameras, lights, color themes and the default view."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    Field,
    PrivateAttr,
    ValidationInfo,
    field_validator,
    model_validator,
)

from ...base.declaration import Declaration, Frame, Name, Point, Rgba, Vector
from ...base.errors import mismatch
from ...base.frames import Array
from ..importers.mesh_files import mesh_endings
from ..importers.mjcf_file import is_mjcf_object

_MJCF_KINDS = "a file's name, MJCF text, a mujoco.MjSpec, a PyMJCF RootElement or a composer entity"

# Entries of `size` of each shape, m.
SHAPE_SIZES = {
    "box": "length x, length y, length z",
    "sphere": "radius",
    "cylinder": "radius, length",
    "capsule": "radius, length between the two centres",
    "ellipsoid": "radius x, radius y, radius z",
    "axes": "length",
    "limb": "length of its first link, of its second, radius of the first, of the second",
}
Rgb = tuple[float, float, float]
Look = Literal["light", "dark"]
FinishName = Literal["plastic", "metal", "rubber"]


def _inside(file: str) -> str:
    path = Path(file)
    if "\0" in file:
        raise mismatch(file, "a file's name")
    if path.is_absolute() or ".." in path.parts:
        raise mismatch(file, "a file inside the directory, without '..'")
    return file


def _of_a_mesh(file: str) -> str:
    if Path(_inside(file)).suffix.lower() not in mesh_endings():
        formats = ", ".join(mesh_endings())
        raise mismatch(file, f"a mesh ({formats})")
    return file


def _of_a_urdf(file: str | None) -> str | None:
    return None if file is None else _inside(file)


MeshFile = Annotated[str, AfterValidator(_of_a_mesh)]


def check_mjcf(mjcf: Any) -> Any:
    """Returns a piece of MJCF. Raises ValueError if its type is invalid."""
    if mjcf is None or is_mjcf_object(mjcf):
        return mjcf
    if not isinstance(mjcf, str):
        raise ValueError(f"found {type(mjcf).__name__}; expected {_MJCF_KINDS}")
    if mjcf.lstrip().startswith("<"):
        return mjcf
    if not mjcf.strip():
        raise ValueError("is empty; expected an MJCF file or text that starts with <mujoco")
    return _inside(mjcf)


def check_shape_size(shape: str, size: Array | None) -> None:
    """Raises ValueError if the size of a shape is invalid."""
    meaning = SHAPE_SIZES[shape]
    if size is None or len(size) != len(meaning.split(",")) or (size <= 0).any():
        found = "none" if size is None else size.tolist()
        article = "an" if shape[0] in "ae" else "a"
        raise ValueError(
            f"size of {article} {shape}: found {found}; expected positive {meaning} in m"
        )


class Object(Declaration):
    """An object: a primitive shape, coordinate axes, a mesh, a piece of MJCF, or a URDF.

    An object is fixed to its frame. In simulation, an object of a scene with a mass moves freely.

    Attributes:
        name: unique name in its scene or robot.
        shape: primitive shape. `axes` shows coordinate axes at the frame of the object. A `limb` is
            an arm or leg of a person: two links from its frame to the frame that it `reaches`.
        size: full lengths and radii in m, see `SHAPE_SIZES`.
        mesh: mesh file, relative to `directory`.
        mesh_scale: length of the unit of the mesh file in m.
        mjcf: MJCF file relative to `directory`, MJCF text that starts with `<mujoco`, or in Python
            a `mujoco.MjSpec`, a PyMJCF `mjcf.RootElement`, or a dm_control composer entity.
        urdf: URDF file without joints relative to `directory`, for example of a table or a tool.
        frame: pose in the world, or in the frame of the robot to which a child is fixed.
        reaches: for a limb, the frame at its end (`left/flange`). Its joint is on the side of the x
            axis of its frame. If the end is out of reach, the limb points towards it.
        end: for a limb, the position of its end in this frame, m.
        on: for a child of a robot, the frame to which it is fixed: `base`, `link1`, ..., `flange`.
        rgba: red, green, blue and opacity, from 0 to 1. A piece of MJCF has its own colors.
        finish: surface of a shape or mesh: `plastic`, `metal` or `rubber`.
        mass: mass of a solid with uniform density, kg (default for a child of a robot: the density
            of water).
        friction: coefficient of friction of all contacts in simulation (default: 0.3).
        directory: folder of the files, set by the reader of the declaration.
    """

    name: Name
    shape: Literal["box", "sphere", "cylinder", "capsule", "ellipsoid", "axes", "limb"] | None = (
        None
    )
    size: Vector | None = None
    mesh: MeshFile | None = None
    mesh_scale: float = Field(1.0, gt=0)
    mjcf: Any = None
    urdf: Annotated[str | None, AfterValidator(_of_a_urdf)] = None
    frame: Frame = Field(default_factory=lambda: np.eye(4))
    rgba: Rgba = Field(default_factory=lambda: np.array([0.62, 0.66, 0.70, 1.0]))
    reaches: str | None = None
    end: Point = Field(default_factory=lambda: np.zeros(3))
    finish: FinishName = "plastic"
    on: str = "flange"
    mass: float | None = Field(None, gt=0)
    friction: float | None = Field(None, ge=0)
    directory: str = ""

    _declared: tuple[Path, str] | None = PrivateAttr(
        None
    )  # file and key, if they differ from those of the robot

    @field_validator("mjcf")
    @classmethod
    def _mjcf_is_inside(cls, mjcf: Any) -> Any:
        return check_mjcf(mjcf)

    @model_validator(mode="after")
    def _one_kind(self) -> Object:
        given = [key for key in ("shape", "mesh", "mjcf", "urdf") if getattr(self, key) is not None]
        if len(given) != 1:
            found = " and ".join(given) or "none of them"
            raise ValueError(f"found {found}; expected exactly one of shape, mesh, mjcf, urdf")
        if (self.shape == "limb") != (self.reaches is not None):
            found = self.reaches or "none"
            raise ValueError(f"reaches: found {found}; expected a frame of a limb, and of no other")
        self._check_solid()
        if "finish" in self.model_fields_set and (self.shape in (None, "axes") and not self.mesh):
            what = "axes" if self.shape else "MJCF" if self.mjcf is not None else "a URDF"
            found = f"finish: found '{self.finish}' for {what}"
            raise ValueError(f"{found}; expected it of a shape that is a body, or of a mesh")
        if self.shape is None:
            return self
        if self.size is None and self.shape == "axes":
            self.__dict__["size"] = np.array([0.2])
        check_shape_size(self.shape, self.size)
        return self

    def _check_solid(self) -> None:
        for key in ("mass", "friction"):
            if getattr(self, key) is None or self.shape not in (None, "axes", "limb") or self.mesh:
                continue
            found = f"{key}: found {getattr(self, key):g}"
            if self.urdf is not None:
                raise ValueError(f"{found} for a URDF, which stays where it is; expected none")
            if self.mjcf is not None:
                raise ValueError(f"{found} for a piece of MJCF; expected it in its geoms")
            raise ValueError(f"{found} for {self.shape}; expected another shape, or a mesh")

    @property
    def is_free(self) -> bool:
        """Whether it moves freely in simulation."""
        return self.mass is not None


def set_directory(children: Any, folder: Path) -> None:
    """Makes the folders of children relative to the folder of their file."""
    for child in children if isinstance(children, list) else []:
        if isinstance(child, dict) and isinstance(child.setdefault("directory", ""), str):
            child["directory"] = str(folder / child["directory"])


def _unit_range(rgb: Array) -> Array:
    if (rgb < 0).any() or (rgb > 1).any():
        raise mismatch(rgb.tolist(), "three numbers from 0 to 1")
    return rgb


def _direction(vector: Array) -> Array:
    if not np.abs(vector).max() > 0:
        raise mismatch(vector.tolist(), "a direction")
    return vector


class Camera(Declaration):
    """A named camera.

    Attributes:
        position: position in `frame`, m.
        look_at: point at the center of the image, in `frame`, m.
        fovy_deg: vertical field of view in degrees.
        frame: T_world_frame of `position` and `look_at`. A route to its input `NAME.frame` can move
            the camera with a robot.
    """

    position: Point
    look_at: Point = Field(default_factory=lambda: np.zeros(3))
    fovy_deg: float = Field(45.0, gt=0, lt=180)
    frame: Frame = Field(default_factory=lambda: np.eye(4))

    @field_validator("look_at")
    @classmethod
    def _is_elsewhere(cls, look_at: Array, info: ValidationInfo) -> Array:
        position = info.data.get("position")
        if position is not None and np.array_equal(look_at, position):
            raise mismatch(look_at.tolist(), "another point than position")
        return look_at


class View(Declaration):
    """The default view of a scene.

    Attributes:
        camera: name of a camera of the scene. The other fields concern the free camera.
        azimuth_deg: viewing direction about the vertical axis in degrees; 90 looks along +y.
        elevation_deg: elevation in degrees; negative values look down.
        distance: distance from the look-at point in m (default: fits the scene).
        look_at: look-at point (3,), m (default: the center of the scene).
        follow: robot, group or frame (`lwr/flange`) that the free camera follows.
        look: color theme, `light` or `dark`.
    """

    camera: str | None = None
    azimuth_deg: float = 150.0
    elevation_deg: float = -14.0
    distance: float | None = Field(None, gt=0)
    look_at: Point | None = None
    follow: str | None = None
    look: Look = "light"


@dataclass(frozen=True)
class PhysicalLight:
    """Light of the surroundings for physically based renderers.

    Values are relative to the light that renders a white surface as white.

    Attributes:
        sky: radiance of the sky that lights surfaces, relative to the visible radiance.
        ground: radiance from below, relative to the color of the lighter tiles of the floor.
        softbox: radiance of a large lamp above, which smooth surfaces reflect.
        key: illuminance of the light that casts shadows, on a surface that faces it.
        bulb: radius of this light, m. A larger radius results in softer shadows.
    """

    sky: float
    ground: float
    softbox: float
    key: float
    bulb: float = 0.15


@dataclass(frozen=True)
class Palette:
    """Colors of the surroundings (red, green, blue from 0 to 1) and lights.

    Attributes:
        sky: colors at the horizon and at the zenith.
        tiles: two colors of the floor tiles, and the color of the lines between them.
        haze: color at the end of the floor.
        headlight: ambient and diffuse intensity.
        key: intensity of the light that casts shadows.
        physical: the same light for physically based renderers.
    """

    sky: tuple[Rgb, Rgb]
    tiles: tuple[Rgb, Rgb, Rgb]
    haze: Rgb
    headlight: tuple[float, float]
    key: float
    physical: PhysicalLight


KEY_DIRECTION = (-0.35, 0.4, -1.0)  # direction of the light that casts shadows

PALETTES = {
    # Together with the key light, a floor is just below white when viewed from above.
    "light": Palette(
        sky=((0.97, 0.98, 0.99), (0.70, 0.76, 0.82)),
        tiles=((0.83, 0.85, 0.87), (0.86, 0.88, 0.90), (0.78, 0.80, 0.83)),
        haze=(0.93, 0.95, 0.97),
        headlight=(0.34, 0.28),
        key=0.52,
        physical=PhysicalLight(sky=0.40, ground=0.55, softbox=0.3, key=0.72),
    ),
    "dark": Palette(
        sky=((0.11, 0.13, 0.16), (0.03, 0.04, 0.05)),
        tiles=((0.15, 0.17, 0.20), (0.17, 0.19, 0.22), (0.24, 0.27, 0.31)),
        haze=(0.09, 0.11, 0.14),
        headlight=(0.30, 0.30),
        key=0.55,
        physical=PhysicalLight(sky=16.0, ground=16.0, softbox=0.6, key=0.42),
    ),
}


@dataclass(frozen=True)
class Finish:
    """Reflection of light at a surface.

    Attributes:
        roughness: roughness from 0 (mirror) to 1, for physically based renderers. Its square is
            the width of a microfacet lobe.
        metallic: fraction of the light that is reflected in the color of the surface.
        specular: strength of highlights in the classic renderer, 0 to 1.
        shininess: sharpness of highlights in the classic renderer, 0 to 1.
    """

    roughness: float
    metallic: float
    specular: float
    shininess: float


# Plastic is the default material of MuJoCo. In surroundings with one lamp, a metal that reflects
# all light would be almost black, so about half of the light is scattered, like by blasted
# aluminum. The values of roughness were chosen by eye, satin for metal and dull for rubber. The
# shininess is (2 / roughness^4 - 2) / 128, see `filament/geoms.py`.
FINISHES: dict[str, Finish] = {
    "metal": Finish(roughness=0.42, metallic=0.45, specular=0.8, shininess=0.49),
    "rubber": Finish(roughness=0.9, metallic=0.0, specular=0.1, shininess=0.008),
}


class Light(Declaration):
    """A light with a position and a direction.

    Attributes:
        position: position (3,), m.
        direction: direction (3,) of the light, of any length.
        diffuse: red, green and blue, from 0 to 1.
        directional: whether the rays are parallel, like those of the sun.
        cast_shadow: whether objects cast shadows.
    """

    position: Point
    direction: Annotated[Point, AfterValidator(_direction)] = np.array([0.0, 0.0, -1.0])
    diffuse: Annotated[Point, AfterValidator(_unit_range)] = np.full(3, 0.7)
    directional: bool = True
    cast_shadow: bool = True
