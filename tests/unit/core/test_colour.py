"""The colour step on fixed smoke."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import frame_of, puff, random_style, smoke_of
from tests.fixtures.stylize_fixtures import run_core, scene_of
from usdsmoke.config.resolve import resolve_config
from usdsmoke.config.settings import Config
from usdsmoke.core.smoke.active import ActiveSmoke, make_octaves, sample_colours
from usdsmoke.core.smoke.srgb import BRIGHTEST, decode_srgb, encode_srgb
from usdsmoke.core.steps.colour import initial_colours, optimize_colours, run_colour_step
from usdsmoke.core.steps.optimize import Descent, Minimum
from usdsmoke.core.steps.pictures import ColourView, ViewPool, prepare_views
from usdsmoke.core.steps.targets import StepProblem, StyleTargets, make_targets
from usdsmoke.core.style.losses import PictureLoss
from usdsmoke.core.style.style_image import scale_style
from usdsmoke.core.views.scene import Scene, frame_views
from usdsmoke.runs.budget.findings import find_frame

SCENE = Scene(0.6, 0.3, 1.0, "Y", 1.0, 12)
BACKGROUND = torch.tensor([0.4, 0.3, 0.2])


def config_of(**sections: dict) -> Config:
    base = {
        "views": {"pool": 3},
        "features": {"layers": ["oriented1", "oriented2"]},
        "optimize": {"threads": 1, "tolerance": 0.0},
    }
    return resolve_config(base, sections)


def targets_of(config: Config, styles: int = 1) -> StyleTargets:
    images = [random_style(16, 20, seed) for seed in range(styles)]
    return make_targets(images, SCENE, config, torch.device("cpu"))


def problem_of(smoke: ActiveSmoke, config: Config) -> StepProblem:
    return StepProblem(smoke, targets_of(config), SCENE, config)


def picture_of(view: ColourView, colours: torch.Tensor, targets: StyleTargets) -> torch.Tensor:
    """Display-encoded pixels [P 3] where there is more than a little smoke."""
    picture = view.unpremultiplied(decode_srgb(colours), targets.background)
    return picture[view.alpha > 0.3]


@pytest.fixture(scope="module")
def smoke() -> ActiveSmoke:
    return smoke_of(puff(12))


@pytest.fixture(scope="module")
def views(smoke: ActiveSmoke) -> list[ColourView]:
    return prepare_views(smoke, frame_views(smoke, config_of().views, SCENE, 0), SCENE.gamma_w)


def test_noise_belongs_to_the_voxel_and_the_seed(smoke):
    order = torch.randperm(len(smoke.ijk), generator=torch.Generator().manual_seed(0))
    shuffled = ActiveSmoke(smoke.ijk[order], smoke.density[order], smoke.index_to_stage)
    colours = initial_colours(smoke, "noise", 3)
    assert torch.equal(initial_colours(shuffled, "noise", 3), colours[order])
    assert not torch.equal(initial_colours(smoke, "noise", 4), colours)
    assert 0 <= colours.min() and colours.max() < 1 and colours.std() > 0.2
    assert initial_colours(smoke, "density", 3).eq(1).all()


def test_the_straight_picture_has_the_smoke_s_own_colour_however_thin_it_is(smoke, views):
    colour = torch.tensor([0.7, 0.2, 0.1]).expand(len(smoke.ijk), 3)
    view = views[0]
    straight = view.unpremultiplied(colour, BACKGROUND)
    seen = (view.alpha / (view.alpha + 0.01))[..., None]  # half background at 1 % of opacity
    mixed = encode_srgb(seen * colour[0] + (1 - seen) * BACKGROUND)
    assert torch.allclose(straight, mixed, atol=1e-5)
    empty = view.alpha == 0
    assert empty.any() and torch.allclose(straight[empty], encode_srgb(BACKGROUND), atol=1e-6)
    assert view.guide[view.alpha > 0.5].min() > 0.6


def thin_run(
    gamma: float, iterations: list[int], target: str = "emission"
) -> tuple[torch.Tensor, torch.Tensor, list[float]]:
    """The picture of the start, the colours in the end and the losses at an extinction per voxel,
    with the exposure that is measured for it."""
    config = config_of(optics={"gamma": gamma}, views={"pool": 1}, colour={"target": target})
    smoke = smoke_of(puff(12))
    scene = scene_of([frame_of(puff(12))], config, "Y")
    targets = make_targets([random_style(16, 20)], scene, config, torch.device("cpu"))
    views = frame_views(smoke, config.views, scene, 0)
    (view,) = prepare_views(smoke, views, scene.gamma_w, scene.exposure)
    start = decode_srgb(initial_colours(smoke, "noise", 0))
    colours, ends = run_colour_step(StepProblem(smoke, targets, scene, config), iterations)
    picture = view.unpremultiplied(start, targets.background)
    return picture, colours, [end.smoothed for end in ends]


def test_the_straight_picture_of_thin_smoke_does_not_depend_on_how_thin_it_is():
    thin, thinner = (thin_run(gamma, [0, 0])[0] for gamma in (1e-4, 1e-7))
    assert torch.allclose(thin, thinner, atol=1e-3)
    assert thin.std() > 0.1  # and it is no empty picture


def test_smoke_as_thin_as_the_paper_s_is_painted_like_thick_smoke():
    """The same colours in the thin limit, and nearly the loss that thick smoke gets.

    After more iterations, what two thin runs differ by is the growth of their round-off.
    """
    thick, faint, fainter = (thin_run(gamma, [8, 8]) for gamma in (0.3, 1e-3, 1e-9))
    assert faint[2] == pytest.approx(thick[2], rel=0.15)
    assert fainter[2] == pytest.approx(faint[2], rel=0.01)
    assert (fainter[1] - faint[1]).abs().mean() < 0.02


def test_voxels_of_thin_smoke_may_be_brighter_than_white_and_no_albedo_is():
    _, emitted, _ = thin_run(1e-3, [30, 30])
    assert 1.05 < emitted.max() <= BRIGHTEST
    _, albedo, _ = thin_run(1e-3, [30, 30], target="albedo")
    assert albedo.min() >= 0 and albedo.max() <= 1


def test_an_optical_depth_of_a_millionth_millionth_can_be_painted():
    _, colours, losses = thin_run(1e-13, [3, 3])
    assert torch.isfinite(colours).all() and np.isfinite(losses).all()
    assert not torch.equal(colours, initial_colours(smoke_of(puff(12)), "noise", 0))


def test_the_loss_falls_and_colours_stay_in_range(smoke, views):
    config = config_of()
    targets = targets_of(config)
    ends: list[Minimum] = []
    colours, end = optimize_colours(
        ViewPool(views), initial_colours(smoke, "noise", 0), targets.at(1), targets.background,
        Descent(0.05, 40), ends.append,
    )  # fmt: skip
    assert end is ends[-1] and len(ends) == 40
    assert end.smoothed < 0.5 * ends[0].loss
    assert 0 <= colours.min() and colours.max() <= 1


def test_a_style_of_one_colour_paints_the_smoke_in_it(smoke, views):
    config = config_of(features={"layers": ["learned0"]})
    colour = np.array([0.8, 0.35, 0.1], np.float32)
    style = np.broadcast_to(colour, (16, 16, 3))
    targets = make_targets([style], SCENE, config, torch.device("cpu"))
    start = initial_colours(smoke, "noise", 0)
    colours, _ = optimize_colours(
        ViewPool(views), start, targets.at(1), targets.background, Descent(0.1, 60)
    )
    painted = picture_of(views[0], colours, targets)
    assert painted.numpy() == pytest.approx(np.broadcast_to(colour, painted.shape), abs=0.05)


def test_views_take_turns_and_several_can_be_seen_at_once(smoke, views, monkeypatch):
    seen: list[int] = []
    real = ColourView.over

    def noted(self: ColourView, *args: torch.Tensor) -> torch.Tensor:
        seen.append([view.alpha is self.alpha for view in views].index(True))
        return real(self, *args)

    monkeypatch.setattr(ColourView, "over", noted)
    targets = targets_of(config_of())
    start = initial_colours(smoke, "noise", 0)
    for n_views in (1, 2):
        seen.clear()
        optimize_colours(
            ViewPool(views, n_views, 5), start, targets.at(1), targets.background, Descent(0.05, 6)
        )
        assert len(seen) == 6 * n_views
        passages = [sorted(seen[n : n + 3]) for n in range(0, len(seen), 3)]
        assert passages == [[0, 1, 2]] * len(passages)


def test_total_variation_smooths_the_picture(smoke, views):
    rough = []
    for weight in (0.0, 1e4):
        targets = targets_of(config_of(losses={"total_variation": weight}))
        start = initial_colours(smoke, "noise", 0)
        colours, _ = optimize_colours(
            ViewPool(views), start, targets.at(1), targets.background, Descent(0.05, 25)
        )
        rough.append(float(picture_of(views[0], colours, targets).std(dim=0).mean()))
    assert rough[1] < 0.32 * rough[0]


@pytest.mark.parametrize(
    ("losses", "iterations", "setting"),
    [
        ({}, 60, None),
        ({"total_variation": 1e4}, 60, "losses.total_variation"),
    ],
)
def test_pictures_without_the_style_s_colour_or_contrast_are_named(losses, iterations, setting):
    steps = {"steps": ["colour"], "threads": 1, "tolerance": 0.0}
    colour = {"iterations": [iterations], "learning_rate": 0.05}
    config = config_of(losses=losses, colour=colour, optimize=steps)
    frame = frame_of(puff(16))
    patches = np.random.default_rng(0).uniform(0, 1, (6, 6, 3)).astype(np.float32)
    style = np.kron(patches, np.ones((4, 4, 1), np.float32))
    (result,) = run_core([frame], config, styles=[style])
    found = [f for f in find_frame("a.vdb", result.report, config) if "the pictures" in f.cause]
    assert [finding.setting for finding in found] == ([setting] if setting else [])


def test_no_smoke_colour_is_changed_by_no_iterations(smoke):
    config = config_of()
    colours, ends = run_colour_step(problem_of(smoke, config), [0, 0])
    assert torch.equal(colours, initial_colours(smoke, "noise", 0)) and ends == []
    start = torch.rand_like(colours)
    kept, ends = run_colour_step(problem_of(smoke, config), [0, 0], start)
    assert torch.equal(kept, start) and ends == []


def test_octaves_without_iterations_cost_no_views_and_no_targets(smoke, monkeypatch):
    config, factors = config_of(), []
    real = StyleTargets.at

    def noted(self: StyleTargets, factor: int) -> PictureLoss:
        factors.append(factor)
        return real(self, factor)

    monkeypatch.setattr(StyleTargets, "at", noted)
    _, ends = run_colour_step(problem_of(smoke, config), [0, 2, 0])
    assert set(factors) == {2} and len(ends) == 1


def test_the_coarse_result_is_what_the_finer_octave_starts_from(smoke):
    """With nothing done on the fine octave it is the interpolated coarse result."""
    config = config_of()
    coarse, _ = run_colour_step(problem_of(make_octaves(smoke, 2)[0], config), [0])
    wanted, _ = sample_colours(make_octaves(smoke, 2)[0], coarse, smoke.positions)
    seen: list[torch.Tensor] = []

    def first_start(views: object, colours: torch.Tensor, *_: object) -> tuple[torch.Tensor, None]:
        seen.append(colours)
        return colours, None

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("usdsmoke.core.steps.colour.optimize_colours", first_start)
        run_colour_step(problem_of(smoke, config), [5, 5])
    assert torch.equal(seen[0], coarse) and torch.equal(seen[1], wanted)


@pytest.mark.parametrize("n_voxels", [1, 1.9, 2, 3, 4.1])
def test_voxels_finer_than_the_pixels_are_painted_in_blocks(smoke, n_voxels, monkeypatch):
    sizes: list[int] = []

    def counted(views: object, colours: torch.Tensor, *_: object) -> tuple[torch.Tensor, None]:
        sizes.append(len(colours))
        return colours, None

    monkeypatch.setattr("usdsmoke.core.steps.colour.optimize_colours", counted)
    problem = replace(problem_of(smoke, config_of()), scene=replace(SCENE, pixel_size=n_voxels))
    colours, _ = run_colour_step(problem, [1, 1])
    halvings = {1: 0, 1.9: 0, 2: 1, 3: 1, 4.1: 2}[n_voxels]
    octaves = make_octaves(smoke, halvings + 2)[:2]
    assert sizes == [len(octave.ijk) for octave in octaves] and len(colours) == len(smoke.ijk)


def test_a_start_keeps_what_is_finer_than_the_pixels(smoke):
    """A checkerboard of voxels, which no picture of two voxels a pixel shows."""
    sign = 1 - 2 * (smoke.ijk.sum(1, keepdim=True) % 2)
    start = (0.5 + 0.2 * sign).expand(-1, 3)
    problem = problem_of(smoke, config_of())
    painted = replace(problem, scene=replace(SCENE, pixel_size=2.0))
    colours, (end,) = run_colour_step(painted, [0, 3], start)
    change = colours - start
    assert end.iteration == 2 and change.abs().max() > 0.05
    assert (change * sign).mean().abs() < 0.02  # 0.2 where the board is lost


def test_the_same_run_gives_the_same_bits_and_another_seed_others(smoke):
    results = []
    for seed in (0, 0, 1):
        config = config_of(optimize={"seed": seed, "threads": 1})
        results.append(run_colour_step(problem_of(smoke, config), [2, 2])[0])
    assert torch.equal(results[0], results[1]) and not torch.equal(results[0], results[2])


def test_several_styles_count_by_their_shares(smoke, views):
    start = initial_colours(smoke, "noise", 0)
    losses = []
    for weights in ([], [1.0, 0.0], [0.0, 2.0], [6.0, 2.0]):
        targets = targets_of(config_of(style={"weights": weights}), styles=2)
        background = torch.full((3,), 0.2)
        pool, descent = ViewPool(views), Descent(0.05, 1)
        losses.append(optimize_colours(pool, start, targets.at(1), background, descent)[1].loss)
    both, first, second, mixed = losses
    assert first != pytest.approx(second, rel=1e-3)
    assert both == pytest.approx((first + second) / 2, rel=1e-5)
    assert mixed == pytest.approx(0.75 * first + 0.25 * second, rel=1e-5)


def test_a_style_of_weight_zero_is_not_looked_at(smoke, monkeypatch):
    """Nor does it shift the background."""
    seen = []
    real = scale_style
    monkeypatch.setattr(
        "usdsmoke.core.steps.targets.scale_style",
        lambda style, *a: seen.append(style) or real(style, *a),
    )
    images = [random_style(16, 20, seed) for seed in range(2)]
    config = config_of(style={"weights": [0.0, 3.0]})
    targets = make_targets(images, SCENE, config, torch.device("cpu"))
    targets.at(1)
    assert len(seen) == 1 and seen[0] is images[1]
    alone = make_targets(images[1:], SCENE, config_of(), torch.device("cpu"))
    assert torch.equal(targets.background, alone.background)


def test_the_style_s_weight_multiplies_its_loss(smoke, views):
    start = initial_colours(smoke, "noise", 0)
    losses = []
    for weight in (1.0, 3.0):
        targets = targets_of(config_of(losses={"style": weight}))
        _, end = optimize_colours(
            ViewPool(views), start, targets.at(1), targets.background, Descent(0.05, 1)
        )
        losses.append(end.loss)
    assert losses[1] == pytest.approx(3 * losses[0], rel=1e-5)


def test_targets_are_made_once_for_each_scale(smoke):
    targets = targets_of(config_of())
    half, whole = (targets.images[0].target(factor, False) for factor in (2, 1))
    assert targets.images[0].target(2, False) is half is not whole


def test_starting_from_plain_density_washes_out_and_noise_does_not():
    """White smoke has no structure to grow from: the picture stays flatter than the style.

    With Gram matrices; distributions pull samples apart that are alike.
    """
    smoke = smoke_of(puff(16))
    config = config_of(features={"layers": []}, losses={"statistic": "gram"})
    views = prepare_views(smoke, frame_views(smoke, config.views, SCENE, 0), 0.4)
    targets = targets_of(config)
    contrast = {}
    for init in ("noise", "density"):
        start = initial_colours(smoke, init, 0)
        colours, _ = optimize_colours(
            ViewPool(views), start, targets.at(1), targets.background, Descent(0.05, 120)
        )
        contrast[init] = float(picture_of(views[0], colours, targets).std(dim=0).mean())
    assert contrast["noise"] > 2 * contrast["density"], contrast
