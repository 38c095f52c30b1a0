"""Writes a compiled MuJoCo model as URDF, so that all peers read the same robot."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import trimesh

_SHOWN = 3  # groups of geoms from here on are hulls for masses and contacts
_JOINTS = {
    int(mujoco.mjtJoint.mjJNT_HINGE): "revolute",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic",
}
# Else MuJoCo leaves out what is drawn, and bodies without joints.
_COMPILER = {"discardvisual": "false", "strippath": "false", "fusestatic": "false"}


def _text(values: np.ndarray) -> str:
    return " ".join(f"{value:.17g}" for value in values)


def _add_origin(parent: ET.Element, position: np.ndarray, quaternion: np.ndarray) -> None:
    """URDF's roll, pitch and yaw are R = Rz(yaw) Ry(pitch) Rx(roll)."""
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, quaternion)
    R = R.reshape(3, 3)
    pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    roll, yaw = np.arctan2(R[2, 1], R[2, 2]), np.arctan2(R[1, 0], R[0, 0])
    rpy = np.array([roll, pitch, yaw])
    ET.SubElement(parent, "origin", xyz=_text(position), rpy=_text(rpy))


def _add_geom(link: ET.Element, model: mujoco.MjModel, geom: int, folder: Path) -> None:
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    position, quaternion = model.geom_pos[geom], model.geom_quat[geom]
    kinds = mujoco.mjtGeom
    if kind == kinds.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        path = folder / f"mesh{mesh}.stl"
        if not path.exists():
            part = slice(
                model.mesh_vertadr[mesh], model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh]
            )
            face = slice(
                model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh]
            )
            trimesh.Trimesh(model.mesh_vert[part], model.mesh_face[face], process=False).export(
                path
            )
        shape = ET.Element("mesh", filename=str(path))
    elif kind == kinds.mjGEOM_BOX:
        shape = ET.Element("box", size=_text(2.0 * size))
    elif kind == kinds.mjGEOM_SPHERE:
        shape = ET.Element("sphere", radius=_text(size[:1]))
    elif kind in (kinds.mjGEOM_CYLINDER, kinds.mjGEOM_CAPSULE):
        shape = ET.Element("cylinder", radius=_text(size[:1]), length=_text(2.0 * size[1:2]))
    else:
        return
    visual = ET.SubElement(link, "visual")
    _add_origin(visual, position, quaternion)
    ET.SubElement(visual, "geometry").append(shape)


def write_urdf(model: mujoco.MjModel, flange: int, path: Path) -> None:
    """Writes bodies, joints, masses and shapes; `flange` is the body whose frame peers report.

    Meshes go into a folder beside the file. Links have no colours. Joints have limits, though wide:
    where there are none, Pinocchio has two coordinates a joint.
    """
    folder = path.with_suffix("")
    folder.mkdir(exist_ok=True)
    robot = ET.Element("robot", name=path.stem)
    ET.SubElement(ET.SubElement(robot, "mujoco"), "compiler", _COMPILER)
    names = ["world", *(f"link{k}" for k in range(1, model.nbody))]
    for body, name in enumerate(names):
        link = ET.SubElement(robot, "link", name=name)
        if not body:
            continue
        inertial = ET.SubElement(link, "inertial")
        _add_origin(inertial, model.body_ipos[body], model.body_iquat[body])
        ET.SubElement(inertial, "mass", value=_text(model.body_mass[body : body + 1]))
        xx, yy, zz = (f"{value:.17g}" for value in model.body_inertia[body])
        ET.SubElement(inertial, "inertia", ixx=xx, iyy=yy, izz=zz, ixy="0", ixz="0", iyz="0")
        first = int(model.body_geomadr[body])
        for geom in range(first, first + int(model.body_geomnum[body])):
            if model.geom_group[geom] < _SHOWN and model.geom_rgba[geom, 3] > 0.0:
                _add_geom(link, model, geom, folder)
        joint = int(model.body_jntadr[body])
        kind = "fixed" if joint < 0 else _JOINTS[int(model.jnt_type[joint])]
        element = ET.SubElement(robot, "joint", name=f"joint{body}", type=kind)
        _add_origin(element, model.body_pos[body], model.body_quat[body])
        ET.SubElement(element, "parent", link=names[model.body_parentid[body]])
        ET.SubElement(element, "child", link=name)
        if joint >= 0:
            ET.SubElement(element, "axis", xyz=_text(model.jnt_axis[joint]))
            ET.SubElement(element, "limit", effort="1000", velocity="100", lower="-10", upper="10")
    ET.SubElement(robot, "link", name="flange")
    element = ET.SubElement(robot, "joint", name="to_flange", type="fixed")
    ET.SubElement(element, "parent", link=names[flange])
    ET.SubElement(element, "child", link="flange")
    ET.indent(robot)
    path.write_text(ET.tostring(robot, encoding="unicode"))
