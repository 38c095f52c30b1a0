"""Third-party models: a small arm as text, and the Jaco arm of dm_control."""

from __future__ import annotations

from functools import cache
from typing import Any

import mujoco
import numpy as np
import pytest

ARM = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <geom name="ground" type="plane" size="2 2 .1"/>
    <body name="arm" pos="0 0 .1">
      <geom name="foot" type="cylinder" size=".06 .1"/>
      <body name="upper" pos="0 0 .1">
        <joint name="turn" axis="0 0 1" damping="1"/>
        <joint name="lift" axis="0 1 0" damping="1" range="-2 2"/>
        <geom name="upper" type="capsule" fromto="0 0 0 0 0 .4" size=".05" mass="2"/>
        <body name="fore" pos="0 0 .4">
          <joint name="elbow" axis="1 2 .5" pos="0 .01 .02" damping="1" actuatorfrcrange="-15 15"/>
          <geom name="fore" type="box" pos=".2 0 0" size=".2 .04 .04" mass="1"/>
          <site name="tip" pos=".4 0 0" euler="0 .5 0"/>
          <body name="gripper" pos=".4 0 0">
            <joint name="grip" type="slide" axis="0 1 0" range="0 .05"/>
            <geom name="finger" type="box" pos=".04 0 0" size=".04 .01 .02" mass=".1"/>
          </body>
        </body>
      </body>
    </body>
    <body name="cube" pos=".5 .5 .3"><freejoint/><geom size=".04" mass=".1"/></body>
  </worldbody>
  <actuator>
    <motor name="turn" joint="turn" gear="10" ctrlrange="-2 2"/>
    <general name="lift" joint="lift" gear="2" forcerange="-30 30"/>
    <motor name="elbow" joint="elbow" gear="100" ctrlrange="-2 2"/>
    <motor name="grip" joint="grip"/>
  </actuator>
</mujoco>
"""
JACO_POSE = (0.3, 2.2, 1.5, -1.2, 1.9, 0.4, 0.4, 0.4, 0.4)
JACO_TORQUES = (12, -25, 14, -3, 2, -2, 0.3, 0.3, 0.3)


def compiled(xml: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Returns a model and its data after `mj_forward`."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def arm(**qpos: float) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Returns the small arm with joint angles and active motors."""
    model, data = compiled(ARM)
    for joint, value in qpos.items():
        data.joint(joint).qpos = value
    data.ctrl[:] = (-1.5, 9.0, 0.05, 0.4)
    mujoco.mj_forward(model, data)
    return model, data


@cache
def _jaco_xml(count: int) -> tuple[str, Any]:
    mjcf = pytest.importorskip("dm_control.mjcf", reason="dm-control is not installed")
    from dm_control.entities.manipulators import kinova

    root = mjcf.RootElement(model="scene")
    root.worldbody.add("geom", type="plane", size=[3, 3, 0.1], rgba=[0.8, 0.82, 0.84, 1])
    root.worldbody.add("light", pos=[1, -1, 3], dir=[-0.3, 0.3, -1], diffuse=[0.6] * 3)
    for k in range(count):
        one = kinova.JacoArm(name=f"jaco{k}" if count > 1 else "jaco")
        one.attach(kinova.JacoHand())
        root.worldbody.add("site", pos=[0, 0.8 * k, 0], name=f"at{k}").attach(one.mjcf_model)
    return root.to_xml_string(), root.get_assets()


def jaco(count: int = 1) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Returns Kinova Jaco arms with hands, in a pose in which all parts are visible."""
    model = mujoco.MjModel.from_xml_string(*_jaco_xml(count))
    data = mujoco.MjData(model)
    data.qpos[:] = np.tile(JACO_POSE, count)
    mujoco.mj_forward(model, data)
    return model, data
