"""Light of the stage that smoke scatters.

Where density is fixed, so is the light in the smoke. A voxel scatters albedo * sigma * L, with

    L = sum over lights of E p(theta) exp(-tau)

where E is the irradiance of the light, p Henyey and Greenstein's phase function [Henyey1941], and
tau the optical depth towards the light. A dome is uniform: every phase function scatters its light
alike, and what hides it is looked up in a few directions, at half the smoke's resolution. That is
light that is scattered once, as in renderers without volume bounces. ``Scattering.bounces`` adds
light that is scattered more often, see ``bounces``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from usdsmoke.base.boxes import union_box, values_in_box
from usdsmoke.base.volume import DenseField, Scattering
from usdsmoke.core.smoke.active import ActiveSmoke, activate, coarsen, sample_colours
from usdsmoke.core.views.bounces import softer, weights
from usdsmoke.core.views.cameras import View
from usdsmoke.core.views.shadows import ShadowMap, trace_shadows


@dataclass(frozen=True)
class Lighting:
    """The lights of a frame, and the smoke that stands in their way."""

    smoke: ActiveSmoke  # all of it
    gamma_w: float  # extinction per density, 1/stage unit
    scattering: Scattering
    weighs_light: bool = False  # colours weigh this light; else they are emitted beside it

    def on(self, positions: Tensor) -> "LitPoints":
        """The light at points.

        Args:
            positions: [P 3] float64, stage space, in the smoke or beside it.
        """
        even, beams = self.smoke.density.new_zeros(len(positions), 3), []
        lights, g = self.scattering.lights, self.scattering.anisotropy
        has_sky = self.scattering.bounces or any(light.towards is None for light in lights)
        sky = self._sky(positions) if has_sky else even[:, :1]
        shadows = iter(self._shadows)
        for light in lights:
            colour = even.new_tensor(light.colour)
            if light.towards is None:
                even += self._weighed(sky, sky).sum(1, keepdim=True) * colour
                continue
            towards = np.asarray(light.towards, float)
            terms = self._weighed(self._terms(next(shadows).at(positions)), sky)
            if g:
                powers = enumerate(terms.split(1, dim=1), start=1)
                beams += [(towards, g**k, part * colour) for k, part in powers]
            else:
                even += terms.sum(1, keepdim=True) * colour / (4 * math.pi)
        return LitPoints(self.scattering, even, tuple(beams))

    @cached_property
    def _shadows(self) -> list[ShadowMap]:
        """Of each distant light, in their order; for all positions."""
        ways = [light.towards for light in self.scattering.lights if light.towards is not None]
        return [trace_shadows(self.smoke, self.gamma_w, np.asarray(way, float)) for way in ways]

    def _sky(self, positions: Tensor) -> Tensor:
        """The share of a dome that is seen through the smoke, [P K], see ``_terms``."""
        found, near = sample_colours(*self._seen_sky, positions)
        return torch.where(near > 0, found, torch.ones_like(found))

    @cached_property
    def _seen_sky(self) -> tuple[ActiveSmoke, Tensor]:
        """The smoke at half its resolution, and that share in its voxels; for all positions."""
        coarse, directions = coarsen(self.smoke), sky_directions()
        total = self._terms(coarse.density.new_zeros(len(coarse.ijk)))
        for towards in directions:
            seen = trace_shadows(coarse, self.gamma_w, towards, both=True)
            total += self._terms(seen.at(coarse.positions))
        return coarse, total / len(directions)

    def _terms(self, shares: Tensor) -> Tensor:
        """[P K] of transmittances [P]: K = 1 without bounces."""
        return softer(shares) if self.scattering.bounces else shares[:, None]

    def _weighed(self, terms: Tensor, sky: Tensor) -> Tensor:
        """Terms of a light as they count where that much of a dome is seen, [P K]."""
        if not self.scattering.bounces:
            return terms
        return terms * weights(self.scattering.albedo, sky[:, 0])


@dataclass(frozen=True)
class LitPoints:
    """The light at points in smoke."""

    scattering: Scattering
    even: Tensor  # [P 3] radiance that is scattered alike to all sides
    # Unit vector to the light [3], anisotropy, irradiance [P 3].
    beams: tuple[tuple[np.ndarray, float, Tensor], ...]

    def scattered(self, forward: np.ndarray) -> Tensor:
        """albedo * L, what the points add to the colour of the smoke, [P 3]; scene-linear, >= 0.

        Args:
            forward: unit vector from the eye, [3], or one for each point, [P 3].
        """
        total = self.even
        for towards, anisotropy, arriving in self.beams:
            cosine = torch.as_tensor(forward @ towards, dtype=total.dtype, device=total.device)
            total = total + arriving * phase(anisotropy, cosine)[..., None]
        return self.scattering.albedo * total


def phase(anisotropy: float, cosine: Tensor) -> Tensor:
    """Henyey and Greenstein's phase function, 1/steradian; over all directions it adds up to 1.

    Args:
        anisotropy: in (-1, 1), the mean cosine; 0 scatters to all sides, above 0 forward.
        cosine: of the angle between the ways of the light before and after.
    """
    g = anisotropy
    return (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * cosine) ** 1.5)


def light_smoke(smoke: ActiveSmoke, gamma_w: float, scattering: Scattering) -> Lighting | None:
    """The light in a frame's smoke; None where there is none.

    Args:
        smoke: all that casts shadows, at full resolution.
        gamma_w: extinction per density, 1/stage unit.
        scattering: its distant lights are parallel, and its domes uniform.
    """
    if not scattering.lights or scattering.albedo == 0 or len(smoke.ijk) == 0:
        return None
    return Lighting(smoke, gamma_w, scattering)


def sky_directions() -> np.ndarray:
    """Unit vectors to a dome, [6 3], which stand for their opposites too: the corners of an
    icosahedron, of equal weight."""
    golden = (1 + 5**0.5) / 2
    corners = [np.roll([0.0, one, golden], shift) for shift in range(3) for one in (-1, 1)]
    found: np.ndarray = np.array(corners) / np.hypot(1, golden)
    return found


def lit_emission(
    density: DenseField,
    fields: Sequence[DenseField | None],
    to_stage: np.ndarray,
    gamma_w: float,
    scattering: Scattering,
    view: View,
) -> DenseField:
    """Emission and scattered light together, radiance per stage unit, as they go to the eye.

    Args:
        density: [i j k].
        fields: the emission, [i j k 3], and the scattering colour, which the albedo is multiplied
            by, each on the density's lattice or None; boxes may differ.
        to_stage: [4 4], the density's grid world to stage space.
        gamma_w: extinction per density, 1/stage unit.
        scattering: see ``light_smoke``.
        view: orthographic or perspective.
    """
    emission, colour = fields
    if emission is None:
        values = np.zeros((*density.values.shape, 3), np.float32)
        emission = replace(density, values=values, background=(0.0, 0.0, 0.0))
    smoke = activate(density, to_stage, torch.device("cpu"))
    lighting = light_smoke(smoke, gamma_w, scattering)
    if lighting is None:
        return emission
    positions, forward = smoke.positions, view.forward
    if view.focal is not None:
        forward = positions.numpy() - view.centre
        length = np.linalg.norm(forward, axis=1, keepdims=True)
        forward = forward / np.where(length > 0, length, 1.0)  # 0: the eye is in this voxel
    light = lighting.on(positions).scattered(forward) * (gamma_w * smoke.density)[:, None]
    if colour is not None:
        own = torch.from_numpy(colour.at(smoke.ijk.numpy()))
        light = light * own.view(len(own), -1)  # an empty field has one number for each voxel
    low, shape = union_box((density, emission))
    values = values_in_box(emission, low, (*shape, 3)).copy()
    values[tuple((smoke.ijk.numpy() - low).T)] += light.numpy()
    return replace(emission, values=values, ijk_min=low)
