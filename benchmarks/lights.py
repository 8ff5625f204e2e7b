"""Light that smoke scatters against Mitsuba 3, and style under a sun with and without it.

Two tables. ``agreement``: mean pictures of a lumpy ball, transmittance and single scattering, at
several optical depths. ``closure``: style loss of one frame's colour picture under a sun and a sky,
on views that are not optimised, with the scattered light drawn by Mitsuba; painted without and with
the light in the model. Takes ten minutes on one core. Mitsuba is an optional dependency:
``pip install usdsmoke[reference]``.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F

from benchmarks.circumstances import circumstances
from usdsmoke.base.settings import Config
from usdsmoke.base.volume import DenseField, LightSource, Scattering, VolumeFrame
from usdsmoke.core.smoke.active import ActiveSmoke, activate
from usdsmoke.core.smoke.srgb import decode_srgb
from usdsmoke.core.steps.colour import run_colour_step
from usdsmoke.core.steps.pictures import prepare_views
from usdsmoke.core.steps.targets import StepProblem, make_targets
from usdsmoke.core.views.cameras import View
from usdsmoke.core.views.lighting import light_smoke
from usdsmoke.core.views.project import colour_map
from usdsmoke.core.views.scene import frame_views, measure_scene
from usdsmoke.pictures import read_style_image
from usdsmoke.vdb.read import GridRequest, read_grids

DEPTHS = (0.1, 1.0, 4.0, 10.0, 50.0)
SUN = (0.8, 0.5, 0.33)
LIGHTS = (
    LightSource("/sun", (3.36, 3.0, 2.5), tuple((np.array(SUN) / np.linalg.norm(SUN)).tolist())),
    LightSource("/sky", (0.25, 0.35, 0.6)),
)


def lumpy_ball(n: int) -> np.ndarray:
    """Smooth smoke without any symmetry, [n n n] float32."""
    x = (np.arange(n) + 0.5) / n - 0.5
    x, y, z = np.meshgrid(x, x, x, indexing="ij")
    ball = np.clip(1 - (x**2 + y**2 + z**2) / 0.42**2, 0, None) ** 2
    lumps = 1 + 0.7 * np.sin(9 * x + 4 * z) * np.cos(11 * y - 3 * x)
    found: np.ndarray = (ball * lumps).astype(np.float32)
    return found


def mitsuba_picture(
    field: DenseField,
    gamma_w: float,
    scattering: Scattering,
    view: View,
    samples: int,
    seed: int,
) -> np.ndarray:
    """The light that smoke scatters once, [H W 3]; without lights, the transmittance of white.

    Args:
        field: in stage space.
        view: orthographic.
        samples: a pixel.
    """
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    place = mi.ScalarTransform4f
    shape = field.values.shape
    corner = np.eye(4)
    corner[:3, :3] = np.diag(shape)
    corner[3, :3] = np.asarray(field.ijk_min) - 0.5
    to_world = place((corner @ field.index_to_world).T)
    grid = mi.VolumeGrid(np.ascontiguousarray(field.values.transpose(2, 1, 0))[..., None])
    g = scattering.anisotropy
    medium = {
        "type": "heterogeneous",
        "albedo": scattering.albedo,
        "scale": gamma_w,
        "sigma_t": {"type": "gridvolume", "grid": grid, "to_world": to_world},
        "phase": {"type": "hg", "g": g} if g else {"type": "isotropic"},
    }
    radius = float(np.linalg.norm((corner @ field.index_to_world)[:3, :3].sum(0)))
    integrator = {"type": "volpath", "max_depth": 2, "rr_depth": 99, "hide_emitters": True}
    scene: dict[str, Any] = {"type": "scene", "integrator": integrator}
    scene["smoke"] = {
        "type": "cube",
        "to_world": to_world @ place().translate([0.5] * 3).scale([0.5] * 3),
        "bsdf": {"type": "null"},
        "interior": medium,
    }
    scene["sensor"] = _sensor(view, radius, samples)
    if not scattering.lights:
        integrator["hide_emitters"] = False
    scene |= _emitters(scattering)
    return np.array(mi.render(mi.load_dict(scene), spp=samples, seed=seed))


def _sensor(view: View, distance: float, samples: int) -> dict[str, Any]:
    """An orthographic camera, so far from the picture's plane."""
    import mitsuba as mi

    place, half = mi.ScalarTransform4f, view.width * view.pixel_size / 2
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


def our_picture(
    field: DenseField, gamma_w: float, scattering: Scattering, view: View
) -> torch.Tensor:
    """The same by the model, [H W 3]."""
    smoke = activate(field, np.eye(4), torch.device("cpu"))
    image, alpha = colour_map(
        smoke.positions, smoke.density, smoke.edges, gamma_w, view, smoke.voxel_size
    )
    lighting = light_smoke(smoke, gamma_w, scattering)
    if lighting is None:
        return (1 - alpha)[..., None].expand(-1, -1, 3)
    return image.apply(lighting.on(smoke.positions).scattered(view.forward))


def field_of(density: np.ndarray) -> DenseField:
    """A density in the unit cube around the origin."""
    n = len(density)
    matrix = np.diag([1 / n, 1 / n, 1 / n, 1.0])
    matrix[3, :3] = 0.5 / n - 0.5
    return DenseField("density", density, (0, 0, 0), matrix)


def refined(density: np.ndarray, factor: int) -> np.ndarray:
    """The same trilinear field on finer voxels."""
    values = torch.from_numpy(density)[None, None]
    finer = F.interpolate(values, scale_factor=factor, mode="trilinear", align_corners=False)
    return finer[0, 0].numpy()


def agreement(n: int, seeds: int, samples: int) -> list[str]:
    """Rows of the first table."""
    density = lumpy_ball(n)
    towards = LIGHTS[0].towards
    cases = {
        "transmittance": Scattering((), 0.0),
        "sun, to all sides": Scattering((LightSource("/sun", (1, 1, 1), towards),), 0.9),
        "sun, g = 0.6": Scattering((LightSource("/sun", (1, 1, 1), towards),), 0.9, 0.6),
    }
    view = View(np.eye(3)[0], np.eye(3)[1], -np.eye(3)[2], np.zeros(3), n, n, 1 / n)
    rows = []
    for name, scattering in cases.items():
        for depth in DEPTHS:
            gamma_w = depth / float((density.sum(2) / n).max())
            theirs = [
                mitsuba_picture(field_of(density), gamma_w, scattering, view, samples, seed).mean()
                for seed in range(seeds)
            ]
            mean, spread = float(np.mean(theirs)), float(np.std(theirs, ddof=1)) / seeds**0.5
            finer = replace(view, height=2 * n, width=2 * n, pixel_size=0.5 / n)
            pairs = ((density, view), (refined(density, 2), finer))
            ours = [
                float(our_picture(field_of(fine), gamma_w, scattering, at).mean())
                for fine, at in pairs
            ]
            rows.append(
                f"| {name} | {depth:g} | {mean:.6f} ± {spread:.6f} | "
                + " | ".join(
                    f"{value / mean - 1:+.2%} ({(value - mean) / spread:+.1f})" for value in ours
                )
                + " |"
            )
            print(rows[-1], flush=True)
    return rows


def closure(
    vdb_file: str, styles: Sequence[str], iterations: int, samples: int
) -> tuple[list[str], float]:
    """Rows of the second table, and by how much the model's light differs from Mitsuba's."""
    config = Config().with_values({"optimize.iterations": iterations, "optics.albedo": 0.9})
    (density,) = read_grids(vdb_file, [GridRequest("density")], config.grids)
    smoke = activate(density, np.eye(4), torch.device("cpu"))
    frame = VolumeFrame(1.0, density, np.eye(4))
    scene = measure_scene([frame], config.views, config.optics, "Y", 1)
    scattering = Scattering(LIGHTS, 0.9)
    lighting = light_smoke(smoke, scene.gamma_w, scattering)
    views = frame_views(smoke, config.views.replace(pool=4, sampling="poisson"), scene, 12345, 1)
    lit = [
        torch.from_numpy(mitsuba_picture(density, scene.gamma_w, scattering, view, samples, 0))
        for view in views
    ]
    ours = [our_picture(density, scene.gamma_w, scattering, view) for view in views]
    pairs = list(zip(lit, ours, strict=True))
    apart = float(np.mean([float((b - a).mean() / a.mean()) for a, b in pairs]))
    rows = []
    for style in styles:
        pixels = read_style_image(style).pixels
        targets = make_targets([pixels], scene, config, torch.device("cpu"))
        problem = StepProblem(smoke, targets, scene, config)
        count = [iterations] * len(config.colour.iterations)
        found = []
        for light in (None, lighting):
            started = time.process_time()
            colours, _ = run_colour_step(replace(problem, lighting=light), count)
            seconds = time.process_time() - started
            found.append((_score(problem, colours, views, lit), seconds))
        (without, before), (with_light, after) = found
        rows.append(
            f"| {Path(style).stem} | {without:.3f} | {with_light:.3f} | {after / before:.2f} |"
        )
        print(rows[-1], flush=True)
    return rows, apart


def _score(
    problem: StepProblem, colours: torch.Tensor, views: Sequence[View], lit: Sequence[torch.Tensor]
) -> float:
    """Style loss of the pictures with Mitsuba's light in them, mean over the views."""
    smoke: ActiveSmoke = problem.smoke
    made = prepare_views(smoke, views, problem.scene.gamma_w, problem.scene.exposure)
    loss, behind = problem.targets.at(1), problem.targets.background
    with torch.no_grad():
        found = [
            float(
                loss(
                    replace(view, scattered=light.to(view.alpha)).unpremultiplied(
                        decode_srgb(colours), behind
                    ),
                    view.guide,
                )
            )
            for view, light in zip(made, lit, strict=True)
        ]
    return float(np.mean(found))


def main(arguments: Sequence[str] | None = None) -> None:
    """Both tables, printed and written."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("vdb", help="a frame of smoke, with a grid density")
    parser.add_argument("styles", nargs="+", help="style images")
    parser.add_argument("--voxels", type=int, default=48, help="of the ball, a side")
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--samples", type=int, default=32, help="a pixel and seed")
    parser.add_argument("--iterations", type=int, default=60, help="of the colour step, an octave")
    parser.add_argument("--report", type=Path)
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    rows = agreement(given.voxels, given.seeds, given.samples)
    closures, apart = closure(given.vdb, given.styles, given.iterations, 8 * given.samples)
    command = ["python", "-m", "benchmarks.lights", given.vdb, *given.styles]
    lines = [
        "# Lights",
        "",
        "Light that smoke scatters, against Mitsuba 3.9.1 (`volpath`, `max_depth` 2). Mean of the",
        f"picture of a lumpy ball of {given.voxels}³ voxels, albedo 0.9, {given.seeds} seeds of",
        f"{given.samples} samples a pixel. Differences of the model from Mitsuba, in brackets in",
        "standard errors of Mitsuba's mean.",
        "",
        "| what | optical depth | Mitsuba | the model | voxels of half the size |",
        "| --- | --- | --- | --- | --- |",
        *rows,
        "",
        "Style loss under a sun and a sky, albedo 0.9, colour step alone, mean over four views",
        "that are not optimised; the light is drawn by Mitsuba. Painted without and with the light",
        "in the model, and CPU time of the second relative to the first. The model's light differs",
        f"from Mitsuba's by {apart:+.0%} in the mean.",
        "",
        "| style | without | with | CPU time |",
        "| --- | --- | --- | --- |",
        *closures,
        "",
        *circumstances(command),
    ]
    if given.report:
        given.report.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
