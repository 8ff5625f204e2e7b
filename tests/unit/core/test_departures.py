"""Carrying a neighbouring frame's result along with the smoke."""

import numpy as np
import pytest
import torch
from scipy.linalg import expm

from tests.fixtures.smoke_fixtures import affine, frame_of, puff, smoke_of
from usdsmoke.base.errors import PlanError
from usdsmoke.base.volume import DenseField, VolumeFrame
from usdsmoke.core.sequence.coherence import carry_colours
from usdsmoke.core.sequence.transit import Transit
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.smoke.noise import white_noise

DENSITY = puff(10)


def shifted(smoke: ActiveSmoke, step: tuple[int, int, int]) -> ActiveSmoke:
    return ActiveSmoke(smoke.ijk + torch.tensor(step), smoke.density, smoke.index_to_stage)


def colours_of(smoke: ActiveSmoke) -> torch.Tensor:
    return torch.rand(len(smoke.ijk), 3, generator=torch.Generator().manual_seed(0))


def test_colours_follow_smoke_that_moves_by_whole_voxels():
    before = smoke_of(DENSITY)
    now = shifted(before, (2, 0, -1))
    frame = frame_of(np.pad(DENSITY, 3), velocity=np.array([48.0, 0.0, -24.0]), ijk_min=(-3,) * 3)
    carried = carry_colours(before, colours_of(before), Transit(frame, 1 / 24), now, seed=0)
    assert torch.allclose(carried, colours_of(before), atol=1e-5)


def test_the_sign_of_time_follows_the_neighbour():
    before = smoke_of(DENSITY)
    now = shifted(before, (-2, 0, 1))
    frame = frame_of(np.pad(DENSITY, 3), velocity=np.array([48.0, 0.0, -24.0]), ijk_min=(-3,) * 3)
    carried = carry_colours(before, colours_of(before), Transit(frame, 1 / 24).reverse, now, seed=0)
    assert torch.allclose(carried, colours_of(before), atol=1e-5)


def test_without_velocity_colours_stay_in_place():
    smoke = smoke_of(DENSITY)
    frame = frame_of(DENSITY)
    assert torch.equal(Transit(frame, 1.0).origins(smoke.positions), smoke.positions)
    carried = carry_colours(smoke, colours_of(smoke), Transit(frame, 1.0), smoke, seed=0)
    assert torch.allclose(carried, colours_of(smoke), atol=1e-5)


def test_velocity_is_read_in_its_own_grid_and_world():
    """A linear velocity on a turned grid whose world is moved and scaled to the stage.

    The flow of v = x S + c is known: (x, 1) times the exponential of [[S, 0], [c, 0]].
    """
    world = affine(3)
    to_stage = np.diag([2.0, 2.0, 2.0, 1.0])
    to_stage[3, :3] = [5.0, -1.0, 0.5]
    ijk = np.stack(np.meshgrid(*[np.arange(8.0)] * 3, indexing="ij"), axis=-1)
    ijk += np.array([-4, 2, 1])
    places = ijk @ world[:3, :3] + world[3, :3]
    slope = np.array([[0.0, 0.3, 0.1], [-0.2, 0.0, 0.1], [0.1, 0.2, -0.1]])
    values = (places @ slope + np.array([1.0, 2.0, 3.0])).astype(np.float32)
    velocity = DenseField("velocity", values, (-4, 2, 1), world)
    frame = VolumeFrame(1.0, frame_of(DENSITY).density, np.eye(4), velocity, to_stage)
    asked = places[2:6, 2:6, 2:6].reshape(-1, 3) + 0.2
    stage = torch.from_numpy(asked @ to_stage[:3, :3] + to_stage[3, :3])
    found = Transit(frame, 0.1).origins(stage)
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[3, :3] = slope, [1.0, 2.0, 3.0]
    earlier = np.insert(asked, 3, 1.0, axis=1) @ expm(-0.1 * generator)
    wanted = earlier[:, :3] @ to_stage[:3, :3] + to_stage[3, :3]
    assert found.numpy() == pytest.approx(wanted, abs=1e-4)
    assert np.abs(found.numpy() - stage.numpy()).max() > 0.3


def swirl(low: int) -> VolumeFrame:
    """A rigid turn around z in a box of 16 voxels, of which the first has the index ``low``."""
    i, j, _ = np.meshgrid(*[np.arange(16.0) - 7.5] * 3, indexing="ij")
    values = np.stack([-j, i, 0 * i], axis=-1).astype(np.float32)
    velocity = DenseField("velocity", values, (low,) * 3, np.eye(4))
    return VolumeFrame(1.0, frame_of(DENSITY).density, np.eye(4), velocity, np.eye(4))


@pytest.mark.parametrize("low", [0, 10**6], ids=["near the origin", "far away"])
def test_what_is_looked_up_in_single_precision_is_as_precise_anywhere(low: int):
    """Places are not rounded: a turn there and back ends where it began, also far away."""
    places = low + 4 + 8 * torch.rand(50, 3, generator=torch.manual_seed(0)).double()
    transit = Transit(swirl(low), 1e-3)
    back = transit.reverse.origins(transit.origins(places))
    assert (back - places).abs().max() < 3e-9
    middle = low + 7.5
    turned = transit.origins(places) - middle
    x, y, z = (places - middle).T
    angle = torch.tensor(1e-3, dtype=torch.float64)
    wanted = torch.stack(
        [x * angle.cos() + y * angle.sin(), y * angle.cos() - x * angle.sin(), z], dim=1
    )
    assert (turned - wanted).abs().max() < 3e-9


def test_a_tracer_follows_shares_of_the_velocity_in_few_steps_if_it_is_told():
    frame = frame_of(np.pad(DENSITY, 3), velocity=np.array([48.0, 0.0, -24.0]), ijk_min=(-3,) * 3)
    places = smoke_of(DENSITY).positions
    trace = Transit(frame, 1 / 24).tracer(places.device)
    step = torch.tensor([2.0, 0.0, -1.0], dtype=torch.float64)
    assert torch.allclose(trace(places, 1.5), places - 1.5 * step)
    assert torch.allclose(trace(places, -1.0), places + step)
    assert torch.equal(trace(places, 0.0), places)

    turn = Transit(swirl(0), 1.0).tracer(places.device)  # by a radian, 7.5 voxels at the corner
    place = torch.full((1, 3), 11.0, dtype=torch.float64)
    exact = turn(place)
    assert (turn(place, 1.0, 100) - exact).abs().max() == 0
    assert 0.1 < (turn(place, 1.0, 1) - exact).norm() < 2.0


@pytest.mark.parametrize("backwards", [False, True])
def test_a_share_of_the_velocity_rides_on_all_of_the_volumes_motion(backwards: bool):
    ride = np.eye(4)
    ride[3, :3] = [0.0, 5.0, 0.0]
    frame = frame_of(np.pad(DENSITY, 3), velocity=np.array([48.0, 0.0, -24.0]), ijk_min=(-3,) * 3)
    places = smoke_of(DENSITY).positions
    trace = Transit(frame, 1 / 24, ride, backwards).tracer(places.device)
    way = torch.tensor([2.0 * 0.5, 5.0, -1.0 * 0.5], dtype=torch.float64)
    assert torch.allclose(trace(places, 0.5), places + way * (1 if backwards else -1))


@pytest.mark.parametrize("value", [1e9, 1e37])
def test_a_single_wild_voxel_is_too_fast_however_many_points_are_asked_for(value: float):
    """Beyond the range of single precision per second, too, where voxels are small."""
    speed = np.zeros((8, 8, 8, 3), np.float32)
    speed[4, 4, 4] = value
    small = np.diag([0.01, 0.01, 0.01, 1.0])
    velocity = DenseField("velocity", speed, (0, 0, 0), small)
    frame = VolumeFrame(1.0, frame_of(DENSITY).density, np.eye(4), velocity, np.eye(4))
    for n_points in (0, 10, 100_000):
        with pytest.raises(PlanError, match="velocity's unit"):
            Transit(frame, 1 / 24).origins(torch.zeros(n_points, 3, dtype=torch.float64))


def test_an_empty_velocity_grid_moves_nothing():
    field = DenseField("velocity", np.zeros((0, 0, 0, 3), np.float32), (0, 0, 0), np.eye(4))
    frame = VolumeFrame(1.0, frame_of(DENSITY).density, np.eye(4), field, np.eye(4))
    positions = smoke_of(DENSITY).positions
    assert Transit(frame, 1.0).origins(positions) is positions


@pytest.mark.parametrize(("depth", "elsewhere"), [(10, 0.0), (1, 1.0)])
def test_a_velocity_of_one_plane_moves_the_smoke_in_it_and_any_slab(depth, elsewhere):
    density = frame_of(puff(10)[:, :, -depth:]).density
    values = np.broadcast_to(np.float32([1.0, 0.0, 0.0]), (10, 10, 1, 3)).copy()
    plane = DenseField("velocity", values, (0, 0, 3), np.eye(4))
    frame = VolumeFrame(1.0, density, np.eye(4), plane, np.eye(4))
    places = torch.tensor([[4.0, 4.0, z] for z in (-40.0, 2.0, 2.5, 3.0, 3.4, 4.0)]).double()
    moved = places - Transit(frame, 1.0).origins(places)
    wanted = [elsewhere, elsewhere, 1.0, 1.0, 1.0, elsewhere]
    assert moved[:, 0].tolist() == pytest.approx(wanted) and (moved[:, 1:] == 0).all()


@pytest.mark.parametrize("speed", [0.0, 0.5, 50.0])
def test_any_speed_gives_finite_colours_in_range(speed):
    smoke = smoke_of(DENSITY)
    velocity = 24.0 * speed * np.array([1.0, -0.7, 0.3])
    frame = frame_of(DENSITY, velocity=velocity)
    carried = carry_colours(smoke, colours_of(smoke), Transit(frame, 1 / 24), smoke, seed=0)
    assert torch.isfinite(carried).all()
    assert carried.min() >= 0 and carried.max() <= 1 + 1e-6


def test_an_absurd_velocity_is_a_named_error():
    smoke = smoke_of(DENSITY)
    frame = frame_of(DENSITY, velocity=np.array([1e9, 0.0, 0.0]))
    with pytest.raises(PlanError, match="velocity's unit"):
        carry_colours(smoke, colours_of(smoke), Transit(frame, 1 / 24), smoke, seed=0)


def test_new_smoke_takes_the_colour_of_its_surroundings_and_noise_far_from_any():
    before = smoke_of(np.ones((8, 8, 8)))
    colours = torch.tensor([0.2, 0.5, 0.9]).expand(512, 3)
    ijk = torch.tensor([[1, 1, 1], [8, 1, 1], [10, 1, 1], [500, 1, 1]])
    now = ActiveSmoke(ijk, torch.ones(4), np.eye(4))
    carried = carry_colours(before, colours, Transit(frame_of(DENSITY), 1.0), now, seed=7)
    assert torch.allclose(carried[:3], colours[:3], atol=1e-6)
    assert torch.equal(carried[3:], white_noise(ijk[3:], 3, 7))
