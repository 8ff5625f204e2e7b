"""What a frame with a mask becomes."""

from typing import Any

import numpy as np
import pytest
import torch

from tests.fixtures.smoke_fixtures import frame_of, masked, puff
from tests.fixtures.stylize_fixtures import by_voxel, quick_config, run_core, scene_of
from usdsmoke.base.errors import NonFiniteError
from usdsmoke.base.volume import DenseField
from usdsmoke.core.sequence.stylize import StylizedFrame
from usdsmoke.core.steps import colour
from usdsmoke.core.steps.targets import StyleTargets
from usdsmoke.core.views.scene import Scene

DENSITY = puff(12)
FRAME = frame_of(DENSITY)
COLOUR = {"optimize": {"steps": ["colour"], "threads": 1}}


# Ranks of samples multiply round-off; matrices do not.
SMOOTH = quick_config(losses={"statistic": "gram"})


@pytest.fixture(scope="module")
def plain() -> StylizedFrame:
    return run_core([FRAME], SMOOTH)[0]


def half_mask() -> np.ndarray:
    """0 in one half of the puff, then a ramp over three voxels, then 1."""
    ramp = np.clip((np.arange(12) - 5) / 4, 0, 1)
    return np.broadcast_to(ramp[:, None, None], DENSITY.shape).copy()


def assert_close(found: DenseField, wanted: DenseField, error: float) -> None:
    """Over all voxels, whatever the two boxes are."""
    one, other = by_voxel(found), by_voxel(wanted)
    nothing = (0.0,) * (found.values.shape[3] if found.values.ndim == 4 else 1)
    for voxel in one.keys() | other.keys():
        difference = np.subtract(one.get(voxel, nothing), other.get(voxel, nothing))
        assert np.abs(difference).max() <= error, voxel


def test_a_mask_of_one_everywhere_is_no_mask(plain):
    """Up to voxels that are faint or not by round-off, and what slopes in bfloat16 make of it."""
    result = run_core([masked(np.ones((1, 1, 1)), background=1.0)], SMOOTH)[0]
    assert_close(result.density, plain.density, 1e-5)
    assert_close(result.emission, plain.emission, 1e-2)
    assert not result.report.warnings


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
@pytest.mark.parametrize("displacement", ["stream", "potential"])
def test_where_the_mask_is_zero_the_source_stays_bit_for_bit(displacement, interpolation):
    """Under splines and with the correction of mass, which take every voxel; it gets no colour."""
    shape = {"learning_rate": 0.05, "reach": 0.1, "iterations": [4]}
    config = quick_config(
        shape={**shape, "displacement": displacement, "interpolation": interpolation},
        losses={"statistic": "gram"},
    )
    result = run_core([masked(half_mask())], config)[0]
    found, emission = by_voxel(result.density), by_voxel(result.emission)
    source = by_voxel(FRAME.density)
    beyond = {voxel for voxel in found.keys() | source.keys() if voxel[0] <= 5}
    assert len(beyond) > 100
    assert all(found.get(voxel) == source.get(voxel) for voxel in beyond)
    assert not any(voxel in emission for voxel in beyond)
    assert any(found.get(v) != source.get(v) for v in source if v[0] > 8)
    assert all(v in emission for v in found if v[0] > 5)
    assert sum(v[0] for v in found.values()) == pytest.approx(DENSITY.sum(), rel=1e-5)


def test_the_mask_scales_the_displacement():
    """After steps of one size; far below the cap, which would level them."""
    config = quick_config(
        shape={"iterations": [3], "learning_rate": 1e-3}, optimize={"steps": ["shape"]}
    )
    weak, full = (
        run_core([masked(np.full(DENSITY.shape, share))], config)[0].report.transport
        for share in (0.1, 1.0)
    )
    ratio = weak.largest_displacement / full.largest_displacement
    assert ratio == pytest.approx(0.1, rel=0.2)


def recorded(monkeypatch: pytest.MonkeyPatch) -> list[torch.Tensor]:
    """The colours [N 3] that each octave of the colour step starts from, as they are asked for."""
    seen: list[torch.Tensor] = []
    real = colour.optimize_colours

    def noted(views: Any, colours: torch.Tensor, *more: Any) -> Any:
        seen.append(colours)
        return real(views, colours, *more)

    monkeypatch.setattr(colour, "optimize_colours", noted)
    return seen


def test_emission_is_the_mask_times_the_painted_colour_times_the_extinction():
    """No iterations: the painted colours are the voxels' noise, with a mask and without."""
    config = quick_config(colour={"iterations": [0]}, **COLOUR)
    plain, half = (run_core([f], config)[0].emission for f in (FRAME, masked(half_mask())))
    assert plain is not None and half is not None
    wanted = plain.values * half_mask()[..., None].astype(np.float32)
    assert half.values == pytest.approx(wanted, rel=1e-5, abs=0)
    assert plain.values.any() and not half.values[half_mask() == 0].any()


def test_voxels_that_the_mask_leaves_out_are_no_unknowns(monkeypatch):
    """Of an octave, whose voxels are twice as large, those whose centres the mask reaches."""
    seen = recorded(monkeypatch)
    run_core([masked(half_mask())], quick_config(**COLOUR))
    fine = int(np.count_nonzero(DENSITY[6:]))
    assert [len(colours) for colours in seen][1] == fine < np.count_nonzero(DENSITY)
    blocks = DENSITY.reshape(6, 2, 6, 2, 6, 2).sum(axis=(1, 3, 5))  # centred at 2 m + 1/2
    assert len(seen[0]) == np.count_nonzero(blocks[3:])


@pytest.mark.parametrize("place", ["of zeros", "elsewhere", "empty"])
def test_a_mask_that_leaves_no_smoke_leaves_the_frame_out_with_its_reason(place, monkeypatch):
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("features were asked for without need")

    monkeypatch.setattr(StyleTargets, "at", refuse)
    frame = {
        "of zeros": masked(np.zeros(DENSITY.shape)),
        "elsewhere": masked(np.ones((3, 3, 3)), ijk_min=(100, 0, 0)),
        "empty": masked(np.zeros((0, 0, 0))),
    }[place]
    result = run_core([frame])[0]
    assert result.density is frame.density and result.emission is not None
    assert result.emission.values.shape == (*DENSITY.shape, 3)
    assert not result.emission.values.any()
    assert "mask" in result.report.left_out


def test_values_beyond_the_range_are_clamped_with_a_warning():
    values = np.ones(DENSITY.shape)
    values[2, 3, 4], values[0, 0, 0], values[6, 6, 6] = 1.5, 7.0, 1e6
    config = quick_config(losses={"statistic": "gram"}, **COLOUR)
    plain, result = (run_core([frame], config)[0] for frame in (FRAME, masked(values, FRAME)))
    (warning,) = result.report.warnings
    assert warning.startswith('3 values of the mask "fade" at timeCode 1 are not between 0 and 1')
    assert_close(result.emission, plain.emission, 5e-4 * plain.emission.values.max())


def test_a_mask_of_hardly_any_smoke_is_told():
    values = np.zeros(DENSITY.shape)
    values[4, 4, 4] = 1.0
    (result,) = run_core([masked(values, FRAME)], quick_config(**COLOUR))
    (warning,) = result.report.warnings
    assert "selects" in warning and "place" in warning


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_mask_that_is_not_finite_is_refused_by_time_code_and_name(bad):
    values = np.ones(DENSITY.shape)
    values[0, 0, 0] = bad
    with pytest.raises(NonFiniteError, match=r'1.*"fade" at timeCode 1 .*repair_nan'):
        run_core([masked(values)], scene=Scene(1.0, 1.0, 1.0, "Y", 1.0, 16))


def test_a_mask_s_background_that_is_not_finite_is_refused_too():
    with pytest.raises(NonFiniteError, match=r'1.*"fade" at timeCode 1 '):
        run_core([masked(np.ones((3, 3, 3)), ijk_min=(4, 4, 4), background=np.nan)])


def test_masked_smoke_still_hides_what_is_behind_it(monkeypatch):
    """The pictures' maps keep the whole smoke's weights at the voxels that are painted; those of
    the back alone, without the unpainted front, would be much larger."""
    made: list[Any] = []
    real = colour.prepare_views

    def noted(*args: Any) -> Any:
        views = real(*args)
        made.append((args, views))
        return views

    monkeypatch.setattr(colour, "prepare_views", noted)
    config = quick_config(
        colour={"iterations": [1]}, optics={"depth": 20.0},
        views={"pool": 2, "image_size": 16, "azimuth": 12, "elevation": 6}, **COLOUR,
    )  # fmt: skip
    back = half_mask().T[..., ::-1]  # seen along -Z
    run_core([masked(back)], config)
    ((smoke, views, gamma_w, exposure, shown, *_), (view, *_)) = made[0]
    assert len(smoke.ijk) == np.count_nonzero(DENSITY)
    whole = real(smoke, views, gamma_w, exposure)[0]
    assert torch.allclose(
        view.image.apply(torch.ones(int((shown > 0).sum()), 1)),
        whole.image.apply(shown[:, None].float()),
        atol=1e-6,
    )
    alone = smoke.take(shown > 0)
    seen = real(alone, views, gamma_w, exposure, shown[shown > 0])[0].alpha
    assert 0 < float(view.alpha.sum()) < 0.3 * float(seen.sum())


def test_a_frame_that_its_mask_leaves_out_in_the_middle_does_not_break_the_window():
    """Time runs on: the colours of the first frame are at their places two frames later."""
    config = quick_config(colour={"iterations": [0]}, **COLOUR)
    velocity = np.array([24.0, 0.0, 0.0])  # a voxel a frame
    moving = [frame_of(DENSITY, 1.0 + k, velocity, ijk_min=(k, 0, 0)) for k in range(3)]
    frames = [
        masked(np.full(DENSITY.shape, k != 1), frame, ijk_min=frame.density.ijk_min)
        for k, frame in enumerate(moving)
    ]
    first, middle, last = run_core(frames, config)
    assert "mask" in middle.report.left_out
    assert not middle.emission.values.any() and middle.density is frames[1].density
    assert last.emission.values == pytest.approx(first.emission.values, abs=1e-4)
    assert by_voxel(first.emission)


@pytest.mark.parametrize("steps", [["shape", "colour"], ["colour"]])
def test_a_mask_that_opens_paints_smoke_whose_neighbours_were_not(steps):
    """From frame to frame, with what the frame before had not painted starting as noise."""
    config = quick_config(optimize={"steps": steps, "threads": 1})
    frames = [
        masked(np.broadcast_to((np.arange(12) >= low)[:, None, None], DENSITY.shape), frame)
        for low, frame in ((9, FRAME), (0, frame_of(DENSITY, 2.0)), (9, frame_of(DENSITY, 3.0)))
    ]
    first, second, third = run_core(frames, config)
    for result, low in ((first, 9), (second, 0), (third, 9)):
        found = by_voxel(result.emission)
        assert found.keys() == {v for v in by_voxel(result.density) if v[0] >= low}
        assert np.isfinite(result.emission.values).all()


@pytest.mark.parametrize("mask", [None, np.ones((12, 12, 12))])
def test_there_is_no_light_where_there_is_no_density(mask):
    """Bit for bit, wherever smoke has moved to: the guidance mask is applied to the result."""
    config = quick_config(shape={"iterations": [4], "learning_rate": 1.0, "reach": 0.1})
    result = run_core([FRAME if mask is None else masked(mask)], config)[0]
    assert result.emission.values.shape[:3] == result.density.values.shape
    assert not result.emission.values[result.density.values == 0].any()
    assert result.emission.values[result.density.values > 0].any(axis=-1).mean() > 0.99


def test_the_extinction_is_the_whole_smoke_s_and_not_the_mask_s():
    frames = [FRAME, masked(half_mask())]
    scenes = [scene_of([frame], quick_config(), "Y") for frame in frames]
    assert scenes[0] == scenes[1]


def test_a_mask_that_slides_over_resting_smoke_is_no_flicker():
    """Only smoke that both masks select is compared, in displacement as in colour."""
    density, frames = puff(20), []
    for number in range(3):
        mask = np.zeros_like(density)
        mask[4 + 3 * number : 10 + 3 * number] = 1
        frames.append(masked(mask, frame_of(density, 1.0 + number)))
    config = quick_config(shape={"iterations": [8], "reach": 0.05}, colour={"iterations": [8]})
    _, *later = run_core(frames, config)
    assert all(0 < result.report.temporal.displacement < 0.6 for result in later)
