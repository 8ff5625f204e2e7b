"""True errors stay below the tolerance that settings were chosen for, and a looser one costs less.

The scenes are sums of Gaussians: exact in every column, and at every departure point.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
import torch

from tests.smoke_fixtures import frame_of, random_style
from tests.stylize_fixtures import quick_config, run_core
from usdsmoke.config import Config, config_to_dict, resolve_config
from usdsmoke.core.calibrate import calibrate
from usdsmoke.core.picture_errors import Painted
from usdsmoke.core.progress import Progress
from usdsmoke.core.scene import frame_views, measure_scene
from usdsmoke.core.smoke import activate
from usdsmoke.core.stylize import stylize_window
from usdsmoke.core.transport import warp
from usdsmoke.error_choice import choose_settings
from usdsmoke.storage_error import storage_errors
from usdsmoke.volume import VolumeFrame

N = 32  # voxels a side
TOLERANCES = (0.5, 0.1)
# Centres and widths in voxels, and peaks.
SCENES = {
    "ball": [((15.5, 15.5, 15.5), 4.5, 1.0)],
    "pair": [((12.0, 18.0, 15.0), 3.5, 1.0), ((20.0, 12.0, 17.0), 4.0, 0.5)],
    "cluster": [
        ((11.0, 11.0, 14.0), 3.2, 1.0),
        ((20.0, 12.0, 18.0), 3.0, 0.7),
        ((15.0, 20.0, 12.0), 3.4, 0.8),
        ((17.0, 15.0, 20.0), 3.0, 0.4),
    ],
}


@dataclass(frozen=True)
class Chosen:
    """A scene with the settings that a tolerance comes to."""

    name: str
    target: float
    config: Config


def density_at(name: str, place: np.ndarray) -> np.ndarray:
    return np.sum(
        [
            peak * np.exp(-((place - np.asarray(centre)) ** 2).sum(-1) / (2 * width**2))
            for centre, width, peak in SCENES[name]
        ],
        axis=0,
    )


def voxels() -> np.ndarray:
    return np.stack(np.meshgrid(*[np.arange(N)] * 3, indexing="ij"), axis=-1).astype(float)


@lru_cache
def scene_frame(name: str) -> VolumeFrame:
    return frame_of(density_at(name, voxels()))


def start_config() -> Config:
    return quick_config(
        views={"image_size": 32, "pool": 4},
        shape={"iterations": [16, 16]},
        colour={"iterations": [24, 24], "learning_rate": 0.05},
    )


@lru_cache
def measured(name: str) -> dict[str, Any]:
    return calibrate(scene_frame(name), [random_style()], start_config(), "Y")


@lru_cache
def chosen(name: str, target: float) -> Chosen:
    base = start_config()
    planned = {"shape": base.shape.iterations, "colour": base.colour.iterations}
    choice = choose_settings(measured(name), target, planned, {})
    return Chosen(name, target, resolve_config(config_to_dict(base), choice.settings))


SETTLED = [(name, target) for name in SCENES for target in TOLERANCES]


def picture_error(found: Chosen) -> float:
    """Of the source's picture, against columns that are exact."""
    frame = scene_frame(found.name)
    scene = measure_scene([frame], found.config, "Y")
    smoke = activate(frame.density, np.eye(4), torch.device("cpu"))
    view = frame_views(smoke, found.config, scene, 0)[0]
    grey = Painted(smoke, None).picture(view, scene.gamma_w)[..., 0].double().numpy()
    across = (np.arange(view.width) - (view.width - 1) / 2) * view.pixel_size
    above = ((view.height - 1) / 2 - np.arange(view.height)) * view.pixel_size
    column = np.zeros_like(grey)
    for centre, width, peak in SCENES[found.name]:
        offset = np.asarray(centre) - view.centre
        x, y = offset @ view.right, offset @ view.up
        squares = (across[None] - x) ** 2 + (above[:, None] - y) ** 2
        column += peak * width * np.sqrt(2 * np.pi) * np.exp(-squares / (2 * width**2))
    exact = -np.expm1(-scene.gamma_w * column)
    return float(np.abs(grey - exact).sum() / exact.sum())


def transport_error(found: Chosen) -> float:
    """Of a swirl as long as the longest displacement, against the density at departure points."""
    place, reach = voxels(), found.config.shape.reach * N
    u = reach * np.stack([np.sin((np.roll(place, 1, -1)[..., k]) / 5.0) for k in range(3)], -1)
    values = torch.from_numpy(density_at(found.name, place))
    scheme: Any = found.config.shape.interpolation
    moved = warp(values, torch.from_numpy(u), scheme=scheme).numpy()
    exact = density_at(found.name, place - u)
    return float(np.abs(moved - exact).sum() / exact.sum())


@pytest.mark.parametrize(("name", "target"), SETTLED)
def test_discretisation_stays_below_the_tolerance(name: str, target: float) -> None:
    found = chosen(name, target)
    source = scene_frame(name)
    scene = measure_scene([source], found.config, "Y")
    (frame,) = stylize_window([source], [random_style()], scene, found.config)
    assert frame.emission is not None
    stored = storage_errors([frame.density, frame.emission], found.config.grids)
    errors = [
        picture_error(found),
        transport_error(found),
        max(entry["value"] for entry in stored.values()),
    ]
    assert sum(errors) < target, errors


@pytest.mark.parametrize(("name", "target"), SETTLED)
def test_the_optimiser_leaves_less_than_the_tolerance(name: str, target: float) -> None:
    """Against the same with four times the iterations."""
    found = chosen(name, target)
    frame, settings = scene_frame(name), config_to_dict(found.config)
    scene = measure_scene([frame], found.config, "Y")
    settings["optimize"]["steps"] = ["colour"]
    few = found.config.colour.iterations
    ends = []
    for iterations in (few, [4 * n for n in few]):
        settings["colour"]["iterations"] = iterations
        seen: list[Progress] = []
        run_core([frame], resolve_config({}, settings), scene, watch=seen)
        ends.append((seen[0].loss, seen[-1].loss))
    (first, last), (_, best) = ends
    assert last - best < target * (first - best), ends


def work(found: Chosen) -> float:
    """Pixels looked at: iterations and projected views, each times the octave's pixels."""
    scene = measure_scene([scene_frame(found.name)], found.config, "Y")
    pixels = (N / scene.pixel_size) ** 2
    steps = (found.config.shape.iterations, found.config.colour.iterations)
    counts = [
        (n + found.config.views.pool) * pixels / 4 ** (len(step) - 1 - octave)
        for step in steps
        for octave, n in enumerate(step)
    ]
    return float(sum(counts))


@pytest.mark.parametrize("name", SCENES)
def test_a_looser_tolerance_is_cheaper(name: str) -> None:
    loose, tight = (chosen(name, target) for target in TOLERANCES)
    assert work(loose) < 0.6 * work(tight)


def test_a_pilot_takes_a_few_pictures_and_no_full_resolution() -> None:
    found = measured("ball")
    assert set(found["steps"]) == {"shape", "colour"}
    sizes, errors = zip(*found["image_sizes"], strict=True)
    assert list(sizes) == sorted(sizes) and list(errors) == sorted(errors, reverse=True)
    shares, levels = zip(*found["prune"], strict=True)
    assert list(shares) == sorted(shares) and list(levels) == sorted(levels)


def test_an_empty_frame_tells_nothing() -> None:
    assert calibrate(frame_of(np.zeros((4, 4, 4))), [random_style()], start_config(), "Y") == {}
