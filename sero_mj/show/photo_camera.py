"""`PhotoCamera`: a real camera with its lens, and how its pictures are drawn in OpenGL.

Its frame is OpenCV's: x to the right of the picture, y down, z forward. Pixels of this file are
OpenCV's as well: u to the right, v down, (0, 0) the centre of the upper left pixel. `PhotoView`
is the same camera as decor sees it, with pixels from the lower left corner.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..decor.font import DEFAULT_FONT, Font
from ..decor.picture_view import Depth, PictureView
from ..errors import UsageError
from ..frames import Array

DistortionModel = Literal["plumb_bob", "rational_polynomial", "equidistant"]
MODELS: tuple[str, ...] = get_args(DistortionModel)
# How many coefficients OpenCV takes for each.
COUNTS: dict[str, tuple[int, ...]] = {
    "plumb_bob": (4, 5),
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
}
Size = tuple[int, int]
_WIDEST = float(np.tan(np.deg2rad(75.0)))  # from the axis; a plane picture of more is mostly edge
_FINER = 1.25  # how much finer the picture without distortion is than the photo
_INVERTIBLE = 0.1  # pixels that a pixel may be off after there and back
_BORDER = 64  # points along each edge


def opencv() -> Any:
    """Returns the module `cv2`.

    Raises:
        UsageError: it is not installed.
    """
    try:
        import cv2
    except ImportError as error:
        raise UsageError(
            f"this needs OpenCV ({error}); `pip install 'sero-mj[camera]'` brings it"
        ) from None
    return cv2


@dataclass(frozen=True, eq=False)
class PhotoCamera:
    """A calibrated camera.

    Attributes:
        width: of its pictures, pixels.
        height: likewise.
        matrix: OpenCV's camera matrix (3, 3): fx, fy, cx and cy, pixels.
        T_world_camera: where it is, (4, 4), m; x to the right, y down, z forward.
        distortion: coefficients in OpenCV's order; none for a lens without distortion.
        model: what they mean; `equidistant` is OpenCV's fisheye.
    """

    width: int
    height: int
    matrix: Array
    T_world_camera: Array
    distortion: Array = field(default_factory=lambda: np.zeros(0))
    model: DistortionModel = "plumb_bob"

    @property
    def is_distorted(self) -> bool:
        """Whether straight lines may be bent in its pictures."""
        return bool(self.distortion.any()) or self.model == "equidistant"

    def resized(self, width: int, height: int) -> PhotoCamera:
        """Returns the camera whose pictures are those of this one in another size."""
        by = np.array([width / self.width, height / self.height])
        matrix = self.matrix.copy()
        matrix[[0, 1], [0, 1]] *= by
        # The edges of the picture stay its edges, and pixels are counted by their centres.
        matrix[:2, 2] = (matrix[:2, 2] + 0.5) * by - 0.5
        return replace(self, width=width, height=height, matrix=matrix)

    def project(self, points: Array) -> tuple[Array, Array]:
        """Projects points of the world.

        Args:
            points: (..., 3), m.

        Returns:
            pixels (..., 2), and depth along z (...), m; pixels of points behind the camera, and of
            those far outside of the picture, are only roughly where they would be.
        """
        T = self.T_world_camera
        in_camera = (points - T[:3, 3]) @ T[:3, :3]
        depth = in_camera[..., 2]
        safe = np.where(np.abs(depth) < 1e-9, 1e-9, depth)
        return self.distort(in_camera[..., :2] / safe[..., None]), depth

    def distort(self, rays: Array) -> Array:
        """Returns the pixels (..., 2) of rays x/z, y/z (..., 2) in the camera's frame."""
        if not self.is_distorted:
            return self._to_pixels(rays)
        # Beyond the picture the polynomials may come back into it.
        radius = np.linalg.norm(rays, axis=-1, keepdims=True)
        beyond = np.maximum(radius / self._largest_radius, 1.0)
        flat = np.ascontiguousarray((rays / beyond).reshape(-1, 2))
        if not len(flat):
            return np.zeros(rays.shape)
        pixels = self._distort(flat).reshape(rays.shape)
        return np.asarray(self.matrix[:2, 2] + (pixels - self.matrix[:2, 2]) * beyond)

    def undistort(self, pixels: Array) -> Array:
        """Returns the rays x/z, y/z (..., 2) of pixels (..., 2); NaN where there is none."""
        if not self.is_distorted:
            K = self.matrix
            return np.asarray((pixels - K[:2, 2]) / (K[0, 0], K[1, 1]))
        return self._undistort(np.reshape(pixels, (-1, 2)).astype(float)).reshape(pixels.shape)

    def _to_pixels(self, rays: Array) -> Array:
        K = self.matrix
        return np.asarray(rays * (K[0, 0], K[1, 1]) + K[:2, 2])

    def _distort(self, rays: Array) -> Array:
        cv2 = opencv()
        if self.model == "equidistant":
            points = np.concatenate([rays, np.ones((len(rays), 1))], axis=1)[:, None]
            zero = np.zeros((3, 1))
            pixels, _ = cv2.fisheye.projectPoints(points, zero, zero, self.matrix, self.distortion)
        else:
            points = np.concatenate([rays, np.ones((len(rays), 1))], axis=1)
            pixels, _ = cv2.projectPoints(
                points, np.zeros(3), np.zeros(3), self.matrix, self.distortion
            )
        return np.asarray(pixels.reshape(-1, 2), np.float64)

    def _undistort(self, pixels: Array) -> Array:
        cv2 = opencv()
        until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-10)
        undistort = cv2.fisheye.undistortPoints
        if self.model == "equidistant":
            rays = undistort(pixels[:, None], self.matrix, self.distortion, criteria=until)
            rays = np.where(np.abs(rays) > 1e3, np.nan, rays)  # OpenCV's mark of those without one
        else:
            rays = cv2.undistortPoints(
                pixels[:, None], self.matrix, self.distortion, criteria=until
            )
        return np.asarray(rays.reshape(-1, 2), np.float64)

    @cached_property
    def _border(self) -> Array:
        """Pixels along the picture's edges, (k, 2)."""
        x, y = (np.linspace(-0.5, n - 0.5, _BORDER) for n in (self.width, self.height))
        sides = [np.stack([x, np.full_like(x, v)], axis=1) for v in (y[0], y[-1])]
        sides += [np.stack([np.full_like(y, u), y], axis=1) for u in (x[0], x[-1])]
        return np.concatenate(sides)

    @cached_property
    def border_rays(self) -> Array:
        """Rays x/z, y/z (k, 2) along the picture's edges that a plane picture can have."""
        rays = self.undistort(self._border)
        rays = rays[np.isfinite(rays).all(axis=1)]
        norm = np.linalg.norm(rays, axis=1, keepdims=True)
        return np.asarray(rays * np.minimum(_WIDEST / np.maximum(norm, 1e-9), 1.0))

    @cached_property
    def _largest_radius(self) -> float:
        if not len(self.border_rays):
            return _WIDEST
        return 1.02 * float(np.linalg.norm(self.border_rays, axis=1).max())

    def misfit(self) -> float:
        """Returns how far off, pixels, the picture's edges are after there and back.

        More than a few tenths means coefficients that are not of this lens: beyond some radius
        they fold the picture.
        """
        if not self.is_distorted:
            return 0.0
        rays = self.undistort(self._border)
        known = np.isfinite(rays).all(axis=1) & (np.linalg.norm(rays, axis=1) < _WIDEST)
        if not known.any():
            return float("inf") if self.model != "equidistant" else 0.0
        there = self._distort(rays[known])
        return float(np.abs(there - self._border[known]).max())

    @property
    def is_invertible(self) -> bool:
        """Whether every pixel of the picture has a ray."""
        return self.misfit() < _INVERTIBLE


@dataclass(frozen=True, eq=False)
class PhotoView(PictureView):
    """A `PhotoCamera` as decor sees it: pixels are those of the photo, with its distortion."""

    camera: PhotoCamera = None  # type: ignore[assignment]  # fields before it have defaults

    @classmethod
    def of_camera(
        cls,
        camera: PhotoCamera,
        near: float,
        font: Font = DEFAULT_FONT,
        inset: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    ) -> PhotoView:
        """Returns the view of a camera.

        Args:
            camera: of the photo.
            near: distance of the near plane, m.
            font: of the host's labels.
            inset: see `PictureView`.
        """
        T = camera.T_world_camera
        return cls(
            position=T[:3, 3],
            right=T[:3, 0],
            up=-T[:3, 1],
            forward=T[:3, 2],
            tan_half_fovy=camera.height / (2 * float(camera.matrix[1, 1])),
            near=near,
            width=camera.width,
            height=camera.height,
            font=font,
            inset=inset,
            camera=camera,
        )

    def project(self, points: Array) -> tuple[Array, Array]:
        """See `PictureView`."""
        pixels, depth = self.camera.project(points)
        return np.stack([pixels[..., 0] + 0.5, self._top - pixels[..., 1]], axis=-1), depth

    def at(self, pixels: Array, depth: Depth) -> Array:
        """See `PictureView`."""
        flipped = np.stack([pixels[..., 0] - 0.5, self._top - pixels[..., 1]], axis=-1)
        rays = np.nan_to_num(self.camera.undistort(flipped))
        ahead = self.forward + rays[..., :1] * self.right - rays[..., 1:] * self.up
        return np.asarray(self.position + depth * ahead)

    @property
    def _top(self) -> float:
        """The centre of the upper row, from the lower edge."""
        return self.height - 0.5


class PlanePicture:
    """How OpenGL draws what a `PhotoCamera` sees, and how that becomes the photo's pixels.

    Without distortion it is drawn as it is. Else a finer picture without distortion is drawn, which
    has all that the photo has, and the photo's pixels are looked up in it.

    Args:
        camera: of the photo.
        largest: width and height that may be drawn, pixels.
        scale: how many pixels are drawn for one of the photo, a side.

    Attributes:
        size: width and height of what is drawn, pixels.
    """

    def __init__(self, camera: PhotoCamera, largest: Size, scale: int = 1) -> None:
        self.camera = camera
        self.size: Size = (camera.width * scale, camera.height * scale)
        self._scale = scale
        self._maps: tuple[Any, Any] | None = None
        # Left, right, lower and upper edge, at a distance of 1.
        K = camera.matrix
        (left, top), (right, bottom) = (
            (np.array(corner) - K[:2, 2]) / (K[0, 0], K[1, 1])
            for corner in ((-0.5, -0.5), (camera.width - 0.5, camera.height - 0.5))
        )
        if camera.is_distorted:
            rays = camera.border_rays
            (left, top), (right, bottom) = rays.min(axis=0), rays.max(axis=0)
            self._look_up((left, top), (right, bottom), largest)
        self._edges = left, right, -bottom, -top

    def _look_up(self, low: Any, high: Any, largest: Size) -> None:
        camera = self.camera
        v, u = np.mgrid[: camera.height, : camera.width]
        rays = camera.undistort(np.stack([u, v], axis=-1).astype(float))
        extent = np.array(high) - low
        # As fine as the photo is where it shows least of the world in a pixel.
        with np.errstate(invalid="ignore"):
            steps = np.linalg.norm(np.diff(rays, axis=1), axis=2)
        finest = float(np.nanpercentile(steps[steps > 0], 1.0)) if (steps > 0).any() else 1e-3
        size = extent * max(_FINER, self._scale) / finest
        size *= min(1.0, *(np.array(largest) / size))
        width, height = (max(round(float(side)), 1) for side in size)
        self.size = (width, height)
        pixels = (rays - low) / extent * (width, height) - 0.5
        pixels = np.nan_to_num(pixels, nan=-10.0, posinf=-10.0, neginf=-10.0).astype(np.float32)
        outside = np.linalg.norm(rays, axis=2) > _WIDEST
        pixels[outside] = -10.0
        cv2 = opencv()
        # To a 32nd of a pixel, in a third of the time.
        self._maps = cv2.convertMaps(pixels[..., 0], pixels[..., 1], cv2.CV_16SC2)

    def look(self, scene: mujoco.MjvScene) -> None:
        """Makes the camera of a scene, that `mjv_updateScene` has filled, this one."""
        T = self.camera.T_world_camera
        for camera in scene.camera:
            near = camera.frustum_near
            left, right, bottom, top = (edge * near for edge in self._edges)
            camera.pos, camera.forward, camera.up = T[:3, 3], T[:3, 2], -T[:3, 1]
            camera.frustum_center = (left + right) / 2
            camera.frustum_width = (right - left) / 2
            camera.frustum_bottom, camera.frustum_top = bottom, top
            camera.orthographic = 0

    def to_photo(self, drawn: NDArray[np.uint8], outside: int) -> NDArray[np.uint8]:
        """Returns the photo's pixels of a picture that was drawn.

        Args:
            drawn: (height, width, 3) of `size`, top row first.
            outside: value of pixels that it does not have.
        """
        if self._maps is None:
            return (
                drawn if self._scale == 1 else np.array(Image.fromarray(drawn).reduce(self._scale))
            )
        cv2 = opencv()
        return np.asarray(
            cv2.remap(
                drawn, *self._maps, cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_CONSTANT, borderValue=(outside,) * 3,
            )
        )  # fmt: skip
