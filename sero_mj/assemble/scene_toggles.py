"""What is shown of the whole scene, as it is declared: the `[toggles]` section."""

from __future__ import annotations

from ..declaration import Declaration


class SceneToggles(Declaration):
    """What is shown of the whole scene; every robot declares its own `show_arrows` and so on.

    Attributes:
        legend: whether it is written what arrows show.
        status: whether faults of the sources are written into the picture.
        frame_names: whether all axes show their names.
        flange_checks: whether received flange frames are compared with the robots' own.
    """

    legend: bool = True
    status: bool = True
    frame_names: bool = False
    flange_checks: bool = True
