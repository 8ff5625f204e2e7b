"""The projection of voxels as a linear map: adjoints, opacity, places, and what is not there."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.fixtures.camera_fixtures import camera_picture
from tests.fixtures.smoke_fixtures import affine, puff, smoke_of
from usdsmoke.core.fields import sparse_image
from usdsmoke.core.fields.sparse_image import SparseImage
from usdsmoke.core.smoke.active import ActiveSmoke
from usdsmoke.core.views import project
from usdsmoke.core.views.cameras import View, orbit_view
from usdsmoke.core.views.optics import MOST_CELLS, Slabs
from usdsmoke.core.views.project import Shown, colour_map, column_map

KINDS = ["orthographic", "perspective"]
PLACES = [(0, False), (1, False), (2, True), (3, True)]  # seeds of transforms, mirrored or not


def middle(smoke: ActiveSmoke) -> np.ndarray:
    return smoke.positions.mean(0).numpy()


def look_at(smoke: ActiveSmoke, kind: str, size: int = 20) -> View:
    view = orbit_view(33.0, 14.0, "Y", middle(smoke), size, size + 3, 1.1)
    if kind == "orthographic":
        return view
    axes = np.eye(4)
    axes[:3, :3] = np.stack([view.right, view.up, -view.forward])
    axes[3, :3] = middle(smoke) - 25.0 * view.forward
    return camera_picture(axes, 50.0, 45.0, size, size + 3)


def maps_of(smoke: ActiveSmoke, view: View, gamma_w: float = 0.3) -> list[SparseImage]:
    columns = column_map(smoke.positions, smoke.edges, view, torch.float64)
    density = smoke.density.double()
    colours, _ = colour_map(smoke.positions, density, smoke.edges, gamma_w, view, smoke.voxel_size)
    return [columns, colours]


def random(*shape: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(*shape, generator=generator, dtype=torch.float64) - 0.5


@pytest.mark.parametrize(("seed", "mirrored"), PLACES)
@pytest.mark.parametrize("kind", KINDS)
def test_adjoint_is_exact_in_any_view_and_transform(kind, seed, mirrored):
    smoke = smoke_of(puff(9), affine(seed, mirrored))
    for image in maps_of(smoke, look_at(smoke, kind)):
        x, y = random(len(smoke.ijk), 3), random(image.height, image.width, 3, seed=1)
        seen = image.apply(x)
        left, right = (seen * y).sum(), (x * image.adjoint(y)).sum()
        assert float((left - right).abs()) <= 1e-12 * float((seen * y).abs().sum())
        assert float(seen.abs().max()) > 1e-3


@pytest.mark.parametrize("most", [3, 1000])
def test_a_picture_is_added_up_from_parts_of_the_voxels(most, monkeypatch):
    smoke = smoke_of(puff(9), affine(0))
    monkeypatch.setattr(sparse_image, "MOST_SUMS", most)
    for image in maps_of(smoke, look_at(smoke, "orthographic")):
        x = random(len(smoke.ijk), 3)
        whole = image.apply(x)
        with monkeypatch.context() as parts:
            parts.setattr(sparse_image, "SCATTERED_ROWS", 50)
            assert torch.allclose(image.apply(x), whole, rtol=1e-12, atol=1e-14)


def test_autograd_goes_through_the_same_adjoint():
    smoke = smoke_of(puff(9))
    for image in maps_of(smoke, look_at(smoke, "orthographic")):
        x = random(len(smoke.ijk), 2).requires_grad_()
        y = random(image.height, image.width, 2, seed=1)
        (gradient,) = torch.autograd.grad((image.apply(x) * y).sum(), x)
        assert torch.equal(gradient, image.adjoint(y))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("gamma_w", [1e-12, 0.01, 1.0, 1e6])
def test_white_smoke_gives_its_opacity_and_that_is_one_minus_what_passes(gamma_w, kind):
    smoke = smoke_of(puff(9), affine(1))
    view = look_at(smoke, kind)
    image, alpha = colour_map(
        smoke.positions, smoke.density, smoke.edges, gamma_w, view, smoke.voxel_size
    )
    columns = column_map(smoke.positions, smoke.edges, view).apply(smoke.density[:, None])
    wanted = -torch.expm1(-gamma_w * columns[..., 0])
    white = image.apply(torch.ones(len(smoke.ijk), 3))
    assert torch.allclose(alpha, wanted, rtol=1e-5, atol=1e-6)
    if gamma_w > 1e-6:  # a picture this faint counts as empty
        assert torch.allclose(white, wanted[..., None].expand_as(white), rtol=1e-5, atol=1e-6)
    assert float(alpha.min()) >= 0 and float(alpha.max()) <= 1 and float(alpha.max()) > 0


@pytest.mark.parametrize("up_axis", ["Y", "Z"])
def test_a_turn_of_90_degrees_on_a_cube_is_exact(up_axis):
    """The turned view of the array is the straight view of the turned array."""
    density = puff(10)
    axes = (0, 2) if up_axis == "Y" else (1, 0)
    turned = np.ascontiguousarray(np.rot90(density, 1, axes))
    pictures = []
    for values, azimuth in ((density, 0), (density, 90), (turned, 0), (density, 360)):
        smoke = smoke_of(values)
        view = orbit_view(azimuth, 0.0, up_axis, np.full(3, 4.5), 12, 12, 1.0)
        image = column_map(smoke.positions, np.eye(3), view, torch.float64)
        pictures.append(image.apply(smoke.density.double()[:, None]))
    straight, quarter, straight_of_turned, full = pictures
    assert torch.allclose(full, straight, atol=1e-12)
    assert torch.allclose(quarter, straight_of_turned, atol=1e-12)
    assert not torch.allclose(quarter, straight, atol=1e-2)


def test_smoke_far_from_the_origin_gives_the_same_picture():
    density, matrix = puff(9), np.diag([0.01, 0.01, 0.01, 1.0])
    far = matrix.copy()
    far[3, :3] = [1e6, -2e6, 3e6]
    near_smoke, far_smoke = smoke_of(density, matrix), smoke_of(density, far)
    pictures = []
    for smoke in (near_smoke, far_smoke):
        centre = smoke.index_to_stage[3, :3] + 0.04
        view = orbit_view(20.0, 10.0, "Y", centre, 16, 16, 0.01)
        image, _ = colour_map(smoke.positions, smoke.density, smoke.edges, 30.0, view, 0.01)
        pictures.append(image.apply(torch.ones(len(smoke.ijk), 3)))
    assert torch.allclose(pictures[0], pictures[1], atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_no_smoke_gives_an_empty_picture(kind):
    view = look_at(smoke_of(puff(9)), kind)
    nothing = torch.zeros(0, 3, dtype=torch.float64)
    columns = column_map(nothing, np.eye(3), view).apply(torch.zeros(0, 1))
    image, alpha = colour_map(nothing, torch.zeros(0), np.eye(3), 1.0, view, 1.0)
    assert columns.shape == (20, 23, 1) and not columns.any()
    assert alpha.shape == (20, 23) and not alpha.any()
    assert not image.apply(torch.zeros(0, 3)).any()
    assert image.adjoint(torch.ones(20, 23, 3)).shape == (0, 3)


def test_voxels_behind_or_at_the_eye_are_not_seen_and_change_nothing():
    smoke = smoke_of(puff(9))
    view = look_at(smoke, "perspective")
    behind = torch.from_numpy(view.centre - np.outer([1e-9, 0.1, 50.0], view.forward))
    positions = torch.cat([smoke.positions, torch.from_numpy(view.centre)[None], behind])
    density = torch.cat([smoke.density, torch.full((4,), 1e3)])
    pictures = []
    for place, values in ((smoke.positions, smoke.density), (positions, density)):
        image, alpha = colour_map(place, values, np.eye(3), 0.5, view, 1.0)
        pictures.append((image.apply(torch.ones(len(values), 3)), alpha))
    for alone, together in zip(*pictures, strict=True):
        assert torch.equal(alone, together)
        assert torch.isfinite(together).all()


def test_only_voxels_behind_the_eye_give_an_empty_finite_picture():
    view = look_at(smoke_of(puff(9)), "perspective")
    behind = torch.from_numpy(view.centre - np.outer([0.0, 1.0], view.forward))
    image, alpha = colour_map(behind, torch.ones(2), np.eye(3), 1.0, view, 1.0)
    assert not alpha.any() and not image.apply(torch.ones(2, 3)).any()
    assert not column_map(behind, np.eye(3), view).apply(torch.ones(2, 1)).any()


def test_what_lies_outside_the_image_is_left_out_of_both_directions():
    view = orbit_view(0.0, 0.0, "Y", np.zeros(3), 4, 4, 1.0)
    positions = torch.tensor([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [1.9, 0.0, 0.0]]).double()
    image = column_map(positions, np.eye(3), view, torch.float64)
    back = image.adjoint(torch.ones(4, 4, 1, dtype=torch.float64))
    assert back.flatten().tolist() == pytest.approx(
        [1.0, 0.0, 0.6]
    )  # 2/5 of the last falls outside


def test_the_front_hides_the_back_and_turns_with_the_view():
    positions = torch.tensor([[0.0, 0.0, 3.0], [0.0, 0.0, -3.0]]).double()
    colours = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for azimuth, front in ((0.0, 0), (180.0, 2)):
        view = orbit_view(azimuth, 0.0, "Y", np.zeros(3), 1, 1, 1.0)
        image, _ = colour_map(positions, torch.full((2,), 50.0), np.eye(3), 1.0, view, 1.0)
        picture = image.apply(colours)[0, 0]
        assert float(picture[front]) == pytest.approx(1.0) and float(picture.sum()) <= 1.0 + 1e-6


@pytest.mark.parametrize("share", [1.0, 0.25])
def test_smoke_that_is_not_shown_hides_what_is_behind_it_and_gives_no_light(share):
    """Two voxels in one column: the hind one is seen through exp(-t) of the front one, and the map
    has but one voxel."""
    positions = torch.tensor([[0.0, 0.0, 3.0], [0.0, 0.0, -3.0]]).double()
    density = torch.tensor([0.8, 1.7], dtype=torch.float64)
    view = orbit_view(0.0, 0.0, "Y", np.zeros(3), 1, 1, 1.0)
    shown = torch.tensor([0.0, share])
    image, alpha = colour_map(positions, density, np.eye(3), 0.9, view, 1.0, Shown(shown))
    wanted = share * np.exp(-0.9 * 0.8) * -np.expm1(-0.9 * 1.7)
    assert float(alpha) == pytest.approx(wanted, rel=1e-12)
    colour = torch.tensor([[0.2, 1.0, 0.5]], dtype=torch.float64)
    assert image.apply(colour)[0, 0].tolist() == pytest.approx((wanted * colour[0]).tolist())
    assert image.adjoint(torch.ones(1, 1, 1).double()).shape == (1, 1)
    _, front = colour_map(positions, density, np.eye(3), 0.9, view, 1.0, Shown(shown.flip(0)))
    assert float(front) == pytest.approx(share * -np.expm1(-0.9 * 0.8), rel=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_shown_is_linear_in_the_share_and_everything_shown_is_the_plain_picture(kind):
    smoke = smoke_of(puff(9), affine(1))
    view, density = look_at(smoke, kind), smoke.density.double()
    share, colours = random(len(smoke.ijk)) + 0.5, random(len(smoke.ijk), 3, seed=1)

    def picture(shown: Tensor | None) -> tuple[Tensor, Tensor]:
        image, alpha = colour_map(
            smoke.positions, density, smoke.edges, 0.3, view, smoke.voxel_size, Shown(shown)
        )
        chosen = colours if shown is None else colours[shown > 0]
        return image.apply(chosen), alpha

    whole, one, part, rest = (picture(s) for s in (None, share * 0 + 1, share, 1 - share))
    for n in range(2):
        assert torch.allclose(one[n], whole[n], atol=1e-8)
        assert torch.allclose(part[n] + rest[n], whole[n], atol=1e-8)
    nothing, alpha = picture(torch.zeros_like(share))
    assert not nothing.any() and not alpha.any()


def test_two_voxels_a_million_apart_take_no_memory_for_the_emptiness_between(monkeypatch):
    positions = torch.tensor([[0.0, 0.0, 0.0], [1e6, 0.0, 1e6]]).double()
    view = orbit_view(0.0, 0.0, "Y", np.array([5e5, 0.0, 5e5]), 4, 64, 2e4)
    cells = []

    def counted(slabs, light_up=Slabs.light_up):
        cells.append(slabs.values.numel())
        light_up(slabs)

    monkeypatch.setattr(Slabs, "light_up", counted)
    monkeypatch.setattr("usdsmoke.core.views.optics.MOST_CELLS", MOST_CELLS // 1000)
    image, alpha = colour_map(positions, torch.full((2,), 1e10), np.eye(3), 1.0, view, 1.0)
    assert 64 * 4 < max(cells) <= MOST_CELLS // 1000 + 2 * 4 * 64
    assert 0.9 < float(alpha.max()) <= 1.0
    assert torch.count_nonzero(image.adjoint(torch.ones(4, 64, 1))) == 2


@pytest.mark.parametrize("density", [1e-30, 1e30, 3e38])
@pytest.mark.parametrize("gamma_w", [1e-30, 1.0, 1e30])
def test_extreme_densities_and_extinctions_give_finite_pictures_and_gradients(density, gamma_w):
    smoke = smoke_of(np.full((3, 3, 3), density))
    view = orbit_view(20.0, 10.0, "Y", np.ones(3), 8, 8, 1.0)
    image, alpha = colour_map(smoke.positions, smoke.density, np.eye(3), gamma_w, view, 1.0)
    picture = image.apply(torch.ones(27, 3))
    assert torch.isfinite(alpha).all() and torch.isfinite(picture).all()
    assert torch.isfinite(image.adjoint(torch.ones_like(picture))).all()
    assert float(picture.max()) <= 1.0 + 1e-5
    if density * gamma_w > 1e6:
        assert float(alpha.max()) == 1.0


@pytest.mark.parametrize("kind", KINDS)
def test_working_in_pieces_gives_the_same_pictures(kind, monkeypatch):
    smoke = smoke_of(puff(12), affine(2, True))
    view, density = look_at(smoke, kind), smoke.density.double()
    share = (random(len(smoke.ijk)) + 0.2).clamp_min(0)

    def made() -> list[Tensor]:
        columns = column_map(smoke.positions, smoke.edges, view, torch.float64)
        image, alpha = colour_map(
            smoke.positions, density, smoke.edges, 0.3, view, smoke.voxel_size, Shown(share)
        )
        colours = random(image.n_voxels, 3)
        return [columns.apply(density[:, None]), image.apply(colours), image.rows, alpha]

    whole = made()
    assert len(density) > 5 * 37
    monkeypatch.setattr(project, "CHUNK_ROWS", 37)
    monkeypatch.setattr("usdsmoke.core.views.optics.CHUNK_CELLS", 100)
    for one, other in zip(whole, made(), strict=True):
        assert torch.allclose(one, other, rtol=1e-12, atol=1e-14)


def test_sums_over_sorted_runs_are_those_entry_by_entry():
    """A GPU takes the runs; here both are at hand."""
    smoke = smoke_of(puff(9), affine(2, True))
    view = look_at(smoke, "perspective")
    for image in maps_of(smoke, view):
        values = random(len(smoke.ijk), 2).double()
        voxel, by_pixel, start = image.runs
        summed = torch.nn.functional.embedding_bag(
            voxel, values, start, mode="sum", per_sample_weights=by_pixel.double()
        )
        exact = replace(image, weight=image.weight.double())
        assert torch.allclose(exact.apply(values).view(-1, 2), summed, rtol=1e-12, atol=1e-14)
        assert len(voxel) == int((image.weight != 0).sum())


@pytest.mark.parametrize("kind", KINDS)
def test_without_faint_voxels_the_picture_lacks_their_light_alone(kind):
    smoke = smoke_of(puff(12), affine(1))
    view, share = look_at(smoke, kind), 1e-3
    place = smoke.positions, smoke.density, smoke.edges, 3.0, view, smoke.voxel_size
    image, alpha = colour_map(*place)
    left, same = colour_map(*place, Shown(faint=share))
    assert torch.equal(same, alpha)
    white = torch.ones(len(smoke.ijk), 1)
    before, after = (of.apply(white)[..., 0] for of in (image, left))
    assert 0.1 * len(image.rows) < len(left.rows) < 0.9 * len(image.rows)
    assert (after <= before + 1e-6).all()
    gone = ~torch.isin(image.rows, left.rows)
    light = torch.bincount(
        image.pixel[gone].reshape(-1), image.weight[gone].reshape(-1), minlength=before.numel()
    )
    assert torch.allclose(before - after, light.view(before.shape), atol=1e-5)
    kept, total = left.total_weights(), image.total_weights()
    assert torch.equal(kept[left.rows], total[left.rows])
    assert (kept[image.rows[gone]] == 0).all()
    assert (image.weight[gone].amax(1) <= 2 * share * alpha.max()).all()


@pytest.mark.parametrize("kind", KINDS)
def test_voxels_are_faint_beside_what_is_painted_of_their_pixel(kind):
    smoke = smoke_of(puff(12), affine(1))
    place = smoke.positions, smoke.density, smoke.edges, 3.0, look_at(smoke, kind), 1.0
    one, part = torch.ones(len(smoke.ijk)), (torch.arange(len(smoke.ijk)) % 3 > 0).double()
    (whole, _), (same, _) = (colour_map(*place, Shown(share, 1e-3)) for share in (None, one))
    assert torch.equal(whole.rows, same.rows)
    masked, alpha = colour_map(*place, Shown(1e-5 * part, 1e-3))
    again, more = colour_map(*place, Shown(part, 1e-3))
    assert torch.allclose(alpha, 1e-5 * more) and torch.equal(masked.rows, again.rows)
    complete, _ = colour_map(*place, Shown(part))
    assert torch.allclose(more, complete.apply(torch.ones(int(part.sum()), 1))[..., 0])
