"""Rays along an axis of one lattice: no cell has to be searched for.

Such a ray stays between four columns of voxels with the same four weights, and it is cut only at
the planes of voxel centres across it. On a segment every field is a line between two planes, so the
light of a ray is a weighted sum of the planes' values, with weights that depend on extinction
alone (``rays.segments``). Front views of smoke that is not turned on the stage are such pictures,
and so are contact sheets.
"""

import numpy as np

from usdsmoke.core.rays.media import Medium
from usdsmoke.core.rays.segments import (
    OPAQUE,
    PARALLEL,
    cut_more,
    n_parts,
    segment_weights,
)

_THICK = 1.0  # optical depth above which a segment is cut
_HIDDEN = 80.0  # optical depth behind which float32 holds no light
_TINY = 1e-30  # keeps 0 / 0 away
_CORNERS = list(np.ndindex(2, 2))


def follows_axis(medium: Medium, direction: np.ndarray) -> bool:
    """Whether a direction follows one of a lattice's axes.

    Args:
        medium: gives the lattice.
        direction: [3], stage space.
    """
    step = np.abs(direction @ np.linalg.inv(medium.index_to_stage)[:3, :3])
    return int((step > PARALLEL * step.max()).sum()) == 1


class Columns:
    """A medium as columns of voxels along the rays of one picture, front to back.

    Args:
        medium: the smoke.
        direction: [3], of all rays, stage space; along an axis of the medium.
        with_light: else only optical depths are found.
    """

    def __init__(self, medium: Medium, direction: np.ndarray, with_light: bool) -> None:
        self._to_index = np.linalg.inv(medium.index_to_stage)
        step = direction @ self._to_index[:3, :3]
        axis = int(np.abs(step).argmax())
        self._length = 1 / abs(float(step[axis]))  # of a segment, stage units
        self._is_reversed, shape = bool(step[axis] < 0), medium.extinction.shape
        self._across = [n for n in range(3) if n != axis]
        self._sides = np.array(shape)[self._across]
        self.numbers_per_ray = shape[axis]
        depths = medium.extinction.sum(axis=axis, dtype=np.float64) * self._length
        self._depths, self._with_light = depths.reshape(-1), with_light
        if not with_light:
            return

        def columns(values: np.ndarray) -> np.ndarray:
            """[n K], as stored: planes may come back to front."""
            return np.ascontiguousarray(np.moveaxis(values, axis, 2)).reshape(-1, shape[axis])

        self._extinction = columns(medium.extinction)
        self._light = [] if medium.emission is None else [*map(columns, medium.emission)]
        # planes from the first that holds anything to behind the last, with the empty ones around
        filled = np.logical_or.reduce([part != 0 for part in (self._extinction, *self._light)])
        some = filled.any(axis=1)
        self._first = np.where(some, filled.argmax(axis=1) - 1, shape[axis])
        self._last = np.where(some, shape[axis] - filled[:, ::-1].argmax(axis=1), 0)

    def trace(self, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Optical depths of rays [R 3], and their light, emission and grey, [R 4]; float64."""
        hit, columns, weights = self._taps(origin)
        depth, light = np.zeros(len(origin)), np.zeros((len(origin), 4))
        depth[hit] = sum(w * self._depths[c] for c, w in zip(columns, weights, strict=True))
        if self._with_light and len(hit):
            first, last = self._first[columns].min(axis=0), self._last[columns].max(axis=0)
            some = first < last
            if some.any():
                planes = slice(int(first[some].min()), int(last[some].max()) + 1)
                light[hit[some]] = self._sent(columns[:, some], weights[:, some], planes)
        return depth, light

    def _taps(self, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which rays [R 3] hit the lattice, and the columns [4 m] around these, with weights."""
        place = (origin @ self._to_index[:3, :3] + self._to_index[3, :3])[:, self._across]
        hit = np.flatnonzero(((place >= 0) & (place <= self._sides - 1)).all(axis=1))
        cell = np.clip(np.floor(place[hit]), 0, self._sides - 2)
        (x, y), (i, j) = (place[hit] - cell).T, cell.astype(np.int64).T
        number = [(i + a) * self._sides[1] + j + b for a, b in _CORNERS]
        share = [(x if a else 1 - x) * (y if b else 1 - y) for a, b in _CORNERS]
        return hit, np.stack(number), np.stack(share)

    def _sent(self, columns: np.ndarray, weights: np.ndarray, planes: slice) -> np.ndarray:
        """Light of rays between columns [4 m] that sends nothing from beside the planes, [m 4]."""
        pairs = list(zip(columns, weights.astype(np.float32)[..., None], strict=True))
        table = self._extinction[:, planes]
        extinction = sum(table[column] * weight for column, weight in pairs)
        if self._is_reversed:
            extinction = np.ascontiguousarray(extinction[:, ::-1])
        seen = self._plane_weights(extinction)
        if self._is_reversed:
            seen = np.ascontiguousarray(seen[:, ::-1])
        light = np.zeros((columns.shape[1], 4))
        for channel, values in enumerate(self._light):
            table = values[:, planes]
            light[:, channel] = sum(
                np.einsum("rk,rk->r", seen, table[column]) * weight[:, 0]
                for column, weight in pairs
            )
        return light

    def _plane_weights(self, extinction: np.ndarray) -> np.ndarray:
        """What the light at each plane adds to a ray, given its extinction there; [m K] both, front
        to back."""
        slope = extinction[:, 1:] - extinction[:, :-1]
        total = extinction[:, 1:] + extinction[:, :-1]
        total += _TINY
        slope /= total
        with np.errstate(over="ignore"):  # which the next line bounds
            thickness = total * (self._length / 2)
        np.minimum(thickness, 2 * OPAQUE, out=thickness)
        before = np.cumsum(thickness, axis=1)
        before -= thickness
        mean, rest = segment_weights(thickness, slope)
        arriving = np.minimum(before, _HIDDEN)
        np.negative(arriving, out=arriving)
        np.exp(arriving, out=arriving)
        arriving *= self._length / 2
        near, far = mean + rest, np.subtract(mean, rest, out=mean)
        thick = np.nonzero((thickness > _THICK) & (before < OPAQUE))
        if len(thick[0]):
            whole = total[thick].astype(np.float64) * (self._length / 2)
            near[thick], far[thick] = _cut_weights(whole, slope[thick], before[thick])
        near *= arriving
        far *= arriving
        weights = np.zeros_like(extinction)
        weights[:, :-1] = near
        weights[:, 1:] += far
        return weights


def _cut_weights(
    thickness: np.ndarray, slope: np.ndarray, before: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Weights of a segment's two ends [M], as ``segment_weights`` gives them for it in parts."""
    index, low, high = cut_more(n_parts(thickness, before, _THICK))
    t, rho, share = thickness[index], slope[index], high - low
    # extinction at both ends of a part, in that of the segment's mean
    begin, end = 1 + rho * (2 * low - 1), 1 + rho * (2 * high - 1)
    total = begin + end + _TINY
    mean, rest = segment_weights(t * share * total / 2, (end - begin) / total)
    passed = np.exp(-t * (low - rho * low * (1 - low))) * share
    first, second = (mean + rest) * passed, (mean - rest) * passed
    near = first * (1 - low) + second * (1 - high)
    far = first * low + second * high
    near, far = (np.bincount(index, side, minlength=len(thickness)) for side in (near, far))
    return near, far
