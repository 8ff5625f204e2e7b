"""Smoke drawn by Mitsuba 3, an independent path tracer: transmittance, glow, light of lamps.

Mitsuba's media scatter and absorb, but do not glow [Mitsuba3]. The glow is drawn by an integrator
of a few lines, which asks a medium where a ray ends and finds the colour there. The variant
``scalar_rgb`` is used: it needs no compiler at run time, and draws about 50 000 rays a second.
"""

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from usdsmoke.base.volume import DenseField, Scattering
from usdsmoke.core.views.cameras import View

MOST_BOUNCES = 64
FEW_BOUNCES = 4  # after which the glow's rays end by chance


@dataclass(frozen=True)
class TracedSmoke:
    """Smoke in stage space, as Mitsuba takes it."""

    density: DenseField  # its grid world is the stage
    gamma_w: float  # extinction per density, 1/stage unit
    scattering: Scattering  # without lights all around is white
    colour: DenseField | None = None  # albedo of each voxel, in place of the even one

    def lit(self, view: View, samples: int, seed: int, bounces: int = 1) -> np.ndarray:
        """The light that smoke scatters, [H W 3]; without lights, the transmittance of white.

        Args:
            view: orthographic.
            samples: a pixel.
            bounces: how often light is scattered at most.
        """
        mi = _mitsuba()
        place = mi.ScalarTransform4f
        to_stage = _unit_to_stage(self.density)
        integrator = {
            "type": "volpath",
            "max_depth": bounces + 1,
            "rr_depth": 99,
            "hide_emitters": bool(self.scattering.lights),
        }
        scene: dict[str, Any] = {"type": "scene", "integrator": integrator}
        scene["smoke"] = {
            "type": "cube",
            "to_world": place(to_stage.T) @ place().translate([0.5] * 3).scale([0.5] * 3),
            "bsdf": {"type": "null"},
            "interior": self._medium(),
        }
        scene["sensor"] = self._sensor(view, samples)
        scene |= _emitters(self.scattering)
        return np.array(mi.render(mi.load_dict(scene), spp=samples, seed=seed))

    def glow(
        self, colours: DenseField, view: View, samples: int, seed: int, bounces: int = 0
    ) -> np.ndarray:
        """Light that smoke emits, [H W 3]: the colours where a ray is absorbed or scattered.

        Args:
            colours: [i j k 3], emission over extinction, on the density's lattice.
            view, samples: see ``lit``.
            bounces: how often emitted light is scattered at most.
        """
        mi = _mitsuba()
        glowing = mi.load_dict({**self._medium(), "albedo": _grid(colours)})
        scattering = mi.load_dict(self._medium())
        phase = mi.load_dict(_phase(self.scattering.anisotropy))
        context = mi.PhaseFunctionContext()

        base: Any = mi.SamplingIntegrator

        class Glow(base):
            def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any, active: bool) -> Any:
                ray, total, left = mi.Ray3f(ray), mi.Color3f(0.0), mi.Color3f(1.0)
                bounce, is_hit = 0, False
                while (found := at(ray, sampler.next_1d(), 0, True)).is_valid():
                    if sampler.next_1d() >= found.sigma_t[0] / found.combined_extinction[0]:
                        ray = mi.Ray3f(found.p, ray.d)
                        continue
                    is_hit = True
                    total += left * found.sigma_s / found.sigma_t
                    if bounce == bounces:
                        break
                    rates = scattering.get_scattering_coefficients(found, True)
                    left = left * rates[0] / rates[2]
                    bounce, most = bounce + 1, max(left[0], left[1], left[2])
                    if bounce > FEW_BOUNCES:
                        if sampler.next_1d() >= most:
                            break
                        left = left / most
                    way = phase.sample(context, found, sampler.next_1d(), sampler.next_2d(), True)
                    ray = mi.Ray3f(found.p, way[0])
                return total, is_hit, []

        at = glowing.sample_interaction
        mi.register_integrator("glow", Glow)
        scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "glow"},
                "sensor": self._sensor(view, samples),
            }
        )
        return np.array(mi.render(scene, spp=samples, seed=seed))

    def _medium(self) -> dict[str, Any]:
        albedo = self.scattering.albedo if self.colour is None else _grid(self.colour)
        return {
            "type": "heterogeneous",
            "albedo": albedo,
            "scale": self.gamma_w,
            "sigma_t": _grid(self.density),
            "phase": _phase(self.scattering.anisotropy),
        }

    def _sensor(self, view: View, samples: int) -> dict[str, Any]:
        """An orthographic camera, farther from the picture's plane than any smoke."""
        mi = _mitsuba()
        place, half = mi.ScalarTransform4f, view.width * view.pixel_size / 2
        corners = np.array([[n >> 2 & 1, n >> 1 & 1, n & 1, 1.0] for n in range(8)])
        corners = (corners @ _unit_to_stage(self.density))[:, :3]
        distance = 1.1 * float(np.linalg.norm(corners - view.centre, axis=1).max())
        eye = place().look_at(
            origin=(view.centre - distance * view.forward).tolist(),
            target=view.centre.tolist(),
            up=view.up.tolist(),
        )
        film = {
            "type": "hdrfilm",
            "width": view.width,
            "height": view.height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
        }
        return {
            "type": "orthographic",
            "to_world": eye @ place().scale([half, half, 1]),
            "film": film,
            "sampler": {"type": "independent", "sample_count": samples},
        }


def _mitsuba() -> Any:
    """The module, in the variant that runs everywhere."""
    mi = importlib.import_module("mitsuba")
    mi.set_variant("scalar_rgb")
    mi.set_log_level(mi.LogLevel.Error)  # it warns of integrators in Python, for their speed
    return mi


def _phase(anisotropy: float) -> dict[str, Any]:
    return {"type": "hg", "g": anisotropy} if anisotropy else {"type": "isotropic"}


def _unit_to_stage(field: DenseField) -> np.ndarray:
    """[4 4] from the unit cube to the box of a field's voxels."""
    corner = np.eye(4)
    corner[:3, :3] = np.diag(field.values.shape[:3])
    corner[3, :3] = np.asarray(field.ijk_min) - 0.5
    found: np.ndarray = corner @ field.index_to_world
    return found


def _grid(field: DenseField) -> dict[str, Any]:
    """Mitsuba's volume of a field: trilinear between the voxels' centres."""
    mi = _mitsuba()
    n_channels = 1 if field.values.ndim == 3 else 3
    values = field.values.reshape(*field.values.shape[:3], n_channels).transpose(2, 1, 0, 3)
    return {
        "type": "gridvolume",
        "grid": mi.VolumeGrid(np.ascontiguousarray(values)),
        "to_world": mi.ScalarTransform4f(_unit_to_stage(field).T),
        "raw": True,
    }


def _emitters(scattering: Scattering) -> dict[str, Any]:
    """Mitsuba's lights; all white around where there are none."""
    found: dict[str, Any] = {}
    for number, light in enumerate(scattering.lights):
        colour = {"type": "rgb", "value": list(light.colour)}
        if light.towards is None:
            found[f"light{number}"] = {"type": "constant", "radiance": colour}
        else:
            way = (-np.array(light.towards)).tolist()
            sun = {"type": "directional", "direction": way, "irradiance": colour}
            found[f"light{number}"] = sun
    return found or {"white": {"type": "constant"}}
