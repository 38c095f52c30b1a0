"""A robot stripped to what moves and weighs: the cheapest model that computes the same."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco


def skeleton(
    model: mujoco.MjModel, joints: Sequence[int], site: int | None, body: int | None
) -> mujoco.MjModel:
    """Returns a model of one robot without shapes; its only site is the flange.

    Its base stays where it is in the model. Of its joints only those named are left; the others
    (of a gripper, of elastic gears) are fixed where they are at first. Bodies that do not move
    against each other are one.

    Args:
        model: where the robot is, perhaps among others.
        joints: ids of its hinge and slide joints, base to flange.
        site: id of the site at the flange, or None.
        body: id of the body whose frame is the flange's, where there is no site.
    """
    spec = mujoco.MjSpec()
    spec.option.gravity = model.opt.gravity
    spec.compiler.fusestatic = True
    spec.compiler.degree = False
    spec.compiler.balanceinertia = False
    copies = {0: spec.worldbody}
    root = model.body_rootid[model.jnt_bodyid[joints[0]]]
    for old in range(1, model.nbody):
        if model.body_rootid[old] != root:
            continue
        new = copies[int(model.body_parentid[old])].add_body(
            pos=model.body_pos[old], quat=model.body_quat[old]
        )
        copies[old] = new
        if model.body_mass[old] > 0.0:
            new.explicitinertial = True
            new.mass, new.inertia = model.body_mass[old], model.body_inertia[old]
            new.ipos, new.iquat = model.body_ipos[old], model.body_iquat[old]
        first = int(model.body_jntadr[old])
        for joint in range(first, first + int(model.body_jntnum[old])):
            if joint in joints:
                new.add_joint(
                    type=mujoco.mjtJoint(int(model.jnt_type[joint])),
                    pos=model.jnt_pos[joint],
                    axis=model.jnt_axis[joint],
                    ref=model.qpos0[model.jnt_qposadr[joint]],
                    armature=model.dof_armature[model.jnt_dofadr[joint]],
                )
    if site is not None:
        at = copies[int(model.site_bodyid[site])]
        at.add_site(name="flange", pos=model.site_pos[site], quat=model.site_quat[site])
    else:
        copies[int(body or 0)].add_site(name="flange")
    return spec.compile()
