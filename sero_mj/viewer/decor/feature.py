"""`Feature`: the base class of visual features, built-in or of another package; and its `Frame`.

A package adds a feature by an entry point in the group `sero_mj.decor`:

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
    """A frame during layout.

    Attributes:
        data: the state of the world: `time`, `xpos`, `site_xpos`, `userdata`, ... as of `MjData`.
        shown: the part of it that has a pose.
        values: per-joint values by name, (N,) each: `torques`, `torque_error`, `joint_angles`, and
            every other input of robots; NaN for no data.
        arrow_values: values that the joints' arrows show, (N,), NaN for no data.
        arrow_limit: values at which arrows have full width, (N,), inf for none.
        stale: message by name of robots, doubles, arrows and frames without fresh data.
        stale_joints: which joints have no fresh data, (N,) bool.
        arrow_geoms: maximum number of geoms of a round arrow.
        cards: panels beside the robots with leaders; features append theirs.
        corners: panels in the corners of the picture, which cards do not cover; likewise.
        panels: other panels; likewise.
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
        warnings.warn("'cards' is deprecated; use 'billboards'", DeprecationWarning, stacklevel=2)
        return self.billboards

    def is_stale(self, names: list[str]) -> Bools:
        """Returns which of these names have no fresh data, (k,) bool."""
        return stale_mask(names, self.stale)


class Drawn(Protocol):
    """What is drawn with every frame."""

    def lay_out(self, frame: Frame) -> None: ...

    def draw(self, frame: Frame) -> None: ...


class FeatureSettings(Declaration):
    """Settings of a feature in a scene, `[decor.NAME]`; subclasses add their own.

    Attributes:
        show: whether it is shown.
    """

    show: bool = True


class Feature:
    """A visual feature of a world.

    All features lay out first, then text is drawn, then all of them draw. So text is kept where
    the number of geoms exceeds the host's capacity.

    Attributes:
        order: position in both passes, lowest first; built-in features have 10 to 90.
        settings: those of the scene, from `start` on.
    """

    order: ClassVar[int] = 100
    settings_kind: ClassVar[type[FeatureSettings]] = FeatureSettings
    settings: Any

    def __init__(self, world: WorldView) -> None:
        self.world = world

    def start(self) -> None:
        """Checks the settings against the world, once; raises DeclarationError, UnknownName."""

    def lay_out(self, frame: Frame) -> None:
        """Adds billboards, corner panels and panels to the frame."""

    def draw(self, frame: Frame) -> None:
        """Adds geoms to the buffer of the frame."""


def make_features(world: WorldView) -> list[Feature]:
    """Returns all installed features that a world shows; logs those that cannot be loaded.

    Raises:
        UnknownName: the scene has settings of a feature that is not installed.
        DeclarationError: settings are wrong.
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
