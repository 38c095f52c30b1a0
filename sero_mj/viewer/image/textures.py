"""Computes the mipmaps of textures without OpenGL, for images of quality `draft`.

The software renderer of Mesa generates mipmaps with shaders, which it compiles for each context.
This takes 50 ms for the floor and 50 ms for the sky, which is more than the render time of a small
robot. Mesa rounds mipmaps differently, which changes pixels by at most 3 of 255.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco
import numpy as np

from ...base.frames import Ints
from .image_files import Pixels

_SRGB = mujoco.mjtColorSpace.mjCOLORSPACE_SRGB
_FACES = 6  # number of faces of a cube texture, which are stored one below the other


@contextmanager
def without_textures(model: mujoco.MjModel) -> Iterator[Ints]:
    """Omits textures from the OpenGL contexts that the `with` block creates.

    The model is changed temporarily, so that only one pixel of each omitted texture is uploaded.

    Yields:
        ids of the omitted textures, for `upload_textures`. They are the square or cube textures
        with 3 channels, without the sRGB color space, whose sides are powers of two.
    """
    wide, tall = model.tex_width.copy(), model.tex_height.copy()
    is_cube = tall == _FACES * wide
    is_plain = (model.tex_nchannel == 3) & (model.tex_colorspace != _SRGB)
    mine = (is_plain & (is_cube | (tall == wide)) & (wide & (wide - 1) == 0)).nonzero()[0]
    model.tex_width[mine] = 1
    model.tex_height[mine] = np.where(is_cube, _FACES, 1)[mine]
    try:
        yield mine
    finally:
        model.tex_width[:], model.tex_height[:] = wide, tall


def upload_textures(model: mujoco.MjModel, context: mujoco.MjrContext, textures: Ints) -> None:
    """Uploads textures of a model and all their mipmaps to an OpenGL context."""
    from OpenGL import GL

    GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
    for texture in textures.tolist():
        side, start = int(model.tex_width[texture]), int(model.tex_adr[texture])
        count = 3 * side * int(model.tex_height[texture])
        faces = model.tex_data[start : start + count].reshape(-1, side, side, 3)
        kind, targets = GL.GL_TEXTURE_2D, [GL.GL_TEXTURE_2D]
        if len(faces) == _FACES:
            kind = GL.GL_TEXTURE_CUBE_MAP
            targets = [GL.GL_TEXTURE_CUBE_MAP_POSITIVE_X + face for face in range(_FACES)]
        GL.glBindTexture(kind, context.texture[texture])
        GL.glTexParameteri(kind, GL.GL_GENERATE_MIPMAP, GL.GL_FALSE)
        for level in range(side.bit_length()):
            for target, pixels in zip(targets, faces, strict=True):
                GL.glTexImage2D(
                    target, level, GL.GL_RGB, *pixels.shape[:2], 0, GL.GL_RGB, GL.GL_UNSIGNED_BYTE,
                    pixels,
                )  # fmt: skip
            faces = _halved(faces) if len(faces[0]) > 1 else faces


def _halved(faces: Pixels) -> Pixels:
    count, side = faces.shape[:2]
    blocks = faces.reshape(count, side // 2, 2, side // 2, 2, 3)
    return np.asarray(blocks.mean(axis=(2, 4)).round(), np.uint8)
