"""`Feature`: the base class of visual features, built-in and third-party, and its `Frame`.

A package adds a feature with an entry point in the group `sero_mj.decor`:

    [project.entry-points."sero_mj.decor"]
    temperature = "my_package:TemperatureGauge"
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol

from ...base.declaration import Declaration
from ...base.errors import DeclarationError, UnknownName, problems_of
from ...base.frames import Array, Bools
from ...base.plugins import DECOR, load_all
from ...robots.assemble.world_view import WorldView
from .billboard_layout import BillboardGroup
from .geom_buffer import GeomBuffer
from .image_view import ImageView
from .panels import Panels
from .staleness import stale_mask
from .toggles import ShownItems, Toggles


@dataclass(eq=False)
class Frame:
    """Data of one frame. Features append to `billboards`, `corners` and `panels`.

    Attributes:
        data: state of the world with the fields of `MjData`: `time`, `xpos`, `site_xpos`,
            `userdata`, ...
        shown: items that are switched on and have a pose.
        values: mapping from the names `torques`, `torque_error`, `joint_angles` and all other
            inputs of robots to the values of all joints, shape (N,) each, NaN for no data.
        arrow_values: values shown by the joints' arrows, shape (N,), NaN for no data.
        arrow_limit: values at which arrows reach full width, shape (N,), inf if there is no limit.
        stale: mapping from names of robots, doubles, arrows and frames without fresh data to
            messages.
        stale_joints: mask (N,) of joints without fresh data.
        arrow_geoms: maximum number of geoms of a round arrow.
        billboards: panels beside the robots, with leaders.
        corners: panels in the corners of the image that billboards must not cover.
        panels: other panels.
    """

    buffer: GeomBuffer
    data: Any
    view: ImageView
    toggles: Toggles
    shown: ShownItems
    values: dict[str, Array]
    arrow_values: Array
    arrow_limit: Array
    stale: dict[str, str]
    stale_joints: Bools
    arrow_geoms: int
    billboards: list[BillboardGroup] = field(default_factory=list)
    corners: list[Panels] = field(default_factory=list)
    panels: list[Panels] = field(default_factory=list)

    @property
    def cards(self) -> list[BillboardGroup]:
        warnings.warn("`cards` is deprecated; use `billboards`", DeprecationWarning, stacklevel=2)
        return self.billboards

    def is_stale(self, names: list[str]) -> Bools:
        """Returns a mask (k,) of the names without fresh data."""
        return stale_mask(names, self.stale)


class Drawn(Protocol):
    """An object that is drawn with every frame."""

    def lay_out(self, frame: Frame) -> None: ...

    def draw(self, frame: Frame) -> None: ...


class FeatureSettings(Declaration):
    """Settings of a feature in a scene, `[decor.NAME]`. Subclasses add fields.

    Attributes:
        show: whether the feature is shown.
    """

    show: bool = True


class Feature:
    """A visual feature of a world.

    For each frame, `lay_out` is called for all features. Then text is drawn, and `draw` is called
    for all features. If the number of geoms exceeds the capacity, geoms added by `draw` are
    dropped, but text is not.

    Attributes:
        order: position in both passes, lowest first. Built-in features use 10 to 90.
        settings: settings of this feature in the scene, set before `start` is called.
    """

    order: ClassVar[int] = 100
    settings_kind: ClassVar[type[FeatureSettings]] = FeatureSettings
    settings: Any

    def __init__(self, world: WorldView) -> None:
        self.world = world

    def start(self) -> None:
        """Called once to check the settings; raises DeclarationError or UnknownName."""

    def lay_out(self, frame: Frame) -> None:
        """Adds billboards, corner panels and panels to the frame."""

    def draw(self, frame: Frame) -> None:
        """Adds geoms to the buffer of the frame."""


def make_features(world: WorldView) -> list[Feature]:
    """Returns all installed features that a world shows, and logs those that cannot be loaded.

    Raises:
        UnknownName: the scene has settings for a feature that is not installed.
        DeclarationError: the settings of a feature are invalid.
    """
    kinds, tables = load_all(DECOR, Feature), world.scene.decor
    for name in tables:
        if name not in kinds:
            raise UnknownName("visual feature", name, kinds)
    made = []
    for name, kind in sorted(kinds.items(), key=lambda each: (each[1].order, each[0])):
        settings = kind.settings_kind(**tables.get(name, {}))
        if settings.show:
            feature = kind(world)
            feature.settings = settings
            try:
                feature.start()
            except (DeclarationError, UnknownName) as error:
                raise DeclarationError(problems_of(error, f"decor.{name}")) from error
            made.append(feature)
    return made
