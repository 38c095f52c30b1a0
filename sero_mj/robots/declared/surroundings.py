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

_MJCF_KINDS = "a file name, MJCF text, a mujoco.MjSpec, a PyMJCF RootElement or a composer entity"

# Entries of `size` by shape, m.
SHAPE_SIZES = {
    "box": "length x, length y, length z",
    "sphere": "radius",
    "cylinder": "radius, length",
    "capsule": "radius, length between the centers of the half spheres",
    "ellipsoid": "radius x, radius y, radius z",
    "axes": "length",
    "limb": "length of link 1, length of link 2, radius of link 1, radius of link 2",
}
Rgb = tuple[float, float, float]
Look = Literal["light", "dark"]
FinishName = Literal["plastic", "metal", "rubber"]


def _inside(file: str) -> str:
    path = Path(file)
    if "\0" in file:
        raise mismatch(file, "a file name")
    if path.is_absolute() or ".." in path.parts:
        raise mismatch(file, "a file inside the directory, without '..'")
    return file


def _of_a_mesh(file: str) -> str:
    if Path(_inside(file)).suffix.lower() not in mesh_endings():
        formats = ", ".join(mesh_endings())
        raise mismatch(file, f"a mesh file ({formats})")
    return file


def _of_a_urdf(file: str | None) -> str | None:
    return None if file is None else _inside(file)


MeshFile = Annotated[str, AfterValidator(_of_a_mesh)]


def check_mjcf(mjcf: Any) -> Any:
    """Returns a declared MJCF file, text or object. Raises ValueError if it is none of these."""
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
    """Raises ValueError if `size` is invalid for a primitive shape, `axes` or a `limb`."""
    meaning = SHAPE_SIZES[shape]
    if size is None or len(size) != len(meaning.split(",")) or (size <= 0).any():
        found = "none" if size is None else size.tolist()
        article = "an" if shape[0] in "ae" else "a"
        raise ValueError(
            f"size of {article} {shape}: found {found}; expected positive {meaning} in m"
        )


class Object(Declaration):
    """An object of a scene or robot: a primitive shape, coordinate axes, a mesh, MJCF, or URDF.

    An object is fixed to its frame. In simulation, an object of a scene with a mass moves freely.

    Attributes:
        name: unique name in the scene or robot.
        shape: primitive shape, or `axes` for coordinate axes at the frame of the object, or `limb`
            for an arm or leg of a person, with two links from this frame to the frame `reaches`.
        size: full lengths and radii in m, for example radius and length of a cylinder.
        mesh: mesh file, relative to `directory`.
        mesh_scale: unit of the mesh file in m.
        mjcf: MJCF file relative to `directory`, MJCF text that starts with `<mujoco`, or in Python
            a `mujoco.MjSpec`, a PyMJCF `mjcf.RootElement`, or a dm_control composer entity.
        urdf: URDF file without joints relative to `directory`, for example of a table or a tool.
        frame: pose of the object in the world, or in the frame to which a child is fixed.
        reaches: frame at the end of a limb (`left/flange`). The elbow or knee bends in the
            direction of the x axis of `frame`. If the end is out of reach, the limb points to it.
        end: position of the end of a limb in the frame `reaches`, m.
        on: frame of the robot to which a child is fixed, `base`, `link1`, ..., `flange`.
        rgba: color as red, green, blue and opacity, from 0 to 1. MJCF has its own colors.
        finish: surface finish of a shape or mesh, `plastic`, `metal` or `rubber`.
        mass: mass in kg, with uniform density (default for a child of a robot: density of water).
        friction: friction coefficient of all contacts in simulation (default: 0.3).
        directory: folder of the files, set when the declaration is read.
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
            if self.reaches is None:
                raise ValueError("reaches: found none; expected the frame at the end of the limb")
            raise ValueError(f"reaches: found {self.reaches}; only a limb can have `reaches`")
        self._check_solid()
        if "finish" in self.model_fields_set and (self.shape in (None, "axes") and not self.mesh):
            what = "axes" if self.shape else "MJCF" if self.mjcf is not None else "a URDF"
            found = f"finish: found '{self.finish}' for {what}"
            raise ValueError(f"{found}; expected a finish only for solid shapes and meshes")
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
                raise ValueError(f"{found} for a URDF object, which cannot move; expected no {key}")
            if self.mjcf is not None:
                raise ValueError(
                    f"{found} for an MJCF object; expected the {key} in the geoms of the MJCF"
                )
            raise ValueError(f"{found} for {self.shape}; expected a solid shape or a mesh")

    @property
    def is_free(self) -> bool:
        """Whether the object, if it belongs to a scene, moves freely in simulation."""
        return self.mass is not None


def set_directory(children: Any, folder: Path) -> None:
    """Resolves the directories of children in tables relative to the folder of their file."""
    for child in children if isinstance(children, list) else []:
        if isinstance(child, dict) and isinstance(child.setdefault("directory", ""), str):
            child["directory"] = str(folder / child["directory"])


def _unit_range(rgb: Array) -> Array:
    if (rgb < 0).any() or (rgb > 1).any():
        raise mismatch(rgb.tolist(), "three numbers from 0 to 1")
    return rgb


def _direction(vector: Array) -> Array:
    if not np.abs(vector).max() > 0:
        raise mismatch(vector.tolist(), "a nonzero vector")
    return vector


class Camera(Declaration):
    """A camera of a scene, which may be fixed or move with a robot.

    Attributes:
        position: position of the camera in `frame`, m.
        look_at: point at the center of the image in `frame`, m.
        fovy_deg: vertical field of view in degrees.
        frame: initial reference frame of `position` and `look_at`, as a pose in the world. A route
            to the input `NAME.frame` moves it, for example with a robot.
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
            raise mismatch(look_at.tolist(), "a point that differs from position")
        return look_at


class View(Declaration):
    """The default view of a scene.

    Attributes:
        camera: name of a camera of the scene. All other fields except `look` are for the free
            camera.
        azimuth_deg: viewing direction about the vertical axis in degrees; 90 looks along +y.
        elevation_deg: viewing direction above the horizontal plane in degrees; negative values look
            down.
        distance: distance of the free camera from `look_at` in m (default: fits the scene).
        look_at: point at the center of the image, m (default: the center of the scene).
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
    """Lighting of a scene for physically based renderers.

    Values are relative to the light that renders a white surface as white.

    Attributes:
        sky: radiance of the sky for lighting surfaces, relative to its visible radiance.
        ground: radiance from below, relative to the color of the lighter floor tiles.
        softbox: radiance of a large lamp above the scene, which smooth surfaces reflect.
        key: illuminance by the light that casts shadows, on a surface facing the light.
        bulb: radius of the light that casts shadows, m. A larger radius softens the shadows.
    """

    sky: float
    ground: float
    softbox: float
    key: float
    bulb: float = 0.15


@dataclass(frozen=True)
class Palette:
    """Colors and lights of a color theme. Colors are red, green and blue, from 0 to 1.

    Attributes:
        sky: colors of the sky at the horizon and at the zenith.
        tiles: two colors of the floor tiles, and the color of the lines between them.
        haze: color into which the floor fades in the distance.
        headlight: ambient and diffuse intensity of the headlight.
        key: intensity of the light that casts shadows.
        physical: corresponding lighting for physically based renderers.
    """

    sky: tuple[Rgb, Rgb]
    tiles: tuple[Rgb, Rgb, Rgb]
    haze: Rgb
    headlight: tuple[float, float]
    key: float
    physical: PhysicalLight


KEY_DIRECTION = (-0.35, 0.4, -1.0)  # direction of the rays that cast shadows

PALETTES = {
    # With the key light, the floor is slightly darker than white when viewed from above.
    "light": Palette(
        sky=((0.82, 0.845, 0.87), (0.66, 0.73, 0.81)),
        tiles=((0.83, 0.85, 0.87), (0.86, 0.88, 0.90), (0.78, 0.80, 0.83)),
        haze=(0.82, 0.845, 0.87),
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
    """The reflection properties of a surface.

    Attributes:
        roughness: roughness from 0 (mirror) to 1, for physically based renderers. Its square is
            the width of the microfacet lobe.
        metallic: fraction of the light that is reflected in the color of the surface.
        specular: strength of highlights in the classic renderer, from 0 to 1.
        shininess: sharpness of highlights in the classic renderer, from 0 to 1.
    """

    roughness: float
    metallic: float
    specular: float
    shininess: float


# Plastic is the default material of MuJoCo. With one lamp, a metal that reflects all light would be
# almost black, so about half of the light is scattered, as by sandblasted aluminum. The values of
# roughness were chosen by eye, satin for metal and dull for rubber. The shininess is
# (2 / roughness^4 - 2) / 128, which `filament/geoms.py` explains.
FINISHES: dict[str, Finish] = {
    "metal": Finish(roughness=0.42, metallic=0.45, specular=0.8, shininess=0.49),
    "rubber": Finish(roughness=0.9, metallic=0.0, specular=0.1, shininess=0.008),
}


class Light(Declaration):
    """A light of a scene.

    Attributes:
        position: position of the light in the world, m.
        direction: direction of the rays, as a vector of any length.
        diffuse: diffuse color as red, green and blue, from 0 to 1.
        directional: whether the rays are parallel, like those of the sun.
        cast_shadow: whether the light casts shadows.
    """

    position: Point
    direction: Annotated[Point, AfterValidator(_direction)] = np.array([0.0, 0.0, -1.0])
    diffuse: Annotated[Point, AfterValidator(_unit_range)] = np.full(3, 0.7)
    directional: bool = True
    cast_shadow: bool = True
