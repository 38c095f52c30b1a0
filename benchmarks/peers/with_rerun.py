"""rerun with yourdfpy: a transform for every link, an arrow for every joint, to its server."""

from __future__ import annotations

import numpy as np
import rerun as rr
import yourdfpy
from common import main, measure_shown, urdf

NAME = "rerun-sdk"


def show(joints: int) -> None:
    rr.init("peers")
    rr.serve_grpc()
    robot = yourdfpy.URDF.load(urdf(joints))
    names = robot.actuated_joint_names
    child = [robot.joint_map[name].child for name in names]
    rr.log_file_from_path(urdf(joints))

    def update(angles: np.ndarray, torques: np.ndarray) -> None:
        robot.update_cfg(angles)
        frames = np.array([robot.get_transform(link) for link in child])
        for link, frame in zip(child, frames, strict=True):
            rr.log(f"robot/{link}", rr.Transform3D(translation=frame[:3, 3], mat3x3=frame[:3, :3]))
        arrows = rr.Arrows3D(
            origins=frames[:, :3, 3], vectors=0.01 * torques[:, None] * frames[:, :3, 2]
        )
        rr.log("torques", arrows)

    measure_shown(NAME, joints, update)


if __name__ == "__main__":
    main({"show_page_7": lambda: show(7), "show_page_51": lambda: show(51)})
