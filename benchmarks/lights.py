"""Light that smoke scatters against Mitsuba 3, and style under a sun with and without it.

Three tables. ``agreement``: mean pictures of a lumpy ball, transmittance, emission and single
scattering, at several optical depths. ``closure``: style loss of one frame under a sun and a sky,
as Mitsuba draws it, on views that are not optimised; painted without and with the light in the
model, as an albedo, and as both. ``cost``: CPU time of a frame without and with lights. Mitsuba is
an optional dependency: ``pip install mitsuba``.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F

from benchmarks.circumstances import circumstances, publish
from usdsmoke.base.naming import EMISSION, SCATTERING
from usdsmoke.base.volume import DenseField, LightSource, Scattering, VolumeFrame
from usdsmoke.config.settings import Config
from usdsmoke.core.sequence.stylize import stylize_window
from usdsmoke.core.smoke.active import ActiveSmoke, activate
from usdsmoke.core.smoke.srgb import encode_srgb
from usdsmoke.core.steps.light_share import white_exposure
from usdsmoke.core.steps.pictures import prepare_views
from usdsmoke.core.steps.targets import StepProblem, make_targets
from usdsmoke.core.views.cameras import View
from usdsmoke.core.views.lighting import light_smoke
from usdsmoke.core.views.project import colour_map
from usdsmoke.core.views.scene import frame_views, measure_scene
from usdsmoke.pictures import compose_sheet, read_style_image, write_png
from usdsmoke.vdb.read import GridRequest, read_grids
from usdsmoke.work_precision.path_tracer import MOST_BOUNCES, TracedSmoke

DEPTHS = (0.1, 1.0, 4.0, 10.0, 30.0, 50.0)
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


def our_picture(
    field: DenseField, gamma_w: float, scattering: Scattering, view: View
) -> torch.Tensor:
    """The same as ``TracedSmoke.lit`` by the model, [H W 3]."""
    smoke = activate(field, np.eye(4), torch.device("cpu"))
    image, alpha = colour_map(
        smoke.positions, smoke.density, smoke.edges, gamma_w, view, smoke.voxel_size
    )
    lighting = light_smoke(smoke, gamma_w, scattering)
    if lighting is None:
        return (1 - alpha)[..., None].expand(-1, -1, 3)
    return image.apply(lighting.on(smoke.positions).scattered(view.forward))


def our_emission(
    field: DenseField, colours: DenseField, gamma_w: float, view: View
) -> torch.Tensor:
    """The same as ``TracedSmoke.glow`` by the model, [H W 3]."""
    smoke = activate(field, np.eye(4), torch.device("cpu"))
    image, _ = colour_map(
        smoke.positions, smoke.density, smoke.edges, gamma_w, view, smoke.voxel_size
    )
    return image.apply(torch.from_numpy(colours.values[tuple(smoke.ijk.numpy().T)]))


def stripes(n: int) -> np.ndarray:
    """Colours that change along each axis, [n n n 3] float32."""
    x = (np.arange(n) + 0.5) / n
    axes = np.meshgrid(x, x, x, indexing="ij")
    found: np.ndarray = np.stack([0.5 + 0.4 * np.sin(6 * a) for a in axes], -1).astype(np.float32)
    return found


def field_of(density: np.ndarray) -> DenseField:
    """A density in the unit cube around the origin."""
    n = len(density)
    matrix = np.diag([1 / n, 1 / n, 1 / n, 1.0])
    matrix[3, :3] = 0.5 / n - 0.5
    return DenseField("density", density, (0, 0, 0), matrix)


def refined(values: np.ndarray, factor: int) -> np.ndarray:
    """The same trilinear field, [n n n] or [n n n C], on finer voxels."""
    channels = torch.from_numpy(values.reshape(*values.shape[:3], -1)).movedim(-1, 0)[None]
    finer = F.interpolate(channels, scale_factor=factor, mode="trilinear", align_corners=False)
    side = factor * len(values)
    return finer[0].movedim(0, -1).reshape(side, side, side, *values.shape[3:]).numpy()


@dataclass(frozen=True)
class _Case:
    """The ball at one optical depth; the last channel is compared, whose colour changes along the
    view."""

    depth: float
    scattering: Scattering | None  # None: emission
    n: int
    samples: int

    @property
    def view(self) -> View:
        n = self.n
        return View(np.eye(3)[0], np.eye(3)[1], -np.eye(3)[2], np.zeros(3), n, n, 1 / n)

    @property
    def gamma_w(self) -> float:
        return self.depth / float((lumpy_ball(self.n).sum(2) / self.n).max())

    def theirs(self, seed: int) -> float:
        scattering = self.scattering or Scattering((), 0.0)
        smoke = TracedSmoke(self.smoke(), self.gamma_w, scattering)
        if self.scattering is None:
            picture = smoke.glow(self.colours(), self.view, self.samples, seed)
        else:
            picture = smoke.lit(self.view, self.samples, seed)
        return float(picture[..., 2].mean())

    def ours(self, factor: int) -> float:
        side = factor * self.n
        view = replace(self.view, height=side, width=side, pixel_size=1 / side)
        smoke, extinction = self.smoke(factor), self.gamma_w
        if self.scattering is None:
            picture = our_emission(smoke, self.colours(factor), extinction, view)
        else:
            picture = our_picture(smoke, extinction, self.scattering, view)
        return float(picture[..., 2].mean())

    def smoke(self, factor: int = 1) -> DenseField:
        return field_of(refined(lumpy_ball(self.n), factor))

    def colours(self, factor: int = 1) -> DenseField:
        return field_of(refined(stripes(self.n), factor))


def agreement(n: int, seeds: int, samples: int) -> list[str]:
    """Rows of the first table."""
    sun = (LightSource("/sun", (1, 1, 1), LIGHTS[0].towards),)
    kinds = {
        "transmittance": Scattering((), 0.0),
        "emission": None,
        "sun, to all sides": Scattering(sun, 0.9),
        "sun, g = 0.6": Scattering(sun, 0.9, 0.6),
        "sky": Scattering((LightSource("/sky", (1, 1, 1)),), 0.9),
    }
    rows = []
    for name, scattering in kinds.items():
        for depth in DEPTHS:
            case = _Case(depth, scattering, n, samples)
            theirs = [case.theirs(seed) for seed in range(seeds)]
            rows.append(_row(f"{name} | {depth:g}", theirs, [case.ours(1), case.ours(2)]))
            print(rows[-1], flush=True)
    return rows


def _row(what: str, theirs: Sequence[float], ours: Sequence[float]) -> str:
    mean, spread = float(np.mean(theirs)), float(np.std(theirs, ddof=1)) / len(theirs) ** 0.5
    found = [f"{value / mean - 1:+.2%} ({(value - mean) / spread:+.1f})" for value in ours]
    return f"| {what} | {mean:.6f} ± {spread:.6f} | {' | '.join(found)} |"


@dataclass(frozen=True)
class _Painting:
    """What is painted, and what the smoke scatters beside it."""

    name: str
    settings: dict[str, Any]
    knows_light: bool = True


_Row = list[tuple[str, np.ndarray]]  # titles and pictures
PAINTINGS = (
    _Painting("glow alone", {"optics.albedo": 0.0}),
    _Painting("without the light", {"optics.albedo": 0.5}, knows_light=False),
    _Painting("with it", {"optics.albedo": 0.5}),
    _Painting("albedo", {"colour.target": "albedo"}),
    _Painting("both", {"colour.target": "both"}),
)


def closure(
    vdb_file: str, styles: Sequence[str], iterations: int, samples: int, picture: Path | None
) -> list[str]:
    """Rows of the second table, and a picture of all styles."""
    plain = Config().with_values({"optimize.iterations": iterations})
    (density,) = read_grids(vdb_file, [GridRequest("density")], plain.grids)
    frame = VolumeFrame(1.0, density, np.eye(4), lights=LIGHTS)
    rows, drawn, images = [], list[_Row](), []
    for style in styles:
        pixels = read_style_image(style).pixels
        images.append(pixels)
        once, often = _Row(), _Row()
        for painting in PAINTINGS:
            config = plain.with_values(painting.settings)
            scored = _score(_paint(frame, config, pixels, painting), samples)
            rows.append(f"| {Path(style).stem} | {painting.name} | {scored.text} |")
            once.append((f"{painting.name}, once", scored.once))
            often.append((f"{painting.name}, all bounces", scored.often))
            print(rows[-1], flush=True)
        drawn += [once, often]
    if picture is not None:
        write_png(picture, compose_sheet("", drawn, images))
    return rows


def cost(vdb_file: str, style: str, iterations: int, runs: int) -> list[str]:
    """Rows of the third table: CPU time of a frame's colour step with its estimates, alternated."""
    config = Config().with_values(
        {
            "optimize.iterations": iterations,
            "optimize.tolerance": 0.0,
            "optimize.steps": ["colour"],
        }
    )
    (density,) = read_grids(vdb_file, [GridRequest("density")], config.grids)
    frame = VolumeFrame(1.0, density, np.eye(4))
    optics = config.optics.replace(thicken=1.0)  # the smoke as it is
    scene = measure_scene([frame], config.views, optics, "Y", 1)
    pixels = read_style_image(style).pixels
    lit = {"no light": (), "a sun": LIGHTS[:1], "a sky": LIGHTS[1:], "a sun and a sky": LIGHTS}
    seconds: dict[str, list[float]] = {name: [] for name in lit}
    for _ in range(runs):
        for name, lights in lit.items():
            started = time.process_time()
            list(stylize_window([replace(frame, lights=lights)], [pixels], scene, config))
            seconds[name].append(time.process_time() - started)
    least = {name: min(found) for name, found in seconds.items()}
    return [f"| {name} | {t:.2f} | {t / least['no light']:.2f} |" for name, t in least.items()]


@dataclass(frozen=True)
class _Painted:
    """A frame of smoke with what is written of it, as ``stylize`` would."""

    frame: VolumeFrame
    smoke: ActiveSmoke
    problem: StepProblem
    emission: DenseField  # over the extinction, [i j k 3]
    albedo: DenseField | None  # of each voxel
    scattering: Scattering


def _paint(frame: VolumeFrame, config: Config, pixels: np.ndarray, painting: _Painting) -> _Painted:
    """One colour step, at full resolution and strength."""
    optics = config.optics.replace(thicken=1.0)  # the smoke as it is
    scene = measure_scene([frame], config.views, optics, "Y", 1)
    if config.colour.target == "albedo":
        scene = replace(scene, stops=white_exposure([frame], config, scene))
    lights = frame.lights if painting.knows_light else ()
    config = config.with_values({"optimize.steps": ["colour"], "optimize.error_budget": False})
    (result,) = stylize_window([replace(frame, lights=lights)], [pixels], scene, config)
    smoke = activate(result.density, np.eye(4), torch.device("cpu"))
    targets = make_targets([pixels], scene, config, torch.device("cpu"))
    sigma = (scene.gamma_w * result.density.values).clip(1e-30)[..., None]
    over = {field.name: replace(field, values=field.values / sigma) for field in result.painted}
    black = replace(result.painted[0], values=np.zeros_like(result.painted[0].values))
    return _Painted(
        frame, smoke, StepProblem(smoke, targets, scene, config), over.get(EMISSION, black),
        over.get(SCATTERING), Scattering(frame.lights, config.albedo),
    )  # fmt: skip


@dataclass(frozen=True)
class _Scored:
    text: str  # cells of the table
    once: np.ndarray  # the first view, display-encoded, [H W 3]
    often: np.ndarray


def _score(painted: _Painted, samples: int) -> _Scored:
    """Style loss of Mitsuba's pictures of views that are not optimised, scattered once and with
    all bounces."""
    scene, targets, views = painted.problem.scene, painted.problem.targets, _views(painted)
    traced = TracedSmoke(painted.frame.density, scene.gamma_w, painted.scattering, painted.albedo)
    made = prepare_views(painted.smoke, views, scene.gamma_w, scene.exposure)
    loss, found, pictures = targets.at(1), {}, []
    for bounces in (1, MOST_BOUNCES):
        losses = []
        for view, look in zip(views, made, strict=True):
            light = traced.lit(view, samples, 0, bounces)
            again = 0 if bounces == 1 else bounces
            light = light + traced.glow(painted.emission, view, samples, 0, again)
            light = light * 2.0**scene.stops
            picture = look.over(torch.from_numpy(light).to(look.alpha), targets.background)
            losses.append(float(loss(picture, look.guide)))
            if view is views[0]:
                shown = encode_srgb(torch.from_numpy(light).clamp(0, 1)).numpy()
                pictures.append(shown.repeat(3, 0).repeat(3, 1))
        found[bounces] = float(np.mean(losses))
    text = f"{found[1]:.2f} | {found[MOST_BOUNCES]:.2f}"
    return _Scored(text, *pictures)


def _views(painted: _Painted) -> list[View]:
    views = painted.problem.config.views.replace(pool=4, sampling="poisson")
    return frame_views(painted.smoke, views, painted.problem.scene, 12345, 1)


def main(arguments: Sequence[str] | None = None) -> None:
    """All tables, printed and written."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("vdb", help="a frame of smoke, with a grid density")
    parser.add_argument("styles", nargs="+", help="style images")
    parser.add_argument("--voxels", type=int, default=32, help="of the ball, a side")
    parser.add_argument("--seeds", type=int, default=16)
    parser.add_argument("--samples", type=int, default=16, help="a pixel and seed")
    parser.add_argument("--iterations", type=int, default=180, help="of the colour step")
    parser.add_argument("--report", type=Path)
    parser.add_argument("--picture", type=Path, help="of all styles")
    parser.add_argument("--cost-alone", action="store_true", help="print the third table")
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    if given.cost_alone:
        print("\n".join(cost(given.vdb, given.styles[0], 60, 9)))
        return
    rows = agreement(given.voxels, given.seeds, given.samples)
    closures = closure(given.vdb, given.styles, given.iterations, 2 * given.samples, given.picture)
    costs = cost(given.vdb, given.styles[0], 60, 3)
    command = ["python", "-m", "benchmarks.lights", given.vdb, *given.styles]
    lines = [
        "# Lights",
        "",
        "Against Mitsuba 3.9.1: transmittance and scattered light by its `volpath`, `max_depth` 2;",
        "emission by an integrator of ours that asks its medium where a ray ends. Mean of the",
        f"picture of a lumpy ball of {given.voxels}³ voxels, albedo 0.9, {given.seeds} seeds of",
        f"{given.samples} samples a pixel. Differences of the model from Mitsuba, in brackets in",
        "standard errors of Mitsuba's mean.",
        "",
        "| what | optical depth | Mitsuba | the model | voxels of half the size |",
        "| --- | --- | --- | --- | --- |",
        *rows,
        "",
        f"Style loss under a sun and a sky, colour step alone ({given.iterations} iterations),",
        f"of pictures that Mitsuba draws with {2 * given.samples} samples a pixel,",
        "mean over four views that are not optimised: light scattered once and glow not at all,",
        "then both with all bounces. *Glow alone*: smoke that scatters nothing",
        "(`optics.albedo=0`). Then smoke of albedo 0.5, painted without and with the light in the",
        "model, and with `colour.target` albedo and both.",
        "",
        "| style | painted | once | all bounces |",
        "| --- | --- | --- | --- |",
        *closures,
        "",
        "CPU seconds of a frame, colour step of 60 iterations with its estimates, least of three",
        "runs in turn, and over those without a light. A step had 360 iterations by default.",
        "",
        "| lights | CPU seconds | relative |",
        "| --- | --- | --- |",
        *costs,
        "",
        *circumstances(command),
    ]
    publish("\n".join(lines) + "\n", given.report)


if __name__ == "__main__":
    main()
