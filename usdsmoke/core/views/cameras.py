"""Views of the smoke: rigid cameras in stage space, orthographic or perspective."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from usdsmoke.base.errors import ShapeError
from usdsmoke.base.volume import CameraSource
from usdsmoke.config.look_sections import ViewsConfig
from usdsmoke.core.smoke.schedule import ALL_ROUND, view_ranges

FIT_MARGIN = 0.02  # of the smoke's own size, on every side of a picture that is fitted to it
APERTURE_UNIT = 0.1  # of a stage unit: what an orthographic camera's film is measured in
FREE = 60.0  # degrees around a camera's direction, without views of other sides
_GOLDEN = (math.sqrt(5) - 1) / 2


@dataclass(frozen=True)
class View:
    """A pinhole or parallel camera; rows of the image go down.

    ``right``, ``up``, ``forward`` are orthonormal in stage space. A point projects to
    pixel x = W/2 - 1/2 + s * (p - centre).right + shift[0] and
    y = H/2 - 1/2 - s * (p - centre).up + shift[1], where s = 1 / pixel_size (orthographic) or
    focal / depth (perspective: ``centre`` is the eye and ``focal`` in pixels).
    """

    right: np.ndarray
    up: np.ndarray
    forward: np.ndarray
    centre: np.ndarray
    height: int
    width: int
    pixel_size: float  # stage units; orthographic only
    focal: float | None = None  # pixels; None is orthographic
    azimuth: float = 0.0
    elevation: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)  # pixels, right and down: a lens that is off-centre


def orbit_view(
    azimuth: float,
    elevation: float,
    up_axis: str,
    centre: np.ndarray,
    height: int,
    width: int,
    pixel_size: float,
) -> View:
    """An orthographic view that looks at ``centre`` from an angle around the stage's up axis.

    Args:
        azimuth: degrees around up; 0 looks along -Z on a Y-up stage and along +Y on a Z-up stage,
            with +X to the right of the picture.
        elevation: degrees; positive looks down from above.
        up_axis: "Y" or "Z".
        centre: [3], stage space.
        height, width: pixels.
        pixel_size: stage units.
    """
    a, e = math.radians(azimuth), math.radians(elevation)
    right = np.array([math.cos(a), 0.0, -math.sin(a)])
    forward = np.array([-math.sin(a) * math.cos(e), -math.sin(e), -math.cos(a) * math.cos(e)])
    if up_axis == "Z":  # turn Y-up into Z-up: (x, y, z) -> (x, -z, y)
        right, forward = (np.array([v[0], -v[2], v[1]]) for v in (right, forward))
    up = np.cross(right, forward)
    return View(
        right, up, forward, np.asarray(centre, float), height, width, pixel_size,
        azimuth=azimuth, elevation=elevation,
    )  # fmt: skip


def frame_points(view: View, points: np.ndarray, height: int | None, width: int | None) -> View:
    """The same orthographic view, moved and scaled so that its picture holds all points.

    Args:
        view: gives the direction alone.
        points: [N 3], stage space, at least one.
        height, width: pixels; one of them may be None and follows from the other. There is a
            margin of a fiftieth at least.
    """
    in_view = np.asarray(points, float) @ np.stack([view.right, view.up, view.forward], axis=1)
    low, high = in_view.min(axis=0), in_view.max(axis=0)
    largest = float((high - low).max()) or 1.0
    sides = np.maximum((high - low)[:2] * (1 + 2 * FIT_MARGIN), 1e-3 * largest)
    if height is None and width is None:
        raise ShapeError("neither height nor width of a picture was given. Pass at least one.")
    pixel_size = max(
        sides[0] / width if width is not None else 0.0,
        sides[1] / height if height is not None else 0.0,
    )
    centre = (low + high) / 2 @ np.stack([view.right, view.up, view.forward])
    return replace(
        view,
        centre=centre,
        height=height if height is not None else max(1, math.ceil(sides[1] / pixel_size - 1e-6)),
        width=width if width is not None else max(1, math.ceil(sides[0] / pixel_size - 1e-6)),
        pixel_size=float(pixel_size),
    )


def view_of_camera(camera: CameraSource, height: int, width: int) -> View:
    """What a camera of the stage shows, as ``height`` x ``width`` square pixels.

    The horizontal aperture spans the picture's width, which is hdStorm's and usdrecord's way too
    (``expandVertically`` or ``crop``): a picture that is higher than the film shows more above and
    below, a lower one less. As in ``Gf.Camera``, scale in the camera's transform is ignored, and a
    mirrored one is mirrored back. The clipping range is ignored.

    Args:
        camera: see ``CameraSource``.
        height, width: pixels.
    """
    place = np.asarray(camera.camera_to_stage, float)
    right, up, forward = rigid_axes(place[:3, :3])
    eye = place[3, :3]
    per_unit = width / camera.horizontal_aperture  # pixels per unit of film
    across, above = camera.horizontal_offset, camera.vertical_offset
    if camera.is_orthographic:
        centre = eye + APERTURE_UNIT * (across * right + above * up)
        return View(right, up, forward, centre, height, width, APERTURE_UNIT / per_unit)
    return View(
        right, up, forward, eye, height, width, 0.0, camera.focal_length * per_unit,
        shift=(-across * per_unit, above * per_unit),
    )  # fmt: skip


def camera_orbit(
    camera: CameraSource, azimuth: float, elevation: float, target: np.ndarray, pixel_size: float
) -> View:
    """An orthographic view of a place from the camera's direction, or from beside it.

    Args:
        camera: its eye (perspective) or its axis (orthographic) gives the direction, its up and
            right the picture's.
        azimuth: degrees around the camera's up; positive moves the view to the right.
        elevation: degrees; positive moves the view up, along the camera's up.
        target: [3], stage space; the picture's centre, one pixel large until it is fitted.
        pixel_size: stage units.
    """
    place = np.asarray(camera.camera_to_stage, float)
    right, up, forward = rigid_axes(place[:3, :3])
    towards = np.asarray(target, float) - place[3, :3]
    if not camera.is_orthographic and towards @ forward > 0:  # else it is not in the picture
        forward = towards / np.linalg.norm(towards)
        right = right - (right @ forward) * forward
        right = right / np.linalg.norm(right)
        up = np.cross(right, forward)
    turned = orbit_view(azimuth, elevation, "Y", target, 1, 1, pixel_size)
    axes = np.stack([right, up, -forward])
    return replace(
        turned, right=turned.right @ axes, up=turned.up @ axes, forward=turned.forward @ axes
    )


def view_rays(view: View, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and unit directions of the rays through points of the picture, [N 3], stage space.

    Distances along an orthographic view's rays are depths from its ``centre``; a perspective one's
    rays start in its eye.

    Args:
        view: orthographic or perspective.
        x, y: [N], pixels; a pixel's centre is a whole number, y goes down.
    """
    across = np.asarray(x, float)[:, None] - (view.width - 1) / 2 - view.shift[0]
    above = (view.height - 1) / 2 + view.shift[1] - np.asarray(y, float)[:, None]
    offset = across * view.right + above * view.up
    if view.focal is None:
        start = view.centre + view.pixel_size * offset
        return start, np.broadcast_to(view.forward, start.shape)
    direction = offset / view.focal + view.forward
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return np.broadcast_to(view.centre, direction.shape), direction


def rigid_axes(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Right, up and forward of a camera whose x, y, z are the rows of a [3 3] matrix, in stage
    space.

    The polar decomposition's rotation: no axis is preferred where the matrix shears.
    """
    rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    if np.linalg.det(rows) < 0:
        rows = np.diag([-1.0, 1.0, 1.0]) @ rows
    u, _, v = np.linalg.svd(rows)
    right, up, backward = u @ v
    return right, up, -backward


def sample_angles(config: ViewsConfig, n: int, seed: int, n_aside: int = 0) -> np.ndarray:
    """``n`` (azimuth, elevation) pairs in degrees, [n 2], spread over the configured ranges.

    The last ``n_aside`` of them are those of ``angles_aside``.

    ``fixed`` and ``uniform`` lay out a lattice (fixed always contains the middle, as its first
    pair), ``poisson`` keeps the most distant of many random candidates, one point after the other,
    which is a Poisson-disc set without a radius that could fail [Mitchell1991]. Every count and
    every range is valid, a zero range included: the angle is then constant.
    """
    half = np.array(view_ranges(config))
    middle = np.array([config.centre_azimuth, config.centre_elevation])
    if config.sampling == "poisson":
        unit = _spread_points(n - n_aside, half, seed)
    else:
        unit = _lattice(n - n_aside, half, with_middle=config.sampling == "fixed")
    return np.concatenate([middle + unit * half, angles_aside(config, n_aside)])


def angles_aside(config: ViewsConfig, n: int) -> np.ndarray:
    """``n`` (azimuth, elevation) pairs in degrees, [n 2], on the sides that a camera does not see.

    Azimuths are even, ``FREE`` away from the camera's direction at least; views between would blur
    what it sees. Elevations are spread over ``views.elevation``, or that of views all round, by
    steps of the golden ratio.
    """
    number = np.arange(1, n + 1)
    half = ALL_ROUND[1] if config.elevation is None else config.elevation
    around = FREE + (360.0 - 2 * FREE) * (number - 0.5) / max(n, 1)
    above = half * (2 * (number * _GOLDEN % 1) - 1)
    return np.stack([around, above], axis=1)


def draw_views(iteration: int, count: int, pool: int, seed: int) -> list[int]:
    """The views of a pool that an iteration uses: ``count`` numbers below ``pool``.

    The whole pool is used again and again, each time in another order, so every view is used
    equally often and none has a fixed neighbour. The same arguments always give the same views.

    Args:
        iteration: from 0.
        count: views an iteration; may exceed the pool, whose views then repeat.
        pool: number of views, at least 1.
        seed: of the orders.
    """
    first = iteration * count
    return [
        int(_view_order(turn // pool, pool, seed)[turn % pool])
        for turn in range(first, first + count)
    ]


@lru_cache(maxsize=64)
def _view_order(passage: int, pool: int, seed: int) -> np.ndarray:
    return np.random.default_rng([seed, 0x71E3, passage]).permutation(pool)


def _spread_points(n: int, half: np.ndarray, seed: int) -> np.ndarray:
    """[n 2] in [-1, 1]^2: best candidate sampling, distances measured in degrees."""
    generator = np.random.default_rng([seed, 0x5EED])
    points = generator.uniform(-1, 1, (1, 2))
    scale = np.where(half > 0, half, 0.0)
    while len(points) < n:
        candidates = generator.uniform(-1, 1, (24, 2))
        gap = (candidates[:, None] - points[None]) * scale
        if half[0] >= 180:  # all round: the two ends of the range are one angle
            gap[..., 0] -= 360 * np.round(gap[..., 0] / 360)
        nearest = np.min((gap**2).sum(-1), axis=1)
        points = np.vstack([points, candidates[np.argmax(nearest)]])
    return points


def _lattice(n: int, half: np.ndarray, with_middle: bool) -> np.ndarray:
    """[n 2] in [-1, 1]^2, row by row; the middle, when asked for, first instead of its nearest."""
    if n == 1:
        return np.zeros((1, 2))
    n_rows = 1 if half[1] == 0 else max(1, round(math.sqrt(n * half[1] / max(half[0], 1e-9))))
    n_rows = min(n_rows, n) if half[0] > 0 else n
    counts = [n // n_rows + (row < n % n_rows) for row in range(n_rows)]
    full_turn = half[0] >= 180  # the two ends of the range are one angle
    rows = []
    for row, count in enumerate(counts):
        y = 0.0 if n_rows == 1 else -1 + 2 * row / (n_rows - 1)
        steps = count if full_turn else count - 1
        rows += [(0.0 if count == 1 else -1 + 2 * k / steps, y) for k in range(count)]
    points = np.array(rows)
    if with_middle:
        nearest = int(np.argmin((points**2).sum(1)))
        points = np.vstack([np.zeros((1, 2)), np.delete(points, nearest, axis=0)])
    return points
