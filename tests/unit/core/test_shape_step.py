"""The shape step from outside: what it moves in its pictures, and what it holds meanwhile."""

import gc
import weakref
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from tests.fixtures.smoke_fixtures import frame_of, masked, puff, random_style, smoke_of
from tests.fixtures.stylize_fixtures import quick_config, run_core, scene_of
from usdsmoke.core.fields.lattice import Lattice
from usdsmoke.core.fields.pyramid import SparsePyramid
from usdsmoke.core.fields.transport import warp
from usdsmoke.core.steps import move, optimize, shape
from usdsmoke.core.steps.motion import Motion, MotionBox
from usdsmoke.core.steps.move import displacement_of
from usdsmoke.core.steps.pictures import ViewPool, grey_view
from usdsmoke.core.steps.shape import max_displacement, run_shape_step
from usdsmoke.core.steps.targets import StepProblem, StyleTargets, make_targets
from usdsmoke.core.views.project import column_map
from usdsmoke.core.views.scene import frame_views
from usdsmoke.core.views.visibility import EffectMask

KEPT = 8  # the iteration whose state is the result: see Pictures


class Pictures:
    """Stands for the style: a loss that is linear in the picture, and falls until pictures are not
    that of iteration 8.

    The optimiser remembers its state in iterations 0, 8, ... and goes back to the best of them when
    it ends much worse. So the picture seen in iteration 8 belongs to the result.
    """

    uses_content = False

    def __init__(self) -> None:
        self.seen: dict[int, Tensor] = {}

    def at(self, factor: int, grey: bool = False) -> "Pictures":
        return self

    def __call__(self, picture: Tensor, guide: Tensor, content: Any, iteration: int) -> Tensor:
        self.seen.setdefault(iteration, picture.detach().clone())
        ramp = torch.linspace(-1, 1, picture.shape[1])[:, None]
        slope = (picture * ramp).mean()
        value = 1 - min(iteration, KEPT) / 20
        if iteration > KEPT and not torch.equal(picture, self.seen[KEPT]):
            value = 5.0
        return value + slope - slope.detach()


def drift(lattice: Lattice, _: Tensor) -> Tensor:
    """A displacement that the frame before has left."""
    return torch.tensor([0.4, -0.3, 0.2]).expand(*lattice.shape, 3)


@pytest.mark.parametrize("start", [None, drift], ids=["at rest", "drifting"])
@pytest.mark.parametrize("kind", ["stream", "potential", "mixed"])
@pytest.mark.parametrize("many", [1, 10**9], ids=["blocks", "voxels"])
def test_the_optimised_picture_is_that_of_the_whole_box_moved(
    many: int, kind: str, start: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a mask. Only voxels that count are moved while optimising; here all of them are. Where
    blocks move, pictures are theirs.

    A drift beyond those voxels is left out of the flow, which reads it between the smoke's voxels.
    """
    monkeypatch.setattr(move, "MANY_VOXELS", many)
    half = np.broadcast_to(np.linspace(0, 1, 12)[:, None, None], (12, 12, 12))
    frame, smoke = masked(half), smoke_of(puff(12))
    config = quick_config(
        shape={"displacement": kind, "iterations": [KEPT + 2], "learning_rate": 0.05},
        views={"azimuth": 0.0, "elevation": 0.0, "centre_azimuth": 30.0},
        losses={"keep": 0.0},
    )
    scene, mask, pictures = scene_of([frame], config), EffectMask(frame), Pictures()
    scene = replace(scene, pixel_size=0.6 * scene.pixel_size)  # or blocks of voxels would move
    problem = StepProblem(smoke, cast(StyleTargets, pictures), scene, config, mask)
    found, ends = run_shape_step(problem, config.shape.iterations, start)
    assert ends[-1].restored

    limit, shown = max_displacement(smoke, config.shape.reach), move.movable_blocks(smoke, scene)
    displacement = displacement_of(found, shown, limit, mask)
    assert displacement.lattice.shape == found.lattice.shape
    lattice = displacement.lattice
    density, places = lattice.fill(shown), lattice.positions()
    share = mask.at(places).to(density).reshape(density.shape)
    u = lattice.from_stage(displacement.values)
    moved = warp(density, u / density.new_tensor(lattice.spacing), scheme="linear")
    (view,) = frame_views(shown, config.views, scene, 0, 1 if shown is smoke else 2)
    image = column_map(places, shown.edges, view)
    gamma, exposure = scene.gamma_w_shape, scene.exposure_shape
    whole = grey_view(image, density.flatten(), share.flatten(), gamma, exposure)
    wanted = whole.over_grey(whole.picture(moved.flatten()), scene.grey_mean)
    torch.testing.assert_close(pictures.seen[KEPT], wanted, rtol=0, atol=2e-5)
    still = whole.over_grey(whole.grey, scene.grey_mean)
    assert (wanted - still).abs().max() > 0.005


class Alive(TorchDispatchMode):
    """Whether any of some objects lived during the last operation of torch."""

    def __init__(self, watched: Sequence["weakref.ref[Any]"]) -> None:
        super().__init__()
        self.watched, self.last = watched, False

    def __torch_dispatch__(
        self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Any = None
    ) -> Any:
        self.last = any(item() is not None for item in self.watched)
        return func(*args, **(kwargs or {}))


@pytest.fixture
def no_collection() -> Iterator[None]:
    """What only the garbage collector would free stays."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def octaves() -> list[Any]:
    """The views of octaves and what is optimised in them, most of a step's memory."""
    return [item for item in gc.get_objects() if type(item) in (ViewPool, SparsePyramid)]


@pytest.mark.usefixtures("no_collection")
@pytest.mark.parametrize("iterations", [[2, 2, 2], [2, 2, 0]])
def test_the_views_of_one_octave_are_held_while_it_is_optimised(iterations: list[int]) -> None:
    smoke, config = smoke_of(puff(12)), quick_config()
    scene = scene_of([masked(np.ones((12, 12, 12)))], config)
    targets = make_targets([random_style()], scene, config, torch.device("cpu"))
    problem = StepProblem(smoke, targets, scene, config)
    before, begun, optimised = len(octaves()), [], []
    latest: list[weakref.ref[Any]] = []

    def start(lattice: Lattice, near: Tensor) -> Tensor:
        begun.append(len(octaves()) - before)
        return drift(lattice, near)

    def watch(octave: int, state: object) -> None:
        held = octaves()
        optimised.append((octave, len(held) - before))
        latest[:] = map(weakref.ref, held)

    with Alive(latest) as alive:
        run_shape_step(problem, iterations, start, watch)
    assert set(begun) == {0} and len(begun) >= 3
    assert {n for _, n in optimised} == {2}
    assert {octave for octave, _ in optimised} == {k for k, n in enumerate(iterations) if n}
    assert latest and not alive.last  # dense boxes are made after them


def test_what_is_left_in_pieces_is_given_back_before_an_octave_is_optimised(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[int] = []
    monkeypatch.setattr(optimize, "give_back_memory", lambda: calls.append(1))
    run_core([frame_of(puff(12))])
    assert len(calls) == 2 + 2 * 2  # two octaves; those of colours are optimised, and mended


@pytest.mark.parametrize(
    ("many", "far", "least", "most"),
    [(10**9, 0.12, 0.01, 0.005), (1, 0.29, 0.005, 0.003)],
    ids=["voxels", "blocks"],
)
def test_smoke_that_is_moved_far_hardly_folds(
    many: int, far: float, least: float, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the penalty 1 % of the voxels do, and where blocks move twice as far."""
    monkeypatch.setattr(move, "MANY_VOXELS", many)
    config = quick_config().with_values(
        {
            "optimize.steps": ["shape"],
            "views.image_size": 64,
            "views.pool": 4,
            "views.elevation": 40.0,
            "shape.iterations": [40],
            "shape.reach": far,
            "shape.learning_rate": 0.7 * far,
            "losses.keep": 0.0,
        }
    )
    folded = []
    for unpunished in ((), ("FOLDING_WEIGHT", "BLOCK_FOLDING_WEIGHT")):
        for name in unpunished:
            monkeypatch.setattr(shape, name, 0.0)
        (frame,) = run_core([frame_of(puff(24))], config)
        folded.append(frame.report.transport.folded)
    assert folded[0] < most < least < folded[1]


def test_a_departure_from_the_start_counts_in_pixels() -> None:
    """So that it weighs as much at any resolution, and with any reach."""
    smoke = smoke_of(puff(12))
    box = MotionBox.of(smoke, None, move.fade_of(smoke), None)
    noise = torch.randn(*box.lattice.shape, 3, generator=torch.Generator().manual_seed(0))

    def cost(pixels: float, factor: int = 1, reach: float = 0.04) -> float:
        config = quick_config(shape={"reach": reach}, losses={"keep": 0.0})
        scene = scene_of([frame_of(puff(12))], config)
        scene = replace(scene, pixel_size=pixels * scene.pixel_size)
        problem = StepProblem(smoke, cast(StyleTargets, Pictures()), scene, config, None)
        motion = Motion(box, max_displacement(smoke, reach), "stream", 3)
        potential = 0.1 * motion.pyramid.chosen(noise)
        steady, free = (
            shape._Octave(problem, motion, factor, 0, weight, 0.0).loss(potential, 0)
            for weight in (100.0, 0.0)
        )
        return float(steady - free)

    assert cost(1.0) > 0.1
    assert cost(2.0) == pytest.approx(cost(1.0) / 4, rel=1e-3)
    assert cost(1.0, factor=2) == pytest.approx(cost(1.0) / 4, rel=1e-3)
    assert cost(1.0, reach=0.08) == pytest.approx(cost(1.0), rel=1e-3)


@pytest.mark.parametrize(("many", "done"), [(10**9, (2, 3, 4)), (1, (2, 4))])
def test_where_blocks_move_the_octave_that_has_the_same_voxels_is_left_out(
    many: int, done: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(move, "MANY_VOXELS", many)
    config = quick_config(shape={"iterations": [2, 3, 4]}, optimize={"steps": ["shape"]})
    (frame,) = run_core([frame_of(puff(24))], config)
    assert frame.report.shape is not None and frame.report.shape.iterations == done


@pytest.mark.parametrize(("limit", "done"), [(2000, (2, 4)), (10**9, (2, 3, 4))])
def test_small_and_large_frames_of_a_shot_move_alike(
    limit: int, done: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Blocks of two voxels, if the largest frame has many of them."""
    monkeypatch.setattr(move, "MANY_VOXELS", limit)
    config = quick_config(shape={"iterations": [2, 3, 4]}, optimize={"steps": ["shape"]})
    frames = [frame_of(puff(n), float(n)) for n in (12, 24)]
    assert [len(smoke_of(puff(n)).ijk) > 2000 for n in (12, 24)] == [False, True]
    for frame in frames:
        (found,) = run_core([frame], config, scene=scene_of(frames, config))
        assert found.report.shape is not None and found.report.shape.iterations == done


def test_fog_around_moved_smoke_is_as_it_was() -> None:
    """A background above 0 applies outside of the box, and up to the smoke in it."""
    background = 0.05
    frame = frame_of(puff(14) + background)
    frame = replace(frame, density=replace(frame.density, background=background))
    config = quick_config(optimize={"steps": ["shape"]}, optics={"thicken": 1.0})
    (result,) = run_core([frame], config)
    before, after = frame.density, result.density
    assert after.background == before.background and not np.array_equal(after.values, before.values)
    outside = np.ones(after.values.shape, bool)
    low = np.subtract(before.ijk_min, after.ijk_min)
    outside[tuple(slice(a, a + n) for a, n in zip(low, before.values.shape, strict=True))] = False
    assert after.values.min() > 0 and (after.values[outside] >= np.float32(background)).all()
