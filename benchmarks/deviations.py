"""What each deviation from the paper's colour step buys, on the paper's loss and on ours.

    python -m benchmarks.deviations [--width 48] [--report FILE.md] [--pictures FILE.png]

A frame of the example plume is painted as published [Christen2020, eqs. 3, 7, 10]: squared
distances of guided Gram matrices, the premultiplied picture over its maximum, Adam with a constant
rate of 1 in 255, nine views an iteration, 300 iterations in three octaves. Then one choice after
the other becomes usdsmoke's. The network is the embedded one, with the two layers in place of
relu2_1 and relu3_1. Both losses are means over views that no row had; CPU seconds of one thread.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks.circumstances import publish, table_page
from benchmarks.control_scenes import frame_of, paint_styles, simulate_smoke
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.settings import Config
from usdsmoke.core.features.network import Network, build_network
from usdsmoke.core.smoke.active import ActiveSmoke, activate, octaves_to_do, sample_colours
from usdsmoke.core.smoke.srgb import decode_srgb, encode_srgb
from usdsmoke.core.steps.colour import initial_colours, run_colour_step
from usdsmoke.core.steps.pictures import ColourView, prepare_views
from usdsmoke.core.steps.targets import StepProblem, make_targets
from usdsmoke.core.style.losses import gram_matrix
from usdsmoke.core.style.style_image import scale_style
from usdsmoke.core.views.scene import Scene, frame_views, measure_scene

__all__ = ["main"]

STYLE = "strokes"
LAYERS = frozenset({"learned2", "learned3"})
PAPER = {"views.azimuth": 10, "views.elevation": 5}  # degrees to either side
GRAM = {"losses.statistic": "gram", "losses.nearest": 0, "features.layers": sorted(LAYERS)}
ITERATIONS = (100, 100, 100)
N_JUDGED, JUDGED_SEED = 12, 98765


@dataclass(frozen=True)
class Published:
    """The published method, or with some of its choices made otherwise."""

    n_views: int = 9  # an iteration
    pool: int = 64  # that they are drawn from
    rate: float = 1 / 255
    falls: bool = False  # the rate, over the second half of an octave
    premultiplied: bool = True


@dataclass(frozen=True)
class Row:
    """What a method ends with."""

    name: str
    seconds: float
    published: float  # eq. 3, relative to the style's own Gram matrices
    ours: float  # the default loss
    picture: np.ndarray  # [H W 3], the smoke's own colours over the style's mean


class Judge:
    """Both losses on views that nobody had, and the paper's loss for its optimiser."""

    def __init__(self, smoke: ActiveSmoke, scene: Scene, style: np.ndarray, config: Config) -> None:
        self._scene, self._pixels, self._config = scene, style, config
        self._targets = make_targets([style], scene, config, torch.device("cpu"))
        views = config.views.replace(pool=N_JUDGED)
        judged = frame_views(smoke, views, scene, JUDGED_SEED)
        self._views = list(prepare_views(smoke, judged, scene.gamma_w, scene.exposure))

    def published_loss(self, factor: int) -> Callable[[ColourView, Tensor, bool], Tensor]:
        """Eq. 3 of pictures 1/factor of full size: of a view and linear colours [N 3]."""
        size = self._scene.image_size / factor
        style = scale_style(self._pixels, size, self._config.style, torch.zeros(()))
        network: Network = build_network(self._config.features, 0)(style)
        with torch.no_grad():
            wanted = {name: gram_matrix(maps) for name, maps in network(style, LAYERS).items()}

        def loss(view: ColourView, linear: Tensor, premultiplied: bool) -> Tensor:
            picture = view.unpremultiplied(linear, self._targets.background)
            if premultiplied:
                picture = encode_srgb(view.shown(linear))
                picture = picture / picture.detach().max()
            maps = network(picture, LAYERS)
            terms = [
                (gram_matrix(maps[name], view.guide) - gram).square().sum() / gram.square().sum()
                for name, gram in wanted.items()
            ]
            return torch.stack(terms).sum()

        return loss

    def row(self, name: str, seconds: float, colours: Tensor) -> Row:
        """The row of display-encoded colours [N 3]."""
        linear, published, ours = decode_srgb(colours), self.published_loss(1), self._targets.at(1)
        behind = self._targets.background
        with torch.no_grad():
            theirs = [float(published(view, linear, True)) for view in self._views]
            pictures = [view.unpremultiplied(linear, behind) for view in self._views]
            own = [
                float(ours(picture, view.guide))
                for picture, view in zip(pictures, self._views, strict=True)
            ]
        return Row(name, seconds, *map(float, map(np.mean, (theirs, own))), pictures[0].numpy())


def rows(width: int) -> Iterator[Row]:
    """From the published method to the defaults."""
    frame = frame_of(simulate_smoke(width, 8, {"3-D": 48, "2-D": 1})["3-D"])
    style = paint_styles([STYLE], 256)[STYLE]
    config = resolve_config({**PAPER, "optimize.threads": 1})
    optics = config.optics.replace(thicken=1.0)  # the smoke as it is
    scene = measure_scene([frame], config.views, optics, "Y", 1)
    smoke = activate(frame.density, frame.density_to_stage, torch.device("cpu"))
    judge = Judge(smoke, scene, style, config)
    yield judge.row("white noise", 0.0, initial_colours(smoke, "noise", 0))
    method = Published()
    for name, changes in (
        ("as published", {}),
        ("one view an iteration, of 16", {"n_views": 1, "pool": 16}),
        ("rate of 0.05, which falls in the second half", {"rate": 0.05, "falls": True}),
        ("unpremultiplied picture", {"premultiplied": False}),
    ):
        method, begun = replace(method, **changes), time.process_time()
        colours = _paint(method, smoke, scene, config, judge)
        yield judge.row(name, time.process_time() - begun, colours)
    for name, settings in (
        ("relative distance of Gram matrices, with means", {**GRAM, **_of(ITERATIONS)}),
        ("distributions", {**GRAM, **_of(ITERATIONS), "losses.statistic": "sliced_wasserstein"}),
        ("patches, areas, all layers: the defaults from the front", {}),
        ("the defaults, from all round", {"views.azimuth": Config().views.azimuth}),
    ):
        chosen, begun = resolve_config(config, settings), time.process_time()
        targets = make_targets([style], scene, chosen, torch.device("cpu"))
        problem = StepProblem(smoke, targets, scene, chosen)
        colours, _ = run_colour_step(problem, chosen.colour.iterations)
        yield judge.row(name, time.process_time() - begun, colours)


def _of(iterations: Sequence[int]) -> dict[str, list[int]]:
    return {"colour.iterations": list(iterations)}


def _paint(
    method: Published, smoke: ActiveSmoke, scene: Scene, config: Config, judge: Judge
) -> Tensor:
    """Colours by Adam on eq. 3, coarse to fine."""
    colours, before = initial_colours(smoke, "noise", 0), smoke
    views = config.views.replace(pool=method.pool)
    for number, factor, octave, n in octaves_to_do(smoke, ITERATIONS, scene.pixel_size):
        if number == 0:
            colours, before = initial_colours(octave, "noise", 0), octave
        unknown = sample_colours(before, colours, octave.positions)[0].requires_grad_(True)
        seen = prepare_views(
            octave, frame_views(octave, views, scene, number, factor), scene.gamma_w, scene.exposure
        )
        loss, generator = judge.published_loss(factor), np.random.default_rng(number)
        adam = torch.optim.Adam([unknown], lr=method.rate)
        for iteration in range(n):
            if method.falls:
                adam.param_groups[0]["lr"] = method.rate * min(1.0, 1.9 - 1.8 * iteration / n)
            drawn = generator.choice(len(seen), method.n_views, replace=False)
            adam.zero_grad()
            linear = decode_srgb(unknown)
            total = sum(loss(seen[int(k)], linear, method.premultiplied) for k in drawn)
            (total / method.n_views).backward()
            adam.step()
            with torch.no_grad():
                unknown.clamp_(0, 1)
        colours, before = unknown.detach(), octave
    return sample_colours(before, colours, smoke.positions)[0]


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--width", type=int, default=48, help="voxels across the smoke's box")
    parser.add_argument("--report", type=Path, help="Markdown file for the table")
    parser.add_argument("--pictures", type=Path, help="PNG file: one view of each row")
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    found = []
    for row in rows(given.width):
        found.append(row)
        print(_line(row), file=sys.stderr, flush=True)
    intro = [
        "# What each deviation from the paper buys",
        "",
        "The colour step on one frame. Each row keeps the choices of those above it.",
        "`python -m benchmarks.deviations --help` says what the losses are.",
    ]
    columns = ["colour step", "CPU s", "the paper's loss (eq. 3)", "our loss"]
    command = ["python -m benchmarks.deviations"]
    command += arguments if arguments is not None else sys.argv[1:]
    publish(table_page(intro, columns, [*map(_line, found)], command), given.report)
    if given.pictures:
        _save(found, given.pictures)
    return 0


def _line(row: Row) -> str:
    return f"| {row.name} | {row.seconds:.1f} | {row.published:.3f} | {row.ours:.2f} |"


def _save(found: Sequence[Row], file_path: Path) -> None:
    """The rows' pictures side by side, three times as large."""
    from PIL import Image

    strip = np.concatenate([row.picture for row in found], axis=1)
    strip = np.repeat(np.repeat(strip, 3, axis=0), 3, axis=1)
    Image.fromarray(np.uint8(255 * strip.clip(0, 1) + 0.5)).save(file_path)


if __name__ == "__main__":
    sys.exit(main())
