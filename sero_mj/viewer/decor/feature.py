"""`Feature`: the base class of built-in and third-party visual features, which draw a `Frame`.

A package adds a visual feature with an entry point in the group `sero_mj.decor`:

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
    """The data of one frame. Features append to `billboards`, `corners` and `panels`.

    Attributes:
        buffer: buffer to which features add geoms.
        data: state of the world with the fields of `MjData`, such as `time`, `xpos`, `site_xpos`
            and `userdata`.
        shown: items that are switched on and have a pose.
        values: mapping from input names, such as `torques`, `torque_error` and `joint_angles`, to
            the values of all joints, shape (N,) each, NaN for no data.
        arrow_values: values shown by the arrows of the joints, shape (N,), NaN for no data.
        arrow_limit: values at which arrows reach full width, shape (N,), inf if there is no limit.
        stale: mapping from the names of items without fresh data (robots, doubles, arrows and
            frames) to messages.
        stale_joints: mask of the joints without fresh data, shape (N,).
        billboards: panels beside the robots, with leaders to the described items.
        corners: panels in the corners of the image, which billboards must not cover.
        panels: all other panels.
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
    billboards: list[BillboardGroup] = field(default_factory=list)
    corners: list[Panels] = field(default_factory=list)
    panels: list[Panels] = field(default_factory=list)

    @property
    def cards(self) -> list[BillboardGroup]:
        warnings.warn("`cards` is deprecated; use `billboards`", DeprecationWarning, stacklevel=2)
        return self.billboards

    def is_stale(self, names: list[str]) -> Bools:
        """Returns a mask of the named items without fresh data, shape (k,)."""
        return stale_mask(names, self.stale)


class Drawn(Protocol):
    """An object that `Decor` draws in each frame, such as a `Feature`."""

    def lay_out(self, frame: Frame) -> None: ...

    def draw(self, frame: Frame) -> None: ...


class FeatureSettings(Declaration):
    """Settings of a visual feature: the table `[decor.NAME]` of a scene. Subclasses add fields.

    Attributes:
        show: whether the feature is shown.
    """

    show: bool = True


class Feature:
    """Base class of visual features, which add geoms and text to each frame of a world.

    For each frame, `lay_out` of all features is called. Then text is drawn, and `draw` of all
    features is called. If the number of geoms exceeds the capacity, geoms added by `draw` are
    dropped, but text is not.

    Attributes:
        order: sort key of the calls, lowest first. Built-in features use 10 to 90.
        settings: settings of this feature in the scene, which are set before `start` is called.
    """

    order: ClassVar[int] = 100
    settings_kind: ClassVar[type[FeatureSettings]] = FeatureSettings
    settings: Any

    def __init__(self, world: WorldView) -> None:
        self.world = world

    def start(self) -> None:
        """Called once to check the settings. May raise DeclarationError or UnknownName."""

    def lay_out(self, frame: Frame) -> None:
        """Called for each frame to add billboards, corner panels and other panels."""

    def draw(self, frame: Frame) -> None:
        """Called for each frame, after `lay_out`, to add geoms to the buffer."""


def make_features(world: WorldView) -> list[Feature]:
    """Returns the installed features that a world shows, and logs those that cannot be loaded.

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
