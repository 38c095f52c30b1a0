"""Saves the view when a window or page closes, and restores it at the next start."""

from __future__ import annotations

from ...base.errors import UsageError
from ..image.camera import copy_camera
from ..session.recent_views import load_view, save_view
from ..session.view_state import ViewState, apply_state
from .live import LiveHost


def save(host: LiveHost) -> None:
    """Saves the camera, switches, selection, layout and tool states of a window or page."""
    save_view(host.world.scene, host.view_state(), host.layout, host.tools.saved_state)


def restore(host: LiveHost, *, with_camera: bool = True) -> None:
    """Restores the last saved view of the scene, or does nothing if there is none."""
    try:
        found = load_view(host.world.scene)
    except UsageError as error:
        host.say(str(error), is_bad=True)
        return
    if found is not None:
        state, layout, of_tools = found
        show_state(host, state if with_camera else state._replace(camera=""))
        host.show_layout(layout)
        host.tools.restore_saved(of_tools)


def show_state(host: LiveHost, state: ViewState) -> None:
    """Applies a saved view to a window or page, and shows the first setting that is invalid."""
    camera, joint, errors = apply_state(host.world, host.toggles, state)
    if camera is not None:
        copy_camera(camera, host.view_camera)
    if joint is not None:
        host.select(joint)
    if state.time is not None and host.mirror.sources and not host.clock.is_live:
        host.clock.seek(state.time)
        host.clock.is_paused = True
    if errors:
        host.say(f"part of the saved view is ignored: {errors[0]}", is_bad=True)
