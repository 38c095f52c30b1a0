"""Saves the state of a window or page at the end, and restores it at the next start."""

from __future__ import annotations

from ...base.errors import UsageError
from ..image.camera import copy_camera
from ..session.recent_views import find_view, keep_view
from ..session.view_state import ViewState, apply_state
from .live import LiveHost


def keep(host: LiveHost) -> None:
    """Saves camera, switches, selection, layout, and what tools keep."""
    keep_view(host.world.scene, host.view_state(), host.layout, host.tools.kept)


def restore(host: LiveHost, *, with_camera: bool = True) -> None:
    """Restores the saved view of a scene, if any."""
    try:
        found = find_view(host.world.scene)
    except UsageError as error:
        host.say(str(error), is_bad=True)
        return
    if found is not None:
        state, layout, kept = found
        show_state(host, state if with_camera else state._replace(camera=""))
        host.show_layout(layout)
        host.tools.take_kept(kept)


def show_state(host: LiveHost, state: ViewState) -> None:
    """Restores a view as far as it fits the scene; reports the rest."""
    camera, joint, wrong = apply_state(host.world, host.toggles, state)
    if camera is not None:
        copy_camera(camera, host.view_camera)
    if joint is not None:
        host.select(joint)
    if state.time is not None and host.mirror.sources and not host.clock.is_live:
        host.clock.seek(state.time)
        host.clock.is_paused = True
    if wrong:
        host.say(f"of the view before: {wrong[0]}", is_bad=True)
