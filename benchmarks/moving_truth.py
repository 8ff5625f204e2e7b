"""The temporal rows of ``benchmarks.told_true``: a turning scene, and its errors by other code."""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from benchmarks.told_true_scenes import Scene
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.smoke.active import ActiveSmoke

__all__ = ["RATE", "temporal_error", "turned_shot"]

RATE = 24.0  # frames a second
ANGLE = np.radians(4.0)  # a frame
OFF_AXIS = (3.0, 2.0)  # voxels along i and k, from the middle of the box to the axis
MARGIN = 4  # voxels around the box, which the smoke turns into
LEAST = 1e-3  # of the greatest density: what interpolation leaves beyond the smoke
TRIPS = 4  # shifts that the floor is the mean of
ENOUGH = 0.5  # of a neighbourhood's weight that lies in smoke
MOST_FLOOR = 0.5  # squared, as in the estimate

Box = tuple[np.ndarray, np.ndarray, np.ndarray]  # values [I J K C], smoke [I J K], first index


def turned_shot(scene: Scene) -> list[VolumeFrame]:
    """A scene's frame and the next one, turned about a vertical axis; both with that velocity.

    The smoke of the next frame is known exactly, or interpolated by a cubic spline.
    """
    density = scene.frame.density
    low = np.asarray(density.ijk_min) - MARGIN
    shape = np.array(density.values.shape) + 2 * MARGIN
    places = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1) + low
    places = places.astype(float)
    before = _turned(places, scene, -ANGLE)
    if scene.truth is not None:
        values = scene.truth(before)
    else:
        index = np.moveaxis(before - np.asarray(density.ijk_min), -1, 0)
        values = ndimage.map_coordinates(density.values.astype(float), index, order=3)
        values = np.where(values > LEAST * density.values.max(), values, 0.0)
    across = places - _axis(scene)
    pace = ANGLE * RATE * np.linalg.norm(density.index_to_world[0, :3])
    rates = pace * np.stack([-across[..., 2], 0 * across[..., 1], across[..., 0]], -1)
    first = (int(low[0]), int(low[1]), int(low[2]))
    velocity = DenseField("vel", rates.astype(np.float32), first, density.index_to_world)
    here = replace(scene.frame, velocity=velocity, velocity_to_stage=np.eye(4))
    moved = DenseField("density", values.astype(np.float32), first, density.index_to_world)
    return [here, replace(here, time_code=here.time_code + 1, density=moved)]


def temporal_error(
    scene: Scene, before: tuple[ActiveSmoke, np.ndarray], after: tuple[ActiveSmoke, np.ndarray]
) -> float:
    """The share of a pattern that does not move with the turning smoke, above an exact trip's loss.

    The definition of ``core.sequence.steadiness`` with every voxel in place of a thousand, with
    circles in place of steps along the velocity, and with the mean over several trips as the floor.

    Args:
        before: smoke of the frame, and the pattern at its voxels [N C].
        after: the same of the next frame.
    """
    rng = np.random.default_rng(0)
    ijk = before[0].ijk.numpy()
    mass = np.maximum(before[0].density.numpy().astype(float), 0.0)
    then, now = _boxed(*before), _boxed(*after)
    centres = ijk + rng.uniform(-0.5, 0.5, ijk.shape)
    near = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), -1).reshape(-1, 3)
    weights = np.prod(np.array([0.25, 0.5, 0.25])[near + 1], axis=1)
    points = centres[:, None] + near
    old, inside = _look_up(then, points)
    found, there = _look_up(now, _turned(points, scene, ANGLE))
    error = _squared(old, found, weights * (inside & there), mass)
    trips = [_trip(then, shift) for shift in rng.uniform(0.0, 1.0, (TRIPS, 3))]
    floors = []
    for trip in trips:
        back, there = _look_up(trip, points)
        floors.append(_squared(old, back, weights * (inside & there), mass))
    floor = min(float(np.mean(floors)), MOST_FLOOR)
    return float(np.sqrt(max(error - floor, 0.0) / (1 - floor)))


def _axis(scene: Scene) -> np.ndarray:
    """An index position on the axis."""
    density = scene.frame.density
    middle = np.asarray(density.ijk_min) + (np.array(density.values.shape) - 1) / 2
    return np.asarray(middle + np.array([OFF_AXIS[0], 0.0, OFF_AXIS[1]]))


def _turned(places: np.ndarray, scene: Scene, angle: float) -> np.ndarray:
    """Index positions [... 3] after a turn."""
    axis = _axis(scene)
    x, y, z = np.moveaxis(places - axis, -1, 0)
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(np.stack([c * x - s * z, y, s * x + c * z], -1) + axis)


def _boxed(smoke: ActiveSmoke, values: np.ndarray) -> Box:
    ijk = smoke.ijk.numpy()
    low = ijk.min(0) - 2
    shape = tuple(ijk.max(0) - low + 3)
    box, some = np.zeros((*shape, values.shape[1])), np.zeros(shape)
    place = tuple((ijk - low).T)
    box[place], some[place] = values, 1.0
    return box, some, low.astype(float)


def _look_up(box: Box, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values [... C] between the voxels with smoke, and where there are any."""
    values, some, low = box
    index = np.moveaxis(points - low, -1, 0)
    near = ndimage.map_coordinates(some, index, order=1)
    channels = [
        ndimage.map_coordinates(values[..., c], index, order=1) for c in range(values.shape[-1])
    ]
    return np.stack(channels, -1) / np.maximum(near, 1e-12)[..., None], near > 1e-3


def _trip(box: Box, shift: np.ndarray) -> Box:
    """The same pattern on voxels that lie a part of a voxel farther."""
    values, _, low = box
    places = np.stack(np.meshgrid(*map(np.arange, values.shape[:3]), indexing="ij"), -1)
    found, there = _look_up(box, places + low + shift)
    return found * there[..., None], there.astype(float), low + shift


def _squared(then: np.ndarray, now: np.ndarray, weights: np.ndarray, mass: np.ndarray) -> float:
    total = weights.sum(1)
    counts = total > ENOUGH
    shares = (weights / np.maximum(total, 1e-12)[:, None])[counts][..., None]
    a, b = (then[counts] * shares).sum(1), (now[counts] * shares).sum(1)
    weight = (mass[counts] / mass[counts].sum())[:, None]
    middle = (weight * (a + b)).sum(0) / 2
    pattern = (weight * ((a - middle) ** 2 + (b - middle) ** 2)).sum()
    return float((weight * (a - b) ** 2).sum() / pattern)
