"""Lends the meshes of arrows and axes to OpenGL contexts of shown models."""

from __future__ import annotations

import mujoco

from ..decor.arrow_shapes import shapes_model


def lend_shapes(context: mujoco.MjrContext) -> int:
    """Uploads the meshes of arrows and axes to the current OpenGL context.

    An `MjrContext` draws only meshes of its own model. They are display lists of OpenGL, which all
    `MjrContext` of one OpenGL context share. The lists exist until the OpenGL context is destroyed.

    Returns:
        `dataid` of the first mesh in scenes that are rendered with `context`.
    """
    buffer = context.currentBuffer
    lender = mujoco.MjrContext(shapes_model(), mujoco.mjtFontScale.mjFONTSCALE_50)
    first = int(lender.baseMesh) - int(context.baseMesh)
    lender.baseMesh = lender.rangeMesh = 0  # not freed with the lender
    lender.free()
    mujoco.mjr_setBuffer(buffer, context)
    return first
