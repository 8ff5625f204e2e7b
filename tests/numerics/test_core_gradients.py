"""The gradients of whole chains on an 8 x 8 x 8 volume, against differences of their values."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.fixtures.smoke_fixtures import affine, held_in_voxels, puff, random_style, smoke_of
from usdsmoke.config.look_sections import LossesConfig
from usdsmoke.core.features.network import EmbeddedFeatures
from usdsmoke.core.fields.lattice import Lattice, surround
from usdsmoke.core.fields.potential import border_mask
from usdsmoke.core.fields.pyramid import expand_levels, pyramid_shapes
from usdsmoke.core.fields.transport import warp
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.smoke.memory import accumulate
from usdsmoke.core.smoke.srgb import decode_srgb
from usdsmoke.core.steps.pictures import ColourView
from usdsmoke.core.style.losses import PictureLoss, StyleTarget, total_variation
from usdsmoke.core.views.cameras import View, orbit_view
from usdsmoke.core.views.optics import opacity
from usdsmoke.core.views.project import colour_map, column_map
from usdsmoke.core.views.scene import fit_view

DOUBLE = torch.float64
STEP = 1e-6


def random(*shape: int, seed: int) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=DOUBLE)


@pytest.fixture(scope="module")
def smoke() -> ActiveSmoke:
    made = smoke_of(puff(8, cut=0.02), affine(1))
    return ActiveSmoke(made.ijk, made.density.double(), made.index_to_stage)


@pytest.fixture(scope="module")
def target() -> StyleTarget:
    style = torch.from_numpy(random_style(24, 24)).double()
    return StyleTarget(style, EmbeddedFeatures(style), dict.fromkeys(EmbeddedFeatures.names, 1.0))


def view_of(smoke: ActiveSmoke) -> View:
    return fit_view(orbit_view(25.0, 15.0, "Y", np.zeros(3), 1, 1, 1.0), smoke)


def assert_slopes_agree(
    function: Callable[[Tensor], Tensor], start: Tensor, error: float = 1e-6, n: int = 6
) -> None:
    """Along n random directions; the differences are central."""
    unknown = start.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(function(unknown), unknown)
    scale = gradient.norm().item()
    assert scale > 0
    for seed in range(n):
        direction = random(*start.shape, seed=100 + seed) - 0.5
        direction = direction / direction.norm()
        ahead, behind = (function(start + s * STEP * direction).item() for s in (1, -1))
        wanted = (ahead - behind) / (2 * STEP)
        assert (gradient * direction).sum().item() == pytest.approx(wanted, abs=error * scale)


def colour_chain(
    smoke: ActiveSmoke, compare: Callable[[Tensor, ColourView], Tensor]
) -> Callable[[Tensor], Tensor]:
    """Display-encoded voxel colours -> light -> picture -> loss."""
    image, alpha = colour_map(
        smoke.positions, smoke.density, smoke.edges, 0.6, view_of(smoke), smoke.voxel_size
    )
    view = ColourView(image, alpha)
    background = torch.tensor([0.5, 0.4, 0.3], dtype=DOUBLE)
    return lambda colours: compare(view.unpremultiplied(decode_srgb(colours), background), view)


def test_colours_to_a_quadratic_loss(smoke):
    goal = random(1, 1, 3, seed=1)
    chain = colour_chain(smoke, lambda picture, _: ((picture - goal) ** 2).sum())
    assert_slopes_agree(chain, 0.1 + 0.8 * random(len(smoke.ijk), 3, seed=2))


def test_colours_to_the_style_loss_with_its_guide_and_total_variation(smoke, target):
    chain = colour_chain(
        smoke,
        lambda picture, view: target.loss(picture, view.guide) + 0.3 * total_variation(picture),
    )
    assert_slopes_agree(chain, 0.1 + 0.8 * random(len(smoke.ijk), 3, seed=3), error=1e-5)


NEW_LOSSES = {
    "histogram": {"histogram": 1.0},
    "sliced Wasserstein": {"statistic": "sliced_wasserstein"},
    "content": {"content": 1.0},
    "Laplacian": {"laplacian": 30.0},
    "photorealism": {"photorealism": 100.0},
    "all at once": {
        "statistic": "sliced_wasserstein",
        "histogram": 0.5,
        "content": 0.5,
        "laplacian": 10.0,
        "photorealism": 30.0,
        "total_variation": 0.2,
    },
}


@pytest.mark.parametrize("weights", NEW_LOSSES.values(), ids=NEW_LOSSES)
def test_colours_to_everything_a_picture_is_judged_by(smoke, weights):
    """With the smoke's own opacity as the content; where a loss is a part of the whole, the style's
    is left out, so that its own slope is compared."""
    losses = LossesConfig(**weights)
    style = torch.from_numpy(random_style(24, 24)).double()
    alone = {"content", "laplacian", "photorealism"} >= set(weights)
    layers = {} if alone else dict.fromkeys(("oriented1", "learned1"), 1.0)
    target = StyleTarget(style, EmbeddedFeatures(style), layers, losses, ["oriented2"])
    judge = PictureLoss([target], [1.0], losses)

    def compare(picture: Tensor, view: ColourView) -> Tensor:
        content = judge.content(view.alpha[..., None].expand(-1, -1, 3))
        return judge(picture, view.guide, content, 3)

    chain = colour_chain(smoke, compare)
    assert_slopes_agree(chain, 0.1 + 0.8 * random(len(smoke.ijk), 3, seed=7), error=1e-5)


def test_colours_to_the_sum_of_several_views_taken_one_by_one(smoke):
    """As ``optimize_colours`` does it: each picture gives its slope before the next one is made."""
    goal = random(1, 1, 3, seed=1)
    position, density = smoke.positions, smoke.density
    maps = [
        colour_map(position, density, smoke.edges, 0.6, view, smoke.voxel_size)
        for view in (view_of(smoke), fit_view(orbit_view(80, 5, "Y", np.zeros(3), 1, 1, 1), smoke))
    ]
    background = torch.tensor([0.5, 0.4, 0.3], dtype=DOUBLE)

    def term(view: ColourView, linear: Tensor) -> Tensor:
        return ((view.unpremultiplied(linear, background) - goal) ** 2).sum()

    terms = [partial(term, ColourView(image, alpha)) for image, alpha in maps]
    start = 0.1 + 0.8 * random(len(smoke.ijk), 3, seed=2)
    assert_slopes_agree(lambda colours: accumulate(decode_srgb(colours), terms), start)


def shape_chain(
    smoke: ActiveSmoke, kind: str, compare: Callable[[Tensor], Tensor]
) -> tuple[Callable[[Tensor], Tensor], Lattice]:
    """Potential -> displacement -> moved density -> columns -> opacity -> loss."""
    lattice = surround(smoke, 2)
    box = lattice.fill(smoke)
    mask = border_mask(box, 2.0)
    active = torch.nonzero(box > -1)
    image = column_map(lattice.positions(active), smoke.edges, view_of(smoke), DOUBLE)

    def chain(potential: Tensor) -> Tensor:
        moved = held_in_voxels(potential, mask, kind, 2.0, lattice)
        density = warp(box, moved[tuple(active.T)], active_ijk=active, scheme="linear")
        return compare(opacity(0.3 * image.apply(density[:, None])))

    return chain, lattice


@pytest.mark.parametrize(("kind", "n_channels"), [("stream", 3), ("potential", 1), ("mixed", 4)])
def test_potential_to_a_quadratic_loss(smoke, kind, n_channels):
    chain, lattice = shape_chain(smoke, kind, lambda grey: ((grey - 0.3) ** 2).sum())
    assert_slopes_agree(chain, 2 * random(*lattice.shape, n_channels, seed=4), error=1e-5)


def test_pyramid_of_a_stream_function_to_the_style_loss(smoke, target):
    chain, lattice = shape_chain(
        smoke, "stream", lambda grey: target.loss(grey.expand(-1, -1, 3), None)
    )
    zeros = [smoke.density.new_zeros(*shape, 3) for shape in pyramid_shapes(lattice.shape, 3)]
    finest = 2 * random(*zeros[-1].shape, seed=5)

    def from_coarse(level: Tensor) -> Tensor:
        return chain(expand_levels([level, *zeros[1:-1], finest]))

    assert_slopes_agree(from_coarse, random(*zeros[0].shape, seed=6), error=1e-4)


def test_single_precision_slopes_agree_with_double_ones(smoke):
    """What the optimiser really uses: the same chain in float32."""
    image, alpha = colour_map(
        smoke.positions, smoke.density, smoke.edges, 0.6, view_of(smoke), smoke.voxel_size
    )
    single, single_alpha = colour_map(
        smoke.positions,
        smoke.density.float(),
        smoke.edges,
        0.6,
        view_of(smoke),
        smoke.voxel_size,
    )
    colours = 0.1 + 0.8 * random(len(smoke.ijk), 3, seed=2)
    gradients = []
    for view, start in (
        (ColourView(image, alpha), colours),
        (ColourView(single, single_alpha), colours.float()),
    ):
        unknown = start.clone().requires_grad_()
        picture = view.unpremultiplied(decode_srgb(unknown), start.new_tensor([0.5, 0.4, 0.3]))
        (gradient,) = torch.autograd.grad((picture**2).sum(), unknown)
        gradients.append(gradient.double())
    assert (gradients[0] - gradients[1]).norm() < 1e-5 * gradients[0].norm()
