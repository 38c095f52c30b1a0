"""`PhotoCamera`: a real camera with a lens, and the rendering of its images in OpenGL.

The camera frame follows OpenCV, with x to the right of the image, y down and z forward. Pixels in
this file also follow OpenCV, with u to the right, v down and (0, 0) at the center of the upper left
pixel. `PhotoView` is the same camera with pixels that are counted from the lower left corner.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, Literal, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ...base.errors import UsageError
from ...base.frames import Array
from ...viewer.decor.font import DEFAULT_FONT, Font
from ...viewer.decor.image_view import Depth, ImageView

DistortionModel = Literal["plumb_bob", "rational_polynomial", "equidistant"]
MODELS: tuple[str, ...] = get_args(DistortionModel)
# Possible numbers of OpenCV coefficients for each distortion model.
COUNTS: dict[str, tuple[int, ...]] = {
    "plumb_bob": (4, 5),
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
}
Size = tuple[int, int]
_MAX_TANGENT = float(np.tan(np.deg2rad(75.0)))  # tangent of the maximum ray angle from the axis
_OVERSAMPLING = 1.25  # resolution of the undistorted image, relative to that of the photo
_MAX_PIXELS = 12e6  # maximum number of pixels of the undistorted image
_LOOKUP_COLUMNS = 320  # number of samples per row; pixels in between are interpolated
_OUTSIDE = -10.0  # coordinate of pixels outside of the image
_ROUND_TRIP_TOLERANCE = 0.1  # maximum error of a pixel after conversion to a ray and back, pixels
_MAX_RADIUS = 20.0  # maximum distance of rays from the axis at z = 1
_GRID = 33  # number of samples along each image side


def opencv() -> Any:
    """Imports and returns the module `cv2`, or raises UsageError if it is not installed."""
    try:
        import cv2
    except ImportError as error:
        raise UsageError(
            f"OpenCV is required ({error}): run `pip install 'sero-mj[camera]'`"
        ) from None
    return cv2


@dataclass(frozen=True, eq=False)
class PhotoCamera:
    """The intrinsics and the pose of a calibrated real camera.

    Attributes:
        matrix: camera matrix of OpenCV with fx, fy, cx and cy, shape (3, 3), pixels.
        T_world_camera: pose of the camera, with x to the right, y down and z forward, shape (4, 4),
            m.
        distortion: distortion coefficients in the order of OpenCV; empty for no distortion.
        model: distortion model; `equidistant` is the fisheye model of OpenCV.
    """

    width: int
    height: int
    matrix: Array
    T_world_camera: Array
    distortion: Array = field(default_factory=lambda: np.zeros(0))
    model: DistortionModel = "plumb_bob"

    @property
    def is_distorted(self) -> bool:
        return bool(self.distortion.any()) or self.model == "equidistant"

    def resized(self, width: int, height: int) -> PhotoCamera:
        """Returns the camera for images that are resized to another size in pixels."""
        by = np.array([width / self.width, height / self.height])
        matrix = self.matrix.copy()
        matrix[[0, 1], [0, 1]] *= by
        # The edges of the image do not move, and pixel coordinates refer to pixel centers.
        matrix[:2, 2] = (matrix[:2, 2] + 0.5) * by - 0.5
        return replace(self, width=width, height=height, matrix=matrix)

    def project(self, points: Array) -> tuple[Array, Array]:
        """Projects world points to pixels.

        Returns:
            pixels, shape (..., 2), and depths along z, shape (...), m. Pixels of points behind the
            camera or far outside of the image are approximate.
        """
        T = self.T_world_camera
        in_camera = (points - T[:3, 3]) @ T[:3, :3]
        depth = in_camera[..., 2]
        safe = np.where(np.abs(depth) < 1e-9, 1e-9, depth)
        return self.distort(in_camera[..., :2] / safe[..., None]), depth

    def distort(self, rays: Array) -> Array:
        """Returns the pixels of rays in the camera frame, given by x/z and y/z, shape (..., 2)."""
        if not self.is_distorted:
            return self._to_pixels(rays)
        # Outside of the image, the distortion polynomials may lead to pixels inside of it.
        radius = np.linalg.norm(rays, axis=-1, keepdims=True)
        beyond = np.maximum(radius / self._limits[1], 1.0)
        flat = np.ascontiguousarray((rays / beyond).reshape(-1, 2))
        if not len(flat):
            return np.zeros(rays.shape)
        pixels = self._distort(flat).reshape(rays.shape)
        return np.asarray(self.matrix[:2, 2] + (pixels - self.matrix[:2, 2]) * beyond)

    def undistort(self, pixels: Array) -> Array:
        """Returns the rays of pixels in the camera frame, given by x/z and y/z, shape (..., 2).

        Pixels at the edges may have no ray, because distortion polynomials are not monotone outside
        of the calibrated area. The values are NaN for these pixels.
        """
        if not self.is_distorted:
            K = self.matrix
            return np.asarray((pixels - K[:2, 2]) / (K[0, 0], K[1, 1]))
        return self._found_rays(pixels, self._limits[0])

    def _found_rays(self, pixels: Array, fold: float) -> Array:
        flat = np.reshape(pixels, (-1, 2)).astype(float)
        if not len(flat):
            return np.zeros(pixels.shape)
        rays = self._undistort(flat)
        # OpenCV returns very large values for pixels without a ray.
        rays[~(np.abs(rays) < _MAX_RADIUS).all(axis=1)] = np.nan
        there = self._distort(np.nan_to_num(rays))
        is_found = np.abs(there - flat).max(axis=1) < _ROUND_TRIP_TOLERANCE
        is_found &= np.linalg.norm(rays, axis=1) < fold
        rays[~is_found] = np.nan
        return rays.reshape(pixels.shape)

    @cached_property
    def _limits(self) -> tuple[float, float]:
        # The limits are cached, because calibration computes many poses of the same lens.
        arrays = (np.ascontiguousarray(each, float) for each in (self.matrix, self.distortion))
        key = *(each.tobytes() for each in arrays), self.model
        return _limits_of(self.width, self.height, *key)

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
        points, camera = pixels[:, None], (self.matrix, self.distortion)
        if self.model == "equidistant":
            rays = cv2.fisheye.undistortPoints(points, *camera, criteria=until)
        elif hasattr(cv2, "undistortPointsIter"):  # OpenCV 4
            rays = cv2.undistortPointsIter(points, *camera, np.eye(3), np.eye(3), until)
        else:
            rays = cv2.undistortPoints(points, *camera, criteria=until)
        return np.array(rays.reshape(-1, 2), np.float64)

    @cached_property
    def _some_rays(self) -> Array:
        return self.undistort(self._some_pixels)

    @property
    def _some_pixels(self) -> Array:
        u, v = (np.linspace(-0.5, n - 0.5, _GRID) for n in (self.width, self.height))
        return np.stack(np.meshgrid(u, v), axis=-1)

    @property
    def drawable(self) -> float:
        """Fraction of the image in which the lens model is valid, so that geoms can be drawn."""
        return float(np.isfinite(self._some_rays).all(axis=-1).mean())

    @cached_property
    def extent(self) -> tuple[Array, Array]:
        """Minimum and maximum of x/z and y/z over all rays of the image, shape (2,) each."""
        rays = self._some_rays.reshape(-1, 2)
        rays = rays[np.isfinite(rays).all(axis=1)]
        norm = np.linalg.norm(rays, axis=1, keepdims=True)
        rays = rays * np.minimum(_MAX_TANGENT / np.maximum(norm, 1e-9), 1.0)
        return rays.min(axis=0), rays.max(axis=0)


@lru_cache(maxsize=16)
def _limits_of(
    width: int, height: int, matrix: bytes, distortion: bytes, model: DistortionModel
) -> tuple[float, float]:
    # Returns two distances of rays from the axis at z = 1: the one beyond which distortion moves
    # pixels back towards the center, and the largest one in the image.
    K, coefficients = np.frombuffer(matrix).reshape(3, 3), np.frombuffer(distortion)
    lens = PhotoCamera(width, height, K, np.eye(4), coefficients, model)
    radii = np.linspace(0.0, _MAX_RADIUS, 4001)
    fold = _MAX_RADIUS
    for turn in np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False).tolist():
        rays = radii[:, None] * np.array([np.cos(turn), np.sin(turn)])
        away = np.linalg.norm(lens._distort(rays) - K[:2, 2], axis=1)
        back = np.flatnonzero(~(np.diff(away) > 0.0))
        fold = min(fold, float(radii[back[0]]) if len(back) else _MAX_RADIUS)
    distances = np.linalg.norm(lens._found_rays(lens._some_pixels, fold), axis=-1)
    distances = distances[np.isfinite(distances)]
    largest = min(float(distances.max(initial=0.0)), _MAX_TANGENT) or _MAX_TANGENT
    return fold, min(1.02 * largest, fold)


@dataclass(frozen=True, eq=False)
class PhotoView(ImageView):
    """The view of a `PhotoCamera`, whose pixels are those of the photo, with its distortion."""

    camera: PhotoCamera = None  # type: ignore[assignment]  # fields before it have defaults

    @classmethod
    def of_camera(
        cls,
        camera: PhotoCamera,
        near: float,
        font: Font = DEFAULT_FONT,
        inset: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    ) -> PhotoView:
        """Returns the view of a camera whose near plane is at a distance in m."""
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
        pixels, depth = self.camera.project(points)
        return np.stack([pixels[..., 0] + 0.5, self._top - pixels[..., 1]], axis=-1), depth

    def at(self, pixels: Array, depth: Depth) -> Array:
        flipped = np.stack([pixels[..., 0] - 0.5, self._top - pixels[..., 1]], axis=-1)
        rays = self.camera.undistort(flipped)
        K = self.camera.matrix
        plain = (flipped - K[:2, 2]) / (K[0, 0], K[1, 1])
        rays = np.where(np.isfinite(rays), rays, plain)
        direction = self.forward + rays[..., :1] * self.right - rays[..., 1:] * self.up
        return np.asarray(self.position + depth * direction)

    @property
    def _top(self) -> float:
        return self.height - 0.5


class PlaneImage:
    """The rendered image of a `PhotoCamera`, and its mapping to the pixels of photos.

    Without distortion, the photo view is rendered directly. Otherwise, an undistorted image of
    higher resolution that covers the photo is rendered and then resampled.

    Args:
        largest: maximum width and height of the rendered image, pixels.
        scale: number of rendered pixels per pixel of the photo, along each side.

    Attributes:
        size: width and height of the rendered image, pixels.
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
            (left, top), (right, bottom) = camera.extent
            self._look_up((left, top), (right, bottom), largest)
        self._edges = left, right, -bottom, -top

    def _look_up(self, low: Any, high: Any, largest: Size) -> None:
        camera, cv2 = self.camera, opencv()
        # Rays are computed for some pixels and interpolated in between.
        apart = max(camera.width // _LOOKUP_COLUMNS, 1)
        rows, columns = camera.height // apart + 2, camera.width // apart + 2
        v, u = np.mgrid[:rows, :columns].astype(float) * apart
        rays = camera.undistort(np.stack([u, v], axis=-1))
        extent = np.array(high) - low
        # The resolution is that of the pixels with the smallest angle in the photo.
        steps = np.linalg.norm(np.diff(rays, axis=1), axis=2) / apart
        steps = steps[np.isfinite(steps) & (steps > 0)]
        finest = float(np.percentile(steps, 1.0)) if len(steps) else 1e-3
        size = extent * max(_OVERSAMPLING, self._scale) / finest
        size *= min(1.0, *(np.array(largest) / size), np.sqrt(_MAX_PIXELS / size.prod()))
        width, height = (max(round(float(side)), 1) for side in size)
        self.size = (width, height)
        pixels = (rays - low) / extent * (width, height) - 0.5
        pixels[~(np.linalg.norm(rays, axis=2) < _MAX_TANGENT)] = np.nan
        at = np.arange(camera.width, dtype=np.float32), np.arange(camera.height, dtype=np.float32)
        everywhere = np.meshgrid(at[0] / apart, at[1] / apart)
        each = [
            cv2.remap(pixels[..., k].astype(np.float32), *everywhere, cv2.INTER_LINEAR)
            for k in (0, 1)
        ]
        is_drawn = np.isfinite(each[0]) & np.isfinite(each[1])
        # With a resolution of 1/32 pixel, resampling takes a third of the time.
        self._maps = cv2.convertMaps(
            *(np.where(is_drawn, of, _OUTSIDE).astype(np.float32) for of in each), cv2.CV_16SC2
        )

    def look(self, scene: mujoco.MjvScene) -> None:
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
        """Resamples a rendered image to the pixels of the photo.

        Pixels that the rendered image does not contain have the value `outside`.
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
