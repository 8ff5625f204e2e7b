"""A small smoke solver: stable fluids in a closed box, on a voxel-centred grid.

A step is: sources, forces (buoyancy, vorticity confinement), projection, advection. Sources:
J. Stam, "Stable Fluids", 1999; R. Fedkiw, J. Stam, H. W. Jensen, "Visual Simulation of Smoke",
2001.
Clamped advection: A. Selle et al., "An Unconditionally Stable MacCormack Method", 2008.
The projection is exact: with slip walls each velocity component is a sine series along its own
axis and a cosine series along the others, so that removing the divergence is a product in
frequency space.

Space is in stage units with Y up, time in seconds, arrays are [i j k] and velocities [i j k 3].
"""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy import fft

__all__ = ["PlumeSettings", "SmokeSolver", "corner_samples", "project"]

HEIGHT = 2.0  # of the box, stage units
ASPECT = 5.0 / 3.0  # height over width
CHUNK = 2**15  # positions that one thread samples at a time; they stay in its cache


@dataclass(frozen=True)
class PlumeSettings:
    """What the plume is like; the same at every resolution."""

    buoyancy: float = 5.5  # upward acceleration of the hottest smoke, stage units / s^2
    cooling_time: float = 1.6  # seconds after which 1/e of the heat is left
    fading_time: float = 6.0  # the same for density
    confinement: float = 0.32  # strength of vorticity confinement, 1
    source_height: float = 0.10  # of the source's middle above the floor, stage units
    source_radius: float = 0.18
    source_rate: float = 14.0  # density and heat added per second
    gusts: float = 3.2  # sideways acceleration at the source, stage units / s^2
    seed: int = 3


class SmokeSolver:
    """The state of the smoke and how it goes on.

    Args:
        resolution: voxels along the box's width and depth; the height has 5/3 as many.
        settings: see PlumeSettings.
    """

    def __init__(self, resolution: int, settings: PlumeSettings) -> None:
        self.shape = (resolution, round(resolution * ASPECT), resolution)
        self.voxel_size = HEIGHT / self.shape[1]
        self.settings = settings
        self.time = 0.0
        self.density = np.zeros(self.shape, np.float32)
        self.heat = np.zeros(self.shape, np.float32)
        self.velocity = np.zeros((*self.shape, 3), np.float32)
        self._centres = self._voxel_centres()
        self._index = np.stack(np.indices(self.shape), axis=-1).astype(np.float32)
        rng = np.random.default_rng(settings.seed)
        self._waves = rng.normal(0.0, 11.0, (14, 3)).astype(np.float32)
        self._phases = rng.uniform(0.0, 2.0 * np.pi, 14)
        self._rates = rng.uniform(2.0, 9.0, 14)

    def _voxel_centres(self) -> np.ndarray:
        """[i j k 3] in stage units: the box stands on y = 0, its axis is the Y axis."""
        width = self.shape[0] * self.voxel_size
        origin = np.array([-0.5 * width, 0.0, -0.5 * width])
        index = np.stack(np.indices(self.shape), axis=-1)
        return (origin + (index + 0.5) * self.voxel_size).astype(np.float32)

    def step(self, dt: float) -> None:
        """Go on by ``dt`` seconds."""
        self._add_source(dt)
        self.velocity += dt * self._forces()
        self.velocity = project(self.velocity)
        self._advect(dt)
        self.density *= np.float32(np.exp(-dt / self.settings.fading_time))
        self.heat *= np.float32(np.exp(-dt / self.settings.cooling_time))
        self.time += dt

    def _noise(self, xyz: np.ndarray, turn: float) -> np.ndarray:
        """A smooth function of place and time with mean 0 and deviation about 0.7."""
        phases = (self._phases + turn + self._rates * self.time).astype(np.float32)
        return np.sin(xyz @ self._waves.T + phases).sum(-1) / np.sqrt(len(phases))

    def _add_source(self, dt: float) -> None:
        centre = np.array([0.0, self.settings.source_height, 0.0], np.float32)
        distance = np.linalg.norm((self._centres - centre) * [1.0, 2.0, 1.0], axis=-1)
        inside = distance < self.settings.source_radius
        xyz = self._centres[inside]
        fall_off = 1.0 - (distance[inside] / self.settings.source_radius) ** 2
        added = (
            dt
            * self.settings.source_rate
            * fall_off
            * np.clip(1.0 + self._noise(xyz, 0.0), 0.0, 2.5)
        )
        self.density[inside] = np.minimum(self.density[inside] + added, 1.0)
        self.heat[inside] = np.minimum(self.heat[inside] + added, 1.0)
        for axis, turn in ((0, 1.0), (2, 4.0)):
            self.velocity[inside, axis] += dt * self.settings.gusts * self._noise(xyz, turn)

    def _forces(self) -> np.ndarray:
        """Acceleration [i j k 3], stage units / s^2."""
        h = self.voxel_size
        gradients = [np.gradient(self.velocity[..., axis], h) for axis in range(3)]
        curl = np.stack(
            [
                gradients[2][1] - gradients[1][2],
                gradients[0][2] - gradients[2][0],
                gradients[1][0] - gradients[0][1],
            ],
            axis=-1,
        )
        towards = np.stack(np.gradient(np.linalg.norm(curl, axis=-1), h), axis=-1)
        towards /= np.linalg.norm(towards, axis=-1, keepdims=True) + 1e-6
        force = self.settings.confinement * h * np.cross(towards, curl)
        force[..., 1] += self.settings.buoyancy * self.heat
        return force.astype(np.float32)

    def _advect(self, dt: float) -> None:
        """Carry density, heat and the velocity itself with the flow (MacCormack, clamped)."""
        shift = self.velocity * np.float32(dt / self.voxel_size)
        carried = np.concatenate(
            [self.density[..., None], self.heat[..., None], self.velocity], axis=-1
        )
        # The midpoint rule for the departure points keeps eddies round.
        middle, _, _ = corner_samples(shift, self._index - 0.5 * shift)
        forward, low, high = corner_samples(carried, self._index - middle)
        returned, _, _ = corner_samples(forward, self._index + middle)
        moved = np.clip(forward + 0.5 * (carried - returned), low, high)
        self.density, self.heat = moved[..., 0].copy(), moved[..., 1].copy()
        self.velocity = np.ascontiguousarray(moved[..., 2:])


def corner_samples(
    values: np.ndarray, positions_ijk: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Trilinear samples of ``values`` [i j k C] at index positions [... 3], clamped to the box.

    Returns:
        The samples, and the least and the greatest of the eight voxels each was made of, [... C].
    """
    shape = np.array(values.shape[:3])
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    flat = values.reshape(-1, values.shape[3])
    positions = positions_ijk.reshape(-1, 3)

    def sample(begin: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        at = np.clip(positions[begin : begin + CHUNK], 0.0, (shape - 1).astype(np.float32))
        base = np.minimum(at.astype(np.int32), (shape - 2).astype(np.int32))
        part = (at - base).T
        first = (base * strides).sum(-1)
        total, low, high = 0.0, np.inf, -np.inf
        for corner in np.ndindex(2, 2, 2):
            x, y, z = (part[axis] if corner[axis] else 1.0 - part[axis] for axis in range(3))
            picked = flat.take(first + int((np.array(corner) * strides).sum()), axis=0)
            total = total + (x * y * z)[:, None] * picked
            low, high = np.minimum(low, picked), np.maximum(high, picked)
        return np.asarray(total, np.float32), np.asarray(low), np.asarray(high)

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        parts = list(threads.map(sample, range(0, len(positions), CHUNK)))
    target = (*positions_ijk.shape[:-1], values.shape[3])
    total, low, high = (np.concatenate(each).reshape(target) for each in zip(*parts, strict=True))
    return total, low, high


def project(velocity: np.ndarray) -> np.ndarray:
    """The part of ``velocity`` [i j k 3] that is free of divergence and tangential at the walls.

    Component a is a series of sin(pi m (i + 1/2) / n) along axis a, m = 1..n, and of cosines with
    m = 0..n-1 along the other two; in these bases the gradient of a cosine series is a product with
    the wave numbers pi m / n.
    """
    shape = velocity.shape[:3]
    waves = np.meshgrid(*(np.pi * np.arange(n) / n for n in shape), indexing="ij", sparse=True)
    spectra = [_to_waves(velocity[..., axis], axis) for axis in range(3)]
    square = sum(wave**2 for wave in waves)
    square[0, 0, 0] = 1.0  # the mean has no divergence, its numerator is 0
    potential = sum(wave * spectrum for wave, spectrum in zip(waves, spectra, strict=True)) / square
    return np.stack(
        [_from_waves(spectra[axis] - waves[axis] * potential, axis) for axis in range(3)], axis=-1
    )


def _to_waves(component: np.ndarray, axis: int) -> np.ndarray:
    """Sine series along ``axis``, cosine along the others; wave number m stands at index m."""
    others = [other for other in range(3) if other != axis]
    spectrum = fft.dst(
        fft.dctn(component, type=2, axes=others, norm="ortho"), axis=axis, norm="ortho"
    )
    spectrum = np.roll(spectrum, 1, axis=axis)
    # m = n has no cosine partner; it arrives at index 0, where there is no sine.
    np.moveaxis(spectrum, axis, 0)[0] = 0.0
    return spectrum


def _from_waves(spectrum: np.ndarray, axis: int) -> np.ndarray:
    others = [other for other in range(3) if other != axis]
    rolled = np.roll(spectrum, -1, axis=axis)
    cosines = fft.idst(rolled, axis=axis, norm="ortho")
    return fft.idctn(cosines, type=2, axes=others, norm="ortho").astype(np.float32)
