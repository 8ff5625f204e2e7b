"""Pictures of constant smoke are constant, whatever the voxels' shape and the view's direction."""

import numpy as np
import pytest
import torch
from scipy import ndimage

from tests.fixtures.smoke_fixtures import frame_of
from usdsmoke.config.look_sections import ViewsConfig
from usdsmoke.config.settings import Config
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.views.cameras import View, orbit_view
from usdsmoke.core.views.footprint import ColumnSums
from usdsmoke.core.views.project import colour_map, column_map
from usdsmoke.core.views.scene import fit_view, frame_views, measure_scene

FINE = 8  # points across half of a hat


def box_of(counts: tuple[int, int, int], sides: tuple[float, float, float]) -> ActiveSmoke:
    """Constant smoke of density 1."""
    ijk = torch.tensor(list(np.ndindex(*counts)))
    return ActiveSmoke(ijk, torch.ones(len(ijk)), np.diag([*sides, 1.0]))


def chords(view: View, smoke: ActiveSmoke) -> np.ndarray:
    """Exact lengths of the view's rays in the box, averaged with the hat of a pixel, [H W]."""
    low, high = smoke.box
    sides = np.diag(smoke.edges)
    low, high = (low - 0.5) * sides, (high + 0.5) * sides
    offsets = (np.arange(2 * FINE) + 0.5) / FINE - 1
    x = np.arange(view.width) - (view.width - 1) / 2
    y = (view.height - 1) / 2 - np.arange(view.height)
    summed, weights = np.zeros((view.height, view.width)), 0.0
    for dx in offsets:
        for dy in offsets:
            weight = (1 - abs(dx)) * (1 - abs(dy))
            across, up = view.right * (x + dx)[None, :, None], view.up * (y + dy)[:, None, None]
            start = view.centre + view.pixel_size * (across + up)
            with np.errstate(divide="ignore", invalid="ignore"):
                one, other = (low - start) / view.forward, (high - start) / view.forward
            along = np.abs(view.forward) < 1e-12
            inside = (start >= low) & (start <= high)
            one = np.where(along, np.where(inside, -1e9, 1e9), one)
            other = np.where(along, 1e9, other)
            enter, leave = np.minimum(one, other).max(-1), np.maximum(one, other).min(-1)
            summed += weight * np.clip(leave - enter, 0, None)
            weights += weight
    return summed / weights


def view_of(smoke: ActiveSmoke, azimuth: float, elevation: float) -> View:
    """With the pixels that a run takes."""
    values = np.ones(tuple(smoke.box[1] + 1), np.float32)
    scene = measure_scene(
        [frame_of(values, index_to_world=smoke.index_to_stage)],
        Config().views,
        Config().optics,
        "Y",
    )
    size = scene.pixel_size
    return fit_view(orbit_view(azimuth, elevation, "Y", np.zeros(3), 1, 1, size), smoke)


@pytest.mark.parametrize("direction", [(0, 0), (12, 6), (30, 0), (45, 0), (45, 30), (135, 0)])
@pytest.mark.parametrize(
    ("counts", "sides"),
    [
        ((32, 32, 32), (1.0, 1.0, 1.0)),
        ((32, 16, 32), (1.0, 2.0, 1.0)),
        ((32, 8, 32), (1.0, 4.0, 1.0)),
        ((32, 6, 32), (1.0, 8.0, 1.0)),
        ((20, 20, 20), (1.0, 1.0, 10.0)),
    ],
)
def test_constant_smoke_has_no_holes_and_hardly_ripples(
    counts: tuple[int, int, int],
    sides: tuple[float, float, float],
    direction: tuple[float, float],
) -> None:
    smoke = box_of(counts, sides)
    view = view_of(smoke, *direction)
    image = column_map(smoke.positions, smoke.edges, view, torch.float64)
    found = image.apply(torch.ones(len(smoke.ijk), 1, dtype=torch.float64))[..., 0].numpy()
    exact = chords(view, smoke)
    inside = ndimage.binary_erosion(exact > 0.5 * exact.max(), iterations=2)
    assert inside.sum() > 100
    error = found[inside] / exact[inside] - 1
    assert np.sqrt((error**2).mean()) < 0.005
    assert np.abs(error).max() < 0.02


@pytest.mark.parametrize("direction", [(0, 0), (90, 0), (30, 10), (45, 0)])
def test_columns_are_those_of_the_optimiser(direction: tuple[float, float]) -> None:
    """For any density, also where voxels behind one another are counted at once."""
    smoke = box_of((10, 6, 8), (1.0, 2.0, 1.0))
    view = view_of(smoke, *direction)
    sums = ColumnSums(smoke.voxels, view)
    image = column_map(smoke.positions, smoke.edges, view, torch.float64)
    for seed in (0, 1):
        density = np.random.default_rng(seed).uniform(0, 1, len(smoke.ijk))
        wanted = image.apply(torch.as_tensor(density)[:, None])[..., 0].numpy()
        np.testing.assert_allclose(sums(density).reshape(wanted.shape), wanted, atol=1e-12)


def test_a_long_voxel_keeps_its_mass_and_its_colour() -> None:
    smoke = box_of((12, 3, 12), (1.0, 8.0, 1.0))
    view = view_of(smoke, 30.0, 20.0)
    columns = column_map(smoke.positions, smoke.edges, view, torch.float64)
    mass = float(columns.apply(torch.ones(len(smoke.ijk), 1, dtype=torch.float64)).sum())
    assert mass * view.pixel_size**2 == pytest.approx(smoke.voxel_volume * len(smoke.ijk))
    image, alpha = colour_map(smoke.positions, smoke.density, smoke.edges, 0.1, view, 1.0)
    white = image.apply(torch.ones(len(smoke.ijk), 1))[..., 0]
    assert torch.allclose(white, alpha, atol=1e-5)


def test_pixels_are_the_shortest_edge_of_voxels_of_any_shape() -> None:
    for sides, wanted in (((1, 4, 1), 1.0), ((2, 2, 20), 2.0), ((3, 3, 3), 3.0)):
        smoke = box_of((16, 16, 16), tuple(map(float, sides)))
        assert view_of(smoke, 0, 0).pixel_size == pytest.approx(wanted)


def test_views_near_an_axis_splat_every_cube_once() -> None:
    smoke = box_of((8, 8, 8), (1.0, 1.0, 1.0))
    frame = frame_of(np.ones((8, 8, 8), np.float32))
    near = ViewsConfig(azimuth=12.0, elevation=6.0)
    scene = measure_scene([frame], near, Config().optics, "Y")
    for view in frame_views(smoke, near, scene, 0):
        assert column_map(smoke.positions, smoke.edges, view).pixel.shape == (512, 4)
