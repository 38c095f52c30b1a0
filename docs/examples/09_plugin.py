"""Add a visual feature: a column above the flange, one box per 10 Nm of torque."""

import sys
from pathlib import Path

import mujoco
import numpy as np

# In a package, pyproject.toml declares the entry point and `pip install` registers it:
#     [project.entry-points."sero_mj.decor"]
#     load = "my_package:Load"
about = Path("plugin/my_package-1.dist-info")
about.mkdir(parents=True, exist_ok=True)
(about / "METADATA").write_text("Metadata-Version: 2.1\nName: my-package\nVersion: 1\n")
(about / "entry_points.txt").write_text("[sero_mj.decor]\nload = __main__:Load\n")
sys.path.insert(0, "plugin")

import sero_mj  # after the entry point is registered
from sero_mj.viewer.decor.feature import Feature, Frame


class Load(Feature):
    """Draws the sum of the magnitudes of all torques as a column."""

    def draw(self, frame: Frame) -> None:
        torque = np.nansum(np.abs(frame.values["torques"]))
        count = int(torque / 10.0)
        rows = frame.buffer.take(count, int(mujoco.mjtGeom.mjGEOM_BOX))
        top = self.world.frame(frame.data, "lwr/flange")[:3, 3]
        rows["pos"] = top + np.linspace(
            [0, 0, 0.1], [0, 0, 0.1 + 0.03 * count], len(rows)
        )
        rows["size"], rows["mat"], rows["rgba"] = 0.012, np.eye(3), (0.9, 0.3, 0.1, 1.0)


pose, torques = [0, 0.6, 0, -1.2, 0, 1.2, 0], [0, -60, 5, 35, 0, -8, 0]
lwr = sero_mj.SerialRobot.from_model("lwr", joint_angles=pose, torques=torques)
sero_mj.render_image(sero_mj.Scene(robots=[lwr]), "09_plugin.webp", size=(640, 400))
