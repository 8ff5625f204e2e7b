"""What a shot's camera can see: a frustum with a soft border, and the size of its pixels.

Plain numpy, without torch: planning uses it too.
"""

from dataclasses import dataclass, replace

import numpy as np

from usdsmoke.base.volume import CameraSource
from usdsmoke.core.smoke.voxels import Voxels
from usdsmoke.core.views.cameras import APERTURE_UNIT, rigid_axes

LEAST_BORDER = 2.0  # voxels: a point between voxels reads those around it


@dataclass(frozen=True)
class Frustum:
    """The space in front of a camera's film, between its clipping planes.

    Film coordinates are tangents (perspective) or stage units (orthographic), across and up.
    """

    eye: np.ndarray  # [3] stage space
    axes: np.ndarray  # [3 3] right, up, forward as rows, orthonormal
    low: np.ndarray  # [2] the film's left and lower edge
    high: np.ndarray  # [2] the right and upper edge
    near: float  # stage units along forward
    far: float
    border: float  # width over which the effect ends beyond the edges, in film coordinates
    is_orthographic: bool
    # Least width of that, stage units: right before the eye a film is smaller than a voxel, and
    # renderers interpolate between those around it.
    least_border: float = 0.0

    def shares(self, points: np.ndarray) -> np.ndarray:
        """1 inside the film, falling smoothly to 0 across the border, [N] float64.

        The clipping planes have a border too, as wide as the film's border there.

        Args:
            points: [N 3], stage space.
        """
        place = self._seen_from_eye(points)
        depth = place[:, 2]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            film = place[:, :2] if self.is_orthographic else place[:, :2] / depth[:, None]
            ends = [(self.low - film) / self._film_border, (film - self.high) / self._film_border]
            close = self._is_close(depth)
            for end, beyond in zip(ends, self._beyond_edges(place[close]), strict=True):
                end[close] = beyond / self.least_border
            ends.append(np.stack(self._beyond_clips(depth), 1))
        over = np.nan_to_num(np.concatenate(ends, 1), nan=1.0).clip(0.0, 1.0)
        shares = np.prod(1 - over * over * (3 - 2 * over), axis=1)
        return np.where((depth > 0) | close | self.is_orthographic, shares, 0.0)

    def distances(self, points: np.ndarray) -> np.ndarray:
        """How far points lie beyond the border's outermost plane, [N]; inside all it is negative.

        Where it is 0 or more, the share is 0. Beyond edges it is an underestimate.

        Args:
            points: [N 3], stage space.
        """
        place = self._seen_from_eye(points)
        return np.max(self._plane_distances(place), axis=1)

    def misses(self, corners: np.ndarray) -> bool:
        """True if a convex body is certainly outside: all its corners are beyond one plane.

        Args:
            corners: [N 3], stage space.
        """
        distances = self._plane_distances(self._seen_from_eye(corners))
        return bool((distances >= 0).all(axis=0).any())

    def depths(self, points: np.ndarray) -> np.ndarray:
        """Distances along the camera's axis, [N], stage units; negative behind it."""
        return (np.asarray(points, float) - self.eye) @ self.axes[2]

    def unclipped(self) -> "Frustum":
        """The same without clipping planes: all that is before the eye."""
        return replace(self, near=-np.inf if self.is_orthographic else 0.0, far=np.inf)

    def _seen_from_eye(self, points: np.ndarray) -> np.ndarray:
        return (np.asarray(points, float) - self.eye) @ self.axes.T

    def _is_close(self, depth: np.ndarray) -> np.ndarray:
        """Where a perspective film's border is narrower than the least, [N]."""
        if self.is_orthographic:
            return np.zeros(len(depth), bool)
        return (self.border * depth < self.least_border) & (depth > -self.least_border)

    def _beyond_edges(self, place: np.ndarray) -> list[np.ndarray]:
        """How far points lie beyond a perspective film's low and high edges, [N 2] each.

        What is beyond an edge is convex: behind the eye an edge goes on parallel to the axis.
        """
        across, depth = place[:, :2], place[:, 2:]
        low = np.minimum(self.low * depth, np.where(self.low < 0, 0.0, np.inf))
        high = np.maximum(self.high * depth, np.where(self.high > 0, 0.0, -np.inf))
        return [low - across, across - high]

    @property
    def _film_border(self) -> float:
        """Width of the border on the film; a perspective one is too narrow near the eye."""
        return max(self.border, self.least_border) if self.is_orthographic else self.border

    def _beyond_clips(self, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        near, far = self._clip_borders()
        beyond = np.zeros_like(depth) if np.isinf(self.far) else (depth - self.far) / far
        return (self.near - depth) / near, beyond

    def _clip_borders(self) -> tuple[float, float]:
        """Widths of the borders before the near and behind the far plane, stage units, > 0."""
        if self.is_orthographic:
            return self._film_border, self._film_border
        least = max(self.least_border, 1e-12)
        return max(self.border * self.near, least), max(self.border * self.far, least)

    def _plane_distances(self, place: np.ndarray) -> np.ndarray:
        """[N 6], to the outer planes of the border; ``place`` as seen from the eye."""
        border = self._film_border
        low, high = self.low - border, self.high + border
        across, depth = place[:, :2], place[:, 2:]
        if self.is_orthographic:
            sides = [low - across, across - high]
        else:
            lean = [np.sqrt(1 + edge**2) for edge in (low, high)]
            sides = [(low * depth - across) / lean[0], (across - high * depth) / lean[1]]
            if self.least_border > 0:
                beyond = self._beyond_edges(place)
                sides = [
                    np.minimum(side, (far - self.least_border) / length)
                    for side, far, length in zip(sides, beyond, lean, strict=True)
                ]
        near, far = self._clip_borders()
        return np.concatenate([*sides, self.near - near - depth, depth - self.far - far], axis=1)


def frustum_of(camera: CameraSource, margin: float, voxel: float = 0.0) -> Frustum:
    """The frustum of a camera's whole film.

    Args:
        camera: see ``CameraSource``.
        margin: width of the border, as a share of the film's width, > 0.
        voxel: longest edge of a voxel, stage units; the border is at least two of them wide.
    """
    place = np.asarray(camera.camera_to_stage, float)
    scale = APERTURE_UNIT if camera.is_orthographic else 1 / camera.focal_length
    size = np.array([camera.horizontal_aperture, camera.vertical_aperture]) * scale
    middle = np.array([camera.horizontal_offset, camera.vertical_offset]) * scale
    near, far = camera.clipping_range
    if not camera.is_orthographic:
        near = max(near, 0.0)  # nothing behind a pinhole is visible
    return Frustum(
        place[3, :3],
        np.stack(rigid_axes(place[:3, :3])),
        middle - size / 2,
        middle + size / 2,
        near,
        far,
        margin * float(size[0]),
        camera.is_orthographic,
        LEAST_BORDER * voxel,
    )


def pixel_footprint(camera: CameraSource, depth: float, width: int) -> float:
    """The width that one pixel of the camera's picture covers, stage units.

    Args:
        depth: distance along the camera's axis, stage units; ignored if it is orthographic.
        width: pixels of the picture.
    """
    if camera.is_orthographic:
        return APERTURE_UNIT * camera.horizontal_aperture / width
    return depth * camera.horizontal_aperture / camera.focal_length / width


def visible_part(smoke: Voxels, camera: CameraSource | None, margin: float) -> Voxels:
    """The voxels in the camera's picture or its border; all of them without a camera."""
    if camera is None or smoke.is_empty:
        return smoke
    shares = frustum_of(camera, margin, smoke.longest_edge).shares(smoke.positions)
    return smoke.take(shares > 0)


def nearest_footprint(visible: Voxels, camera: CameraSource | None, width: int) -> float:
    """What a pixel of the shot covers at the nearest visible smoke, stage units; 0 without any.

    Args:
        width: pixels of the shot's pictures.
    """
    if camera is None or visible.is_empty:
        return 0.0
    depth = float(frustum_of(camera, 1.0).depths(visible.positions).min())
    return pixel_footprint(camera, max(depth, 0.0), width)
