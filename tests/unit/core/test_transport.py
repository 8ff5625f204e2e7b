"""Transport keeps what it must keep, lets go what leaves, and refuses what it cannot do."""

import math

import pytest
import torch
from torch import Tensor

from usdsmoke.base.errors import NonFiniteError, PlanError, ShapeError
from usdsmoke.core.fields.flow import flow
from usdsmoke.core.fields.sample import voxel_positions
from usdsmoke.core.fields.transport import (
    SCHEMES,
    Scheme,
    backtrace,
    choose_substeps,
    correct_mass,
    warp,
)
from usdsmoke.core.smoke.tasks import computing_threads

SHAPE = (9, 7, 8)


def random(*shape: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def uniform(shape: tuple[int, ...], *speed: float, dtype: torch.dtype = torch.float64) -> Tensor:
    return torch.tensor(speed, dtype=dtype).expand(*shape[:3], 3)


def blob(shape: tuple[int, ...], *centre: float, sigma: float = 1.5) -> Tensor:
    position = voxel_positions(shape, torch.empty(0, dtype=torch.float64)).reshape(*shape, 3)
    away = position - torch.tensor(centre, dtype=torch.float64)
    return torch.exp(-away.square().sum(dim=-1) / (2 * sigma**2))


def advect(
    values: Tensor, velocity: Tensor, dt: float, scheme: Scheme, n_substeps: int | None = None
) -> Tensor:
    """Values after the time dt: the back-trace's departure points, looked up."""
    n_substeps = n_substeps or choose_substeps(velocity, dt)
    arrivals = voxel_positions(values.shape, values)
    u = arrivals - backtrace(velocity, arrivals, dt, n_substeps)
    return warp(values, u.reshape(*values.shape[:3], 3), scheme=scheme)


def tolerance(scheme: str) -> float:
    return 1e-14 if scheme == "cubic" else 0.0  # the spline's prefilter rounds


@pytest.mark.parametrize("scheme", SCHEMES)
def test_zero_velocity_zero_step_and_zero_displacement_change_nothing(scheme):
    values = random(*SHAPE, 2)
    moving, still = uniform(SHAPE, 0.3, -0.6, 0.9), torch.zeros(*SHAPE, 3, dtype=values.dtype)
    for found in (
        advect(values, still, 1.0, scheme),
        advect(values, moving, 0.0, scheme),
        warp(values, still, scheme=scheme),
    ):
        torch.testing.assert_close(found, values, rtol=0, atol=tolerance(scheme))


@pytest.mark.parametrize("scheme", SCHEMES)
def test_shift_by_whole_voxels_is_exact_and_brings_in_nothing(scheme):
    values = random(*SHAPE)
    expected = torch.zeros_like(values)
    expected[2:, :, :-1] = values[:-2, :, 1:]
    moved = advect(values, uniform(SHAPE, 1.0, 0.0, -0.5), 2.0, scheme)
    warped = warp(values, uniform(SHAPE, 2.0, 0.0, -1.0), scheme=scheme)
    for found in (moved, warped):
        # The spline of a box that ends abruptly is cut off 12 voxels out: 1e-7.
        torch.testing.assert_close(found, expected, rtol=0, atol=tolerance(scheme) and 1e-7)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_smoke_that_leaves_the_box_leaves(scheme):
    """Looking up a border that is held outwards would let a sheet on the floor grow."""
    values = torch.zeros(16, 16, 16, dtype=torch.float64)
    values[:, :2, :] = 1.0  # a sheet on the floor
    total, velocity = float(values.sum()), uniform((16, 16, 16), 0.31, -0.47, 0.0)
    before = total
    for _ in range(24):
        values = advect(values, velocity, 1.0, scheme)
        assert float(values.sum()) < before
        before = float(values.sum())
    assert before < 1e-3 * total


@pytest.mark.parametrize("cfl", [0.0, 0.3, 1.0, 4.0, 17.0, 50.0])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_result_is_finite_and_in_range_at_every_cfl_number(scheme, cfl):
    values = random(*SHAPE, dtype=torch.float32)
    velocity = (random(*SHAPE, 3, seed=1, dtype=torch.float32) - 0.5) * 2 * cfl
    moved = advect(values, velocity, 1.0, scheme)
    assert torch.isfinite(moved).all()
    assert moved.min() >= 0 and moved.max() <= values.max()


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("scale", [2.0**-100, 2.0**100])
def test_the_unit_of_density_does_not_matter(scheme, scale):
    values = random(*SHAPE, dtype=torch.float32)
    velocity = uniform(SHAPE, 0.3, -0.6, 1.9, dtype=torch.float32)
    moved = advect(values * scale, velocity, 1.0, scheme)
    assert torch.equal(moved, advect(values, velocity, 1.0, scheme) * scale)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_active_voxels_get_what_the_whole_box_gives_them(scheme):
    shape = (20, 18, 16)
    values = blob(shape, 9.0, 8.0, 7.0, sigma=1.0) * (blob(shape, 9.0, 8.0, 7.0, sigma=1.0) > 1e-3)
    u = (random(*shape, 3, seed=5) - 0.5) * 2
    whole = warp(values, u, scheme=scheme)
    reached = torch.nn.functional.max_pool3d(values[None, None], 7, 1, 3)[0, 0] > 0
    active = reached.nonzero()
    assert len(active) < 0.6 * values.numel()
    found = warp(values, u, scheme=scheme, active_ijk=active)
    torch.testing.assert_close(found, whole[reached], rtol=0, atol=1e-15)
    torch.testing.assert_close(warp(values, u[reached], scheme=scheme, active_ijk=active), found)


def test_rotation_of_a_box_that_is_no_cube_is_rigid():
    """Turning in unit coordinates would exchange the long and the short side."""
    shape = (48, 32, 1)
    values = blob(shape, 30.0, 16.0, 0.0, sigma=2.0)
    offset = voxel_positions(shape, values) - torch.tensor([24.0, 16.0, 0.0], dtype=torch.float64)
    turn = torch.stack([-offset[:, 1], offset[:, 0], torch.zeros_like(offset[:, 0])], dim=1)
    velocity = turn.reshape(*shape, 3) * (math.pi / 2)
    found = advect(values, velocity, 1.0, "cubic", 400)
    torch.testing.assert_close(found, blob(shape, 24.0, 22.0, 0.0, sigma=2.0), rtol=0, atol=1e-4)


def test_substeps_follow_the_fastest_component():
    velocity = torch.zeros(4, 4, 4, 3)
    assert choose_substeps(velocity, 1.0) == 1
    velocity[1, 2, 3, 1] = -7.2
    assert choose_substeps(velocity, 1.0) == 8
    assert choose_substeps(velocity, -0.5) == 4
    assert choose_substeps(velocity, 1.0, cfl=4.0) == 2
    assert choose_substeps(velocity[:0], 1.0) == 1


def test_substeps_improve_the_back_trace_of_a_strong_swirl():
    shape = (33, 33, 1)
    offset = voxel_positions(shape, torch.empty(0, dtype=torch.float64)) - 16
    turn = torch.stack([-offset[:, 1], offset[:, 0], torch.zeros_like(offset[:, 0])], dim=1)
    velocity = turn.reshape(*shape, 3) * 2.0
    values, exact = blob(shape, 22.0, 16.0, 0.0, sigma=2.0), None
    angle = 2.0
    exact = blob(shape, 16 + 6 * math.cos(angle), 16 + 6 * math.sin(angle), 0.0, sigma=2.0)
    chosen = advect(values, velocity, 1.0, "cubic") - exact
    single = advect(values, velocity, 1.0, "cubic", 1) - exact
    assert chosen.abs().max() < 0.02 < 0.5 < single.abs().max()


@pytest.mark.parametrize("speed", [1e5, 1e12, 1e30])
def test_absurd_velocity_is_refused_with_its_cfl_number(speed):
    with pytest.raises(PlanError, match=r"crosses .* unit"):
        choose_substeps(torch.full((*SHAPE, 3), speed), 1.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_non_finite_inputs_are_counted_and_refused(bad):
    velocity, values = torch.zeros(*SHAPE, 3), torch.ones(SHAPE)
    velocity[3, 3, 3, 1] = velocity[4, 4, 4, 0] = bad
    values[0, 0, 0] = bad
    wanted = rf"2 of {velocity.numel()} numbers of the velocity"
    with pytest.raises(NonFiniteError, match=wanted):
        choose_substeps(velocity, 1.0)
    with pytest.raises(NonFiniteError, match=wanted):
        backtrace(velocity, torch.zeros(1, 3), 1.0)
    with pytest.raises(NonFiniteError, match="the displacement"):
        warp(torch.ones(SHAPE), velocity)
    with pytest.raises(NonFiniteError, match=r"1 of 504"):
        warp(values, torch.zeros(*SHAPE, 3))
    with pytest.raises(NonFiniteError, match="cfl above 0"):
        choose_substeps(torch.zeros(1, 3), bad)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda v, u: warp(v, u, scheme="bfecc"), "bfecc.* linear, cubic"),
        (lambda v, u: backtrace(u, u[0, 0], 1.0, 0), "0 sub-steps"),
        (lambda v, u: backtrace(u[..., :2], v[:1, 0, :3], 1.0), r"\[9, 7, 8, 2\]"),
        (lambda v, u: warp(v, u[:4]), r"displacement has shape \[4, 7, 8, 3\]"),
        (
            lambda v, u: warp(v, u, active_ijk=torch.tensor([[9, 0, 0], [0, 0, -1], [1, 1, 1]])),
            "2 of 3 active voxels lie outside the box of .9, 7, 8. voxels",
        ),
        (lambda v, u: warp(v, u, active_ijk=torch.zeros(4, 3)), "integers of shape .N 3."),
    ],
)
def test_what_does_not_fit_is_refused(call, message):
    with pytest.raises(ShapeError, match=message):
        call(torch.ones(SHAPE), torch.zeros(*SHAPE, 3))


def test_mass_is_corrected_and_its_error_reported():
    source, moved = torch.full(SHAPE, 2.0), torch.full(SHAPE, 1.5)
    corrected, error = correct_mass(moved, source)
    assert error == pytest.approx(-0.25)
    torch.testing.assert_close(corrected, source)


@pytest.mark.parametrize("unit", [1.0, 1e30, 1e-30])
@pytest.mark.parametrize("missing", [-0.2, 0.0, 0.01, 0.2, 0.9])
def test_mass_comes_from_where_look_ups_differ(missing, unit):
    """Values stay between both look-ups, until those are used up."""
    source = random(9, 8, 7)
    linear = source + 0.3 * (random(9, 8, 7, seed=1) - 0.5)
    linear[:3] = source[:3]
    moved = source * (source.sum() + missing) / source.sum() if missing == 0.9 else source.clone()
    moved[5] += missing / moved[5].numel() * (missing != 0.9)
    corrected, error = correct_mass(unit * moved, unit * source, unit * linear)
    assert error == pytest.approx(float(moved.sum() / source.sum()) - 1, abs=1e-12)
    assert float(corrected.sum()) == pytest.approx(unit * float(source.sum()), rel=1e-9)
    if missing != 0.9:
        low, high = torch.minimum(moved, linear), torch.maximum(moved, linear)
        slack = 1e-7
        assert (corrected / unit >= low - slack).all() and (corrected / unit <= high + slack).all()
        torch.testing.assert_close(corrected[:3] / unit, moved[:3], rtol=1e-8, atol=0)


def test_the_mass_of_a_core_is_not_taken_from_the_smoke_around_it():
    """Of voxels 300 times denser the look-up is 3% off; a factor would take that from all smoke."""
    places = torch.stack(torch.meshgrid(*[torch.arange(24.0)] * 3, indexing="ij"), -1).double()
    away = (places - 11.5).norm(dim=-1)
    smoke = torch.sigmoid((8 - away) / 0.7) * (1 + 0.3 * torch.sin(places[..., 0]))
    core = (places - torch.tensor([10.3, 11.5, 12.2])).norm(dim=-1) < 1.2
    u = flow(0.9 * torch.sin(2 * math.pi * places[..., [1, 2, 0]] / 12))
    source = smoke + 300 * core
    moved, linear = (warp(source, u, scheme=scheme).clamp_min(0) for scheme in ("cubic", "linear"))
    corrected, error = correct_mass(moved, source, linear)
    factor, _ = correct_mass(moved, source)
    far = (warp(core.double(), u) == 0) & (places - 11.5).norm(dim=-1).gt(6)
    assert abs(error) > 0.02
    assert float(factor[far].sum() / moved[far].sum()) < 0.98
    assert float(corrected[far].sum() / moved[far].sum()) == pytest.approx(1, abs=1e-3)


def test_mass_that_cannot_be_corrected_is_left_and_reported():
    empty, full = torch.zeros(SHAPE), torch.ones(SHAPE)
    for moved, source, expected in (
        (empty, empty, 0.0),
        (empty, full, -1.0),
        (full, empty, math.inf),
    ):
        corrected, error = correct_mass(moved, source)
        assert corrected is moved and error == expected
    assert correct_mass(-full, full)[1] == -2.0


def test_one_and_two_threads_agree():
    values = random(34, 45, 46, dtype=torch.float32)  # more voxels than a thread samples at once
    u = (random(34, 45, 46, 3, seed=1, dtype=torch.float32) - 0.5) * 4
    results = []
    for n in (1, 2):
        with computing_threads(n):
            results.append([warp(values, u, scheme=scheme) for scheme in SCHEMES])
    for one, two in zip(*results, strict=True):
        assert torch.equal(one, two)


@pytest.mark.parametrize("channels", [(), (2,)])
def test_a_core_a_hundred_times_denser_empties_no_smoke_around_it(channels: tuple[int, ...]):
    generator = torch.Generator().manual_seed(1)
    smoke = 0.5 + 0.5 * torch.rand(16, 16, 16, *channels, generator=generator)
    pyro = smoke.clone()
    pyro[6:9, 6:9, 6:9] *= 200
    shift = torch.full((16, 16, 16, 3), 0.4)
    inside = (slice(1, 15),) * 3
    moved, linear = warp(pyro, shift, scheme="cubic")[inside], warp(pyro, shift)[inside]
    assert moved.min() >= 0.25
    assert (moved / linear).max() < 4  # 8 without the bounds
    plain = warp(smoke, shift, scheme="cubic")[inside]
    far = (slice(12, 14),) * 3  # of the core, the spline's rings have faded there
    assert (moved[far] / plain[far] - 1).abs().max() < 0.05


def test_a_dense_core_empties_no_smoke_beside_empty_voxels():
    """A sheet of two voxels with a core a thousand times denser: each cell has an empty voxel."""
    sheet = torch.zeros(16, 16, 16)
    sheet[:, :, 7:9] = 1.0
    core = sheet.clone()
    core[6:9, 6:9, 7:9] *= 1000
    shift = torch.tensor([0.4, 0.3, 0.6]).expand(16, 16, 16, 3)
    moved, linear = warp(core, shift, scheme="cubic"), warp(core, shift)
    assert (moved >= linear / 10 - 1e-6).all()
