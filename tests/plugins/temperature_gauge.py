"""A plug-in: a round gauge at each joint that shows the temperature of its motor.

A robot declares the input `temperatures`, and a route connects it to values of a source.
A scene can set the settings in the table [decor.temperature]. Its pyproject.toml has:

    [project.entry-points."sero_mj.decor"]
    temperature = "temperature_gauge:TemperatureGauge"
"""

from __future__ import annotations

import mujoco
import numpy as np
from pydantic import Field

from sero_mj.viewer.decor.feature import Feature, FeatureSettings, Frame

SEGMENTS = 12
COLD, HOT = np.array([0.20, 0.55, 0.90, 1.0]), np.array([0.90, 0.15, 0.10, 1.0])


class GaugeSettings(FeatureSettings):
    """Settings of the gauge in a scene.

    Attributes:
        full: temperature at which the circle is full, degrees Celsius.
    """

    full: float = Field(80.0, gt=0)


class TemperatureGauge(Feature):
    """A ring of boxes about each joint, filled and colored by its temperature."""

    settings_kind = GaugeSettings

    def draw(self, frame: Frame) -> None:
        """Draws the rings of all joints that have a temperature."""
        temperatures = frame.values.get("temperatures")
        if temperatures is None:
            return
        index = np.isfinite(temperatures).nonzero()[0]
        rows = frame.buffer.take(len(index) * SEGMENTS, int(mujoco.mjtGeom.mjGEOM_BOX))
        if not len(rows):
            return
        sites = self.world.joints.centre_site[index]
        radius = 0.75 * self.world.joints.arrow_radius[index][:, None, None]
        axes = frame.data.site_xmat[sites].reshape(-1, 1, 3, 3)
        angle = np.linspace(0.0, 2.0 * np.pi, SEGMENTS, endpoint=False)[:, None]
        outward = np.cos(angle) * axes[..., 0] + np.sin(angle) * axes[..., 1]
        along = np.cos(angle) * axes[..., 1] - np.sin(angle) * axes[..., 0]
        share = np.clip(temperatures[index] / self.settings.full, 0.0, 1.0)[:, None]
        filled = np.arange(SEGMENTS) < np.ceil(share * SEGMENTS)

        grid = rows.reshape(len(index), SEGMENTS)
        grid["pos"] = frame.data.site_xpos[sites][:, None] + radius * outward
        normal = np.broadcast_to(axes[..., 2], along.shape)
        grid["mat"] = np.stack(np.broadcast_arrays(outward, along, normal), axis=-1)
        grid["size"] = radius * (0.06, 0.2, 0.06)
        colour = COLD + share[..., None] * (HOT - COLD)
        grid["rgba"] = np.where(filled[..., None], colour, (0.3, 0.3, 0.3, 0.4))
